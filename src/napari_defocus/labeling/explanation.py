"""Why a map says what it says at one pixel: the curve log p(r) of its window, told and drawn."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.core.checks import check_flag, check_real
from napari_defocus.core.image import PreparedImage, given_array, given_image, prepare_image
from napari_defocus.labeling.confidence import tolerance
from napari_defocus.labeling.data_term import EXTRAPOLATED
from napari_defocus.likelihood.candidates import BlurCandidates, check_candidates, check_place
from napari_defocus.likelihood.evidence import evidence_share
from napari_defocus.likelihood.own_side import asked_windows
from napari_defocus.settings import CONFIDENT

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Float64 = NDArray[np.floating]
Box = tuple[float, float, float, float]

FLOOR = -20.0
"""How far below its maximum log p(r) is drawn: 2e-9 times as likely."""

_NEARLY = 1.0
"""Answers that differ by less, in log p(r), are nearly as likely: by a factor of 2.7."""

_NEIGHBORS = 32
"""px around a place whose windows are looked at: averaged curves reach no farther."""
_DETAILS = 8
"""How far, in px, averaged curves and filtered details see; see `evidence`."""

_CURVE_COLOR, _OWN_COLOR, _MAP_COLOR = "#3d9be9", "#e8702a", "#2ca58d"
"""Told apart on dark and on light, and by people who see less red or green."""


@dataclass(frozen=True, eq=False)
class PixelExplanation:
    """What is known about the blur of one pixel, and what a map made of it.

    ``str()`` tells it in a few lines.

    Attributes
    ----------
    row, column : float
        The place, in px.
    scales : (L,) float64 ndarray
        In px.
    log_likelihood : (L,) float64 ndarray
        log p(r) of the pixel's window, relative to its maximum; 0 at most.
    radii, heights : (n,) float64 ndarray
        The candidates, in px, at most 3, best first, and their log p(r), relative to the same
        maximum.
    window : (float, float, float, float)
        Top, left, bottom and right edge of the window, in px, see `BlurCandidates.window_at`.
    evidence : float
        How much texture there is around, from 0 to 1; below 0.5 a map is extrapolated.
    scale_name : str
        What the scale measures, with its unit.
    blur : float or None
        The map's value, in px; None if no map was given or it has none here.
    confidence : float or None
        From 0 to 1; None if it was not given or is not known here.
    own_log_likelihood : (L,) float64 ndarray or None
        The curve that the labelling took instead, relative to its own maximum: that of a
        window which lies more on the pixel's side of an edge. None if it took the pixel's
        own, or no image was given.
    own_window : (float, float, float, float) or None
        Where that window is.
    """

    row: float
    column: float
    scales: Float64
    log_likelihood: Float64
    radii: Float64
    heights: Float64
    window: Box
    evidence: float
    scale_name: str
    blur: float | None = None
    confidence: float | None = None
    own_log_likelihood: Float64 | None = None
    own_window: Box | None = None

    @property
    def best(self) -> float | None:
        """The likeliest scale in px, by the curve that the labelling took; None without one."""
        if self.own_log_likelihood is not None:
            return float(self.scales[self.own_log_likelihood.argmax()])
        return float(self.radii[0]) if len(self.radii) else None

    @property
    def carried_in(self) -> bool:
        """The old name of `extrapolated`."""
        warnings.warn("carried_in is called extrapolated now", FutureWarning, stacklevel=2)
        return self.extrapolated

    @property
    def extrapolated(self) -> bool:
        """Whether there is too little texture to know, and a map has its value from around."""
        return self.evidence < EXTRAPOLATED or not len(self.radii)

    def __str__(self) -> str:
        return "\n".join([self.summary(), *self.remarks()])

    def summary(self) -> str:
        """Return the map's value and its confidence, or the likeliest blur if there is no map."""
        if self.blur is not None:
            sure = "" if self.confidence is None else f", with a confidence of {self._sure()}"
            return f"The blur is {_px(self.blur)} px{sure}."
        if self.best is None:
            return "Nothing here tells the blur."
        return f"The likeliest blur is {_px(self.best)} px."

    def _sure(self) -> str:
        """Return the confidence, never rounded up to one that is trusted."""
        assert self.confidence is not None
        if self.confidence >= CONFIDENT:
            return f"{self.confidence:.2f}"
        return f"{math.floor(100 * self.confidence) / 100:.2f} (not trusted)"

    def remarks(self) -> list[str]:
        """Return what is to be said about the curve and the map, a sentence or two each."""
        told = [*self._on_evidence(), *self._on_map()]
        if not told and self.confidence is not None and self.confidence < CONFIDENT:
            told.append("Where pictures looked like this in tests, maps were often wrong.")
        return told

    def _on_evidence(self) -> Iterator[str]:
        if self.extrapolated:
            yield "There is too little texture here to tell the blur."
            if self.blur is not None:
                yield "The map has its value from the surroundings."
            return
        if self.own_window is not None:
            top, left, bottom, right = self.own_window
            yield (
                "The fine details in this frame lie on the other side of an edge. So the frame "
                f"around row {(top + bottom) / 2:.0f}, column {(left + right) / 2:.0f} was asked: "
                f"its answer is {_px(self.best)} px."
            )
            return
        yield from self._on_other_answers()

    def _on_other_answers(self) -> Iterator[str]:
        for radius, height in zip(self.radii[1:], self.heights[1:], strict=True):
            below = self.heights[0] - height
            if below < _NEARLY and abs(radius - self.radii[0]) > _tolerance(radius):
                yield (
                    f"The next best answer, {_px(radius)} px, is {math.exp(-below):.2f} times as "
                    f"likely as the best one, {_px(self.radii[0])} px."
                )
                return
        nearly = self.scales[self.log_likelihood > -_NEARLY]
        if nearly.size and np.ptp(nearly) > 2 * _tolerance(nearly.mean()):
            yield (
                f"Seen alone, this place may have any blur from {_px(nearly[0])} to "
                f"{_px(nearly[-1])} px."
            )

    def _on_map(self) -> Iterator[str]:
        if self.blur is None:
            return
        best = self.best
        if best is not None and not self.extrapolated and abs(self.blur - best) > _tolerance(best):
            alone = f"Seen alone, its likeliest blur is {_px(best)} px. "
            yield (
                f"{alone if self.own_window is None else ''}The map has {_px(self.blur)} px, "
                "because that fits the places around it better."
            )
        if self.blur > self.scales[-2]:
            yield f"No blur beyond {_px(self.scales[-1])} px was looked for: it may be wider."


def explain_pixel(
    candidates: BlurCandidates,
    row: float,
    column: float,
    *,
    blur_map: ArrayLike | None = None,
    confidence: ArrayLike | None = None,
    image: ArrayLike | None = None,
    intensity_range: tuple[float, float] | None = None,
) -> PixelExplanation:
    """Tell what is known about the blur of one pixel: the paper's Fig. 6, and what came of it.

    Only the surroundings are looked at: it takes milliseconds, whatever the picture's size.

    Parameters
    ----------
    candidates : BlurCandidates
        From `estimate_candidates`.
    row, column : float
        A place in the picture, in px.
    blur_map : (H, W) array_like, optional
        From `label_blur_map` with these candidates, in px.
    confidence : (H, W) array_like, optional
        From `confidence_map`.
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like, optional
        The picture that the candidates came from. With it, it is also told whether the
        labelling took the curve of another window, see `PixelExplanation`.
    intensity_range : (float, float), optional
        The intensities that count as 0 and 1; those of `candidates` if left out.

    Returns
    -------
    PixelExplanation

    Raises
    ------
    TypeError
        If `image` has no real dtype.
    ValueError
        If the place is outside the picture, or `blur_map`, `confidence` or `image` has another
        height and width than the picture of `candidates`.

    Examples
    --------
    >>> import numpy as np
    >>> from skimage.data import gravel
    >>> from napari_defocus import estimate_candidates, explain_pixel, simulate_defocus
    >>> picture = simulate_defocus(gravel()[:100, :100], np.full((100, 100), 3.0))
    >>> explanation = explain_pixel(estimate_candidates(picture), 50, 50)
    >>> round(explanation.best)
    3
    >>> explanation.log_likelihood.shape
    (81,)
    """
    check_candidates(candidates)
    check_place(row, column, candidates.image_shape)
    values = {"blur_map": blur_map, "confidence": confidence}
    known = {
        name: _value_at(name, given, candidates, row, column) for name, given in values.items()
    }
    i, j = candidates.nearest_window(row, column)
    curve = candidates.curve[i, j].astype(np.float64)
    present = np.isfinite(candidates.radii[i, j])
    heights = candidates.log_likelihoods[i, j][present].astype(np.float64)
    top = max([float(curve.max()), *heights])
    own = None if image is None else _own_side(candidates, image, intensity_range, (i, j))
    return PixelExplanation(
        row=float(row),
        column=float(column),
        scales=candidates.scales,
        log_likelihood=curve - top,
        radii=candidates.radii[i, j][present].astype(np.float64),
        heights=heights - top,
        window=candidates.window_at(row, column),
        evidence=_evidence_at(candidates, (i, j)),
        scale_name=candidates.psf.scale_name,
        blur=known["blur_map"],
        confidence=known["confidence"],
        own_log_likelihood=None if own is None else own[0],
        own_window=None if own is None else own[1],
    )


def draw_explanation(
    explanation: PixelExplanation, axes: Axes, *, floor: float = FLOOR, legend: bool = True
) -> None:
    """Draw the curve of one pixel, its candidates, and what the map says.

    Parameters
    ----------
    explanation : PixelExplanation
        From `explain_pixel`.
    axes : matplotlib.axes.Axes
        Empty axes.
    floor : float, optional
        How far down log p(r) is shown, below 0.
    legend : bool, optional
        Whether to say what is what.

    Examples
    --------
    >>> import numpy as np
    >>> from matplotlib.figure import Figure
    >>> from skimage.data import gravel
    >>> from napari_defocus import estimate_candidates, explain_pixel
    >>> axes = Figure().subplots()
    >>> draw_explanation(explain_pixel(estimate_candidates(gravel()[:60, :60]), 30, 30), axes)
    >>> axes.get_xlabel()
    'blur radius (px)'
    """
    check_flag("legend", legend)
    if not isinstance(explanation, PixelExplanation):
        raise TypeError(f"explanation is {explanation!r}; it takes what explain_pixel returns")
    check_real("floor", floor, "a finite number below 0")
    if not -math.inf < floor < 0:
        raise ValueError(f"floor is {floor}; it takes a finite number below 0")
    if not hasattr(axes, "plot"):
        raise TypeError(f"axes is {axes!r}; it takes axes of matplotlib")
    told = explanation
    moved = told.own_log_likelihood is not None
    axes.plot(
        *(told.scales, told.log_likelihood),
        color=_CURVE_COLOR,
        lw=1.0 if moved else 1.6,
        ls="--" if moved else "-",
        label="this window" if moved else "log p(r)",
    )
    if told.own_log_likelihood is not None:
        asked = "the window that is asked"
        axes.plot(told.scales, told.own_log_likelihood, color=_OWN_COLOR, lw=1.6, label=asked)
    if len(told.radii):
        dots = told.radii, np.maximum(told.heights, floor)
        axes.plot(*dots, "o", color=_CURVE_COLOR, ms=6, clip_on=False, zorder=3, label="candidates")
    if told.blur is not None:
        axes.axvline(told.blur, color=_MAP_COLOR, lw=1.6, label="map")
        band = told.blur - _tolerance(told.blur), told.blur + _tolerance(told.blur)
        axes.axvspan(*band, color=_MAP_COLOR, alpha=0.2, lw=0)
    axes.set(
        xlim=(0, told.scales[-1]),
        ylim=(floor, -floor / 20),
        xlabel=told.scale_name,
        ylabel="how likely: log p(r), 0 at the best",
        title=_title(told),
    )
    if legend:
        axes.legend(loc="lower right", fontsize="small", framealpha=0.6)


def _title(told: PixelExplanation) -> str:
    value = "" if told.blur is None else f": {_px(told.blur)} px"
    sure = "" if told.confidence is None else f", confidence {told.confidence:.2f}"
    return f"row {told.row:.0f}, column {told.column:.0f}{value}{sure}"


def _tolerance(scale: float) -> float:
    return float(tolerance(np.array(scale)))


def _px(scale: Any) -> str:
    """Write a scale; 0.25 px stands for all that cannot be told from a point."""
    return f"{scale:.2f}" if 0 < scale < 0.5 else f"{scale:.1f}"


def _value_at(
    name: str, given: ArrayLike | None, candidates: BlurCandidates, row: float, column: float
) -> float | None:
    """Return the value of a map at a place; None where it has none."""
    if given is None:
        return None
    values = given_array(name, given)
    if values.shape != candidates.image_shape:
        raise ValueError(
            f"{name} has shape {values.shape}; it takes the picture's, {candidates.image_shape}"
        )
    value = float(values[round(row), round(column)])
    return value if math.isfinite(value) else None


def _evidence_at(candidates: BlurCandidates, place: tuple[int, int]) -> float:
    """Return `evidence_share` at one window, from as many windows as it depends on."""
    around, first = _around(candidates, place, math.ceil(_NEIGHBORS / candidates.stride) + 1)
    return float(evidence_share(around)[place[0] - first[0], place[1] - first[1]])


def _own_side(
    candidates: BlurCandidates,
    image: ArrayLike,
    intensity_range: tuple[float, float] | None,
    place: tuple[int, int],
) -> tuple[Float64, Box] | None:
    """Return the curve that `on_own_side` gives to one window, and where it comes from.

    None if it leaves the window its own. It is called on a cut-out that has all that it sees.
    """
    array = given_image("image", image)
    if array.shape[:2] != candidates.image_shape:
        raise ValueError(
            f"image has shape {array.shape}; these candidates are of a picture of "
            f"{candidates.image_shape[0]} x {candidates.image_shape[1]} px"
        )
    # It smooths over 0.7 sides of a window, takes a slope, and moves by half a side at most.
    around, first = _around(candidates, place, math.ceil(candidates.window / candidates.stride) + 2)
    at = place[0] - first[0], place[1] - first[1]
    asked = asked_windows(*_with_picture(around, array, intensity_range))
    row, column = (int(index[at]) for index in asked)
    if (row, column) == at:
        return None
    curve = around.curve[row, column].astype(np.float64)
    taken = around.row_centers[row], around.column_centers[column]
    return curve - curve.max(), candidates.window_at(*taken)


def _around(
    candidates: BlurCandidates, place: tuple[int, int], reach: int
) -> tuple[BlurCandidates, tuple[int, int]]:
    """Cut out the curves of the windows around one, and say which is the first of them."""
    top, left = max(place[0] - reach, 0), max(place[1] - reach, 0)
    rows, columns = slice(top, place[0] + reach + 1), slice(left, place[1] + reach + 1)
    around = replace(
        candidates,
        curve=candidates.curve[rows, columns],
        weight=None,
        strength=None,
        direction=None,
        row_centers=candidates.row_centers[rows],
        column_centers=candidates.column_centers[columns],
    )
    return around, (top, left)


def _with_picture(
    around: BlurCandidates, image: NDArray[Any], intensity_range: tuple[float, float] | None
) -> tuple[BlurCandidates, PreparedImage]:
    """Cut out the picture around windows, and count their places from its corner."""
    margin = 2 * around.stride + _DETAILS
    cut, centers = [], []
    for places in (around.row_centers, around.column_centers):
        # Even, as places half-way between pixels are rounded to even ones.
        start = max(0, 2 * ((int(places[0]) - margin) // 2))
        cut.append(slice(start, int(places[-1]) + margin + 2))
        centers.append(places - start)
    found = around.intensities if intensity_range is None else intensity_range
    picture = prepare_image(image[tuple(cut)], found)
    sharp = None if around.sharp is None else around.sharp[tuple(cut)]
    placed = replace(around, row_centers=centers[0], column_centers=centers[1], sharp=sharp)
    return placed, picture

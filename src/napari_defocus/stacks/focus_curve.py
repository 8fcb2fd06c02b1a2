"""How much of each plane of a stack is in focus, and how blurred it is."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.core.checks import check_confidence, check_real
from napari_defocus.core.image import given_array
from napari_defocus.core.progress import Progress, silent
from napari_defocus.settings import CONFIDENT, UNKNOWN, USUAL_THRESHOLD

Float64 = NDArray[np.float64]

COLUMNS = ("share_in_focus", "median_radius_px", "median_confidence", "share_sure")
"""Columns of the table that `FocusCurve.save` writes, after those of the plane."""

_LEAST_KNOWN = 0.01
"""Of a plane: if less is known, its share in focus and its median radius are not."""

_AS_MUCH = 0.75
"""Times the most in focus: a plane with so much counts as one with as much. By hand: how much is
sure differs by that among planes of one stack, whatever their focus."""


@dataclass(frozen=True, eq=False, kw_only=True)
class FocusCurve:
    """How sharp each plane of a stack is, from `focus_curve`.

    Attributes
    ----------
    share_in_focus : (...) float64 ndarray
        The share of the plane's known pixels, from 0 to 1, see `focus_curve`. NaN for a plane of
        which less than 1 % is known.
    median_radius : (...) float64 ndarray
        Of the plane's known pixels, in px; NaN as above.
    median_confidence : (...) float64 ndarray or None
        From 0 to 1; None if no confidence was given.
    share_sure : (...) float64 ndarray or None
        The share of the plane's pixels whose confidence is high; None as above.
    """

    share_in_focus: Float64
    median_radius: Float64
    median_confidence: Float64 | None = None
    share_sure: Float64 | None = None

    @property
    def best(self) -> tuple[int, ...] | None:
        """Index of the plane with the most in focus; of several, the one with the least median.

        A plane counts as far as it is known. One with three quarters of the most in focus has as
        much. None if nothing is known of any plane.
        """
        known = np.isfinite(self.share_in_focus)
        if not known.any():
            return None
        share = 1.0 if self.share_sure is None else self.share_sure
        amount = self.share_in_focus * share
        most = amount >= _AS_MUCH * amount[known].max()
        radius = np.where(most, self.median_radius, np.inf)
        return tuple(int(at) for at in np.unravel_index(radius.argmin(), radius.shape))

    @property
    def rests_on(self) -> str:
        """What the curve rests on, in a few words.

        Examples
        --------
        >>> import numpy as np
        >>> maps, sure = np.ones((2, 8, 10)), np.ones((2, 8, 10))
        >>> sure[:, :, 2:] = 0.1
        >>> focus_curve(maps, confidence=sure).rests_on
        'the 20% of each plane that are sure'
        """
        if not np.isfinite(self.share_in_focus).any():
            return "nothing: no plane is known"
        if self.share_sure is None or not np.isfinite(self.share_sure).any():
            return "all pixels, sure or not: there is no confidence"
        ends = np.nanmin(self.share_sure), np.nanmax(self.share_sure)
        low, high = (f"{round(100 * end)}" for end in ends)
        share = low if low == high else f"{low} to {high}"
        return f"the {share}% of each plane that are sure"

    def save(self, path: str | PathLike[str], *, force: bool = False) -> None:
        """Write the curve as a table, whole or not at all.

        It is a CSV file with a row for each plane. The first column says which plane, from 0;
        there are several if planes are counted along several axes. Unknown values are empty.

        Parameters
        ----------
        path : path-like
        force : bool, optional
            Whether a file that exists is overwritten.

        Raises
        ------
        TypeError
            If `force` is neither True nor False.
        OSError
            If the file cannot be written or exists already; the message has the path and the
            reason.
        """
        from napari_defocus.core.writing import write_results

        write_results({Path(path): self._table().encode()}, force=force)

    def _table(self) -> str:
        shape = self.share_in_focus.shape
        planes = ["plane"] if len(shape) == 1 else [f"plane_{axis}" for axis in range(len(shape))]
        curves = (self.share_in_focus, self.median_radius, self.median_confidence, self.share_sure)
        text = io.StringIO()
        table = csv.writer(text, lineterminator="\n")
        table.writerow([*planes, *COLUMNS])
        for at in np.ndindex(shape):
            table.writerow([*at, *(_cell(curve, at) for curve in curves)])
        return text.getvalue()


def _cell(curve: Float64 | None, at: tuple[int, ...]) -> str:
    return "" if curve is None or np.isnan(curve[at]) else f"{curve[at]:.6g}"


def focus_curve(
    blur_maps: ArrayLike,
    *,
    in_focus: ArrayLike | None = None,
    confidence: ArrayLike | None = None,
    within: ArrayLike | None = None,
    threshold: float = USUAL_THRESHOLD,
    min_confidence: float = CONFIDENT,
    progress: Progress = silent,
) -> FocusCurve:
    r"""Return how much of each plane of a stack is in focus, and how blurred it is.

    With the radii r of the known pixels K of a plane, its share in focus is

    .. math:: \frac{1}{|K|} \, \left|\{\mathbf{x} \in K: r[\mathbf{x}] \le \tau\}\right|

    where :math:`\tau` is `threshold`; with a mask, the share of the mask. The median radius is that
    of K, too. With a confidence, only what is sure is known: a dark background, whose radii mean
    nothing, does not count. Without one, all pixels are taken as known, and `FocusCurve.rests_on`
    says so. Planes are read one at a time, so that the stack may be larger than memory.

    Parameters
    ----------
    blur_maps : (..., H, W) array_like
        Blur maps in px, such as `estimate_blur_map` makes of every plane. NumPy, dask, zarr, and
        anything else with a shape whose planes are read by their index, will do. NaN and infinite
        values are unknown pixels: they do not count.
    in_focus : (..., H, W) array_like, optional
        Masks, such as those of `segment_in_focus`: 0 is blurred, 2 is not known, all else in
        focus. Without masks, what is blurred by `threshold` or less is in focus.
    confidence : (..., H, W) array_like, optional
        Confidences, such as `confidence_map` makes of every plane, from 0 to 1. Pixels where it
        is 0, such as those outside of an analysed region, do not count at all. Below
        `min_confidence`, they are not known.
    within : (H, W) or (..., H, W) array_like, optional
        What counts, where it is not 0: a mask or labels, such as of tissue or cells.
    threshold : float, optional
        In px, from 0 up; not used if there are masks.
    min_confidence : float, optional
        The least confidence of a pixel that is sure, and known.
    progress : callable, optional
        Called with a step's name and the share that is done, after every plane.

    Returns
    -------
    FocusCurve
        Its arrays have the shape that comes before `(H, W)`.

    Raises
    ------
    TypeError
        If an array holds no real numbers.
    ValueError
        If `blur_maps` has less than two axes or a side of 0, another array has another shape, or
        a number is beyond its range.

    Examples
    --------
    >>> import numpy as np
    >>> from napari_defocus import focus_curve
    >>> radii = np.array([4.0, 1.0, 0.5, 3.0])
    >>> curve = focus_curve(radii[:, None, None] * np.ones((20, 30)), threshold=1.5)
    >>> curve.share_in_focus
    array([0., 1., 1., 0.])
    >>> curve.best
    (2,)
    """
    _check_threshold(threshold)
    check_confidence("min_confidence", min_confidence)
    maps = _stack("blur_maps", blur_maps)
    if len(maps.shape) < 2 or 0 in maps.shape:
        raise ValueError(
            f"blur_maps has shape {tuple(maps.shape)}; it takes (..., H, W), none of them 0"
        )
    masks = _like("in_focus", in_focus, maps)
    sure = _like("confidence", confidence, maps)
    where = None if within is None else _within(within, maps)
    found = np.full((4, *maps.shape[:-2]), np.nan)
    count = math.prod(maps.shape[:-2])
    for number, at in enumerate(np.ndindex(maps.shape[:-2])):
        progress("Reading the planes", number / count)
        plane = _Plane(
            given_array("blur_maps", maps[at]),
            None if masks is None else np.asarray(masks[at]),
            None if sure is None else np.asarray(sure[at]),
            None if where is None else np.asarray(where[at if where.ndim > 2 else ...]) != 0,
        )
        found[(slice(None), *at)] = plane.values(threshold, min_confidence)
    shares, radii, confidences, sures = found
    if sure is None:
        return FocusCurve(share_in_focus=shares, median_radius=radii)
    return FocusCurve(
        share_in_focus=shares,
        median_radius=radii,
        median_confidence=confidences,
        share_sure=sures,
    )


@dataclass(frozen=True, eq=False)
class _Plane:
    """What is known of a plane, (H, W) each."""

    blur_map: NDArray[Any]
    mask: NDArray[Any] | None
    confidence: NDArray[Any] | None
    within: NDArray[np.bool_] | None

    def values(self, threshold: float, min_confidence: float) -> tuple[float, float, float, float]:
        """Return the four values of the plane; NaN for those that nothing is known of."""
        counts = np.isfinite(self.blur_map)
        if self.within is not None:
            counts &= self.within
        if self.confidence is not None:
            counts &= self.confidence > 0
        if not counts.any():
            return math.nan, math.nan, math.nan, math.nan
        known, focused = counts.copy(), self.blur_map <= np.float64(threshold)
        if self.mask is not None:
            unknown = self.mask == UNKNOWN if self.mask.dtype.kind != "b" else False
            known, focused = known & ~np.asarray(unknown), self.mask != 0
        if self.confidence is not None:
            known &= self.confidence >= min_confidence
        enough = known.sum() >= _LEAST_KNOWN * counts.sum()
        share = float(focused[known].mean()) if enough else math.nan
        median = float(np.median(self.blur_map[known])) if enough else math.nan
        if self.confidence is None:
            return share, median, math.nan, math.nan
        sure = self.confidence[counts]
        return share, median, float(np.median(sure)), float((sure >= min_confidence).mean())


def _within(within: Any, maps: Any) -> Any:
    """Return what counts, of each plane or of all."""
    marks = _stack("within", within)
    shapes = tuple(maps.shape), tuple(maps.shape[-2:])
    if tuple(marks.shape) not in shapes:
        raise ValueError(
            f"within has shape {tuple(marks.shape)}; it takes that of blur_maps, {shapes[0]}, or "
            f"of its planes, {shapes[1]}"
        )
    return marks


def _stack(name: str, array: Any) -> Any:
    """Return something that has a shape and gives its planes by their index, not read yet."""
    stack = (
        array if hasattr(array, "shape") and hasattr(array, "dtype") else given_array(name, array)
    )
    if np.dtype(stack.dtype).kind not in "buif":
        raise TypeError(f"{name} has dtype {stack.dtype}; it takes real numbers")
    return stack


def _like(name: str, array: Any, maps: Any) -> Any:
    """Return a stack like `_stack`, of the shape of the maps; None for None."""
    if array is None:
        return None
    stack = _stack(name, array)
    if tuple(stack.shape) != tuple(maps.shape):
        raise ValueError(
            f"{name} has shape {tuple(stack.shape)}; it takes that of blur_maps, "
            f"{tuple(maps.shape)}"
        )
    return stack


def _check_threshold(threshold: float) -> None:
    check_real("threshold", threshold, "a finite number of px from 0 up")
    if not (math.isfinite(threshold) and threshold >= 0):
        raise ValueError(f"threshold is {threshold}; it takes a finite number of px from 0 up")

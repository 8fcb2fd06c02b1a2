"""In-focus masks of a picture, a stack or a dask array, and up to which blur things are in them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.api.dispatch import is_lazy_candidates
from napari_defocus.core.checks import (
    Unknown,
    check_flag,
    check_threshold_or_auto,
    check_whole,
)
from napari_defocus.core.extras import need_matting_extra
from napari_defocus.core.image import given_array, prepare_image
from napari_defocus.core.progress import Progress, silent
from napari_defocus.core.progress import within as within_progress
from napari_defocus.labeling.focus_threshold import focus_threshold_of
from napari_defocus.labeling.known import checked_within, known_places_of
from napari_defocus.labeling.matting import opacity
from napari_defocus.labeling.problem import LabelingProblem
from napari_defocus.labeling.seeds import checked_seeds
from napari_defocus.labeling.segmentation import labeled_mask
from napari_defocus.likelihood.candidates import BlurCandidates
from napari_defocus.settings import UNKNOWN, MaskSettings

if TYPE_CHECKING:
    from napari_defocus.tiled.candidates import LazyCandidates

Threshold = float | Literal["auto"]


@overload
def segment_in_focus(
    candidates: BlurCandidates,
    image: ArrayLike,
    *,
    threshold: Threshold = ...,
    smoothness: float = ...,
    color_sigma: float = ...,
    unknown: Unknown = ...,
    seeds: ArrayLike | None = ...,
    within: ArrayLike | None = ...,
    alpha: Literal[False] = ...,
    intensity_range: tuple[float, float] | None = ...,
    progress: Progress = ...,
) -> NDArray[np.uint8]: ...


@overload
def segment_in_focus(
    candidates: BlurCandidates,
    image: ArrayLike,
    *,
    threshold: Threshold = ...,
    smoothness: float = ...,
    color_sigma: float = ...,
    unknown: Unknown = ...,
    seeds: ArrayLike | None = ...,
    within: ArrayLike | None = ...,
    alpha: Literal[True],
    intensity_range: tuple[float, float] | None = ...,
    progress: Progress = ...,
) -> NDArray[np.float32]: ...


@overload
def segment_in_focus(
    candidates: LazyCandidates,
    image: Any,
    *,
    threshold: Threshold = ...,
    smoothness: float = ...,
    color_sigma: float = ...,
    unknown: Unknown = ...,
    seeds: Any = ...,
    within: Any = ...,
    progress: Progress = ...,
) -> Any: ...


def segment_in_focus(
    candidates: BlurCandidates | LazyCandidates,
    image: ArrayLike,
    *,
    threshold: Threshold = MaskSettings.threshold,
    smoothness: float = MaskSettings.smoothness,
    color_sigma: float = MaskSettings.color_sigma,
    unknown: Unknown = MaskSettings.unknown,
    seeds: ArrayLike | None = None,
    within: ArrayLike | None = None,
    alpha: bool = False,
    intensity_range: tuple[float, float] | None = None,
    progress: Progress = silent,
) -> NDArray[np.uint8] | NDArray[np.float32]:
    """Separate what is in focus from what is blurred.

    A minimum cut minimises (17). Being in focus costs what the best scale up to `threshold` costs,
    and being blurred what the best scale above it costs (18). A boundary costs least along edges of
    colour (16). The mask keeps to `seeds`, and what is around them follows.

    Parameters
    ----------
    candidates : BlurCandidates or LazyCandidates
        From `estimate_candidates` on the same picture. The same candidates serve for all
        settings below.
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like
        The picture, for its colours.
    threshold : float or "auto", optional
        tau of (18), the largest blur scale in px that counts as in focus. "auto" finds it from
        the picture, once for all planes of a stack: it is `focus_threshold`.
    smoothness : float, optional
        lambda_0 of (16) for a boundary between two pixels. Larger masks have fewer parts.
    color_sigma : float, optional
        sigma_lambda of (16), as a share of the picture's contrast.
    unknown : {"fill", "leave"}, optional
        What becomes of places that say nothing themselves: those without texture, and where the
        likeliest radius has a confidence below 0.5. They are filled from around, or left as 2.
    seeds : (H, W) integer array_like, optional
        What is known: 1 in focus, 2 blurred, 0 not known. The mask always keeps to it.
    within : (H, W) bool or integer array_like, optional
        What is judged, where it is not 0: a mask or labels, such as of tissue or cells. What lies
        outside has no say in the threshold. In the mask it is 0, or 2 if `unknown` is "leave".
    alpha : bool, optional
        Return the opacity of what is in focus instead, see `matte_in_focus`. It takes one picture
        in memory, and what is not known is filled first.
    intensity_range : (float, float), optional
        The intensities that count as 0 and 1; those of `candidates` if left out.
    progress : callable, optional
        Called as ``progress(step, done)``; an exception from it ends the work.

    Returns
    -------
    (H, W) uint8 ndarray
        1 in focus, 0 blurred, and 2 not known, if that is left. For a stack it is (..., H, W),
        and for a dask array a dask array. With `alpha` float32, from 0 to 1.

    Raises
    ------
    ImportError
        If `alpha` is asked for, and PyMatting is not installed.
    TypeError
        If `image` has no real dtype, `seeds` holds other values than integers, or `within` neither
        these nor bool.
    ValueError
        If `image` is not a picture (see `estimate_candidates`), or not that of `candidates`. If
        `threshold` is not within the scales of `candidates`, `smoothness` is negative,
        `color_sigma` is not positive, or `unknown` is another word. If `seeds` or `within` has
        another shape than the picture, or `seeds` other values.

    See Also
    --------
    focus_threshold : The threshold that "auto" takes.
    known_places : What `unknown` is about.
    matte_in_focus : A soft mask, for hair and fur.

    Examples
    --------
    >>> import numpy as np
    >>> from skimage.data import camera
    >>> from napari_defocus import estimate_candidates, segment_in_focus, simulate_defocus
    >>> picture = simulate_defocus(camera()[:100, :100], np.full((100, 100), 5.0))
    >>> int(segment_in_focus(estimate_candidates(picture), picture).max())
    0
    """
    asked = threshold, smoothness, color_sigma, unknown
    check_flag("alpha", alpha)
    if is_lazy_candidates(candidates):
        if alpha:
            raise ValueError("alpha is True; it takes one picture in memory, plane by plane")
        settings = _checked(*asked, candidates.scales)
        given = {"seeds": seeds, "within": within}
        return candidates.results(image, progress, **given, mask=settings)["mask"]
    settings = _checked(*asked, candidates.scales)
    if seeds is not None:
        checked_seeds(seeds, candidates.image_shape)
    where = None if within is None else checked_within(within, candidates.image_shape)
    if alpha:
        need_matting_extra()
    problem = LabelingProblem.of(candidates, image, intensity_range)
    report = within_progress(progress, 0.0, 0.3 if alpha else 1.0)
    settings = replace(settings, unknown="fill") if alpha else settings
    mask = labeled_mask(problem, settings, seeds=seeds, within=where, progress=report)
    if not alpha:
        return mask
    return opacity(problem.picture.color, mask, progress=within_progress(progress, 0.3, 1.0))


def matte_in_focus(
    image: ArrayLike,
    mask: ArrayLike,
    *,
    width: int | None = None,
    intensity_range: tuple[float, float] | None = None,
    progress: Progress = silent,
) -> NDArray[np.float32]:
    """Return a soft mask: how much of each pixel is in focus, for hair, fur and seeds.

    Pixels up to `width` from the border of a mask may be mixtures. What lies farther inside or
    outside tells how much of each they have, by closed-form matting [1]_. Only tiles along the
    border are solved: about 0.4 s a tile of 192 px.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like
        The picture.
    mask : (H, W) bool or integer array_like
        From `segment_in_focus`: 1 in focus, 0 blurred, 2 not known.
    width : int, optional
        In px; 2.5 % of the shorter side, from 4 to 40 px, if left out. Wider for longer hair.
    intensity_range : (float, float), optional
        The intensities that count as 0 and 1.
    progress : callable, optional
        Called as ``progress(step, done)``; an exception from it ends the work.

    Returns
    -------
    (H, W) float32 ndarray
        Opacity, from 0 to 1.

    Raises
    ------
    ImportError
        If PyMatting is not installed: ``pip install 'napari-defocus[matting]'``. When it is first
        used, it is compiled, which takes some seconds.
    TypeError, ValueError
        If `image` is not a picture, or `mask` or `width` is not as above: a mask from a file may
        have 255 where it is in focus.

    References
    ----------
    .. [1] A. Levin, D. Lischinski, Y. Weiss, "A Closed-Form Solution to Natural Image Matting",
       IEEE Transactions on Pattern Analysis and Machine Intelligence 30(2), 2008.

    Examples
    --------
    >>> from napari_defocus import estimate_candidates, matte_in_focus, segment_in_focus
    >>> mask = segment_in_focus(estimate_candidates(picture), picture)  # doctest: +SKIP
    >>> opacity = matte_in_focus(picture, mask)  # doctest: +SKIP
    """
    picture = prepare_image(image, intensity_range)
    marks = given_array("mask", mask)
    if marks.dtype.kind not in "bui":
        raise TypeError(f"mask has dtype {marks.dtype}; it takes bool or integers")
    if marks.shape != picture.shape:
        raise ValueError(
            f"mask has shape {marks.shape}; it takes the picture's height and width, "
            f"{picture.shape}"
        )
    if marks.min() < 0 or marks.max() > UNKNOWN:
        raise ValueError(
            f"mask holds {marks.min()} to {marks.max()}; it takes 0 blurred, 1 in focus, "
            "2 not known"
        )
    if width is not None:
        check_whole("width", width)
    need_matting_extra()
    return opacity(picture.color, marks.astype(np.uint8), width, progress)


def _checked(
    threshold: Threshold,
    smoothness: float,
    color_sigma: float,
    unknown: Unknown,
    scales: NDArray[np.floating],
) -> MaskSettings:
    check_threshold_or_auto(threshold, float(scales[-1]))
    return MaskSettings(
        threshold=threshold, smoothness=smoothness, color_sigma=color_sigma, unknown=unknown
    )


def focus_threshold(
    candidates: BlurCandidates | LazyCandidates,
    image: ArrayLike,
    *,
    within: ArrayLike | None = None,
    intensity_range: tuple[float, float] | None = None,
    progress: Progress = silent,
) -> float:
    """Return up to which blur a picture counts as in focus, found from its own blur.

    What is sharp in a picture depends on its lens, its size and its sharpening. So the sharpest
    15 % of its places are in focus, as far as they are sure, and what is blurred by 1.2 px more;
    from there the threshold moves to a blur that few places have.

    Parameters
    ----------
    candidates : BlurCandidates or LazyCandidates
        From `estimate_candidates` on the same picture. Of a stack, up to eight planes are looked
        at, and of these there is one threshold.
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like
        The picture, for its details. A dask array is read now.
    within : (H, W) bool or integer array_like, optional
        What counts, where it is not 0.
    intensity_range : (float, float), optional
        See `segment_in_focus`.
    progress : callable, optional
        Called as ``progress(step, done)``; an exception from it ends the work.

    Returns
    -------
    float
        In px, from 1 to 3.5: what is blurred everywhere by more is nowhere in focus. It is 2, as
        in the paper, for pictures that say nothing of their blur, and in the mode "paper".

    Raises
    ------
    TypeError, ValueError
        As `segment_in_focus`.

    Examples
    --------
    >>> import numpy as np
    >>> from skimage.data import camera
    >>> from napari_defocus import estimate_candidates, focus_threshold, simulate_defocus
    >>> radii = np.where(np.arange(200) < 100, 0.5, 6.0) * np.ones((200, 1))
    >>> picture = simulate_defocus(camera()[100:300, 150:350], radii)
    >>> 1 <= focus_threshold(estimate_candidates(picture), picture) <= 3.5
    True
    """
    if is_lazy_candidates(candidates):
        return candidates.threshold_now(image, within, progress)
    where = None if within is None else checked_within(within, candidates.image_shape)
    problem = LabelingProblem.of(candidates, image, intensity_range)
    return focus_threshold_of(problem, where, progress)


def known_places(
    candidates: BlurCandidates,
    image: ArrayLike,
    *,
    intensity_range: tuple[float, float] | None = None,
) -> NDArray[np.bool_]:
    """Return where a picture itself says whether it is in focus.

    That is where the likeliest radius has a confidence of 0.5 or more. Plain walls, sky, the empty
    background of fluorescence and smooth shading are not known: a mask there is filled from around.

    Parameters
    ----------
    candidates : BlurCandidates
        From `estimate_candidates` on the same picture.
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like
        The picture, for its details.
    intensity_range : (float, float), optional
        The intensities that count as 0 and 1; those of `candidates` if left out.

    Returns
    -------
    (H, W) bool ndarray
        `segment_in_focus` leaves the others as 2 if `unknown` is "leave".

    Raises
    ------
    TypeError, ValueError
        As `segment_in_focus`.

    Examples
    --------
    >>> import numpy as np
    >>> from skimage.data import camera
    >>> from napari_defocus import estimate_candidates, known_places
    >>> picture = camera()[100:200, 100:300] / 255.0
    >>> picture[:, 100:] = 0.5  # a wall
    >>> known = known_places(estimate_candidates(picture), picture)
    >>> bool(known[:, :60].mean() > 0.9), bool(known[:, 140:].any())
    (True, False)
    """
    return known_places_of(LabelingProblem.of(candidates, image, intensity_range))

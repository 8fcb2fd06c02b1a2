"""Maps of a picture, a stack or a dask array: the blur, how sure it is, what is safe to undo."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any, Literal, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.api.candidates import estimate_candidates
from napari_defocus.api.dispatch import EstimationOptions, arranged_image, is_lazy_candidates
from napari_defocus.core.axes import said_axes
from napari_defocus.core.checks import (
    Linearize,
    Mode,
    check_flag,
    check_risk,
)
from napari_defocus.core.progress import Progress, silent, within
from napari_defocus.labeling.blur_map import extrapolated, labeled_blur_map
from napari_defocus.labeling.confidence import confidence_and_caution, map_confidence
from napari_defocus.labeling.problem import LabelingProblem
from napari_defocus.likelihood.candidates import BlurCandidates
from napari_defocus.likelihood.shot_noise import ShotNoise
from napari_defocus.psf.families import Disc, PSFFamily
from napari_defocus.settings import BLOCK_SIZE, MapSettings, RestorationSettings

if TYPE_CHECKING:
    from napari_defocus.tiled.candidates import LazyCandidates

Float32 = NDArray[np.float32]


@overload
def estimate_blur_map(
    image: ArrayLike,
    *,
    smoothness: float = ...,
    color_sigma: float = ...,
    return_confidence: Literal[False] = ...,
    axes: str | None = ...,
    channel_axis: int | None = ...,
    **options: Unpack[EstimationOptions],
) -> Float32: ...


@overload
def estimate_blur_map(
    image: ArrayLike,
    *,
    smoothness: float = ...,
    color_sigma: float = ...,
    return_confidence: Literal[True],
    axes: str | None = ...,
    channel_axis: int | None = ...,
    **options: Unpack[EstimationOptions],
) -> tuple[Float32, Float32]: ...


def estimate_blur_map(
    image: ArrayLike,
    *,
    psf: PSFFamily | Literal["auto"] = Disc(),
    noise_variance: float | ShotNoise | None = MapSettings.noise_variance,
    window: int = MapSettings.window,
    stride: int = MapSettings.stride,
    linearize: Linearize | None = MapSettings.linearize,
    camera_softness: float = MapSettings.camera_softness,
    smoothness: float = MapSettings.smoothness,
    color_sigma: float = MapSettings.color_sigma,
    mode: Mode = MapSettings.mode,
    intensity_range: tuple[float, float] | None = None,
    return_confidence: bool = False,
    axes: str | None = None,
    channel_axis: int | None = None,
    block_size: int = BLOCK_SIZE,
    progress: Progress = silent,
) -> Float32 | tuple[Float32, Float32]:
    """Measure the defocus blur at every pixel: candidates, then labels.

    A stack is measured plane by plane. For a dask array, the results are dask arrays, which any of
    dask's schedulers computes part by part when they are asked for. Memory is bounded by
    `block_size`, not by the picture. A plane that fits into one part has exactly the map that it
    has as an array. Larger planes have exactly the same candidates, and maps that differ by 0.02 px
    or less.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like, or dask.array.Array
        Any real dtype, in any range: k * image + b has the same map. NaN, masked and fully
        transparent pixels are not known. With `axes`, it is a stack.
    psf, noise_variance, window, stride, linearize, camera_softness, mode
        See `estimate_candidates`.
    smoothness, color_sigma
        See `label_blur_map`.
    intensity_range : (float, float), optional
        The intensities that count as 0 and 1; found by default, see `estimate_candidates`.
    return_confidence : bool, optional
        Return also the probability that each radius is right to 0.5 px, see `confidence_map`.
    axes, channel_axis, block_size
        See `estimate_candidates`.
    progress : callable, optional
        Called as ``progress(step, done)``; an exception from it ends the work.

    Returns
    -------
    blur_map : (H, W) float32 ndarray
        Blur scale in px, which is the radius for `Disc`. For a stack it is (..., H, W), with the
        axes of the planes first. It is a dask array if `image` is one.
    confidence : (H, W) float32 ndarray
        In [0, 1]; only with `return_confidence`.

    Raises
    ------
    TypeError, ValueError
        As in the two functions.

    Examples
    --------
    >>> import numpy as np
    >>> from skimage.data import camera
    >>> from napari_defocus import estimate_blur_map, simulate_defocus
    >>> picture = simulate_defocus(camera()[:100, :100], np.full((100, 100), 3.0))
    >>> estimate_blur_map(picture).shape
    (100, 100)
    """
    settings = MapSettings(smoothness=smoothness, color_sigma=color_sigma)
    check_flag("return_confidence", return_confidence)
    axes = said_axes(image, axes, channel_axis)
    candidates = estimate_candidates(
        image,
        psf=psf,
        noise_variance=noise_variance,
        window=window,
        stride=stride,
        mode=mode,
        linearize=linearize,
        camera_softness=camera_softness,
        intensity_range=intensity_range,
        axes=axes,
        block_size=block_size,
        progress=within(progress, 0.0, 0.4),
    )
    if is_lazy_candidates(candidates):
        found = candidates.results(image, progress, map=settings, confidence=return_confidence)
        return tuple(found.values()) if return_confidence else found["blur_map"]
    problem = LabelingProblem.of(candidates, arranged_image(image, axes)[0], intensity_range)
    blur_map = labeled_blur_map(problem, settings, progress=within(progress, 0.4, 1.0))
    return (blur_map, map_confidence(candidates, blur_map)) if return_confidence else blur_map


@overload
def label_blur_map(
    candidates: BlurCandidates,
    image: ArrayLike,
    *,
    smoothness: float = ...,
    color_sigma: float = ...,
    intensity_range: tuple[float, float] | None = ...,
    return_extrapolated: Literal[False] = ...,
    progress: Progress = ...,
) -> Float32: ...


@overload
def label_blur_map(
    candidates: BlurCandidates,
    image: ArrayLike,
    *,
    smoothness: float = ...,
    color_sigma: float = ...,
    intensity_range: tuple[float, float] | None = ...,
    return_extrapolated: Literal[True],
    progress: Progress = ...,
) -> tuple[Float32, NDArray[np.bool_]]: ...


@overload
def label_blur_map(
    candidates: LazyCandidates,
    image: Any,
    *,
    smoothness: float = ...,
    color_sigma: float = ...,
    return_extrapolated: bool = ...,
    progress: Progress = ...,
) -> Any: ...


def label_blur_map(
    candidates: BlurCandidates | LazyCandidates,
    image: ArrayLike,
    *,
    smoothness: float = MapSettings.smoothness,
    color_sigma: float = MapSettings.color_sigma,
    intensity_range: tuple[float, float] | None = None,
    return_extrapolated: bool = False,
    return_carried_in: bool | None = None,
    progress: Progress = silent,
) -> Float32 | tuple[Float32, NDArray[np.bool_]]:
    """Choose one blur scale at every pixel: likely, smooth, and free to jump at colour edges.

    This is Section III-B of the paper [1]_. Minimum cuts minimise (14), with the penalty (15) on
    differences of labels 0.1 px apart, and with weights (16) that depend on the colours of 8
    neighbours. Where there is no texture, the blur comes from around, mostly from where the
    colours are the same.

    Parameters
    ----------
    candidates : BlurCandidates or LazyCandidates
        From `estimate_candidates` on the same picture. Their mode decides. "paper" takes the
        artificial likelihood of three candidates and expansion moves. "curve" takes the whole
        likelihood curve, of each window's own side of an edge. It labels from coarse to fine,
        which is faster, and makes the map continuous. Where wide blur is within 64 px, jumps cost a
        tenth at the outline of the default mask (`segment_in_focus`).
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like
        The picture, for its colours.
    smoothness : float, optional
        lambda_0 of (16), for a difference of one label, 0.1 px. Larger maps are smoother.
    color_sigma : float, optional
        sigma_lambda of (16), as a share of the picture's contrast: neighbours whose colours
        differ by more may differ in blur at little cost.
    intensity_range : (float, float), optional
        The intensities that count as 0 and 1; those of `candidates` if left out.
    return_extrapolated : bool, optional
        Return also where the map was extrapolated.
    return_carried_in : bool, optional
        The old name of `return_extrapolated`.
    progress : callable, optional
        Called as ``progress(step, done)``; an exception from it ends the work.

    Returns
    -------
    blur_map : (H, W) float32 ndarray
        Blur scale in px, which is the radius for `Disc`. For a stack it is (..., H, W), and for
        a dask array a dask array.
    extrapolated : (H, W) bool ndarray
        True where there is no evidence; only with `return_extrapolated`.

    Raises
    ------
    TypeError
        If `image` has no real dtype.
    ValueError
        If `image` is not a picture (see `estimate_candidates`) or another one than that of
        `candidates`, if `smoothness` is negative or `color_sigma` not positive.

    References
    ----------
    .. [1] X. Zhu, S. Cohen, S. Schiller, P. Milanfar, "Estimating Spatially Varying Defocus
       Blur from A Single Image", IEEE Transactions on Image Processing 22(12), 2013.

    Examples
    --------
    >>> import numpy as np
    >>> from skimage.data import camera
    >>> from napari_defocus import estimate_candidates, label_blur_map, simulate_defocus
    >>> picture = simulate_defocus(camera()[:100, :100], np.full((100, 100), 3.0))
    >>> blur_map = label_blur_map(estimate_candidates(picture), picture)
    >>> float(np.median(blur_map).round())
    3.0
    """
    if return_carried_in is not None:
        warnings.warn(
            "return_carried_in is called return_extrapolated now", FutureWarning, stacklevel=2
        )
        return_extrapolated = return_carried_in
    settings = MapSettings(smoothness=smoothness, color_sigma=color_sigma)
    check_flag("return_extrapolated", return_extrapolated)
    if is_lazy_candidates(candidates):
        found = candidates.results(image, progress, map=settings, extrapolated=return_extrapolated)
        return tuple(found.values()) if return_extrapolated else found["blur_map"]
    problem = LabelingProblem.of(candidates, image, intensity_range)
    blur_map = labeled_blur_map(problem, settings, progress=progress)
    return (blur_map, extrapolated(problem)) if return_extrapolated else blur_map


@overload
def confidence_map(candidates: BlurCandidates, blur_map: ArrayLike) -> Float32: ...


@overload
def confidence_map(candidates: LazyCandidates, blur_map: Any) -> Any: ...


def confidence_map(candidates: BlurCandidates | LazyCandidates, blur_map: ArrayLike) -> Float32:
    """Return the probability that each radius of a blur map is right.

    Right means within 0.5 px of the true radius, and beyond 5 px within a tenth of the map's
    value. The confidence is a logistic function of eight numbers of each window. It was fitted
    once, on simulations of many kinds and on six photographs with measured radii.

    Three of the numbers come from the curve log p(r), averaged over neighbouring windows: the share
    of the likelihood within the tolerance, the depth of the curve, and the distance of its best
    radius. The others are the largest difference that the map has within 31 px, whether the radius
    can be told from a camera's own softness, the noise, the power relative to it, and whether all
    windows nearby prefer one direction, as after motion.

    Where there is no texture, the curve is flat. There, the confidence is the share of all radii
    that lie within the tolerance: at most 0.14 for radii up to 8 px, less if larger ones are
    searched.

    The confidence does not know that the lens is another one than assumed: see `compare_psf`.
    `BlurCandidates.doubt` is about the whole picture, and not part of the confidence.

    Parameters
    ----------
    candidates : BlurCandidates or LazyCandidates
        Of the mode "curve"; the likelihood of the mode "paper" is too sure of itself.
    blur_map : (H, W) array_like
        From `label_blur_map` with these candidates, in px.

    Returns
    -------
    (H, W) float32 ndarray
        In [0, 1]. Of a stack (..., H, W), and a dask array if one came in.

    Raises
    ------
    TypeError
        If `blur_map` holds no real numbers.
    ValueError
        If it has another shape than the picture of `candidates`, or values that are not finite.

    Examples
    --------
    >>> import numpy as np
    >>> from skimage.data import camera
    >>> from napari_defocus import *
    >>> picture = simulate_defocus(camera()[:100, :100], np.full((100, 100), 3.0))
    >>> candidates = estimate_candidates(picture)
    >>> confidence_map(candidates, label_blur_map(candidates, picture)).shape
    (100, 100)
    """
    if is_lazy_candidates(candidates):
        return candidates.judged(blur_map)["confidence"]
    return map_confidence(candidates, blur_map)


@overload
def cautious_blur_map(
    candidates: BlurCandidates, blur_map: ArrayLike, *, risk: float = ...
) -> Float32: ...


@overload
def cautious_blur_map(candidates: LazyCandidates, blur_map: Any, *, risk: float = ...) -> Any: ...


def cautious_blur_map(
    candidates: BlurCandidates | LazyCandidates,
    blur_map: ArrayLike,
    *,
    risk: float = RestorationSettings.risk,
) -> Float32:
    """Return how much of the blur of a map is safe to take away.

    Too small a radius leaves some blur. Too large a radius makes rings and halos, which is worse.
    So the radius is lowered until the true one is smaller with a probability of at most `risk`. The
    probability comes from the curve log p(r) and the map's confidence: if radii more than 0.5 px
    below the map's are unlikely enough, the map's radius stays, and otherwise a quantile of the
    curve is taken. Edges without texture often fit two radii; the smaller one counts. The reduction
    is smoothed over 8 px.

    Parameters
    ----------
    candidates : BlurCandidates or LazyCandidates
        Of the mode "curve".
    blur_map : (H, W) array_like
        From `label_blur_map` with these candidates, in px.
    risk : float, optional
        From 0 (nothing is safe) to 1 (the unchanged map).

    Returns
    -------
    (H, W) float32 ndarray
        Scale in px, nowhere above the map. It is meant for `restore_all_in_focus` and is not a
        measurement.

    Raises
    ------
    TypeError, ValueError
        As `confidence_map`, and if `risk` is not in [0, 1].

    Examples
    --------
    >>> import numpy as np
    >>> from skimage.data import camera
    >>> from napari_defocus import *
    >>> picture = simulate_defocus(camera()[:100, :100], np.full((100, 100), 3.0))
    >>> candidates = estimate_candidates(picture)
    >>> blur_map = label_blur_map(candidates, picture)
    >>> bool((cautious_blur_map(candidates, blur_map) <= blur_map).all())
    True
    """
    check_risk(risk)
    if is_lazy_candidates(candidates):
        return candidates.judged(blur_map, risk)["cautious"]
    return confidence_and_caution(candidates, blur_map, risk=risk)[1]

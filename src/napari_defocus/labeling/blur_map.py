"""The coherent blur map: data term, edge weights, labels on the grid and at its edges, (14)-(16).

Labels are found on the grid of analysed windows, a label for each block of pixels, with the
data term times the block's area and the weights of all pixel pairs that cross between blocks.
Blocks beside a jump of the blur are then labelled pixel by pixel, so that the map follows the
picture's edges, and between labels that belong together the map is interpolated.
"""

from __future__ import annotations

from typing import Literal, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.core.axes import arranged_image
from napari_defocus.core.checks import Linearize, Mode, check_flag, check_weights
from napari_defocus.core.progress import Progress, silent, within
from napari_defocus.labeling.confidence import checked_map, confidence_and_caution, confidence_map
from napari_defocus.labeling.continuous_refinement import refine_labels
from napari_defocus.labeling.data_term import CARRIED_IN, evidence_share
from napari_defocus.labeling.graph_cuts import (
    expand_until_settled,
    minimize_energy,
    minimize_energy_from,
)
from napari_defocus.labeling.multigrid import coarser
from napari_defocus.labeling.pixel_refinement import (
    energy_of_pixels,
    interpolate_labels,
    label_pixels,
)
from napari_defocus.labeling.problem import CoarseLabels, Scene
from napari_defocus.likelihood.blur_spectra import LABEL_STEP
from napari_defocus.likelihood.candidates import (
    BlurCandidates,
    as_lazy,
    check_not_lazy,
    estimate_candidates,
)
from napari_defocus.likelihood.noise import ShotNoise
from napari_defocus.psf.families import Disc, PSFFamily
from napari_defocus.settings import BLOCK_SIZE, MapSettings

Float32 = NDArray[np.float32]

JUMP = 4
"""The smallest difference of labels that counts as a discontinuity of the blur."""

REACH = 6
"""How far, in px, a discontinuity may be moved off the blocks at once."""

CURVE_WEIGHT = np.float32(24)
"""Of the curves' depth as data term, against the penalty (15)."""

_LEAST_SMOOTHNESS = 1e-12
_HOLD = 12.0
"""Of the smoothness, for each label that the rim of a part differs from the whole picture's."""


@overload
def label_blur_map(
    candidates: BlurCandidates,
    image: ArrayLike,
    *,
    smoothness: float = ...,
    color_sigma: float = ...,
    intensity_range: tuple[float, float] | None = ...,
    return_carried_in: Literal[False] = ...,
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
    return_carried_in: Literal[True],
    progress: Progress = ...,
) -> tuple[Float32, NDArray[np.bool_]]: ...


def label_blur_map(
    candidates: BlurCandidates,
    image: ArrayLike,
    *,
    smoothness: float = MapSettings.smoothness,
    color_sigma: float = MapSettings.color_sigma,
    intensity_range: tuple[float, float] | None = None,
    return_carried_in: bool = False,
    progress: Progress = silent,
) -> Float32 | tuple[Float32, NDArray[np.bool_]]:
    """Choose one blur scale at every pixel: likely, smooth, and free to jump at colour edges.

    Section III-B of the paper [1]_: minimises (14) with the penalty (15) on differences of
    labels 0.1 px apart and the colour-dependent weights (16) over 8 neighbours, by minimum
    cuts. Where there is no texture, the blur is carried in from around, rather from where the
    colours are the same.

    Parameters
    ----------
    candidates : BlurCandidates or LazyCandidates
        From `estimate_candidates` on the same picture. Their mode decides: "paper" takes the
        artificial likelihood of three candidates, labelled by expansion moves; "curve" the
        whole likelihood curve, which follows steep blur better, of each window's own side of
        edges, labelled from coarse to fine, which is faster, and made continuous.
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like
        The picture, for its colours.
    smoothness : float, optional
        lambda_0 of (16), for a difference of one label, 0.1 px. Larger maps are smoother.
    color_sigma : float, optional
        sigma_lambda of (16), as a share of the picture's contrast: neighbours whose colours
        differ by more may differ in blur at little cost.
    intensity_range : (float, float), optional
        The intensities that count as 0 and 1; those of `candidates` if left out.
    return_carried_in : bool, optional
        Return also where the map was carried in.
    progress : callable, optional
        Called as ``progress(step, done)``; an exception from it ends the work.

    Returns
    -------
    blur_map : (H, W) float32 ndarray
        Blur scale in px: the radius, for `Disc`. Of a stack (..., H, W), and a dask array if
        one came in.
    carried_in : (H, W) bool ndarray
        True where there is no evidence; only with `return_carried_in`.

    Raises
    ------
    TypeError
        If `image` has no real dtype.
    ValueError
        If `image` is no picture (see `estimate_candidates`) or another one than that of
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
    check_weights(smoothness, color_sigma)
    check_flag("return_carried_in", return_carried_in)
    lazy = as_lazy(candidates)
    if lazy is not None:
        weights = smoothness, color_sigma
        found = lazy.results(image, progress, map_weights=weights, carried_in=return_carried_in)
        return tuple(found.values()) if return_carried_in else found["blur_map"]
    scene = Scene.of(candidates, image, intensity_range)
    blur_map = blur_map_of_scene(
        scene, smoothness=smoothness, color_sigma=color_sigma, progress=progress
    )
    return (blur_map, carried_in(scene)) if return_carried_in else blur_map


def carried_in(scene: Scene) -> NDArray[np.bool_]:
    """Return where the map of a scene has no evidence of its own: (H, W)."""
    return scene.blocks.spread(evidence_share(scene.own) < CARRIED_IN)


def blur_map_of_scene(
    scene: Scene,
    *,
    smoothness: float = MapSettings.smoothness,
    color_sigma: float = MapSettings.color_sigma,
    around: CoarseLabels | None = None,
    progress: Progress = silent,
) -> Float32:
    """Do the work of `label_blur_map`, which see, on a scene.

    If it is a part of a picture, `around` says what the whole picture's blocks want.
    """
    candidates, blocks, color = scene.own, scene.blocks, scene.color
    step = "Making the map coherent"
    progress(step, 0.0)
    cost, block_cost, weights = _problem_of_blocks(scene, smoothness, color_sigma)
    choosing = within(progress, 0.0, 0.7, step)
    if around is not None:
        around.hold(block_cost, _HOLD * smoothness)
    if candidates.mode == "paper":
        labels = expand_until_settled(block_cost, weights, choosing)
    elif around is not None:
        labels = minimize_energy_from(around.labels, block_cost, weights, choosing)
    else:
        labels = minimize_energy(block_cost, weights, choosing)
    progress("Following the picture's edges", 0.7)
    pixels = label_pixels(
        labels,
        cost,
        blocks,
        color,
        smoothness=smoothness,
        color_sigma=scene.sigma(color_sigma),
        jump=JUMP,
        reach=REACH,
        progress=within(progress, 0.7, 0.9),
    )
    scales = np.float32(LABEL_STEP) * labels
    if candidates.mode == "curve":
        pairs = blocks.edge_weights(np.zeros_like(color), color_sigma, 1.0)
        likeness = weights / np.maximum(smoothness * pairs, _LEAST_SMOOTHNESS)
        own = None if around is None else around.own
        scales = refine_labels(
            candidates, labels, likeness, JUMP, smoothness, own, within(progress, 0.9, 1.0)
        )
    progress("Smoothing out the steps", 1.0)
    return interpolate_labels(scales, labels, pixels, blocks, JUMP)


def _problem_of_blocks(
    scene: Scene, smoothness: float, color_sigma: float
) -> tuple[Float32, Float32, Float32]:
    """Return D of (14) for a pixel at each window and for its block, and the blocks' weights."""
    cost = scene.cost(CURVE_WEIGHT)
    weights = scene.blocks.edge_weights(scene.color, scene.sigma(color_sigma), smoothness)
    return cost, cost * scene.blocks.area[..., None], weights


def coarse_problem(
    scene: Scene, levels: int, *, smoothness: float, color_sigma: float
) -> tuple[Float32, Float32]:
    """Return what is minimised, on a grid that is coarser by so many powers of two.

    Returns
    -------
    data, weights : ndarray
        As `minimize_energy` takes them.
    """
    _, data, weights = _problem_of_blocks(scene, smoothness, color_sigma)
    for _ in range(levels):
        data, weights = coarser(data, weights)
    return data, weights


def preview_of_blur_map(
    scene: Scene,
    *,
    smoothness: float = MapSettings.smoothness,
    color_sigma: float = MapSettings.color_sigma,
    progress: Progress = silent,
) -> Float32:
    """Return about what `blur_map_of_scene` will, in a tenth of its time: without fine detail.

    Labels are chosen for blocks of twice the windows' spacing, and interpolated.
    """
    check_weights(smoothness, color_sigma)
    progress("Preview", 0.0)
    blocks = scene.blocks
    _, cost, weights = _problem_of_blocks(scene, smoothness, color_sigma)
    labels = minimize_energy(cost, weights, within(progress, 0.0, 1.0, "Preview"), coarse=True)
    scales = np.float32(LABEL_STEP) * labels
    return interpolate_labels(scales, labels, blocks.spread(labels), blocks, JUMP)


def confidence_of_scene(
    scene: Scene, *, blur_map: Float32, progress: Progress = silent
) -> tuple[Float32, Float32]:
    """Return `confidence_map` and `cautious_blur_map` of a scene's map."""
    progress("Measuring the confidence", 0.0)
    return confidence_and_caution(scene.candidates, blur_map)


@overload
def estimate_blur_map(
    image: ArrayLike,
    *,
    psf: PSFFamily = ...,
    noise_variance: float | ShotNoise | None = ...,
    window: int = ...,
    stride: int = ...,
    linearize: Linearize | None = ...,
    smoothness: float = ...,
    color_sigma: float = ...,
    mode: Mode = ...,
    intensity_range: tuple[float, float] | None = ...,
    return_confidence: Literal[False] = ...,
    axes: str | None = ...,
    channel_axis: int | None = ...,
    block_size: int = ...,
    progress: Progress = ...,
) -> Float32: ...


@overload
def estimate_blur_map(
    image: ArrayLike,
    *,
    psf: PSFFamily = ...,
    noise_variance: float | ShotNoise | None = ...,
    window: int = ...,
    stride: int = ...,
    linearize: Linearize | None = ...,
    smoothness: float = ...,
    color_sigma: float = ...,
    mode: Mode = ...,
    intensity_range: tuple[float, float] | None = ...,
    return_confidence: Literal[True],
    axes: str | None = ...,
    channel_axis: int | None = ...,
    block_size: int = ...,
    progress: Progress = ...,
) -> tuple[Float32, Float32]: ...


def estimate_blur_map(
    image: ArrayLike,
    *,
    psf: PSFFamily = Disc(),
    noise_variance: float | ShotNoise | None = MapSettings.noise_variance,
    window: int = MapSettings.window,
    stride: int = MapSettings.stride,
    linearize: Linearize | None = MapSettings.linearize,
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

    Of a dask array, results are dask arrays, which are computed part by part when they are asked
    for, by any of dask's schedulers; of a stack, plane by plane. Memory is bounded by
    `block_size`, not by the picture. A plane of one part has exactly the map that it has as an
    array; of larger ones, candidates are exactly the same and maps differ by 0.02 px or less.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like, or dask.array.Array
        Any real dtype, in any range: k * image + b has the same map. NaN, masked and fully
        transparent pixels are not known. A stack if `axes` or `channel_axis` says so.
    psf, noise_variance, window, stride, linearize, mode
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
        Blur scale in px: the radius, for `Disc`. Of a stack (..., H, W), its planes' axes first,
        and a dask array if one came in.
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
    check_weights(smoothness, color_sigma)
    check_flag("return_confidence", return_confidence)
    candidates = estimate_candidates(
        image,
        psf=psf,
        noise_variance=noise_variance,
        window=window,
        stride=stride,
        mode=mode,
        linearize=linearize,
        intensity_range=intensity_range,
        axes=axes,
        channel_axis=channel_axis,
        block_size=block_size,
        progress=within(progress, 0.0, 0.4),
    )
    lazy = as_lazy(candidates)
    if lazy is not None:
        weights = smoothness, color_sigma
        found = lazy.results(image, progress, map_weights=weights, confidence=return_confidence)
        return tuple(found.values()) if return_confidence else found["blur_map"]
    blur_map = label_blur_map(
        candidates,
        arranged_image(image, axes, channel_axis)[0],
        smoothness=smoothness,
        color_sigma=color_sigma,
        intensity_range=intensity_range,
        progress=within(progress, 0.4, 1.0),
    )
    return (blur_map, confidence_map(candidates, blur_map)) if return_confidence else blur_map


def labeling_energy(
    blur_map: ArrayLike,
    candidates: BlurCandidates,
    image: ArrayLike,
    *,
    smoothness: float = MapSettings.smoothness,
    color_sigma: float = MapSettings.color_sigma,
    intensity_range: tuple[float, float] | None = None,
) -> float:
    """Evaluate what `label_blur_map` minimises, (14), for any map, pixel by pixel.

    Every pixel pays the data term of its label, interpolated between the windows, and every pair
    of 8-neighbours the difference of their labels times the weight (16). Of two maps of one
    picture, the one with less energy is the better compromise, for these candidates.

    Parameters
    ----------
    blur_map : (H, W) array_like
        Blur scale in px at every pixel; rounded to labels 0.1 px apart.
    candidates, image, smoothness, color_sigma, intensity_range
        As in `label_blur_map`.

    Returns
    -------
    float
        In units of 1 / 24 of log-likelihood; of log-likelihood in the mode "paper".

    Raises
    ------
    TypeError
        If `image` has no real dtype or `blur_map` holds no real numbers.
    ValueError
        If `blur_map` has not the shape of the picture, or values that are not finite or outside
        the scales of `candidates`, and as in `label_blur_map`.

    Examples
    --------
    >>> import numpy as np
    >>> from skimage.data import camera
    >>> from napari_defocus import estimate_candidates, labeling_energy, simulate_defocus
    >>> picture = simulate_defocus(camera()[:100, :100], np.full((100, 100), 3.0))
    >>> candidates = estimate_candidates(picture)
    >>> right, wrong = (
    ...     labeling_energy(np.full((100, 100), r), candidates, picture) for r in (3, 4)
    ... )
    >>> right < wrong
    True
    """
    check_weights(smoothness, color_sigma)
    check_not_lazy(candidates)
    scales = checked_map(blur_map, candidates.image_shape)
    largest = float(candidates.scales[-1])
    labels = np.rint(scales / LABEL_STEP)
    if not ((labels >= 0) & (labels < len(candidates.scales))).all():
        raise ValueError(
            f"blur_map holds {scales.min():g} to {scales.max():g}; it takes scales from 0 to "
            f"{largest:g} px, those of the candidates"
        )
    scene = Scene.of(candidates, image, intensity_range)
    return energy_of_pixels(
        labels.astype(np.int32),
        scene.cost(CURVE_WEIGHT),
        scene.blocks,
        scene.color,
        smoothness=smoothness,
        color_sigma=scene.sigma(color_sigma),
    )

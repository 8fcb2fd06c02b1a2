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

from napari_defocus.boundaries import (
    Blocks,
    energy_of_pixels,
    interpolate_labels,
    label_pixels,
)
from napari_defocus.candidates import BlurCandidates, estimate_candidates
from napari_defocus.confidence import checked_map
from napari_defocus.evidence import evidence_share, limited_depth, on_own_side
from napari_defocus.graphcut import expand_until_settled, minimize_energy
from napari_defocus.image import PreparedImage, prepare_image
from napari_defocus.noise import ShotNoise
from napari_defocus.progress import Progress, silent, within
from napari_defocus.psf import Disc, PSFFamily
from napari_defocus.refinement import refine_labels
from napari_defocus.settings import Linearize, MapSettings, Mode, check_weights
from napari_defocus.spectrum import LABEL_STEP

Float32 = NDArray[np.float32]

KAPPA = np.array([1e-20, 1e-12, 1e-7, 1e-3, 1e-1, 1, 1e-1, 1e-3, 1e-7, 1e-12, 1e-20])
"""The kernel that widens candidates into an artificial likelihood (Section III-B)."""

JUMP = 4
"""The smallest difference of labels that counts as a discontinuity of the blur."""

REACH = 6
"""How far, in px, a discontinuity may be moved off the blocks at once."""

LIKELIHOOD_FLOOR = 1e-24
"""The artificial likelihood of scales that no candidate reaches, instead of 0."""

_CURVE_WEIGHT = np.float32(24)
_LEAST_SMOOTHNESS = 1e-12
_CARRIED_IN = 0.5


def data_term(candidates: BlurCandidates, curve_weight: np.float32 = _CURVE_WEIGHT) -> Float32:
    """Return D of (14): the cost of each of `candidates.scales` at each window, (R, C, L).

    In the mode "paper", -log of the artificial likelihood; in "curve", `curve_weight` times the
    limited depth.
    """
    if candidates.mode == "paper":
        return -np.log(artificial_likelihood(candidates)).astype(np.float32)
    return curve_weight * limited_depth(candidates)


def artificial_likelihood(candidates: BlurCandidates) -> NDArray[np.float64]:
    """Return p~ of Section III-B: the three candidates widened by kappa, sum 1, (R, C, L)."""
    present = np.isfinite(candidates.radii)
    known = np.where(present, candidates.log_likelihoods, 0).astype(np.float64)
    height = np.where(present, np.exp(known - known[..., :1]), 0)
    label = np.rint(np.where(present, candidates.radii, 0) / LABEL_STEP).astype(int)
    count, reach = len(candidates.scales), len(KAPPA) // 2
    likelihood = np.zeros((*label.shape[:2], count + 2 * reach))
    rows, columns = np.indices(label.shape[:2])
    for k in range(label.shape[2]):
        for tap, weight in enumerate(KAPPA):
            likelihood[rows, columns, label[..., k] + tap] += weight * height[..., k]
    likelihood = np.maximum(likelihood[..., reach:-reach], LIKELIHOOD_FLOOR)
    return likelihood / likelihood.sum(axis=2, keepdims=True)


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
    candidates : BlurCandidates
        From `estimate_candidates` on the same picture. Their mode decides: "paper" takes the
        artificial likelihood of three candidates, labelled by expansion moves; "curve" the
        whole likelihood curve, which follows steep blur better, of each window's own side of
        edges, labelled from coarse to fine, which is faster, and made continuous.
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like
        The picture, for its colours.
    smoothness : float, optional
        lambda_0 of (16), for a difference of one label, 0.1 px. Larger maps are smoother.
    color_sigma : float, optional
        sigma_lambda of (16), intensities in [0, 1]: neighbours whose colours differ by more
        may differ in blur at little cost.
    intensity_range : (float, float), optional
        The intensities that count as 0 and 1.
    return_carried_in : bool, optional
        Return also where the map was carried in.
    progress : callable, optional
        Called as ``progress(step, done)``; an exception from it ends the work.

    Returns
    -------
    blur_map : (H, W) float32 ndarray
        Blur scale in px: the radius, for `Disc`.
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
    picture = picture_of(candidates, image, intensity_range)
    progress("Making the map coherent", 0.0)
    candidates = on_own_side(candidates, picture)
    blocks = Blocks.around(candidates.row_centers, candidates.column_centers, picture.shape)
    cost = data_term(candidates)
    block_cost = cost * blocks.area[..., None]
    weights = blocks.edge_weights(picture.color, color_sigma, smoothness)
    minimize = expand_until_settled if candidates.mode == "paper" else minimize_energy
    labels = minimize(block_cost, weights, within(progress, 0.0, 0.7, "Making the map coherent"))
    progress("Following the picture's edges", 0.7)
    pixels = label_pixels(
        labels,
        cost,
        blocks,
        picture.color,
        smoothness=smoothness,
        color_sigma=color_sigma,
        jump=JUMP,
        reach=REACH,
        progress=within(progress, 0.7, 0.9),
    )
    scales = np.float32(LABEL_STEP) * labels
    if candidates.mode == "curve":
        pairs = blocks.edge_weights(np.zeros_like(picture.color), color_sigma, 1.0)
        likeness = weights / np.maximum(smoothness * pairs, _LEAST_SMOOTHNESS)
        scales = refine_labels(
            candidates, labels, likeness, JUMP, smoothness, within(progress, 0.9, 1.0)
        )
    progress("Smoothing out the steps", 1.0)
    blur_map = interpolate_labels(scales, labels, pixels, blocks, JUMP)
    if not return_carried_in:
        return blur_map
    return blur_map, blocks.spread(evidence_share(candidates) < _CARRIED_IN)


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
    progress: Progress = silent,
) -> Float32:
    """Measure the defocus blur at every pixel of one picture: candidates, then labels.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like
        Any real dtype; integers are scaled by their dtype's range, floats are taken as
        [0, 1]. A fourth channel is opacity.
    psf, noise_variance, window, stride, linearize, mode
        See `estimate_candidates`.
    smoothness, color_sigma
        See `label_blur_map`.
    intensity_range : (float, float), optional
        The intensities that count as 0 and 1.
    progress : callable, optional
        Called as ``progress(step, done)``; an exception from it ends the work.

    Returns
    -------
    (H, W) float32 ndarray
        Blur scale in px: the radius, for `Disc`.

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
    candidates = estimate_candidates(
        image,
        psf=psf,
        noise_variance=noise_variance,
        window=window,
        stride=stride,
        mode=mode,
        linearize=linearize,
        intensity_range=intensity_range,
        progress=within(progress, 0.0, 0.4),
    )
    return label_blur_map(
        candidates,
        image,
        smoothness=smoothness,
        color_sigma=color_sigma,
        intensity_range=intensity_range,
        progress=within(progress, 0.4, 1.0),
    )


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
    scales = checked_map(blur_map, candidates.image_shape)
    largest = float(candidates.scales[-1])
    labels = np.rint(scales / LABEL_STEP)
    if not ((labels >= 0) & (labels < len(candidates.scales))).all():
        raise ValueError(
            f"blur_map holds {scales.min():g} to {scales.max():g}; it takes scales from 0 to "
            f"{largest:g} px, those of the candidates"
        )
    picture = picture_of(candidates, image, intensity_range)
    candidates = on_own_side(candidates, picture)
    return energy_of_pixels(
        labels.astype(np.int32),
        data_term(candidates),
        Blocks.around(candidates.row_centers, candidates.column_centers, picture.shape),
        picture.color,
        smoothness=smoothness,
        color_sigma=color_sigma,
    )


def picture_of(
    candidates: BlurCandidates, image: ArrayLike, intensity_range: tuple[float, float] | None
) -> PreparedImage:
    """Prepare the picture that candidates came from, or say that it is another one."""
    picture = prepare_image(image, intensity_range)
    if picture.shape != candidates.image_shape:
        raise ValueError(
            f"image is {picture.shape[0]} x {picture.shape[1]} px; these candidates are of a "
            f"picture of {candidates.image_shape[0]} x {candidates.image_shape[1]} px"
        )
    return picture

"""The coherent blur map: data term, edge weights, labels on the grid and at its edges, (14)-(16).

Labels are found on the grid of analysed windows, a label for each block of pixels, with the
data term times the block's area and the weights of all pixel pairs that cross between blocks.
Blocks beside a jump of the blur are then labelled pixel by pixel, so that the map follows the
picture's edges, and between labels that belong together the map is interpolated. At the outline of
what is in focus, by the default mask, a jump costs a tenth where wide blur is nearby.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import minimum_filter

from napari_defocus.core.checks import check_weights
from napari_defocus.core.memory import give_back
from napari_defocus.core.progress import Progress, silent, within
from napari_defocus.labeling.blurred_edges import less_at_blurred_edges, less_at_outline
from napari_defocus.labeling.coarse_to_fine import minimize_energy, minimize_energy_from
from napari_defocus.labeling.confidence import checked_map
from napari_defocus.labeling.continuous_refinement import refine_labels
from napari_defocus.labeling.data_term import EXTRAPOLATED, Costs
from napari_defocus.labeling.graph_cuts import expand_until_settled
from napari_defocus.labeling.multigrid import HALF, coarser
from napari_defocus.labeling.pixel_refinement import (
    energy_of_pixels,
    interpolate_labels,
    label_pixels,
)
from napari_defocus.labeling.problem import CoarseLabels, LabelingProblem
from napari_defocus.labeling.segmentation import default_cut
from napari_defocus.likelihood.blur_spectra import LABEL_STEP, nearest_labels
from napari_defocus.likelihood.candidates import (
    BlurCandidates,
    check_candidates,
)
from napari_defocus.likelihood.evidence import evidence_share
from napari_defocus.settings import MapSettings

Float32 = NDArray[np.float32]

JUMP = 4
"""The smallest difference of labels that counts as a discontinuity of the blur."""

REACH = 6
"""How far, in px, a discontinuity may be moved off the blocks at once."""

CURVE_WEIGHT = np.float32(24)
"""Weight of the curves as data term, against the penalty (15)."""

_SHARE_AT_OUTLINE = np.float32(0.1)
"""Share of the weights that is left at the outline of the default mask, beside wide blur
(docs/decisions.md)."""

_BESIDE, _OF_WIDE = 64, 0.9
"""px around a place in which there has to be wide blur, or plain things with sharp edges read 7 px
(docs/decisions.md); and the weight below which windows say that it is wide. By hand."""

_LEAST_SMOOTHNESS = 1e-12
"""The least sum of pairwise weights, so that it can be divided by."""

_HOLD = 12.0
"""At the rim of a tile, labels are held to those of the whole picture: each label of difference
costs this many times the smoothness.
"""


def extrapolated(problem: LabelingProblem) -> NDArray[np.bool_]:
    """Return where the map has no evidence of its own, but that of its surroundings: (H, W)."""
    return problem.blocks.spread(evidence_share(problem.own) < EXTRAPOLATED)


def labeled_blur_map(
    problem: LabelingProblem,
    settings: MapSettings = MapSettings(),
    *,
    around: CoarseLabels | None = None,
    progress: Progress = silent,
) -> Float32:
    """Minimise (14) and make the labels continuous, see `label_blur_map`.

    Of a tile of a picture, `around` says what the whole picture's blocks want.
    """
    smoothness, color_sigma = settings.smoothness, settings.color_sigma
    candidates, blocks, color = problem.own, problem.blocks, problem.color
    give_back(candidates.image_shape)
    step = "Making the map coherent"
    progress(step, 0.0)
    labels, weights = _labels_of_blocks(problem, settings, around, within(progress, 0.0, 0.7, step))
    give_back(candidates.image_shape)
    progress("Following the picture's edges", 0.7)
    pixels = label_pixels(
        labels,
        problem.costs,
        blocks,
        color,
        smoothness=smoothness / problem.unit(CURVE_WEIGHT),
        color_sigma=problem.sigma(color_sigma),
        jump=JUMP,
        reach=REACH,
        weight=problem.pixel_weight,
        progress=within(progress, 0.7, 0.9),
    )
    give_back(candidates.image_shape)
    axis = candidates.scales.astype(np.float32)
    scales = axis[labels]
    if candidates.mode == "curve":
        likeness = weights[:HALF] / np.maximum(smoothness * problem.pairs, _LEAST_SMOOTHNESS)
        own = None if around is None else around.own
        scales = refine_labels(
            candidates, labels, likeness, JUMP, smoothness, own, within(progress, 0.9, 1.0)
        )
    progress("Smoothing out the steps", 1.0)
    return interpolate_labels(scales, labels, pixels, blocks, JUMP, axis)


def _labels_of_blocks(
    problem: LabelingProblem,
    settings: MapSettings,
    around: CoarseLabels | None,
    progress: Progress,
) -> tuple[NDArray[np.int32], Float32]:
    """Return the labels of the blocks, (R, C), and their weights."""
    cost, weights = _problem_of_blocks(problem, settings, within(progress, 0.0, 0.2))
    report = within(progress, 0.2, 1.0)
    if problem.own.mode == "paper":
        return expand_until_settled(np.asarray(cost), weights, report), weights
    if around is None:
        return minimize_energy(cost, weights, report), weights
    cost = np.asarray(cost)
    around.hold(cost, _HOLD * settings.smoothness)
    return minimize_energy_from(around.labels, cost, weights, report), weights


def _problem_of_blocks(
    problem: LabelingProblem, settings: MapSettings, progress: Progress = silent
) -> tuple[Float32 | Costs, Float32]:
    """Return D of (14) for the pixels of each block, and the blocks' weights."""
    sigma = problem.sigma(settings.color_sigma)
    weights = problem.blocks.edge_weights(problem.color, sigma, settings.smoothness)
    cost = problem.block_costs(CURVE_WEIGHT)
    if problem.candidates.mode == "paper":
        return cost, weights
    beyond = less_at_blurred_edges(weights, problem.squared_step, sigma)
    weights = np.concatenate([weights, beyond])
    wide = _beside_wide_blur(problem.own)
    if wide is not None:
        pixels = problem.blocks.count(default_cut(problem, progress) == 1)
        in_focus = 2 * pixels > problem.blocks.area
        less_at_outline(weights, in_focus, in_focus | wide, _SHARE_AT_OUTLINE)
    return cost, weights


def _beside_wide_blur(candidates: BlurCandidates) -> NDArray[np.bool_] | None:
    """Return which windows have wide blur within `_BESIDE` px: (R, C); None if none has."""
    if candidates.weight is None or candidates.weight.min() >= _OF_WIDE:
        return None
    reach = 2 * round(_BESIDE / candidates.stride) + 1
    near: Float32 = minimum_filter(candidates.weight, reach)
    return near < _OF_WIDE


def coarse_problem(
    problem: LabelingProblem, levels: int, settings: MapSettings
) -> tuple[Float32, Float32]:
    """Return what is minimised, on a grid that is coarser by so many powers of two.

    Returns
    -------
    data, weights : ndarray
        As `minimize_energy` takes them.
    """
    data, weights = _problem_of_blocks(problem, settings)
    for _ in range(levels):
        data, weights = coarser(data, weights)
    return np.asarray(data), weights


def preview_of_blur_map(
    problem: LabelingProblem,
    settings: MapSettings = MapSettings(),
    *,
    progress: Progress = silent,
) -> Float32:
    """Return about what `labeled_blur_map` will, in a tenth of its time: without fine detail.

    Labels are chosen for blocks of twice the windows' spacing, and interpolated.
    """
    progress("Preview", 0.0)
    blocks = problem.blocks
    cost, weights = _problem_of_blocks(problem, settings)
    labels = minimize_energy(
        cost,
        weights,
        within(progress, 0.0, 1.0, "Preview"),
        coarse=True,
    )
    axis = problem.own.scales.astype(np.float32)
    return interpolate_labels(axis[labels], labels, blocks.spread(labels), blocks, JUMP, axis)


def labeling_energy(
    blur_map: ArrayLike,
    candidates: BlurCandidates,
    image: ArrayLike,
    *,
    smoothness: float = MapSettings.smoothness,
    color_sigma: float = MapSettings.color_sigma,
    intensity_range: tuple[float, float] | None = None,
) -> float:
    """Evaluate the energy (14), which `label_blur_map` minimises, for any map.

    Every pixel costs the data term of its label, interpolated between the windows, nine times if it
    shows sharp details itself (`BlurCandidates.sharp`). Every pair of 8-neighbours costs the
    difference of their labels times the weight (16). If two maps of one picture are compared, the
    one with less energy is the better compromise for these candidates.

    Parameters
    ----------
    blur_map : (H, W) array_like
        Blur scale in px at every pixel; rounded to the labels, 0.1 px apart up to 8 px.
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
        If `blur_map` has another shape than the picture, or values that are not finite or outside
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
    check_candidates(candidates)
    scales = checked_map(blur_map, candidates.image_shape)
    largest = float(candidates.scales[-1])
    if not ((scales >= -LABEL_STEP / 2) & (scales <= largest + LABEL_STEP / 2)).all():
        raise ValueError(
            f"blur_map holds {scales.min():g} to {scales.max():g}; it takes scales from 0 to "
            f"{largest:g} px, those of the candidates"
        )
    problem = LabelingProblem.of(candidates, image, intensity_range)
    unit = problem.unit(CURVE_WEIGHT)
    return unit * energy_of_pixels(
        nearest_labels(candidates.scales, scales),
        problem.data_term,
        problem.blocks,
        problem.color,
        smoothness=smoothness / unit,
        color_sigma=problem.sigma(color_sigma),
        weight=problem.pixel_weight,
    )

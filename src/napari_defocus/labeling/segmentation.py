"""In focus or not, at every pixel: binary cuts, (17) and (18).

The border between blocks cannot follow the picture's edges, so that it crosses more and is dearer
than that between pixels. Blocks therefore pay a share of the smoothness, or small things would
not be worth it; then pixels pay in full, and the mask shrinks to the picture's edges.
"""

from __future__ import annotations

from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.core.memory import give_back
from napari_defocus.core.progress import Progress, silent
from napari_defocus.labeling.blurred_edges import less_at_blurred_edges
from napari_defocus.labeling.data_term import least_of_both
from napari_defocus.labeling.focus_threshold import settled, threshold_in_px
from napari_defocus.labeling.graph_cuts import solve_exactly
from napari_defocus.labeling.known import with_unknown_left
from napari_defocus.labeling.multigrid import coarser
from napari_defocus.labeling.pairwise_term import Blocks
from napari_defocus.labeling.pixel_refinement import cut_pixels
from napari_defocus.labeling.problem import CoarseLabels, LabelingProblem
from napari_defocus.labeling.seeds import checked_seeds
from napari_defocus.settings import MaskSettings

Float32 = NDArray[np.float32]

_STEP = "Separating focus from blur"
_CURVE_WEIGHT = np.float32(10)
"""Weight of the data term (18) against the smoothness: at most 150 for a window of one pixel."""

_BLOCK_SHARE = 0.3
"""The share of the smoothness that counts between blocks. With all of it, small things vanish
(docs/decisions.md).
"""

_NEVER = np.float32(1e12)
"""Cost of what must not happen. Energies stay far below, and single precision holds it."""

_default_cuts: WeakKeyDictionary[LabelingProblem, NDArray[np.uint8]] = WeakKeyDictionary()


def labeled_mask(
    problem: LabelingProblem,
    settings: MaskSettings = MaskSettings(),
    *,
    seeds: ArrayLike | None = None,
    within: NDArray[np.bool_] | None = None,
    preview: bool = False,
    around: CoarseLabels | None = None,
    progress: Progress = silent,
) -> NDArray[np.uint8]:
    """Minimise (17), see `segment_in_focus`: a cut of blocks, then of pixels beside its border.

    A preview keeps to the blocks of the windows, and takes a fraction of the time. Of a tile of
    a picture, `around` says what the whole picture's blocks want.
    """
    plain = seeds is None and within is None and around is None and not preview
    if plain and settings == replace(MaskSettings(), unknown=settings.unknown):
        mask = default_cut(problem, progress).copy()
    else:
        settings = settled(problem, settings, within)
        mask = _cut(problem, settings, seeds, preview, around, progress)
    return with_unknown_left(mask, problem, settings, seeds=seeds, within=within)


def default_cut(problem: LabelingProblem, progress: Progress = silent) -> NDArray[np.uint8]:
    """Return the mask of the default settings, 1 in focus and 0 blurred everywhere: (H, W).

    It is remembered as long as the problem is, and must not be written to.
    """
    mask = _default_cuts.get(problem)
    if mask is None:
        mask = _cut(problem, settled(problem, MaskSettings()), None, False, None, progress)
        _default_cuts[problem] = mask
    return mask


def _cut(
    problem: LabelingProblem,
    settings: MaskSettings,
    seeds: ArrayLike | None,
    preview: bool,
    around: CoarseLabels | None,
    progress: Progress,
) -> NDArray[np.uint8]:
    """Return 1 in focus and 0 blurred, everywhere."""
    blocks, color = problem.blocks, problem.color
    fixed = None if seeds is None else _fixed_labels(checked_seeds(seeds, problem.picture.shape))
    progress(_STEP, 0.0)
    cost, block_cost, weights = _problem_of_blocks(problem, settings, fixed)
    if around is not None:
        around.hold(block_cost, float(_NEVER))
    labels = solve_exactly(block_cost, weights)
    progress(_STEP, 0.5)
    if preview:
        mask = blocks.spread(labels)
        return (mask if fixed is None else np.where(fixed >= 0, fixed, mask)).astype(np.uint8)
    give_back(problem.picture.shape)
    mask = cut_pixels(
        labels,
        cost,
        blocks,
        color,
        smoothness=settings.smoothness,
        color_sigma=problem.sigma(settings.color_sigma),
        reach=3 * problem.own.window // 4,
        fixed=fixed,
        weight=problem.pixel_weight,
    )
    progress(_STEP, 1.0)
    return mask.astype(np.uint8)


def _problem_of_blocks(
    problem: LabelingProblem,
    settings: MaskSettings,
    fixed: NDArray[np.int32] | None,
) -> tuple[Float32, Float32, Float32]:
    """Return D of (18) for a pixel at each window and for its block, and the blocks' weights."""
    cost = focus_cost(problem, threshold_in_px(settings))
    share = 1.0 if problem.own.mode == "paper" else _BLOCK_SHARE
    sigma = problem.sigma(settings.color_sigma)
    blocks, color = problem.blocks, problem.color
    weights = blocks.edge_weights(color, sigma, share * settings.smoothness)
    if problem.candidates.mode == "curve":
        weights = less_at_blurred_edges(weights, problem.squared_step, sigma)
    block_cost = cost * problem.block_weight[..., None]
    if fixed is not None:
        block_cost += _seed_cost(fixed, blocks)
    return cost, block_cost, weights


def coarse_mask_problem(
    problem: LabelingProblem,
    levels: int,
    settings: MaskSettings,
    seeds: ArrayLike | None = None,
) -> tuple[Float32, Float32]:
    """Return what is minimised, on a grid that is coarser by so many powers of two.

    Returns
    -------
    data, weights : ndarray
        As `solve_exactly` takes them.
    """
    fixed = None if seeds is None else _fixed_labels(checked_seeds(seeds, problem.picture.shape))
    _, data, weights = _problem_of_blocks(problem, settings, fixed)
    for _ in range(levels):
        data, weights = coarser(data, weights, agreed=True)
    return data, weights


def _fixed_labels(seeds: NDArray[np.integer]) -> NDArray[np.int32]:
    """Return the label of the cut that each pixel must have, -1 where it is free."""
    return np.array([-1, 1, 0], np.int32)[seeds]


def _seed_cost(fixed: NDArray[np.int32], blocks: Blocks) -> Float32:
    """Return what binds blocks to most of their seeds, as `focus_cost`: (R, C, 2).

    As many seeds of both kinds bind a block to none; they act on its pixels.
    """
    surplus = blocks.count(fixed == 1) - blocks.count(fixed == 0)
    return _NEVER * np.stack([surplus > 0, surplus < 0], axis=2).astype(np.float32)


def focus_cost(problem: LabelingProblem, threshold: float) -> Float32:
    """Return D of (18) at each window, blurred and in focus: (R, C, 2).

    The mode "curve" takes 10 times the limited depth, at most 150; the paper's artificial
    likelihood costs at most 55.
    """
    sharp = int(np.count_nonzero(problem.own.scales <= threshold + 1e-9))
    return problem.unit(_CURVE_WEIGHT) * least_of_both(problem.costs, sharp)

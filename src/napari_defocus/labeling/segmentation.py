"""In focus or not, at every pixel: binary cuts, (17) and (18).

The border between blocks cannot follow the picture's edges, so that it crosses more and is dearer
than that between pixels. Blocks therefore pay a share of the smoothness, or small things would
not be worth it; then pixels pay in full, and the mask shrinks to the picture's edges.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.core.checks import check_threshold, check_weights
from napari_defocus.core.progress import Progress, silent, within
from napari_defocus.labeling.graph_cuts import solve_exactly
from napari_defocus.labeling.multigrid import coarser
from napari_defocus.labeling.pixel_refinement import Blocks, label_pixels
from napari_defocus.labeling.problem import CoarseLabels, Scene
from napari_defocus.labeling.seeds import checked_seeds
from napari_defocus.likelihood.candidates import BlurCandidates, as_lazy
from napari_defocus.settings import MaskSettings

Float32 = NDArray[np.float32]

_STEP = "Separating focus from blur"
_CURVE_WEIGHT = np.float32(10)
_BLOCK_SHARE = 0.3
_NEVER = np.float32(1e12)


def segment_in_focus(
    candidates: BlurCandidates,
    image: ArrayLike,
    *,
    threshold: float = MaskSettings.threshold,
    smoothness: float = MaskSettings.smoothness,
    color_sigma: float = MaskSettings.color_sigma,
    seeds: ArrayLike | None = None,
    intensity_range: tuple[float, float] | None = None,
    progress: Progress = silent,
) -> NDArray[np.uint8]:
    """Separate what is in focus from what is blurred.

    Minimises (17): being in focus costs what the best scale up to `threshold` costs, being
    blurred what the best scale above it costs (18), and a boundary costs least along edges of
    colour (16). Pixels of `seeds` are as they say, and draw those around them along.

    Parameters
    ----------
    candidates : BlurCandidates or LazyCandidates
        From `estimate_candidates` on the same picture. Other settings here need no new ones.
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like
        The picture, for its colours.
    threshold : float, optional
        tau of (18), the largest blur scale in px that counts as in focus.
    smoothness : float, optional
        lambda_0 of (16) for a boundary between two pixels. Larger masks have fewer parts.
    color_sigma : float, optional
        sigma_lambda of (16), as a share of the picture's contrast.
    seeds : (H, W) integer array_like, optional
        What is known: 1 in focus, 2 blurred, 0 not known. The mask is never otherwise there.
    intensity_range : (float, float), optional
        The intensities that count as 0 and 1; those of `candidates` if left out.
    progress : callable, optional
        Called as ``progress(step, done)``; an exception from it ends the work.

    Returns
    -------
    (H, W) uint8 ndarray
        1 in focus, 0 blurred. Of a stack (..., H, W), and a dask array if one came in.

    Raises
    ------
    TypeError
        If `image` has no real dtype, or `seeds` no integers.
    ValueError
        If `image` is no picture (see `estimate_candidates`) or another one than that of
        `candidates`, if `threshold` is not within the scales of `candidates`, `smoothness`
        negative or `color_sigma` not positive, or if `seeds` has another shape than the
        picture or other values.

    Examples
    --------
    >>> import numpy as np
    >>> from skimage.data import camera
    >>> from napari_defocus import estimate_candidates, segment_in_focus, simulate_defocus
    >>> picture = simulate_defocus(camera()[:100, :100], np.full((100, 100), 5.0))
    >>> int(segment_in_focus(estimate_candidates(picture), picture).max())
    0
    """
    check_weights(smoothness, color_sigma)
    lazy = as_lazy(candidates)
    check_threshold(threshold, float(candidates.scales[-1]))
    if lazy is not None:
        mask = MaskSettings(threshold=threshold, smoothness=smoothness, color_sigma=color_sigma)
        return lazy.results(image, progress, seeds=seeds, mask=mask)["mask"]
    if seeds is not None:
        checked_seeds(seeds, candidates.image_shape)
    return mask_of_scene(
        Scene.of(candidates, image, intensity_range),
        threshold=threshold,
        smoothness=smoothness,
        color_sigma=color_sigma,
        seeds=seeds,
        progress=progress,
    )


def mask_of_scene(
    scene: Scene,
    *,
    threshold: float = MaskSettings.threshold,
    smoothness: float = MaskSettings.smoothness,
    color_sigma: float = MaskSettings.color_sigma,
    seeds: ArrayLike | None = None,
    preview: bool = False,
    around: CoarseLabels | None = None,
    progress: Progress = silent,
) -> NDArray[np.uint8]:
    """Do the work of `segment_in_focus`, which see, on a scene.

    A preview keeps to the blocks of the windows, and takes a fraction of the time. If the scene
    is a part of a picture, `around` says what the whole picture's blocks want.
    """
    check_weights(smoothness, color_sigma)
    check_threshold(threshold, float(scene.own.scales[-1]))
    blocks, color = scene.blocks, scene.color
    fixed = None if seeds is None else _fixed_labels(checked_seeds(seeds, scene.picture.shape))
    progress(_STEP, 0.0)
    cost, block_cost, weights = _problem_of_blocks(scene, threshold, smoothness, color_sigma, fixed)
    if around is not None:
        around.hold(block_cost, float(_NEVER))
    labels = solve_exactly(block_cost, weights)
    progress(_STEP, 0.5)
    if preview:
        mask = blocks.spread(labels)
        return (mask if fixed is None else np.where(fixed >= 0, fixed, mask)).astype(np.uint8)
    mask = label_pixels(
        labels,
        cost,
        blocks,
        color,
        smoothness=smoothness,
        color_sigma=scene.sigma(color_sigma),
        jump=1,
        reach=_reach(scene.own),
        fixed=fixed,
        progress=within(progress, 0.5, 1.0, _STEP),
    )
    progress(_STEP, 1.0)
    return mask.astype(np.uint8)


def _problem_of_blocks(
    scene: Scene,
    threshold: float,
    smoothness: float,
    color_sigma: float,
    fixed: NDArray[np.int32] | None,
) -> tuple[Float32, Float32, Float32]:
    """Return D of (18) for a pixel at each window and for its block, and the blocks' weights."""
    cost = focus_cost(scene, threshold)
    share = 1.0 if scene.own.mode == "paper" else _BLOCK_SHARE
    sigma = scene.sigma(color_sigma)
    weights = scene.blocks.edge_weights(scene.color, sigma, share * smoothness)
    block_cost = cost * scene.blocks.area[..., None]
    if fixed is not None:
        block_cost += _seed_cost(fixed, scene.blocks)
    return cost, block_cost, weights


def coarse_mask_problem(
    scene: Scene,
    levels: int,
    *,
    threshold: float,
    smoothness: float,
    color_sigma: float,
    seeds: ArrayLike | None = None,
) -> tuple[Float32, Float32]:
    """Return what is minimised, on a grid that is coarser by so many powers of two.

    Returns
    -------
    data, weights : ndarray
        As `solve_exactly` takes them.
    """
    fixed = None if seeds is None else _fixed_labels(checked_seeds(seeds, scene.picture.shape))
    _, data, weights = _problem_of_blocks(scene, threshold, smoothness, color_sigma, fixed)
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


def _reach(candidates: BlurCandidates) -> int:
    """Return how far the border may move, in px: windows see what is sharp from half a side."""
    return 3 * candidates.window // 4


def focus_cost(scene: Scene, threshold: float) -> Float32:
    """Return D of (18) at each window, blurred and in focus: (R, C, 2).

    The mode "curve" takes 10 times the limited depth, at most 150; the paper's artificial
    likelihood costs at most 55.
    """
    cost = scene.cost(_CURVE_WEIGHT)
    sharp = scene.own.scales <= threshold + 1e-9
    return np.stack([cost[..., ~sharp].min(axis=2), cost[..., sharp].min(axis=2)], axis=2)

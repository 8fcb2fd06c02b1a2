"""In-focus masks of a picture, a stack or a dask array."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.api.dispatch import is_lazy_candidates
from napari_defocus.core.checks import check_threshold
from napari_defocus.core.progress import Progress, silent
from napari_defocus.labeling.problem import LabelingProblem
from napari_defocus.labeling.seeds import checked_seeds
from napari_defocus.labeling.segmentation import labeled_mask
from napari_defocus.likelihood.candidates import BlurCandidates
from napari_defocus.settings import MaskSettings

if TYPE_CHECKING:
    from napari_defocus.tiled.candidates import LazyCandidates


@overload
def segment_in_focus(
    candidates: BlurCandidates,
    image: ArrayLike,
    *,
    threshold: float = ...,
    smoothness: float = ...,
    color_sigma: float = ...,
    seeds: ArrayLike | None = ...,
    intensity_range: tuple[float, float] | None = ...,
    progress: Progress = ...,
) -> NDArray[np.uint8]: ...


@overload
def segment_in_focus(
    candidates: LazyCandidates,
    image: Any,
    *,
    threshold: float = ...,
    smoothness: float = ...,
    color_sigma: float = ...,
    seeds: Any = ...,
    progress: Progress = ...,
) -> Any: ...


def segment_in_focus(
    candidates: BlurCandidates | LazyCandidates,
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
    threshold : float, optional
        tau of (18), the largest blur scale in px that counts as in focus.
    smoothness : float, optional
        lambda_0 of (16) for a boundary between two pixels. Larger masks have fewer parts.
    color_sigma : float, optional
        sigma_lambda of (16), as a share of the picture's contrast.
    seeds : (H, W) integer array_like, optional
        What is known: 1 in focus, 2 blurred, 0 not known. The mask always keeps to it.
    intensity_range : (float, float), optional
        The intensities that count as 0 and 1; those of `candidates` if left out.
    progress : callable, optional
        Called as ``progress(step, done)``; an exception from it ends the work.

    Returns
    -------
    (H, W) uint8 ndarray
        1 in focus, 0 blurred. For a stack it is (..., H, W), and for a dask array a dask array.

    Raises
    ------
    TypeError
        If `image` has no real dtype, or `seeds` holds other values than integers.
    ValueError
        If `image` is not a picture (see `estimate_candidates`), or not that of `candidates`. If
        `threshold` is not within the scales of `candidates`, `smoothness` is negative, or
        `color_sigma` is not positive. If `seeds` has another shape than the picture, or other
        values.

    Examples
    --------
    >>> import numpy as np
    >>> from skimage.data import camera
    >>> from napari_defocus import estimate_candidates, segment_in_focus, simulate_defocus
    >>> picture = simulate_defocus(camera()[:100, :100], np.full((100, 100), 5.0))
    >>> int(segment_in_focus(estimate_candidates(picture), picture).max())
    0
    """
    if is_lazy_candidates(candidates):
        settings = _checked(threshold, smoothness, color_sigma, candidates.scales)
        return candidates.results(image, progress, seeds=seeds, mask=settings)["mask"]
    settings = _checked(threshold, smoothness, color_sigma, candidates.scales)
    if seeds is not None:
        checked_seeds(seeds, candidates.image_shape)
    problem = LabelingProblem.of(candidates, image, intensity_range)
    return labeled_mask(problem, settings, seeds=seeds, progress=progress)


def _checked(
    threshold: float, smoothness: float, color_sigma: float, scales: NDArray[np.floating]
) -> MaskSettings:
    check_threshold(threshold, float(scales[-1]))
    return MaskSettings(threshold=threshold, smoothness=smoothness, color_sigma=color_sigma)

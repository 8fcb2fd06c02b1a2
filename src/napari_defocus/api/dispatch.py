"""One picture in memory, or a stack or dask array: what public functions choose by."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, TypedDict

import numpy as np

from napari_defocus.core.axes import axis_roles, is_lazy, planes_first
from napari_defocus.core.checks import Linearize, Mode
from napari_defocus.core.extras import need_large_extra
from napari_defocus.core.image import given_image
from napari_defocus.core.progress import Progress
from napari_defocus.likelihood.candidates import BlurCandidates, check_candidates
from napari_defocus.likelihood.shot_noise import ShotNoise
from napari_defocus.psf.families import PSFFamily

if TYPE_CHECKING:
    from typing_extensions import TypeIs

    from napari_defocus.core.intensity import IntensityRange
    from napari_defocus.tiled.candidates import LazyCandidates
    from napari_defocus.tiled.lazy_planes import LazyPlanes


def arranged_image(image: Any, axes: str | None) -> tuple[Any, str]:
    """Find out which axis of an image is which, and whether it is one picture in memory.

    Returns
    -------
    image : array
        A single picture in memory as (H, W) or (H, W, 3 or 4), and all else as it was.
    roles : str
        Of the axes of what is no single picture in memory; "" of what is.

    Raises
    ------
    TypeError, ValueError
        As `axis_roles`.
    """
    if axes is None and not is_lazy(image):
        if len(np.shape(image) if hasattr(image, "shape") else ()) > 2:
            axis_roles(image.shape, None)
        return image, ""
    array = image if is_lazy(image) else given_image("image", image)
    if any(np.isnan(length) for length in array.shape):
        raise ValueError(
            f"image has shape {array.shape}; it takes a dask array of known size, see its "
            "compute_chunk_sizes"
        )
    roles = axis_roles(tuple(int(n) for n in array.shape), axes)
    if is_lazy(array) or set(roles) - set("yxs"):
        return array, roles
    return planes_first(array, roles), ""


class EstimationOptions(TypedDict, total=False):
    """Keywords of `estimate_candidates` and `estimate_blur_map` that leave the returned type."""

    psf: PSFFamily | Literal["auto"]
    noise_variance: float | ShotNoise | None
    window: int
    stride: int
    mode: Mode
    linearize: Linearize | None
    camera_softness: float
    intensity_range: tuple[float, float] | None
    block_size: int
    progress: Progress


def tiled_planes(image: Any, roles: str, intensity_range: IntensityRange | None) -> LazyPlanes:
    """Return the planes of a stack or dask array, if what they need is installed."""
    need_large_extra()
    from napari_defocus.tiled.lazy_planes import LazyPlanes

    return LazyPlanes.of(image, roles, intensity_range)


def is_lazy_candidates(candidates: BlurCandidates | LazyCandidates) -> TypeIs[LazyCandidates]:
    """Return whether candidates are those of a stack or of a dask array.

    Raises
    ------
    TypeError
        If they are no candidates at all.
    """
    if not isinstance(candidates, BlurCandidates) and hasattr(candidates, "results"):
        return True
    check_candidates(candidates)
    return False

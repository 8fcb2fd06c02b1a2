"""One picture in memory, or a stack or dask array: what public functions choose by."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypedDict

from napari_defocus.core.checks import Linearize, Mode
from napari_defocus.core.extras import need_large_extra
from napari_defocus.core.progress import Progress
from napari_defocus.likelihood.candidates import BlurCandidates, check_candidates
from napari_defocus.likelihood.shot_noise import ShotNoise
from napari_defocus.psf.families import PSFFamily

if TYPE_CHECKING:
    from typing_extensions import TypeIs

    from napari_defocus.core.intensity import IntensityRange
    from napari_defocus.tiled.candidates import LazyCandidates
    from napari_defocus.tiled.lazy_planes import LazyPlanes


class EstimationOptions(TypedDict, total=False):
    """Keywords of `estimate_candidates` and `estimate_blur_map` that leave the returned type."""

    psf: PSFFamily
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

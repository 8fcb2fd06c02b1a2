"""One picture in memory, or a stack or dask array: what public functions choose by."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from napari_defocus.core.extras import need_large_extra
from napari_defocus.likelihood.candidates import BlurCandidates, check_candidates

if TYPE_CHECKING:
    from napari_defocus.core.intensity import IntensityRange
    from napari_defocus.tiled.candidates import LazyCandidates
    from napari_defocus.tiled.lazy_planes import LazyPlanes


def tiled_planes(image: Any, roles: str, intensity_range: IntensityRange | None) -> LazyPlanes:
    """Return the planes of a stack or dask array, if what they need is installed."""
    need_large_extra()
    from napari_defocus.tiled.lazy_planes import LazyPlanes

    return LazyPlanes.of(image, roles, intensity_range)


def lazy_candidates(candidates: Any) -> LazyCandidates | None:
    """Return candidates of a stack or of a dask array; None for those of one picture.

    Raises
    ------
    TypeError
        If they are no candidates at all.
    """
    if not isinstance(candidates, BlurCandidates) and hasattr(candidates, "results"):
        return candidates
    check_candidates(candidates)
    return None

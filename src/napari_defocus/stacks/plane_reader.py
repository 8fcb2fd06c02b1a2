"""Planes of a stack made ready, all with the range of intensities that they share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from napari_defocus.core.checks import Linearize
from napari_defocus.core.image import PreparedImage, checked_range, prepare_image
from napari_defocus.core.intensity import IntensityRange, Limits, needs_limits
from napari_defocus.core.known_pixels import limits_of
from napari_defocus.stacks.matched_planes import MatchedPlanes


@dataclass(frozen=True)
class PlaneReader:
    """Reads planes and makes them ready."""

    planes: MatchedPlanes
    intensity_range: IntensityRange | Limits | None
    linearize: Linearize | None

    @classmethod
    def of(
        cls,
        planes: MatchedPlanes,
        intensity_range: IntensityRange | None,
        linearize: Linearize | None,
    ) -> PlaneReader:
        """Look at all planes for the range that they share, if it is not known without."""
        if not needs_limits(planes.dtype, checked_range(intensity_range)):
            return cls(planes, intensity_range, linearize)
        limits = [limits_of(planes.planes.read(number)) for number in range(len(planes))]
        return cls(planes, Limits.joined(limits), linearize)

    def __call__(self, number: int) -> PreparedImage:
        """Read a plane."""
        return self.prepared(self.planes.look_at(number))

    def prepared(self, plane: NDArray[Any]) -> PreparedImage:
        """Make a plane ready that was read."""
        if plane.ndim == 3 and plane.shape[2] == 1:
            plane = plane[..., 0]
        return prepare_image(plane, self.intensity_range, self.linearize)

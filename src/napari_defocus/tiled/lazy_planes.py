"""The planes of a stack, or a picture larger than memory, whatever the order of its axes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import dask.array as da
import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.axes import is_lazy, planes_first
from napari_defocus.core.image import MIN_SIDE, checked_range

Index = tuple[int, ...]


@dataclass(frozen=True, eq=False)
class LazyPlanes:
    """An image whose planes are computed one at a time, or tile by tile.

    Attributes
    ----------
    image : dask.array.Array
        Planes first, then (H, W), or (H, W, 3 or 4) if `has_colors`.
    given_shape : tuple of int
        Of the image as it was given.
    has_colors : bool
    in_memory : bool
        Whether it was an array in memory, and results are wanted as such.
    """

    image: Any
    given_shape: Index
    has_colors: bool
    in_memory: bool

    @classmethod
    def of(cls, image: Any, roles: str, intensity_range: tuple[float, float] | None) -> LazyPlanes:
        """Arrange an array of numpy or dask whose axes are known, see `axes.axis_roles`.

        Raises
        ------
        TypeError
            If it has no real dtype.
        ValueError
            If it has no plane, or a side below 3 px, or the range is none.
        """
        arranged, in_memory = planes_first(image, roles), not is_lazy(image)
        has_colors = "s" in roles and arranged.ndim == len(roles)
        if np.dtype(image.dtype).kind not in "buif":
            raise TypeError(
                f"image has dtype {image.dtype}; it takes a real one (integers, floats or bool)"
            )
        checked_range(intensity_range)
        if in_memory:
            arranged = _as_dask(arranged, arranged.ndim - 2 - has_colors)
        planes = cls(arranged, image.shape, has_colors, in_memory)
        if min(planes.shape) < MIN_SIDE or 0 in planes.counts:
            raise ValueError(
                f"image has shape {image.shape}; it takes one plane or more, of at least "
                f"{MIN_SIDE} px a side"
            )
        return planes

    @property
    def counts(self) -> Index:
        """How many planes there are along each axis before the last two; () for one picture."""
        return tuple(int(n) for n in self.image.shape[: self.image.ndim - 2 - self.has_colors])

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of a plane, in px."""
        height, width = self.image.shape[len(self.counts) :][:2]
        return int(height), int(width)

    def check_same(self, image: Any) -> None:
        """Refuse another image than this one."""
        if np.shape(image) != self.given_shape:
            raise ValueError(
                f"image has shape {np.shape(image)}; these candidates are of an image of shape "
                f"{self.given_shape}"
            )

    def belonging(self, name: str, array: Any, kinds: str = "buif") -> Any:
        """Return an array with a value for each pixel, (..., H, W), as a dask array.

        Raises
        ------
        TypeError
            If its dtype is none of `kinds`, letters as numpy has them.
        ValueError
            If it has another shape.
        """
        shape, given = self.counts + self.shape, array if is_lazy(array) else np.asarray(array)
        if given.shape != shape:
            raise ValueError(f"{name} has shape {given.shape}; it takes the image's, {shape}")
        if given.dtype.kind not in kinds:
            numbers = "integers" if "f" not in kinds else "real numbers"
            raise TypeError(f"{name} has dtype {given.dtype}; it takes {numbers}")
        return given if is_lazy(given) else _as_dask(given, len(self.counts))

    def plane(self, index: Index) -> Any:
        """Return a plane whose blocks have all colours: (H, W) or (H, W, C) dask.array.Array."""
        plane = self.image[index]
        return plane.rechunk({2: -1}) if self.has_colors and plane.numblocks[2] > 1 else plane

    def each(self, of_plane: Callable[[Index], dict[str, Any]]) -> dict[str, Any]:
        """Put what a function returns for the index of each plane together, by name."""
        found = [of_plane(index) for index in np.ndindex(self.counts)]
        return {name: self._stacked([plane[name] for plane in found]) for name in found[0]}

    def _stacked(self, planes: list[Any]) -> Any:
        if not self.counts:
            return planes[0]
        return da.stack(planes).reshape(self.counts + planes[0].shape)


def _as_dask(array: NDArray[Any], plane_axes: int) -> Any:
    return da.from_array(array, chunks=(1,) * plane_axes + array.shape[plane_axes:], name=False)

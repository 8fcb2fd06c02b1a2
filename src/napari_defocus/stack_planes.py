"""The planes of a stack, read one at a time whatever the order of its axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.axes import axis_roles
from napari_defocus.image import MIN_SIDE, given_image


@dataclass(frozen=True, eq=False)
class StackPlanes:
    """A stack whose planes are read when they are asked for, and not kept.

    Attributes
    ----------
    stack : array
        Anything with a shape, a dtype and planes by index: numpy, dask, zarr.
    plane_axis : int
    order : tuple of int
        Where a plane's height, width and colours, if it has any, lie among its own axes.
    """

    stack: Any
    plane_axis: int
    order: tuple[int, ...]

    @classmethod
    def of(
        cls, stack: Any, axes: str | None = None, channel_axis: int | None = None
    ) -> StackPlanes:
        """Find the planes of a stack; nothing is read.

        Raises
        ------
        TypeError
            If it holds no real numbers, or `axes` or `channel_axis` is of another type.
        ValueError
            If it has other axes than planes, rows, columns and colours, or only one plane.
        """
        array = (
            stack
            if hasattr(stack, "shape") and hasattr(stack, "dtype")
            else given_image("stack", stack)
        )
        if np.dtype(array.dtype).kind not in "buif":
            raise TypeError(f"stack has dtype {array.dtype}; it takes real numbers")
        shape = tuple(int(length) for length in array.shape)
        roles = _roles(shape, axes, channel_axis)
        plane_axis = next(at for at, role in enumerate(roles) if role not in "yxs")
        within = roles.replace(roles[plane_axis], "")
        order = tuple(within.index(role) for role in "yxs" if role in within)
        planes = cls(array, plane_axis, order)
        _check_sizes(planes, shape)
        return planes

    def __len__(self) -> int:
        """Count the planes."""
        return int(self.stack.shape[self.plane_axis])

    @property
    def shape(self) -> tuple[int, ...]:
        """Height and width of a plane in px, and its colours if there is an axis of them."""
        of_plane = [n for axis, n in enumerate(self.stack.shape) if axis != self.plane_axis]
        return tuple(int(of_plane[axis]) for axis in self.order)

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of the stack."""
        return np.dtype(self.stack.dtype)

    def read(self, number: int) -> NDArray[Any]:
        """Read one plane: (H, W) or (H, W, C).

        Raises
        ------
        ValueError
            If it has infinite values.
        """
        plane = given_image("stack", self.stack[(slice(None),) * self.plane_axis + (number,)])
        if plane.dtype.kind == "f" and np.isinf(plane).any():
            raise ValueError(
                f"stack has infinite values in plane {number}; it takes finite ones, NaN unknown"
            )
        return plane.transpose(self.order)


def _roles(shape: tuple[int, ...], axes: str | None, channel_axis: int | None) -> str:
    """Return a letter for each axis, see `axis_roles`; one of them is that of the planes."""
    if axes is None and channel_axis is None:
        usual = {(3, False): "zyx", (4, True): "zyxs"}.get((len(shape), shape[-1:] in ((3,), (4,))))
        if usual is None:
            raise ValueError(
                f"stack has shape {shape}; it takes (Z, H, W), (Z, H, W, 3) or (Z, H, W, 4), "
                "or axes that say which is which"
            )
        return usual
    roles = axis_roles(shape, axes, channel_axis, "stack")
    if len(set(roles) - set("yxs")) != 1:
        given = f"axes is {axes!r}" if axes is not None else f"channel_axis is {channel_axis}"
        raise ValueError(
            f"{given} and stack has shape {shape}; it takes rows, columns, one axis of planes, "
            "and colours if there are any, such as 'zyx'"
        )
    return roles


def _check_sizes(planes: StackPlanes, shape: tuple[int, ...]) -> None:
    if len(planes) < 2:
        raise ValueError(f"stack has shape {shape}, {len(planes)} plane; it takes two or more")
    if min(planes.shape[:2]) < MIN_SIDE:
        raise ValueError(
            f"stack has planes of {planes.shape[0]} x {planes.shape[1]} px; "
            f"it takes at least {MIN_SIDE} px a side"
        )

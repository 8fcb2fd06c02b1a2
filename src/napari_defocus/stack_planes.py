"""The planes of a stack, read one at a time whatever the order of its axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.image import MIN_SIDE

_COLORS = (1, 3, 4)
_ROLES = "y, x, s for colours, and another letter for the planes"


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
        array = stack if hasattr(stack, "shape") and hasattr(stack, "dtype") else np.asarray(stack)
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
            If it has NaN or infinite values.
        """
        plane = np.asarray(self.stack[(slice(None),) * self.plane_axis + (number,)])
        if plane.dtype.kind == "f" and not np.isfinite(plane).all():
            raise ValueError(
                f"stack has NaN or infinite values in plane {number}; it takes finite ones"
            )
        return plane.transpose(self.order)


def _roles(shape: tuple[int, ...], axes: str | None, channel_axis: int | None) -> str:
    """Return a letter for each axis: y, x, s, and another one for the planes."""
    if axes is not None and channel_axis is not None:
        raise ValueError(
            f"axes is {axes!r} and channel_axis is {channel_axis}; they say the same, it takes one"
        )
    if axes is not None:
        return _checked_axes(axes, shape)
    if channel_axis is not None:
        return _with_channels(channel_axis, shape)
    if len(shape) == 3 and shape[2] not in (3, 4):
        return "zyx"
    if len(shape) == 4 and shape[3] in (3, 4):
        return "zyxs"
    raise ValueError(
        f"stack has shape {shape}; it takes (Z, H, W), (Z, H, W, 3) or (Z, H, W, 4), "
        "or axes that say which is which"
    )


def _checked_axes(axes: str, shape: tuple[int, ...]) -> str:
    if not isinstance(axes, str):
        raise TypeError(f"axes is {axes!r}; it takes a string such as 'zyx' or 'zyxs'")
    roles = axes.lower()
    planes = set(roles) - set("yxs")
    letters = len(set(roles)) == len(roles) and roles.isalpha()
    if not (letters and {"y", "x"} <= set(roles) and len(planes) == 1):
        raise ValueError(f"axes is {axes!r}; it takes {_ROLES}, each once, such as 'zyx'")
    if len(roles) != len(shape):
        raise ValueError(f"axes is {axes!r}; stack has {len(shape)} axes, its shape is {shape}")
    return roles


def _with_channels(channel_axis: int, shape: tuple[int, ...]) -> str:
    if not isinstance(channel_axis, int | np.integer):
        raise TypeError(f"channel_axis is {channel_axis!r}; it takes a whole number, or None")
    if len(shape) != 4 or not -4 <= channel_axis < 4:
        raise ValueError(
            f"channel_axis is {channel_axis} and stack has shape {shape}; "
            "it takes one of four axes: planes, rows, columns and colours"
        )
    rest = "zyx"
    at = int(channel_axis) % 4
    return rest[:at] + "s" + rest[at:]


def _check_sizes(planes: StackPlanes, shape: tuple[int, ...]) -> None:
    if len(planes) < 2:
        raise ValueError(f"stack has shape {shape}, {len(planes)} plane; it takes two or more")
    if min(planes.shape[:2]) < MIN_SIDE:
        raise ValueError(
            f"stack has planes of {planes.shape[0]} x {planes.shape[1]} px; "
            f"it takes at least {MIN_SIDE} px a side"
        )
    if len(planes.shape) == 3 and planes.shape[2] not in _COLORS:
        raise ValueError(
            f"stack has {planes.shape[2]} channels; it takes 1, 3 colours, or 4 with opacity"
        )

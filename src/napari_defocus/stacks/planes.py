"""The planes of a stack, read one at a time whatever the order of its axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.axes import FocusAxis, axis_roles, focus_axis
from napari_defocus.core.image import MIN_SIDE, given_image


@dataclass(frozen=True, eq=False)
class StackPlanes:
    """A stack whose planes are read when they are asked for, and not kept.

    Attributes
    ----------
    stack : array
        Anything with a shape, a dtype and planes by index: numpy, dask, zarr.
    focus : FocusAxis
        Which axis is that of the planes, and where the others stay.
    order : tuple of int
        Where a plane's height, width and colours, if it has any, lie among its own axes.
    """

    stack: Any
    focus: FocusAxis
    order: tuple[int, ...]

    @classmethod
    def of(
        cls,
        stack: Any,
        axes: str | None = None,
        *,
        channel: int | None = None,
        time: int | None = None,
    ) -> StackPlanes:
        """Find the planes of a stack, see `focus_axis`; nothing is read.

        Raises
        ------
        TypeError
            If it holds no real numbers, or another argument is of another type.
        ValueError
            If its axes do not say which planes are meant, or there is only one.
        """
        array = (
            stack
            if hasattr(stack, "shape") and hasattr(stack, "dtype")
            else given_image("stack", stack)
        )
        if np.dtype(array.dtype).kind not in "buif":
            raise TypeError(f"stack has dtype {array.dtype}; it takes real numbers")
        shape = tuple(int(length) for length in array.shape)
        roles = _roles(shape, axes)
        focus = focus_axis(shape, roles, channel=channel, time=time)
        within = [role for role in roles if role in "yxs"]
        planes = cls(array, focus, tuple(within.index(role) for role in "yxs" if role in within))
        _check_sizes(planes)
        return planes

    def __len__(self) -> int:
        """Count the planes."""
        return int(self.stack.shape[self.focus.number])

    @property
    def shape(self) -> tuple[int, ...]:
        """Height and width of a plane in px, and its colours if there is an axis of them."""
        within = [
            size
            for axis, size in enumerate(self.stack.shape)
            if axis != self.focus.number and isinstance(self.focus.index[axis], slice)
        ]
        return tuple(int(within[axis]) for axis in self.order)

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
        index = list(self.focus.index)
        index[self.focus.number] = number
        while index[-1] == slice(None):
            index.pop()
        plane = given_image("stack", self.stack[tuple(index)])
        if plane.dtype.kind == "f" and np.isinf(plane).any():
            raise ValueError(
                f"stack has infinite values in plane {number}; it takes finite ones, NaN unknown"
            )
        return plane.transpose(self.order)


def _roles(shape: tuple[int, ...], axes: str | None) -> str:
    """Return a letter for each axis, see `axis_roles`; those of the planes may be several."""
    if axes is not None:
        return axis_roles(shape, axes, name="stack")
    colors = shape[-1:] in ((3,), (4,))
    usual = "zyxs" if colors else "zyx"
    ones = len(shape) - len(usual)
    if ones < 0 or any(size != 1 for size in shape[:ones]):
        raise ValueError(
            f"stack has shape {shape}; it takes (Z, H, W), (Z, H, W, 3) or (Z, H, W, 4), "
            "or axes that say which is which"
        )
    return "abdefghijklmnopqruvw"[:ones] + usual


def _check_sizes(planes: StackPlanes) -> None:
    if min(planes.shape[:2]) < MIN_SIDE:
        raise ValueError(
            f"stack has planes of {planes.shape[0]} x {planes.shape[1]} px; "
            f"it takes at least {MIN_SIDE} px a side"
        )

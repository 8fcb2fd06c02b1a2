"""Which axis of an array is which: rows, columns, colours, and the planes of a stack."""

from __future__ import annotations

from typing import Any

import numpy as np

from napari_defocus.image import given_image

COLORS = (1, 3, 4)
"""How many values a pixel may have: grey, colours, colours and opacity."""


def axis_roles(
    shape: tuple[int, ...], axes: str | None, channel_axis: int | None, name: str = "image"
) -> str:
    """Return a letter for each axis of an array: y, x, s for colours, others for planes.

    Parameters
    ----------
    shape : tuple of int
    axes : str or None
        The letters, as the user gave them.
    channel_axis : int or None
        Which axis holds the colours; the last two of the others are rows and columns.
    name : str, optional
        Of the array, for messages.

    Raises
    ------
    TypeError
        If `axes` is no string, or `channel_axis` no whole number.
    ValueError
        If both are given, or they do not fit the shape. If neither is, and the shape is that of
        no single picture.

    Examples
    --------
    >>> axis_roles((9, 100, 200), "tyx", None), axis_roles((9, 3, 100, 200), None, 1)
    ('tyx', 'asyx')
    """
    if axes is not None and channel_axis is not None:
        raise ValueError(
            f"axes is {axes!r} and channel_axis is {channel_axis}; they say the same, it takes one"
        )
    if axes is not None:
        roles = _checked_axes(axes, shape, name)
    elif channel_axis is not None:
        roles = _with_channels(channel_axis, shape, name)
    elif len(shape) == 2:
        return "yx"
    elif len(shape) == 3 and shape[2] in (3, 4):
        return "yxs"
    else:
        raise ValueError(
            f"{name} has shape {shape}; it takes (H, W), (H, W, 3) or (H, W, 4), "
            "and for stacks axes that say which is which, such as 'zyx'"
        )
    if "s" in roles and shape[roles.index("s")] not in COLORS:
        raise ValueError(
            f"{name} has {shape[roles.index('s')]} channels; it takes 1, 3 colours, or 4 with "
            "opacity"
        )
    return roles


def _checked_axes(axes: str, shape: tuple[int, ...], name: str) -> str:
    if not isinstance(axes, str):
        raise TypeError(f"axes is {axes!r}; it takes a string such as 'zyx' or 'zyxs'")
    roles = axes.lower()
    letters = len(set(roles)) == len(roles) and roles.isalpha()
    if not (letters and {"y", "x"} <= set(roles)):
        raise ValueError(
            f"axes is {axes!r}; it takes y, x, s for colours, and other letters for planes, each "
            "once, such as 'zyx'"
        )
    if len(roles) != len(shape):
        raise ValueError(f"axes is {axes!r}; {name} has {len(shape)} axes, its shape is {shape}")
    return roles


def _with_channels(channel_axis: int, shape: tuple[int, ...], name: str) -> str:
    if not isinstance(channel_axis, int | np.integer):
        raise TypeError(f"channel_axis is {channel_axis!r}; it takes a whole number, or None")
    count = len(shape)
    if count < 3 or not -count <= channel_axis < count:
        raise ValueError(
            f"channel_axis is {channel_axis} and {name} has shape {shape}; it takes the number of "
            "one of its axes, besides rows and columns"
        )
    planes = "abcdefghijklmnopqrtuvwz"[: count - 3]
    roles = [*planes, "y", "x"]
    roles.insert(int(channel_axis) % count, "s")
    return "".join(roles)


def arranged_image(image: Any, axes: str | None, channel_axis: int | None) -> tuple[Any, str]:
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
    if axes is None and channel_axis is None and not is_lazy(image):
        if len(np.shape(image) if hasattr(image, "shape") else ()) > 2:
            axis_roles(image.shape, None, None)
        return image, ""
    array = image if is_lazy(image) else given_image("image", image)
    if any(np.isnan(length) for length in array.shape):
        raise ValueError(
            f"image has shape {array.shape}; it takes a dask array of known size, see its "
            "compute_chunk_sizes"
        )
    roles = axis_roles(tuple(int(n) for n in array.shape), axes, channel_axis)
    if is_lazy(array) or set(roles) - set("yxs"):
        return array, roles
    return planes_first(array, roles), ""


def planes_first(array: Any, roles: str) -> Any:
    """Return an array with its planes' axes first, then y, x, then s if there are colours.

    An axis of one colour is left out.

    Examples
    --------
    >>> planes_first(np.zeros((100, 200, 9)), "yxt").shape
    (9, 100, 200)
    """
    planes = [axis for axis, role in enumerate(roles) if role not in "yxs"]
    order = planes + [roles.index(role) for role in "yxs" if role in roles]
    arranged = array.transpose(order)
    return arranged[..., 0] if "s" in roles and arranged.shape[-1] == 1 else arranged


def is_lazy(array: Any) -> bool:
    """Return whether an array is dask's, which is computed when it is asked for."""
    return hasattr(array, "dask") and hasattr(array, "chunks")

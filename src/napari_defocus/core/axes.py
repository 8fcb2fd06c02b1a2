"""Which axis of an array is which: rows, columns, colours, and the planes of a stack."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

COLORS = (1, 3, 4)
"""How many values a pixel may have: grey, colours, colours and opacity."""

CHOSEN_BY = {"c": "channel", "t": "time"}
"""Axes of which one position is chosen, and the arguments that choose it."""

_LETTER_OF_NAME = dict.fromkeys(("c", "ch", "channel", "channels"), "c")
_LETTER_OF_NAME |= dict.fromkeys(("t", "time", "times"), "t")

_UNNAMED = "iq"
"""tifffile's letters for axes that a file does not name."""


@dataclass(frozen=True)
class FocusAxis:
    """Along which axis of a stack the focus changes, and where all others stay.

    Attributes
    ----------
    letter : str
        Of the axis.
    number : int
        Of the axis, from 0.
    index : tuple of int or slice
        What picks the stack out of the array: numbers for axes that stay, slices for others.
    """

    letter: str
    number: int
    index: tuple[int | slice, ...]

    @property
    def note(self) -> str:
        """What to tell if no axis says that the focus changes along it; "" along z."""
        if self.letter == "z":
            return ""
        if self.letter in _UNNAMED:
            return "pages were taken for planes through focus; the file does not say what they are"
        return f"{self.letter} was taken for focus; it is the only axis with more than one plane"


def focus_axis(
    shape: tuple[int, ...],
    roles: str,
    *,
    channel: int | None = None,
    time: int | None = None,
    name: str = "stack",
    said: Callable[[str], str] = str,
) -> FocusAxis:
    """Find the axis of a stack along which the focus changes.

    It is the only one with more than one plane, when one channel (c) and one time (t) have been
    chosen. Axes of length 1 do not count. Channels are never planes through focus; times are if
    there is nothing else, because stacks are often labelled so by mistake.

    Parameters
    ----------
    shape : tuple of int
    roles : str
        A letter an axis: y, x, s for colours, c for channels, t for times, others for planes.
    channel, time : int, optional
        Which one to take along c and t, from 0.
    name : str, optional
        Of the stack, for messages.
    said : callable, optional
        Turns the name of an argument into what the caller writes, such as "--channel".

    Returns
    -------
    FocusAxis

    Raises
    ------
    TypeError
        If `channel` or `time` is not a whole number.
    ValueError
        If there is no such channel or time, none was chosen of several, or not exactly one axis
        is left.

    Examples
    --------
    >>> focus_axis((1, 2, 7, 90, 140), "tczyx", channel=1).letter
    'z'
    >>> focus_axis((2, 7, 90, 140), "czyx")
    Traceback (most recent call last):
        ...
    ValueError: stack has 2 along c and 7 along z; channel chooses one
    """
    sizes = {letter: size for letter, size in zip(roles, shape, strict=True) if letter not in "yxs"}
    stays = {letter: 0 for letter, size in sizes.items() if size == 1}
    for letter, given in (("c", channel), ("t", time)):
        if given is not None:
            _check_choice(said(CHOSEN_BY[letter]), given, letter, sizes.get(letter, 0), name)
            stays[letter] = int(given)
    left = {letter: size for letter, size in sizes.items() if letter not in stays}
    if len(left) != 1 or "c" in left:
        raise ValueError(f"{name} has {_unclear(left, said)}")
    (letter,) = left
    index = tuple(stays.get(role, slice(None)) for role in roles)
    return FocusAxis(letter, roles.index(letter), index)


def known_axis(name: str) -> str:
    """Return c or t if an axis of this name is that of channels or times, else "".

    Examples
    --------
    >>> known_axis("Channel"), known_axis("t"), known_axis("chi")
    ('c', 't', '')
    """
    return _LETTER_OF_NAME.get(name.strip().lower(), "")


def _check_choice(argument: str, given: Any, letter: str, size: int, name: str) -> None:
    if isinstance(given, bool) or not isinstance(given, int | np.integer):
        raise TypeError(f"{argument} is {given!r}; it takes a whole number, or None")
    if size == 0:
        raise ValueError(f"{argument} is {given}; {name} has no axis {letter} to choose from")
    if not 0 <= given < size:
        raise ValueError(f"{argument} is {given}; {name} has {size} along {letter}, counted from 0")


def _unclear(left: dict[str, int], said: Callable[[str], str]) -> str:
    """Return what keeps the planes from being known, and what to do about it."""
    held = " and ".join(f"{size} along {letter}" for letter, size in left.items())
    if not left:
        return "a single plane; it takes two or more along an axis such as z"
    if list(left) == ["c"]:
        return (
            f"{held}, and channels are not planes through focus; it takes planes along another "
            "axis (if these are planes, name their axis z)"
        )
    others = [letter for letter in left if letter not in CHOSEN_BY]
    chosen = [letter for letter in left if letter == "c" or (letter == "t" and others)]
    if chosen and len(left) - len(chosen) == 1:
        how = " and ".join(said(CHOSEN_BY[letter]) for letter in chosen)
        return f"{held}; {how} {'chooses one' if len(chosen) == 1 else 'choose one of each'}"
    return f"planes, {held}; it takes planes along one axis"


def axis_roles(
    shape: tuple[int, ...],
    axes: str | None,
    channel_axis: int | None = None,
    name: str = "image",
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
    # Planes of unknown meaning: neither channels nor times.
    planes = "abdefghijklmnopqruvwz"[: count - 3]
    roles = [*planes, "y", "x"]
    roles.insert(int(channel_axis) % count, "s")
    return "".join(roles)


def said_axes(
    array: Any, axes: str | None, channel_axis: int | None, name: str = "image"
) -> str | None:
    """Return `axes`, or in its letters what the old argument `channel_axis` says, with a warning.

    Raises
    ------
    TypeError, ValueError
        As `axis_roles`.
    """
    if channel_axis is None:
        return axes
    roles = axis_roles(np.shape(array), axes, channel_axis, name)
    warnings.warn(
        f"channel_axis will go; axes={roles!r} says the same", FutureWarning, stacklevel=3
    )
    return roles


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


def first_plane(array: Any, axes: str | None) -> Any:
    """Return the first plane of a stack, or the picture itself: (H, W) or (H, W, C).

    Examples
    --------
    >>> first_plane(np.zeros((100, 200, 9)), "yxt").shape
    (100, 200)
    """
    roles = axis_roles(tuple(array.shape), axes)
    return planes_first(array, roles)[(0,) * len(set(roles) - set("yxs"))]


def is_lazy(array: Any) -> bool:
    """Return whether an array is dask's, which is computed when it is asked for."""
    return hasattr(array, "dask") and hasattr(array, "chunks")

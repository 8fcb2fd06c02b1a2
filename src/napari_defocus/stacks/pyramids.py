"""Laplacian pyramids (Burt and Adelson, 1983): the details of a picture, size by size."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.compiled import compiled, compiled_inline
from napari_defocus.core.threads import in_bands

Float64 = NDArray[np.float64]
Floating = NDArray[np.floating]

_LEVELS, _SMALLEST = 5, 8
"""The most levels of a pyramid, and the least side of its smallest level, in px. Chosen by hand."""

_LEAST_ROWS = 32
"""Fewer rows are not worth a thread of their own. Results do not depend on it."""

_SIDE = 64
"""px of the pattern over which the power that a level takes is known."""

_FINE_SIDE = 256
"""The same for the noise of all levels: the last has a sixteenth of it."""


def levels_for(shape: tuple[int, ...]) -> int:
    """Return how many levels the pyramid of a plane has."""
    return int(np.clip(np.log2(max(min(shape[:2]) / _SMALLEST, 1)) + 1, 1, _LEVELS))


def pyramid(picture: Floating, levels: int) -> list[Floating]:
    """Return the Laplacian pyramid of a picture, (H, W, C); the last level is its rest."""
    found = []
    for _ in range(levels - 1):
        small = halved(picture)
        found.append(details_of(picture, small))
        picture = small
    return [*found, picture]


def assembled(levels: Sequence[Floating]) -> Floating:
    """Return the picture of a Laplacian pyramid."""
    picture = levels[-1]
    for details in levels[-2::-1]:
        picture = _with_doubled(details, picture, 1)
    return picture


def halved(picture: Floating) -> Floating:
    """Return a picture, (H, W, C), at half the size, each pixel a mean of 5 x 5 by binomials."""
    height, width, channels = picture.shape
    small = np.empty((-(-height // 2), -(-width // 2), channels), picture.dtype)
    in_bands(_halve, len(small), picture, small, least=_LEAST_ROWS)
    return small


def details_of(picture: Floating, small: Floating) -> Floating:
    """Return what a picture shows that the same at half the size does not."""
    return _with_doubled(picture, small, -1)


def _with_doubled(picture: Floating, small: Floating, sign: int) -> Floating:
    found = np.empty_like(picture)
    in_bands(_double, len(picture), picture, small, picture.dtype.type(sign), found,
             least=_LEAST_ROWS)  # fmt: skip
    return found


@compiled_inline
def _mirrored(index: int, length: int) -> int:
    """Return an index within a length; beyond the ends, pixels are mirrored at the last one."""
    if index < 0:
        index = -index
    if index >= length:
        index = 2 * length - 2 - index
    return max(index, 0)


@compiled
def _halve(start: int, stop: int, picture: Floating, small: Floating) -> None:
    height, width, channels = picture.shape
    line = np.empty((width, channels), picture.dtype)
    six, four, part = line.dtype.type(6), line.dtype.type(4), line.dtype.type(1 / 256)
    for row in range(start, stop):
        two_up = picture[_mirrored(2 * row - 2, height)]
        up = picture[_mirrored(2 * row - 1, height)]
        here = picture[2 * row]
        down = picture[_mirrored(2 * row + 1, height)]
        two_down = picture[_mirrored(2 * row + 2, height)]
        for x in range(width):
            for c in range(channels):
                line[x, c] = (
                    six * here[x, c] + four * (up[x, c] + down[x, c]) + two_up[x, c]
                    + two_down[x, c]
                )  # fmt: skip
        for x in range(small.shape[1]):
            two_left, left = _mirrored(2 * x - 2, width), _mirrored(2 * x - 1, width)
            right, two_right = _mirrored(2 * x + 1, width), _mirrored(2 * x + 2, width)
            for c in range(channels):
                small[row, x, c] = part * (
                    six * line[2 * x, c] + four * (line[left, c] + line[right, c])
                    + line[two_left, c] + line[two_right, c]
                )  # fmt: skip


@compiled
def _double(
    start: int, stop: int, picture: Floating, small: Floating, sign: Any, found: Floating
) -> None:
    """Add what is twice as large to a picture, by the same binomials, or take it away."""
    height, width, channels = picture.shape
    line = np.empty((small.shape[1], channels), picture.dtype)
    six = line.dtype.type(6)
    eighth, half = line.dtype.type(1 / 8), line.dtype.type(1 / 2)
    for row in range(start, stop):
        here, after = small[row // 2], small[_mirrored(row + 1, height) // 2]
        if row % 2:
            for x in range(line.shape[0]):
                for c in range(channels):
                    line[x, c] = half * (here[x, c] + after[x, c])
        else:
            before = small[_mirrored(row - 2, height) // 2]
            after = small[_mirrored(row + 2, height) // 2]
            for x in range(line.shape[0]):
                for c in range(channels):
                    line[x, c] = eighth * (six * here[x, c] + before[x, c] + after[x, c])
        for x in range(width):
            if x % 2:
                right = _mirrored(x + 1, width) // 2
                for c in range(channels):
                    between = half * (line[x // 2, c] + line[right, c])
                    found[row, x, c] = picture[row, x, c] + sign * between
            else:
                left, right = _mirrored(x - 2, width) // 2, _mirrored(x + 2, width) // 2
                for c in range(channels):
                    mean = eighth * (six * line[x // 2, c] + line[left, c] + line[right, c])
                    found[row, x, c] = picture[row, x, c] + sign * mean


def bands(levels: int) -> Float64:
    """Return the power that each level of a pyramid takes of each frequency: (L, F, F)."""
    frequency = np.fft.fftfreq(_SIDE)
    passed, found = np.ones((_SIDE, _SIDE)), []
    for level in range(levels):
        through = _passed(frequency * 2**level) if level < levels - 1 else np.zeros(passed.shape)
        # Smoothed once before it is halved, and again when it comes back.
        found.append((passed * (1 - through**2)) ** 2)
        passed = passed * through
    return np.stack(found)


def noise_of_levels(levels: int) -> Float64:
    """Return the variance that white noise of variance 1 has in each level of a pyramid.

    When a level is halved, what was not smoothed away is folded to lower frequencies.
    """
    power, found = np.ones((_FINE_SIDE, _FINE_SIDE)), []
    for _ in range(levels - 1):
        through = _passed(np.fft.fftfreq(len(power))) ** 2
        kept, half = power * through, len(power) // 2
        folded = kept.reshape(2, half, 2, half).sum(axis=(0, 2))
        others = np.tile(folded, (2, 2)) - kept
        found.append(float((power * (1 - through) ** 2 + others * through).mean()))
        power = folded / 4
    return np.array([*found, float(power.mean())])


def _passed(frequency: Floating) -> Float64:
    """Return the share of each frequency that smoothing by binomials leaves: (F, F)."""
    angle = 2 * np.pi * frequency
    low = (6 + 8 * np.cos(angle) + 2 * np.cos(2 * angle)) / 16
    return np.outer(low, low)

"""How bright each plane of a stack is, compared with the others.

A lamp that flickers multiplies the light of a plane, but not the offset o that the camera adds. If
the next plane has g times the light of this one, its mean over a square of 32 px is

    b = o + g (a - o)

Squares are larger than most blur, which moves light but does not lose any. g is the median over the
squares, weighted by their light. o is the same for all planes, from 0 to the darkest place: the
offset that leaves the least difference, or 0 if it does not leave clearly less than 0 does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]
Float32 = NDArray[np.float32]

_CELL = 32
"""px: side of the squares whose means are compared. Chosen by hand."""

_OFFSETS = 9
"""How many offsets of a camera are tried, and again as many between the neighbours of the best."""

_CLEARLY = 0.7
"""An offset must leave at most this share of what no offset leaves, because blur also makes squares
alike. By hand.
"""

_DARK = 0.05
"""Squares darker than this share of the mean light do not count. Chosen by hand."""

_LEAST_ERROR = 1e-4
"""The least error of a gain. Chosen by hand."""

_OF_MEDIAN = 1.2533
"""Standard error of a median against that of a mean, for a normal distribution."""

_NORMAL = 1.4826
"""Standard deviations of a normal distribution in its median absolute deviation."""

LARGEST_DRIFT = 2.0
"""The largest factor between planes that counts as flicker. Chosen by hand."""


@dataclass(frozen=True, eq=False)
class Exposure:
    """How bright planes are against their median.

    Attributes
    ----------
    gain : (Z,) float64 ndarray
        1 is the median.
    error : (Z,) float64 ndarray
        Standard errors; infinite where nothing could be compared.
    offset : float
        What the camera adds, in units of the planes.
    """

    gain: Float64
    error: Float64
    offset: float = 0.0

    @classmethod
    def even(cls, planes: int) -> Exposure:
        """Return that of planes that are equally bright."""
        return cls(np.ones(planes), np.zeros(planes))

    @property
    def is_even(self) -> bool:
        """Whether no plane differs."""
        return bool((self.gain == 1).all())


Squares = tuple[Float64, Float64]
"""Means over the same squares of a plane and of the next one: (N,) each."""


def squares_of(first: Float32, second: Float32, white: float) -> Squares:
    """Return the means of two planes that lie on each other, over squares that both know.

    Parameters
    ----------
    first, second : (H, W) float32 ndarray
        NaN is unknown.
    white : float
        From which value on light is clipped: squares with such pixels do not count.
    """
    shown = []
    for plane in (first, second):
        side = min(_CELL, *plane.shape)
        height, width = (length - length % side for length in plane.shape)
        open_ = np.where(plane[:height, :width] < white, plane[:height, :width], np.nan)
        cells = open_.reshape(height // side, side, width // side, side).astype(np.float64)
        shown.append(cells.mean(axis=(1, 3)).ravel())
    known = np.isfinite(shown[0]) & np.isfinite(shown[1])
    return shown[0][known], shown[1][known]


def exposure_of(pairs: Sequence[Squares], darkest: float) -> Exposure:
    """Find how bright planes are, from what neighbours show.

    Parameters
    ----------
    pairs : sequence of Squares
        Of each plane and the next.
    darkest : float
        The darkest value of all planes: the camera adds no more.
    """
    low, high = min(0.0, darkest), darkest
    for _ in range(2):
        offsets = np.linspace(low, high, _OFFSETS)
        misfits = [sum(_misfit(pair, float(offset)) for pair in pairs) for offset in offsets]
        best = int(np.argmin(misfits))
        offset = float(offsets[best])
        low, high = offsets[max(best - 1, 0)], offsets[min(best + 1, _OFFSETS - 1)]
    if min(misfits) > _CLEARLY * sum(_misfit(pair, 0.0) for pair in pairs):
        offset = 0.0
    steps, errors = np.array([_ratio(pair, offset) for pair in pairs]).T
    if not np.isfinite(errors).all():
        return Exposure(np.ones(len(pairs) + 1), np.full(len(pairs) + 1, np.inf))
    gain = np.exp(np.concatenate([[0.0], np.cumsum(np.log(steps))]))
    middle = len(gain) // 2
    variance = np.concatenate([[0.0], np.cumsum(errors**2)])
    return Exposure(gain / np.median(gain), np.sqrt(np.abs(variance - variance[middle])), offset)


def _misfit(pair: Squares, offset: float) -> float:
    first, second = pair
    left = np.abs(second - offset - _ratio(pair, offset)[0] * (first - offset))
    return float(np.median(left)) if len(left) else 0.0


def _ratio(pair: Squares, offset: float) -> tuple[float, float]:
    """Return the median of the ratios of squares, and its standard error."""
    first, second = (means - offset for means in pair)
    lit = first > max(_DARK * float(first.mean()), 0.0) if len(first) else np.zeros(0, bool)
    ratios = second[lit] / first[lit]
    ratios = ratios[ratios > 0]
    if not len(ratios):
        return 1.0, math.inf
    ratio = float(np.median(ratios))
    scatter = float(np.median(np.abs(ratios - ratio))) * _NORMAL / ratio
    return ratio, max(_OF_MEDIAN * scatter / math.sqrt(len(ratios)), _LEAST_ERROR)

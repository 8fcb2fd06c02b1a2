"""The intensities of a picture: which become 0 and 1, its contrast, and a level of 8 bits.

The method does not depend on how bright a picture is, or on its contrast: k * image + b has the
map, the mask and the confidence of the image. So the range that becomes [0, 1] is a matter of
units only. What is compared with a fixed number is compared in units of the contrast.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

IntensityRange = tuple[float, float]

_NEARLY = 0.25
"""How far noise and ringing may carry floats out of [0, 1], if they are meant to lie there. By
hand.
"""

_WHOLE_RANGES = (255.0, 65535.0)
"""The largest whole numbers that count as 8 bits, and as 16."""

_EXTREME, _MARGIN = 1e-3, 1.25
"""The contrast is at most _MARGIN times the span between the quantile _EXTREME and the opposite
one, so that a few hot pixels do not count. Measured: docs/decisions.md, intensities.
"""

_MANY = 2**20
"""If there are more values than this, only some are sorted for quantiles and levels. By hand."""

_LEAST_CONTRAST, _LEAST_OF_RANGE = 1e-6, 1e-15
"""The least contrast, as a share of the largest intensity: less is rounding of single precision.
And as a share of the range: its square is still a number in single precision.
"""

_CONTRAST_OF_NOISE = 30.0
"""The least contrast, in standard deviations of the noise: less may be noise alone. By hand."""

_FEWEST_LEVELS, _MOST_LEVELS = 9, 256
"""How many different values a picture has that was rounded to levels: at most those of 8 bits. The
least number is chosen by hand.
"""

_FEW = 4096
"""Values that are looked at first, to see whether there are few different ones. By hand."""

_OFF_THE_LEVEL = 0.25
"""How far values may lie off the levels, as a share of their distance. Chosen by hand."""

_ORIGINS = {
    "given": "given",
    "number type": "from the type of its numbers",
    "picture": "from the picture",
}


@dataclass(frozen=True)
class Intensities:
    """Which intensities of a picture become 0 and 1, and how far it fills that range.

    Attributes
    ----------
    low, high : float
        What becomes 0 and 1, as the picture has it.
    origin : {"given", "number type", "picture"}
        Where the range comes from.
    contrast : float
        How far the colours of the picture reach from dark to bright, intensities in [0, 1];
        about 1 for most photographs. The sigma of the colours (16) is a share of it.
    level : float
        How large a level of 8 bits is, intensities in [0, 1].
    """

    low: float
    high: float
    origin: Literal["given", "number type", "picture"]
    contrast: float = 1.0
    level: float = 1 / 255

    @property
    def span(self) -> float:
        """How far 1 is from 0, as the picture has it."""
        return self.high - self.low

    @property
    def unit(self) -> float:
        """The power of two next to the contrast: intensities divided by it lose nothing."""
        return math.ldexp(1.0, round(math.log2(self.contrast)))

    @property
    def grey_levels(self) -> float:
        """In how many steps grey levels are usually counted: 255 for intensities in [0, 1]."""
        return 255.0 if (self.low, self.high) == (0.0, 1.0) else self.span

    def above_noise(self, noise_variance: float) -> Self:
        """Return the same with a contrast that is more than noise, unless the range is given."""
        if self.origin == "given":
            return self
        least = _CONTRAST_OF_NOISE * math.sqrt(noise_variance)
        return self if self.contrast >= least else replace(self, contrast=least)

    def with_contrast_of(self, scaled: NDArray[np.floating]) -> Self:
        """Return the same with the contrast of other intensities, in [0, 1], unless it is given."""
        if self.origin == "given":
            return self
        nominal = Intensities(0.0, 1.0, "number type")
        return replace(self, contrast=_contrast(scaled.ravel(), nominal))

    def facts(self) -> dict[str, Any]:
        """Return what files and tables say of it."""
        return {
            "intensity_low": self.low,
            "intensity_high": self.high,
            "intensities_from": self.origin,
            "contrast": self.contrast,
        }

    def __str__(self) -> str:
        percent = min(100 * self.contrast, 100.0)
        told = f"{percent:.0f}" if percent >= 10 else f"{percent:.2g}"
        return f"{self.low:.6g} to {self.high:.6g} ({_ORIGINS[self.origin]}), contrast {told} %"


@dataclass(frozen=True)
class Limits:
    """The smallest and the largest known intensity of a picture, or of a piece of one.

    Attributes
    ----------
    least, largest : float
        inf and -inf if nothing is known.
    whole : bool
        Whether all are whole numbers.
    """

    least: float
    largest: float
    whole: bool

    @classmethod
    def of(cls, values: NDArray[Any]) -> Self:
        """Look at known intensities."""
        if not values.size:
            return cls(math.inf, -math.inf, True)
        least, largest = float(values.min()), float(values.max())
        whole = values.dtype.kind != "f"
        if not whole and least >= 0 and largest <= _WHOLE_RANGES[-1]:
            whole = bool((values == np.rint(values)).all())
        return cls(least, largest, whole)

    @classmethod
    def joined(cls, pieces: list[Self]) -> Self:
        """Return those of a picture that is made of pieces."""
        return cls(
            min(piece.least for piece in pieces),
            max(piece.largest for piece in pieces),
            all(piece.whole for piece in pieces),
        )


def needs_limits(dtype: np.dtype[Any], intensity_range: IntensityRange | None) -> bool:
    """Return whether the range of a picture is found from its values."""
    return intensity_range is None and (
        dtype.kind == "f" or (dtype.kind in "ui" and dtype.itemsize > 2)
    )


def found_intensities(
    dtype: np.dtype[Any],
    intensity_range: IntensityRange | None,
    limits: Limits | None,
    values: NDArray[Any],
) -> Intensities:
    """Find the intensities that become 0 and 1, the contrast, and the size of a level.

    Parameters
    ----------
    dtype : dtype
        Of the picture.
    intensity_range : (float, float) or None
        As given, and checked.
    limits : Limits or None
        Of the whole picture; only if `needs_limits`.
    values : (N,) ndarray
        Known intensities of its colours: all, or many from everywhere.

    Returns
    -------
    Intensities
        If a range is given, that one, and it is the contrast. Else integers of 8 and 16 bits
        have the range of their type, floats that hardly leave [0, 1] that one. Of other
        numbers, whole ones from 0 up have the range of 8 or of 16 bits if they fit, and all
        else goes from its smallest to its largest value.
    """
    if intensity_range is not None:
        found = Intensities(*intensity_range, "given")
    elif limits is not None:
        found = range_of_values(limits, dtype)
    else:
        low, high = range_of_integers(dtype)
        found = Intensities(low, high, "number type")
    contrast = 1.0
    if intensity_range is None and values.size:
        contrast = _contrast(values, found)
    level = _level(values)
    size = contrast / 255 if level is None else level / found.span
    return replace(found, contrast=contrast, level=size)


def range_of_integers(dtype: np.dtype[Any]) -> tuple[float, float]:
    """Return the range of an integer type; that of all others is from 0 to 1."""
    if dtype.kind not in "ui":
        return 0.0, 1.0
    limits = np.iinfo(dtype)
    return float(limits.min), float(limits.max)


def range_of_values(limits: Limits, dtype: np.dtype[Any]) -> Intensities:
    """Return the range of a picture whose values have these limits, see `found_intensities`."""
    low, high = limits.least, limits.largest
    if low > high or (dtype.kind == "f" and low >= -_NEARLY and high <= 1 + _NEARLY):
        return Intensities(0.0, 1.0, "number type")
    if limits.whole and low >= 0:
        for most in _WHOLE_RANGES:
            if high <= most:
                return Intensities(0.0, most, "picture")
    if low == high:
        high = low + max(1.0, abs(low))
    return Intensities(low, high, "picture")


def _contrast(values: NDArray[Any], of: Intensities) -> float:
    """Return how far known values reach, in units of a range; 1 if they are all the same."""
    some = values[:: max(1, values.size // _MANY)]
    dark, bright = np.quantile(some, (_EXTREME, 1 - _EXTREME))
    least, largest = float(values.min()), float(values.max())
    reach = min(largest - least, _MARGIN * float(bright - dark)) or largest - least
    if not reach > 0:
        return 1.0
    away = max(abs(least - of.low), abs(largest - of.low))
    return max(max(reach, _LEAST_CONTRAST * away) / of.span, _LEAST_OF_RANGE)


def _level(values: NDArray[Any]) -> float | None:
    """Return the distance of the levels that all values lie on; None if they are not few."""
    some = values[:: max(1, values.size // _FEW)]
    if len(np.unique(some)) > _MOST_LEVELS:
        return None
    levels = np.unique(values[:: max(1, values.size // _MANY)]).astype(np.float64)
    if not _FEWEST_LEVELS <= len(levels) <= _MOST_LEVELS:
        return None
    steps = np.diff(levels)
    numbers = np.cumsum(np.rint(steps / steps.min()))
    if numbers[-1] >= _MOST_LEVELS:
        return None
    size = float(levels[-1] - levels[0]) / numbers[-1]
    off = np.abs(levels[1:] - levels[0] - size * numbers).max()
    return size if off < _OFF_THE_LEVEL * size else None

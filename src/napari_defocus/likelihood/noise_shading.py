"""Noise that grows towards the corners: cameras brighten what their lens makes dark there."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Float = NDArray[np.floating]

PLACES_APART = 6
"""px between the places that are looked at: neighbours share most of their surroundings."""

_RINGS, _QUADRANTS = 8, 4
"""Rings with equally many places, in each quarter of a picture: its sectors. By hand."""

_FLOOR_QUANTILE = 0.1
"""The quantile of the variances of a sector that counts, as of those of a picture."""

_FEWEST_PLACES = 100
"""Sectors with fewer say nothing."""

_OUTLIERS, _ROUNDS, _LEAST_SHARE = 2.5, 8, 1e-3
"""Sectors farther from the line than so many deviations are texture, or clipped; rounds of leaving
them out, and the least deviation, as a share of the variance.
"""

_NEAR = 0.25
"""A sector agrees with the line if its variance differs from it by less than this share."""

_AGREEING, _SEEN_QUADRANTS, _OF_EACH_RING = 6, 3, 2
"""So many sectors of a quarter have to agree; so many quarters; so many sectors of each ring."""

_ALIKE = 0.5
"""Share of the growth that such a quarter has to show by itself."""

_LEAST_JPEG = 4_000_000
"""px of a JPEG at least: smaller ones have been scaled down, and what the second compression left
does not grow."""

_LEAST_GROWTH, _MOST_GROWTH = 0.6, 3.0
"""Less growth is not told from texture, and more is not believed. All on photographs, parts of
them, and simulations (docs/decisions.md)."""


@dataclass(frozen=True)
class NoiseShading:
    r"""Noise whose variance grows with the distance from the centre of a picture.

    .. math:: \sigma_n^2(\rho) = \sigma_n^2 \, (1 + g \rho^2)

    Parameters
    ----------
    growth : float
        g: by how much the variance is larger in the corners, as a share of that in the centre.
    center : (float, float)
        Row and column in px of what is seen, which may be a part of the picture.
    radius : float
        Distance from the centre to the corners, in px: there, rho is 1.
    """

    growth: float
    center: tuple[float, float]
    radius: float

    @classmethod
    def over(cls, shape: tuple[int, int], growth: float) -> NoiseShading | None:
        """Return that of a picture of a height and width; None if there is no growth."""
        if growth == 0:
            return None
        row, column = (shape[0] - 1) / 2, (shape[1] - 1) / 2
        return cls(growth, (row, column), float(np.hypot(row, column)))

    def seen_from(self, row: int, column: int) -> NoiseShading:
        """Return the same for a part of the picture that starts at a row and column."""
        return replace(self, center=(self.center[0] - row, self.center[1] - column))

    def halved(self) -> NoiseShading:
        """Return the same for the picture of means of 2 x 2 px."""
        row, column = ((at + 0.5) / 2 - 0.5 for at in self.center)
        return NoiseShading(self.growth, (row, column), self.radius / 2)

    def relative(self, rows: NDArray[np.floating], columns: NDArray[np.floating]) -> Float32:
        """Return how many times noisier than the centre places are: (R, C).

        `rows` and `columns` are in px. Parts of a picture get the bits of the whole.
        """
        across, along = (
            (self.growth * ((at - center) / self.radius) ** 2).astype(np.float32)
            for at, center in zip((rows, columns), self.center, strict=True)
        )
        return (np.float32(1) + across)[:, None] + along

    def relative_over(self, shape: tuple[int, int]) -> Float32:
        """Return how many times noisier than the centre each pixel is: (H, W)."""
        rows, columns = (np.arange(length, dtype=np.float64) for length in shape)
        return self.relative(rows, columns)


@dataclass(frozen=True, eq=False)
class NoisePlaces:
    """Local variances at places of a picture that are known.

    Attributes
    ----------
    finest, fine, intensity : (N,) ndarray
        As a `NoiseSample` has them; `fine` is empty if it was no JPEG.
    outward : (N,) ndarray
        Square of the distance from the picture's centre, 1 in the corners.
    quadrant : (N,) ndarray
        In which quarter of the picture: 0 to 3.
    pixels : int
        Of the whole picture.
    """

    finest: Float
    fine: Float
    intensity: Float
    outward: Float64
    quadrant: NDArray[np.intp]
    pixels: int

    @classmethod
    def joined(cls, parts: list[NoisePlaces]) -> NoisePlaces:
        """Return the places of all parts of a picture."""
        names = "finest", "fine", "intensity", "outward", "quadrant"
        joint = {name: np.concatenate([getattr(one, name) for one in parts]) for name in names}
        return cls(**joint, pixels=parts[0].pixels)

    def flattened(self, growth: float) -> NoisePlaces:
        """Return the same with the variances that noise without this growth would have."""
        relative = 1 + growth * self.outward
        fine = self.fine / relative if self.fine.size else self.fine
        return replace(self, finest=self.finest / relative, fine=fine)

    @property
    def growth(self) -> float:
        """By how much the noise grows towards the corners; that of coarser details in a JPEG."""
        if not self.fine.size:
            return self.growth_of(self.finest)
        return self.growth_of(self.fine) if self.pixels >= _LEAST_JPEG else 0.0

    def growth_of(self, variance: Float) -> float:
        r"""Return by how much variances, (N,), grow towards the corners; 0 if not plainly.

        The flattest places of 32 sectors, 8 rings in each quarter of the picture, have variances
        :math:`v_j` at :math:`\rho_j`, to which a line is fitted:

        .. math:: \underset{a, \, b}{\text{arg min}} \sum_j \left(
            \frac{a + b \rho_j^2}{v_j} - 1\right)^2, \qquad g = \frac{b}{a}

        Sectors far from it do not count. It is taken if three quarters of the picture show it.
        """
        outward, floor = self._sectors(variance)
        if not (np.isfinite(floor).sum(axis=0) >= _AGREEING).sum() >= _SEEN_QUADRANTS:
            return 0.0
        line = _robust_line(outward, floor)
        if line is None:
            return 0.0
        near = np.abs((line[0] + line[1] * outward) / floor - 1) < _NEAR
        growth = line[1] / line[0]
        seen = [
            near[:, one].sum() >= _AGREEING
            and _growth(outward[near[:, one], one], floor[near[:, one], one]) > _ALIKE * growth
            for one in range(_QUADRANTS)
        ]
        if sum(seen) < _SEEN_QUADRANTS or near.sum(axis=1).min() < _OF_EACH_RING:
            return 0.0
        near &= seen
        # The flattest places of a sector are those nearer to the centre: once more, without it.
        outward, floor = self._sectors(variance, growth)
        growth = _growth(outward[near], floor[near])
        return min(growth, _MOST_GROWTH) if growth >= _LEAST_GROWTH else 0.0

    def _sectors(self, variance: Float, growth: float = 0.0) -> tuple[Float64, Float64]:
        """Return mean rho^2 and floor of each sector, (8, 4); NaN where nothing is known.

        `growth` is what is known of it already: floors are those of noise that grows so.
        """
        variance = variance / (1 + growth * self.outward)
        outward, floor = np.full((2, _RINGS, _QUADRANTS), np.nan)
        rings = np.array_split(np.argsort(self.outward, kind="stable"), _RINGS)
        for ring, places in enumerate(rings):
            for quadrant in range(_QUADRANTS):
                own = places[self.quadrant[places] == quadrant]
                if len(own) < _FEWEST_PLACES:
                    continue
                least = float(np.quantile(variance[own], _FLOOR_QUANTILE))
                if least > 0:
                    outward[ring, quadrant] = self.outward[own].mean()
                    floor[ring, quadrant] = least * (1 + growth * outward[ring, quadrant])
        return outward, floor


def _robust_line(outward: Float64, floor: Float64) -> tuple[float, float] | None:
    """Fit a line to the sectors; relative errors count, outliers do not. None if none is plain."""
    known = np.isfinite(floor)
    outward, floor = outward[known], floor[known]
    kept = np.ones(len(floor), bool)
    for _ in range(_ROUNDS):
        line = free_line((outward / floor)[kept], (1 / floor)[kept])
        misfit = np.abs((line[0] + line[1] * outward) / floor - 1)
        kept = misfit < _OUTLIERS * (1.4826 * np.median(misfit[kept]) + _LEAST_SHARE)
        if kept.sum() < _RINGS:
            return None
    return line if min(line) > 0 else None


def _growth(outward: Float64, floor: Float64) -> float:
    """Return the growth that a line fitted to sectors says."""
    constant, slope = free_line(outward / floor, 1 / floor)
    return float(slope / constant) if constant > 0 else math.inf


def free_line(slope: Float64, constant: Float64) -> tuple[float, float]:
    """Return a and b of the least sum of (a constant + b slope - 1)^2."""
    cc, cs, ss = (float(np.sum(one)) for one in (constant**2, constant * slope, slope**2))
    c, s = float(np.sum(constant)), float(np.sum(slope))
    determinant = cc * ss - cs * cs
    if determinant <= 0:
        return c / cc, 0.0
    return (c * ss - s * cs) / determinant, (s * cc - c * cs) / determinant

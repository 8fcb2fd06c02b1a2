r"""The weight of each plane of a stack in one picture, at every pixel and for each size of detail.

A plane that is blurred by r px shows details of one size with a share B(r) of their contrast. All
planes have noise of variance n. If the details have the variance S, and the weights w add up to 1,
the mean squared error is

.. math:: S \Bigl(\sum_z w_z d_z\Bigr)^2 + n \sum_z w_z^2, \qquad d_z = 1 - B(k |z - z_0|)

Among weights that are not negative, it is least for

.. math:: w_z \propto \max(0, 1 - \tau d_z), \qquad
    \tau = \frac{S}{n} \sum_z \max(0, 1 - \tau d_z) \, d_z

Where there is much detail, this is the plane in focus alone. It is several planes where the
position lies between two, or where neither blurs coarse details. Where no plane shows any detail,
it is the mean of all, with less noise. S is the most that any plane shows at a place. So the halo
of something bright in a plane out of focus counts as detail, too, and is not averaged in.

Real blur differs a little from the model. Among the planes near the position, the one that shows
the most contrast counts as the least blurred. The others count as blurred at least as much as their
contrast says.

Clipped light tells no contrast: its spots grow with blur, and their edges stay sharp. But blur
spreads it to where it is not clipped, so that less of it is lost. So near clipped light, the plane
with the least light near the position counts as the least blurred. What planes have more of it, as
a share of the range, is added to d.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.compiled import compiled, compiled_inline
from napari_defocus.core.threads import in_bands
from napari_defocus.psf.families import PSFFamily
from napari_defocus.stacks.pyramids import bands, noise_of_levels
from napari_defocus.stacks.shown_detail import ShownDetail

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

_CHANCE = 1.5
"""What the most of several planes may show by chance, in units of the noise's variance. By hand."""

_LEAST_NOISE = np.finfo(np.float32).tiny
"""The least variance, so that it can be divided by."""

_POSITIONS_A_PLANE, _RATIOS = 32, np.logspace(-2, 6, 33)
"""The table of tau: positions from plane to plane, and values of S / n."""

_HALVINGS = 30
"""Steps of the bisection that finds tau."""

_RADII = 41
"""Radii at which B is measured, up to the family's largest scale."""

_TINY = 1e-12

_NEAR = np.float32(1.5)
"""Within so many planes of the position, the planes' own contrast says which is sharper. By hand.
"""

_NOT_ALL = np.float32(1 - 1e-6)
"""The most contrast of planes farther away, as a share: they are not the sharpest."""

_LEAST_ROWS = 32
"""Fewer rows are not worth a thread of their own. Results do not depend on it."""


@dataclass(frozen=True, eq=False)
class Shares:
    """Which share planes have in details of every size.

    Attributes
    ----------
    planes : int
    px_per_plane : float
        k.
    psf : PSFFamily
    noise_variance : float
        n, in the units of `shown`.
    shown : ShownDetail
        S + n of each level is the most that any plane shows.
    """

    planes: int
    px_per_plane: float
    psf: PSFFamily
    noise_variance: float
    shown: ShownDetail

    @cached_property
    def _tables(self) -> list[tuple[Float32, Float32, Float32]]:
        """Three tables for each level.

        For each position and plane: how much larger d is than that of the best plane. For each
        position and S / n: the best plane's weight, and how much other weights fall with d.
        """
        positions = np.arange((self.planes - 1) * _POSITIONS_A_PLANE + 1) / _POSITIONS_A_PLANE
        radius = self.px_per_plane * np.abs(np.arange(self.planes) - positions[:, None])
        scales, response = _responses(self.psf, len(self.shown))
        tables = []
        for of_level in response:
            lost = 1 - np.interp(radius, scales, of_level)
            tau = np.stack([_tau(lost, ratio) for ratio in _RATIOS], axis=1)
            total = np.maximum(1 - tau[..., None] * lost[:, None], 0).sum(axis=2)
            total = np.maximum(total, _TINY)
            least = lost.min(axis=1, keepdims=True)
            made = (lost - least, (1 - tau * least) / total, tau / total)
            tables.append(tuple(table.astype(np.float32) for table in made))
        return tables

    def at(self, position: Float32) -> list[Weights]:
        """Return the weights of planes in each level, where the best focus is at positions."""
        noises = self.noise_variance * noise_of_levels(len(self.shown))
        near = self.shown.near_clipped()
        return [
            Weights.of(
                np.ascontiguousarray(position[:: 2**level, :: 2**level]),
                self.shown.energy[level],
                self.shown.light[level],
                near[level],
                self._tables[level],
                float(noise),
                1 / max(self.shown.range, _TINY),
            )
            for level, noise in enumerate(noises)
        ]


@dataclass(frozen=True, eq=False)
class Weights:
    """The weights of planes in one level.

    Attributes
    ----------
    position : (h, w) float32 ndarray
    energy, light : (Z, h / 2, w / 2) float32 ndarray
        See `ShownDetail`.
    noise, per_range : float32
        The variance of the noise in this level, and 1 over the range of the light.
    clipped : (h, w) bool ndarray
        Near clipped light.
    lost : (P, Z) float32 ndarray
        How much larger d is than the best plane's, at each position.
    best, fall : (h, w) float32 ndarray
        The weight of the best plane, and how much that of others falls with d.
    most, least : (h, w) float32 ndarray
        Of the planes near the position: the most energy, and the least d where light is clipped.
    """

    position: Float32
    energy: Float32
    light: Float32
    noise: np.float32
    per_range: np.float32
    clipped: Mask
    lost: Float32
    best: Float32
    fall: Float32
    most: Float32
    least: Float32

    @classmethod
    def of(
        cls,
        position: Float32,
        energy: Float32,
        light: Float32,
        clipped: Mask,
        tables: tuple[Float32, Float32, Float32],
        noise: float,
        per_range: float,
    ) -> Weights:
        """Find what does not depend on the plane, for noise of a variance in this level."""
        lost, best, fall = tables
        ratio = energy.max(axis=0) / np.float64(max(noise, float(_LEAST_NOISE))) - _CHANCE
        step = np.log(_RATIOS[1] / _RATIOS[0])
        column = np.log(np.maximum(ratio, _RATIOS[0]) / _RATIOS[0]) / step
        found = cls(
            position, energy, light, np.float32(noise), np.float32(per_range), clipped, lost,
            *(np.empty_like(position) for _ in range(4)),
        )  # fmt: skip
        in_bands(
            _prepare, len(position), position, energy, light, found.noise,
            found.per_range, clipped, column.astype(np.float32), lost, best, fall, found.best,
            found.fall, found.most, found.least, least=_LEAST_ROWS,
        )  # fmt: skip
        return found

    def of_plane(self, number: int) -> Float32:
        """Return the weight of a plane at every place: (h, w)."""
        weight = np.empty_like(self.position)
        in_bands(
            _weigh, len(weight), number, self.position, self.energy[number], self.light[number],
            self.noise, self.per_range, self.clipped, self.lost, self.best, self.fall, self.most,
            self.least, weight, least=_LEAST_ROWS,
        )  # fmt: skip
        return weight


@compiled_inline
def _between(small: Float32, row: int, column: int) -> Any:
    """Return the value at a pixel of what is kept at half the size."""
    top, left = row // 2, column // 2
    bottom = min(top + row % 2, small.shape[0] - 1)
    right = min(left + column % 2, small.shape[1] - 1)
    return np.float32(0.25) * (
        small[top, left] + small[top, right] + small[bottom, left] + small[bottom, right]
    )


@compiled_inline
def _along(table: Float32, row: Any, column: int) -> Any:
    """Return what a table has between two rows."""
    top = min(int(row), table.shape[0] - 1)
    part = row - np.float32(top)
    bottom = min(top + 1, table.shape[0] - 1)
    return table[top, column] + part * (table[bottom, column] - table[top, column])


@compiled
def _prepare(
    start: int,
    stop: int,
    position: Float32,
    energy: Float32,
    light: Float32,
    noise: np.float32,
    per_range: np.float32,
    clipped: Mask,
    column: Float32,
    lost: Float32,
    best: Float32,
    fall: Float32,
    of_best: Float32,
    falls: Float32,
    most: Float32,
    least: Float32,
) -> None:
    steps, last = np.float32(_POSITIONS_A_PLANE), best.shape[1] - 1
    for y in range(start, stop):
        for x in range(position.shape[1]):
            row = position[y, x] * steps
            at = min(_between(column, y, x), np.float32(last))
            left = int(at)
            right, part = min(left + 1, last), at - np.float32(left)
            for table, values in ((best, of_best), (fall, falls)):
                first, second = _along(table, row, left), _along(table, row, right)
                values[y, x] = first + part * (second - first)
            first_near = max(int(np.ceil(position[y, x] - _NEAR)), 0)
            last_near = min(int(np.floor(position[y, x] + _NEAR)), len(energy) - 1)
            largest, smallest = np.float32(0), np.float32(np.inf)
            for plane in range(first_near, last_near + 1):
                largest = max(largest, _between(energy[plane], y, x) - noise)
                if clipped[y, x]:
                    more = _along(lost, row, plane) + per_range * _between(light[plane], y, x)
                    smallest = min(smallest, more)
            most[y, x], least[y, x] = largest, smallest


@compiled
def _weigh(
    start: int,
    stop: int,
    number: int,
    position: Float32,
    energy: Float32,
    light: Float32,
    noise: np.float32,
    per_range: np.float32,
    clipped: Mask,
    lost: Float32,
    best: Float32,
    fall: Float32,
    most: Float32,
    least: Float32,
    weight: Float32,
) -> None:
    one, zero, steps = np.float32(1), np.float32(0), np.float32(_POSITIONS_A_PLANE)
    for y in range(start, stop):
        for x in range(position.shape[1]):
            more = _along(lost, position[y, x] * steps, number)
            near = abs(position[y, x] - np.float32(number)) <= _NEAR
            if clipped[y, x]:
                if near:
                    more += per_range * _between(light, y, x) - least[y, x]
            else:
                shown = one
                if most[y, x] > 0:
                    of_plane = max(_between(energy, y, x) - noise, zero)
                    shown = np.sqrt(of_plane / most[y, x])
                if near and shown >= one:
                    more = zero
                elif near:
                    more = max(more, one - shown)
                else:
                    more = max(more, one - min(shown, _NOT_ALL))
            weight[y, x] = max(best[y, x] - fall[y, x] * more, zero)


def _tau(lost: Float64, ratio: float) -> Float64:
    """Solve for tau, for each row of d: its right side falls with it, its left one grows."""
    low, high = np.zeros(len(lost)), np.full(len(lost), ratio * lost.shape[1])
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        right = ratio * (np.maximum(1 - middle[:, None] * lost, 0) * lost).sum(axis=1)
        above = middle < right
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    return (low + high) / 2


def _responses(psf: PSFFamily, levels: int) -> tuple[Float64, Float64]:
    """Return scales, and the share of the contrast of each level's details that blur leaves.

    For details of one level, white within it.
    """
    scales = np.linspace(0, psf.max_scale, _RADII)
    band = bands(levels)
    frequency = np.fft.fftfreq(band.shape[1])
    found = np.empty((levels, len(scales)))
    for number, scale in enumerate(scales):
        kernel = psf.kernel(scale) if scale > 0 else np.ones((1, 1))
        rows, columns = (np.arange(length) - length // 2 for length in kernel.shape)
        wave_r = np.cos(2 * np.pi * np.outer(frequency, rows))
        wave_c = np.cos(2 * np.pi * np.outer(columns, frequency))
        transfer = np.einsum("ri,ij,jc->rc", wave_r, kernel, wave_c)
        found[:, number] = (band * transfer).sum(axis=(1, 2)) / band.sum(axis=(1, 2))
    return scales, found

r"""One picture from many planes: the weight of each, at every pixel and for each size of detail.

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

The sizes of detail are the levels of a Laplacian pyramid (Burt and Adelson, 1983). The weights of a
level are smooth, so that no seam shows between planes. Planes are read one at a time, and each adds
to the sums of all levels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d, gaussian_filter, map_coordinates

from napari_defocus.core.image import nearest_known
from napari_defocus.core.known_pixels import known_pixels
from napari_defocus.core.progress import Progress
from napari_defocus.psf.families import PSFFamily
from napari_defocus.stacks.matched_planes import cast_to

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Floating = NDArray[np.floating]

_BINOMIAL = np.array([1, 4, 6, 4, 1], np.float32) / 16

_LEVELS, _SMALLEST = 5, 8
"""The most levels of a pyramid, and the least side of its smallest level, in px. Chosen by hand."""

_AREA = 2.0
"""px of a level: standard deviation of the Gaussian over which S is averaged. Chosen by hand."""

_TRANSITION = 0.7
"""px of a level: standard deviation of the Gaussian that smooths weights. Chosen by hand."""

_CHANCE = 1.5
"""What the most of several planes may show by chance, in units of the noise's variance. By hand."""

_LEAST_NOISE = np.finfo(np.float32).tiny
"""The least variance, so that it can be divided by."""

_POSITIONS_A_PLANE, _RATIOS = 32, np.logspace(-2, 6, 33)
"""The table of tau: positions from plane to plane, and values of S / n."""

_HALVINGS = 30
"""Steps of the bisection that finds tau."""

_SIDE = 64
"""px of the pattern by which B of a level is measured."""

_RADII = 41
"""Radii at which B is measured, up to the family's largest scale."""

_TINY = 1e-12

_NEAR = 1.5
"""Within so many planes of the position, the planes' own contrast says which is sharper. By hand.
"""

_NOT_ALL = np.float32(1 - 1e-6)
"""The most contrast of planes farther away, as a share: they are not the sharpest."""

_LEAST_WEIGHT = 1e-6
"""Weight of a plane without any share: it counts only where no better one is known."""


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
        n, in the units of `energy`.
    energy : list of (h, w) float32 ndarray
        S + n of each level: the most that any plane shows.
    """

    planes: int
    px_per_plane: float
    psf: PSFFamily
    noise_variance: float
    energy: Sequence[Float32]

    @cached_property
    def _tables(self) -> list[tuple[Float64, Float64, Float64]]:
        """Three tables for each level.

        For each position and plane: how much larger d is than that of the best plane. For each
        position and S / n: the best plane's weight, and how much other weights fall with d.
        """
        positions = np.arange((self.planes - 1) * _POSITIONS_A_PLANE + 1) / _POSITIONS_A_PLANE
        radius = self.px_per_plane * np.abs(np.arange(self.planes) - positions[:, None])
        scales, response = _responses(self.psf, len(self.energy))
        tables = []
        for of_level in response:
            lost = 1 - np.interp(radius, scales, of_level)
            tau = np.stack([_tau(lost, ratio) for ratio in _RATIOS], axis=1)
            total = np.maximum(1 - tau[..., None] * lost[:, None], 0).sum(axis=2)
            total = np.maximum(total, _TINY)
            least = lost.min(axis=1, keepdims=True)
            tables.append((lost - least, (1 - tau * least) / total, tau / total))
        return tables

    def at(self, level: int, number: int, position: Float32, shown: Float32) -> Float32:
        """Return the weights of a plane in a level, where the best focus is at these positions.

        `shown` is the contrast of details in this plane, as a share of that of the planes near
        the position. It corrects the model where planes are blurred otherwise.
        """
        lost, best, slope = self._tables[level]
        noise = max(self.noise_variance, _LEAST_NOISE) * noise_of_levels(len(self.energy))[level]
        ratio = np.maximum(self.energy[level] / noise - _CHANCE, _RATIOS[0])
        row = position * _POSITIONS_A_PLANE
        step = np.log(_RATIOS[1] / _RATIOS[0])
        column = np.clip(np.log(ratio / _RATIOS[0]) / step, 0, len(_RATIOS) - 1)
        of_best, fall = (
            map_coordinates(table, [row, column], np.float32, order=1, mode="nearest")
            for table in (best, slope)
        )
        more = np.interp(row, np.arange(len(lost)), lost[:, number])
        more = np.where(shown >= 1, 0, more)
        return np.maximum(of_best - fall * np.maximum(more, 1 - shown), 0).astype(np.float32)

    def contrast(self, level: int, energy: Float32) -> Float32:
        """Return the contrast of a level's details, from their energy, without the noise's."""
        noise = self.noise_variance * noise_of_levels(len(self.energy))[level]
        return np.sqrt(np.maximum(energy - np.float32(noise), 0))


def near(position: Float32, number: int) -> NDArray[np.bool_]:
    """Return where a plane is so near the position that it may have a share."""
    return np.abs(position - np.float32(number)) <= _NEAR


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
    frequency = np.fft.fftfreq(_SIDE)
    band = _bands(levels)
    found = np.empty((levels, len(scales)))
    for number, scale in enumerate(scales):
        kernel = psf.kernel(scale) if scale > 0 else np.ones((1, 1))
        rows, columns = (np.arange(length) - length // 2 for length in kernel.shape)
        wave_r = np.cos(2 * np.pi * np.outer(frequency, rows))
        wave_c = np.cos(2 * np.pi * np.outer(columns, frequency))
        transfer = np.einsum("ri,ij,jc->rc", wave_r, kernel, wave_c)
        found[:, number] = (band * transfer).sum(axis=(1, 2)) / band.sum(axis=(1, 2))
    return scales, found


def _bands(levels: int) -> Float64:
    """Return the power that each level of a pyramid takes of each frequency: (L, F, F)."""
    frequency = np.fft.fftfreq(_SIDE)
    passed, bands = np.ones((_SIDE, _SIDE)), []
    for level in range(levels):
        low = np.ones(_SIDE)
        if level < levels - 1:
            angle = 2 * np.pi * frequency * 2**level
            low = (6 + 8 * np.cos(angle) + 2 * np.cos(2 * angle)) / 16
        through = np.outer(low, low)
        bands.append((passed * (1 - through if level < levels - 1 else 1)) ** 2)
        passed = passed * through
    return np.stack(bands)


def noise_of_levels(levels: int) -> Float64:
    """Return the variance that white noise of variance 1 has in each level of a pyramid.

    What is left out when a level is halved is noise that comes back folded: powers add up.
    """
    return np.asarray(_bands(levels).mean(axis=(1, 2)))


def levels_for(shape: tuple[int, ...]) -> int:
    """Return how many levels the pyramid of a plane has."""
    return int(np.clip(np.log2(max(min(shape[:2]) / _SMALLEST, 1)) + 1, 1, _LEVELS))


def pyramid(picture: Floating, levels: int) -> list[Floating]:
    """Return the Laplacian pyramid of a picture, (H, W[, C]); the last level is its rest."""
    found = []
    for _ in range(levels - 1):
        small = _halved(picture)
        found.append(picture - _doubled(small, picture.shape))
        picture = small
    return [*found, picture]


def assembled(levels: Sequence[Floating]) -> Floating:
    """Return the picture of a Laplacian pyramid."""
    picture = levels[-1]
    for details in levels[-2::-1]:
        picture = details + _doubled(picture, details.shape)
    return picture


def _smooth(picture: Floating) -> Floating:
    return correlate1d(
        correlate1d(picture, _BINOMIAL, 0, mode="mirror"), _BINOMIAL, 1, mode="mirror"
    )


def _halved(picture: Floating) -> Floating:
    return _smooth(picture)[::2, ::2]


def _doubled(small: Floating, shape: tuple[int, ...]) -> Floating:
    spread = np.zeros(shape, small.dtype)
    spread[::2, ::2] = 4 * small
    return _smooth(spread)


def local_energy(luminance: Float32, levels: int) -> list[Float32]:
    """Return the energy of details of each level around each place."""
    return [gaussian_filter(each**2, _AREA) for each in pyramid(luminance, levels)]


class Most:
    """The most energy that any of several planes shows, level by level."""

    def __init__(self, levels: int) -> None:
        self.levels = levels
        self.energy: list[Float32] = []

    def see(self, luminance: Float32) -> None:
        """Look at another plane."""
        found = local_energy(luminance, self.levels)
        if not self.energy:
            self.energy = found
        for most, energy in zip(self.energy, found, strict=True):
            np.maximum(most, energy, out=most)


def blended(
    read: Callable[[int], NDArray[Any]],
    prepare: Callable[[NDArray[Any]], Float32],
    position: Float32,
    shares: Shares,
    progress: Progress,
) -> NDArray[Any]:
    """Put planes together by their shares: (H, W) or (H, W, C), of their dtype.

    Planes are read twice: for the most contrast near each position, and to be added up.

    Parameters
    ----------
    read : callable
        Returns a plane, given its number: (H, W) or (H, W, C), masked or NaN where not known.
    prepare : callable
        Returns the luminance of such a plane, in the units of `shares`.
    position : (H, W) float32 ndarray
        Of best focus, in planes from the first.
    shares : Shares
    progress : callable
    """
    step, count = "Putting the planes together", len(shares.energy)
    positions = [position[:: 2**level, :: 2**level] for level in range(count)]
    most = [np.zeros(each.shape, np.float32) for each in positions]
    for number in range(shares.planes):
        progress(step, number / shares.planes / 2)
        for level, energy in enumerate(local_energy(prepare(read(number)), count)):
            contrast = np.where(near(positions[level], number), shares.contrast(level, energy), 0)
            np.maximum(most[level], contrast, out=most[level])
    sums: list[Floating] = []
    weights: list[Floating] = []
    seen = np.zeros(position.shape, bool)
    for number in range(shares.planes):
        progress(step, 0.5 + number / shares.planes / 2)
        plane = read(number)
        known = known_pixels(plane)
        seen |= True if known is None else known
        details = pyramid(_filled(plane, known), count)
        sums = sums or [np.zeros_like(each) for each in details]
        weights = weights or [np.zeros_like(each[..., 0]) for each in details]
        energies = local_energy(prepare(plane), count)
        for level, at in enumerate(positions):
            contrast = shares.contrast(level, energies[level])
            shown = np.divide(
                contrast, most[level], where=most[level] > 0, out=np.ones_like(contrast)
            )
            shown = np.where(near(at, number), shown, np.minimum(shown, _NOT_ALL))
            weight = shares.at(level, number, at, shown)
            weight = gaussian_filter(weight, _TRANSITION) + np.float32(_LEAST_WEIGHT)
            if known is not None:
                weight *= known[:: 2**level, :: 2**level]
            weights[level] += weight
            sums[level] += weight[..., None] * details[level]
        dtype, shape = plane.dtype, plane.shape
    for level, weight in enumerate(weights):
        sums[level] /= np.maximum(weight, np.finfo(np.float32).tiny)[..., None]
    picture = assembled(sums).reshape(shape)
    progress(step, 1.0)
    composite = cast_to(picture, dtype)
    if not seen.all():
        composite[~seen] = np.nan if dtype.kind == "f" else 0
    return composite


def _filled(plane: NDArray[Any], known: NDArray[np.bool_] | None) -> Floating:
    """Return a plane as (H, W, C) of floats; unknown pixels have the nearest one's colour."""
    single = plane.dtype.itemsize <= 2 or plane.dtype == np.float32
    values: Floating = np.ma.getdata(plane).astype(np.float32 if single else np.float64)
    values = values.reshape(*values.shape[:2], -1)
    return values if known is None else nearest_known(values, known)

"""Depth from focus: where along a stack each place is sharp, by the power its planes share.

A thin lens that is moved by equal steps blurs by r_z = k |z - z0| px in plane z. All planes show
one scene. So its local power S_f at a frequency f, which is unknown for a single picture, is the
same in each of them. Plane z should have the power S_f B_f(r_z) + n_f, with the blur spectrum B (6)
and the spectrum n of the noise (7). The power P_zf that is seen costs the deviance of (5) from a
perfect fit,

    d = q - 1 - log q   with   q = P_zf / (S_f B_f(r_z) + n_f),

and a place in focus at z0 costs the sum of d over planes and frequencies, with the best S_f.
That is far sharper evidence than the curves of single pictures, where a blurred edge and a smooth
thing look alike. It needs no resolution in frequency, so windows can be small.
Planes blurred by more than the family's largest scale count as blurred by that much.

Frequencies are joined in rings (the same |f|), and both gradients are added. Memory grows by
four numbers a window and plane, for windows of 17 px.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from napari_defocus.core.compiled import compiled, compiled_inline
from napari_defocus.core.image import PreparedImage
from napari_defocus.core.threads import in_bands
from napari_defocus.likelihood.blur_spectra import spectrum_table
from napari_defocus.likelihood.gabor import frequencies, gradients, local_power, window_centers
from napari_defocus.psf.families import PSFFamily

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]
Mask = NDArray[np.bool_]

_RING_WIDTH = np.sqrt(2)
"""Width of a ring of frequencies, in cycles per window. Chosen by hand."""

_LEAST_NOISE = 1e-9
"""The least variance of the noise, for a contrast of 1. Chosen by hand."""

_SCORING_ROUNDS = 2
"""Steps of Fisher scoring after least squares. Chosen by hand."""

_LEAST_POWER, _TINY = np.float32(1e-3), np.float32(1e-12)
"""The least P_zf whose logarithm is taken, in units of the noise; and what is added to squares
before they are divided by. Chosen by hand.
"""

_MOST_DEVIANCE = np.float32(3)
"""Units of log-likelihood that d of one plane and frequency counts at most. Chosen by hand."""

_LEAST_DISPERSION = np.float32(0.05)
"""The least dispersion of a window: no fit is trusted more. Chosen by hand."""

_ENOUGH = np.float32(0.9)
"""A plane counts if it knows at least this share of what the best plane knows of a window. By hand.
"""

_ROWS_AT_ONCE = 64
"""Rows of windows that are worked on at once. Results do not depend on it."""

_LEAST_BLUR, MOST_PX_A_PLANE = 0.7, 8.0
"""px: the least blur over a whole stack, and the most from plane to plane, that is looked for.
Chosen by hand.
"""

_LADDER, _HALVINGS = np.sqrt(2), 4
"""The factor from one rate (px a plane) to the next that is tried, and how often it is halved
around the best one. Chosen by hand.
"""

_WINDOWS_FOR_RATE = 400
"""About so many windows decide about the rate. Chosen by hand."""

_LEAST_PEAK, _LEAST_RISE, _FEWEST_WINDOWS = 4.0, 1.5, 8
"""Windows decide if their power in the sharpest plane is so many times that of the noise and so
many times its median over the planes. There must be at least so many. By hand.
"""

_HALF_PLANE = 0.5
"""Planes between positions that are tried for the rate."""


@dataclass(frozen=True, eq=False)
class RingBank:
    """The filter bank for planes of one size, its frequencies joined in B rings.

    Attributes
    ----------
    rows, columns : (R,) and (C,) float64 ndarray
        Centres of the windows, in px.
    window : int
        N, in px.
    members : (F, B) float32 ndarray
        1 where a frequency is in a ring.
    scales : (M,) float64 ndarray
        In px.
    blur : (M, B) float64 ndarray
        (6), over the noise spectrum of a variance of 1.
    noise : (B,) float64 ndarray
        (7) for a variance of 1.
    """

    rows: Float64
    columns: Float64
    window: int
    members: Float32
    scales: Float64
    blur: Float64
    noise: Float64

    @classmethod
    def over(cls, shape: tuple[int, int], psf: PSFFamily, window: int, stride: int) -> RingBank:
        """Lay windows over planes of a height and width."""
        rows, columns = (window_centers(length, stride) for length in shape)
        table = spectrum_table(psf, window, rows[0] % 1, columns[0] % 1, "exact", mixed=True)
        radius = np.rint(np.hypot(*frequencies(window).T) / _RING_WIDTH)
        members = (radius[:, None] == np.unique(radius)).astype(np.float32)
        noise = np.einsum("f,fb->b", table.noise.sum(axis=0), members)
        blur = np.einsum("mf,fb->mb", table.value.sum(axis=1), members) / noise
        return cls(rows, columns, window, members, table.scales, blur, noise)

    def room_for(self, planes: int) -> Float32:
        """Return an array for the power of so many planes: (P, B, Z)."""
        return np.empty((len(self.rows) * len(self.columns), len(self.noise), planes), np.float32)

    def power(self, luminance: Float32, opaque: Mask | None = None) -> Float32:
        """Return the local power of a plane in each ring, in units of noise: (R, C, B).

        Planes are mirrored outwards, so that each place has a window of its own.
        """
        pad = self.window // 2 + 1
        luminance = np.pad(luminance, pad, mode="symmetric")
        opaque = None if opaque is None else np.pad(opaque, pad, mode="symmetric")
        gradient = gradients(luminance, opaque, self.window)
        found = np.empty((len(self.rows), len(self.columns), len(self.noise)), np.float32)
        for top in range(0, len(self.rows), _ROWS_AT_ONCE):
            block = slice(top, top + _ROWS_AT_ONCE)
            power = local_power(gradient, self.rows[block] + pad, self.columns + pad, self.window)
            found[block] = np.einsum("rcf,fb->rcb", power.sum(axis=2), self.members) / self.noise
        return found

    def known_share(self, picture: PreparedImage) -> Float32:
        """Return which share of each window is known in a plane: (R, C)."""
        shape = len(self.rows), len(self.columns)
        if picture.opaque is None:
            return np.ones(shape, np.float32)
        share = uniform_filter(picture.opaque.astype(np.float32), self.window)
        rows, columns = (np.rint(at).astype(int) for at in (self.rows, self.columns))
        return np.asarray(share[np.ix_(rows, columns)])


def heard_where(shares: list[Float32]) -> Mask:
    """Return which planes count, (P, Z): those that know about as much as the best plane."""
    share = np.stack([each.ravel() for each in shares], axis=1)
    return share >= _ENOUGH * share.max(axis=1, keepdims=True)


@dataclass(frozen=True, eq=False)
class StackPower:
    """The local power of all planes of a stack, at every window.

    Attributes
    ----------
    power : (P, B, Z) float32 ndarray
        Of P windows, B rings and Z planes, relative to the noise.
    bank : RingBank
    noise_variance : float
        Of all planes.
    gain : (Z,) float64 ndarray
        How bright each plane is, against the others.
    heard : (P, Z) bool ndarray
        False where a plane shows nothing, or nothing of the window's own: it has no say there.
    """

    power: Float32
    bank: RingBank
    noise_variance: float
    gain: Float64
    heard: Mask

    @classmethod
    def of(
        cls,
        power: Float32,
        bank: RingBank,
        noise_variance: float,
        gain: Float64,
        heard: Mask,
        unit: float = 1.0,
    ) -> StackPower:
        """Take what `RingBank.power` has found in the planes, and divide it by the noise's.

        `unit` is that of `Intensities`.
        """
        variance = max(noise_variance, _LEAST_NOISE * unit**2)
        power /= np.float32(variance)
        return cls(power, bank, variance, gain, heard)

    def at(self, windows: Mask) -> StackPower:
        """Return that of some windows."""
        return replace(self, power=self.power[windows], heard=self.heard[windows])

    def cost(self, positions: Float64, px_per_plane: float) -> Float32:
        """Return what a best focus at each position costs at each window: (P, L).

        In units of log-likelihood, divided by the dispersion of each window: its mean deviance
        for the best position against that of the exponential distribution.
        """
        cost, dispersion = self._deviance(self.power, self.heard, positions, px_per_plane)
        cost /= dispersion[:, None]
        return cost

    def px_per_plane(self) -> float:
        """Find by how many px the blur grows from plane to plane; NaN without any texture.

        It follows from the width of the peak that each ring's power has along the planes. Of
        several rates, the one with the least deviance over the windows with the most texture is
        taken.
        """
        power, heard = self._some_with_texture()
        if not len(power):
            return float("nan")
        planes = power.shape[2]
        positions = np.arange(0, planes - 1 + _HALF_PLANE / 2, _HALF_PLANE)
        rungs = int(np.ceil(np.log(MOST_PX_A_PLANE * (planes - 1) / _LEAST_BLUR) / np.log(_LADDER)))
        rates = MOST_PX_A_PLANE * _LADDER ** -np.arange(rungs + 1.0)
        best, least = rates[0], np.inf
        for halving in range(_HALVINGS + 1):
            for rate in rates:
                misfit = float(self._deviance(power, heard, positions, rate)[0].min(axis=1).sum())
                if misfit < least:
                    best, least = rate, misfit
            rates = best * _LADDER ** (np.array([-0.5, 0.5]) / 2**halving)
        return float(best)

    def peak(self) -> Float32:
        """Return the most power of each window, in planes that count: (P,)."""
        return self._peak_and_median()[0]

    def excess(self) -> Float64:
        """Return by how much each window's power rises above its median over the planes: (P,).

        In units of the noise's, the mean over all frequencies: noise alone gives 0.4 to 0.9.
        """
        peak, usual = self._peak_and_median()
        return np.asarray(peak - usual)

    def mean_power(self) -> Float32:
        """Return the power of each window in each plane, the mean over all frequencies: (P, Z)."""
        members = self.bank.members.sum(axis=0)
        return np.einsum("pbz,b->pz", self.power, members / members.sum())

    def _peak_and_median(self) -> tuple[Float32, Float32]:
        """Return the largest and the median power of each window, in planes that count."""
        mean = self.mean_power()
        if self.heard.all():
            return mean.max(axis=1), np.median(mean, axis=1)
        count = np.maximum(self.heard.sum(axis=1), 1)
        ordered = np.sort(np.where(self.heard, mean, np.inf), axis=1)
        ordered = np.where(np.isfinite(ordered), ordered, 0)
        rows = np.arange(len(ordered))
        middle = (ordered[rows, (count - 1) // 2] + ordered[rows, count // 2]) / 2
        return ordered[rows, count - 1], middle

    def _some_with_texture(self) -> tuple[Float32, Mask]:
        """Return the power of windows that show much more in some plane than in most: (p, B, Z).

        And which planes have a say there.
        """
        peak, usual = self._peak_and_median()
        shown = np.flatnonzero((peak > _LEAST_PEAK) & (peak > _LEAST_RISE * usual))
        if len(shown) < _FEWEST_WINDOWS:
            return self.power[:0], self.heard[:0]
        some = shown[:: max(1, len(shown) // _WINDOWS_FOR_RATE)]
        return self.power[some], self.heard[some]

    def _deviance(
        self, power: Float32, heard: Mask, positions: Float64, px_per_plane: float
    ) -> tuple[Float32, Float32]:
        radius = px_per_plane * np.abs(np.arange(len(self.gain)) - positions[:, None])
        rings = range(self.bank.blur.shape[1])
        blur = np.stack(
            [np.interp(radius, self.bank.scales, self.bank.blur[:, ring]) for ring in rings],
            axis=1,
        )
        blur *= self.gain**2 / self.noise_variance
        members = self.bank.members.sum(axis=0)
        return _deviances(power, heard, blur.astype(np.float32), members)


def _deviances(
    power: Float32, heard: Mask, blur: Float32, members: Float32
) -> tuple[Float32, Float32]:
    """Return the deviance for every position, (P, L), and the dispersion of every window, (P,).

    `blur`, (L, B, Z), is what a power of 1 would show, in units of noise, if a place were in
    focus at each position. Every ring's own power is found by least squares, then by scoring.
    """
    deviance = np.empty((len(power), len(blur)), np.float32)
    in_bands(_deviances_of, len(power), power, heard, blur, members, deviance)
    degrees = np.maximum(heard.sum(axis=1, dtype=np.float32), np.float32(1)) * members.sum()
    dispersion = np.maximum(np.float32(2) * deviance.min(axis=1) / degrees, _LEAST_DISPERSION)
    return deviance, dispersion.astype(np.float32)


@compiled
def _deviances_of(
    start: int,
    stop: int,
    power: Float32,
    heard: Mask,
    blur: Float32,
    members: Float32,
    deviance: Float32,
) -> None:
    _, rings, planes = power.shape
    one, zero = np.float32(1), np.float32(0)
    for window in range(start, stop):
        for position in range(blur.shape[0]):
            total = zero
            for ring in range(rings):
                strength = _strength(power, heard, blur, window, position, ring)
                for plane in range(planes):
                    if not heard[window, plane]:
                        continue
                    expected = one + strength * blur[position, ring, plane]
                    ratio = max(power[window, ring, plane], _LEAST_POWER) / expected
                    total += members[ring] * min(ratio - one - np.log(ratio), _MOST_DEVIANCE)
            deviance[window, position] = total


@compiled_inline
def _strength(
    power: Float32, heard: Mask, blur: Float32, window: int, position: int, ring: int
) -> np.float32:
    """Find the power that planes have in common: least squares, then Fisher scoring."""
    one, zero, strength = np.float32(1), np.float32(0), np.float32(0)
    for scoring in range(_SCORING_ROUNDS + 1):
        product, square = zero, _TINY
        for plane in range(power.shape[2]):
            if not heard[window, plane]:
                continue
            shown = blur[position, ring, plane]
            expected = one + strength * shown if scoring else one
            weight = shown / (expected * expected)
            product += weight * (power[window, ring, plane] - one)
            square += weight * shown
        strength = max(product / square, zero)
    return strength

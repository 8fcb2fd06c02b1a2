"""The likelihood of a blur scale given local power spectra: (5), (9), (11), (13).

Powers are taken relative to the noise spectrum: q_i = |g_i|^2 / sigma_ni^2 and
a_i(r) = sigma_i^2(r) / sigma_ni^2, so that the variance in (5) is sigma_ni^2 (1 + s a_i) and

    -log p = sum_i  q_i / (1 + s a_i) + log(1 + s a_i) + log sigma_ni^2.

Both gradients are used: their log-likelihoods, each with its own s, are added.

Pictures are not what (2) assumes: fences, stems and borders put their power into few of the
frequencies. Where the model fits badly, its likelihood is far too sure of itself. So each
gradient's log-likelihood is divided by its dispersion, the mean square of
q_i / (1 + s a_i) - 1 at the best scale, which is 1 for the exponential distribution of (5),
and is taken as at least 1: a quasi-likelihood (McCullagh and Nelder, Generalized Linear
Models, chapter 9). Everything here takes the dispersion as given; 1 is the paper's likelihood.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from napari_defocus.spectrum import SpectrumTable

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]

SILENCE = 1e-12
"""Smallest noise variance in use: a picture without any noise still has finite likelihoods."""

_PADDED = 16
_SMALLEST = np.float32(1e-6)
_FIRST_ROUNDS = 8
_NEXT_ROUNDS = 3
_NEWTON_ROUNDS = 4
FAST_BUT_NAN = {"reassoc", "contract", "arcp", "nsz", "afn"}
"""Everything that fastmath allows but the assumption that no value is NaN or infinite."""


def noise_power(table: SpectrumTable, noise_variance: float) -> Float64:
    """Return sigma_ni^2 of (7): (2, F)."""
    return max(noise_variance, SILENCE) * table.noise


def profile_log_likelihood(
    power: Float32, table: SpectrumTable, scales: Float64, noise_variance: float
) -> Float32:
    """Evaluate log p(r) = max_s log p(r, s), (9), at scales of a table.

    Parameters
    ----------
    power : (P, 2, F) float32 ndarray
        |g_i|^2 of P windows.
    table : SpectrumTable
    scales : (R,) float64 ndarray
        Increasing, in px.
    noise_variance : float

    Returns
    -------
    (P, R) float32 ndarray
    """
    return _curves_and_dispersion(power, table, scales, noise_variance)[0].sum(axis=1)


def quasi_log_likelihood(
    power: Float32, table: SpectrumTable, scales: Float64, noise_variance: float
) -> tuple[Float32, Float32]:
    """Evaluate log p(r) as `profile_log_likelihood`, each gradient divided by its dispersion.

    Returns
    -------
    curves : (P, R) float32 ndarray
    dispersion : (P, 2) float32 ndarray
        From 1 up.
    """
    curves, dispersion = _curves_and_dispersion(power, table, scales, noise_variance)
    return (curves / dispersion[..., None]).sum(axis=1), dispersion


def _curves_and_dispersion(
    power: Float32, table: SpectrumTable, scales: Float64, noise_variance: float
) -> tuple[Float32, Float32]:
    """Return log p(r) of each gradient, (P, 2, R), and its dispersion, (P, 2)."""
    noise = noise_power(table, noise_variance)
    gain = _padded(table.at(scales) / noise, 0.0)
    relative = _padded(power * (1 / noise).astype(np.float32), 1.0)
    curves, dispersion = _profile_curves(relative, gain, noise.shape[1])
    padding = gain.shape[2] - noise.shape[1]
    curves += (padding - np.log(noise).sum(axis=1)).astype(np.float32)[:, None]
    return curves, dispersion


def _padded(values: NDArray[np.floating], filling: float) -> Float32:
    """Fill the last axis up to whole vector registers; a_i = 0, q_i = 1 adds the constant 1."""
    missing = -values.shape[-1] % _PADDED
    widths = [(0, 0)] * (values.ndim - 1) + [(0, missing)]
    return np.pad(values, widths, constant_values=filling).astype(np.float32)


@njit(cache=True, parallel=True, fastmath=True, nogil=True)
def _profile_curves(relative: Float32, gain: Float32, frequencies: int) -> tuple[Float32, Float32]:
    points, directions, _ = relative.shape
    count = gain.shape[0]
    curves = np.empty((points, directions, count), np.float32)
    dispersion = np.ones((points, directions), np.float32)
    for point in prange(points):
        strength = np.empty((directions, count), np.float32)
        for direction in range(directions):
            q = relative[point, direction]
            s = np.float32(1e3)
            rounds = _FIRST_ROUNDS
            for scale in range(count):
                a = gain[scale, direction]
                for _ in range(rounds):
                    s = _next_strength(q, a, s)
                rounds = _NEXT_ROUNDS
                strength[direction, scale] = s
                curves[point, direction, scale] = -_deviance(q, a, s)
        best = 0
        for scale in range(count):
            if curves[point, :, scale].sum() > curves[point, :, best].sum():
                best = scale
        for direction in range(directions):
            misfit = _misfit(
                relative[point, direction], gain[best, direction], strength[direction, best]
            )
            dispersion[point, direction] = max(np.float32(1), misfit / frequencies)
    return curves, dispersion


@njit(cache=True, fastmath=True, nogil=True, inline="always")
def _misfit(q: Float32, a: Float32, s: float) -> np.float32:
    """Return the sum of squares of q / (1 + s a) - 1, each expected to be 1."""
    total = np.float32(0)
    for i in range(q.shape[0]):
        total += (q[i] / (np.float32(1) + s * a[i]) - np.float32(1)) ** 2
    return total


@njit(cache=True, fastmath=True, nogil=True, inline="always")
def _next_strength(q: Float32, a: Float32, s: float) -> np.float32:
    """One round of the fixed point (11), which is a step of Fisher scoring in s."""
    numerator = np.float32(0)
    denominator = np.float32(0)
    for i in range(q.shape[0]):
        inverse = np.float32(1) / (np.float32(1) + s * a[i])
        weight = a[i] * inverse
        numerator += weight * inverse * (q[i] - np.float32(1))
        denominator += weight * weight
    return max(numerator / denominator, _SMALLEST / a[0])


@njit(cache=True, fastmath=True, nogil=True, inline="always")
def _deviance(q: Float32, a: Float32, s: float) -> np.floating:
    """Sum of q / (1 + s a) + log(1 + s a); logarithms of products are cheaper than of factors."""
    total = np.float32(0)
    logarithm = 0.0
    for block in range(0, q.shape[0], _PADDED):
        product = 1.0
        for i in range(block, block + _PADDED):
            variance = np.float32(1) + s * a[i]
            total += q[i] / variance
            product *= variance
        logarithm += np.log(product)
    return total + logarithm


def refine_maxima(
    power: Float32,
    table: SpectrumTable,
    start: Float32,
    reach: float,
    noise_variance: float,
    dispersion: Float32,
) -> tuple[Float32, Float32]:
    """Move scales near local maxima of log p(r) onto them, by Newton steps on the tables.

    Parameters
    ----------
    power : (P, 2, F) float32 ndarray
    table : SpectrumTable
    start : (P, K) float32 ndarray
        Scales in px; NaN is passed over.
    reach : float
        A scale moves at most this far, in px.
    noise_variance : float
    dispersion : (P, 2) float32 ndarray

    Returns
    -------
    scales, log_likelihoods : (P, K) float32 ndarray
        NaN and -inf where `start` is NaN.
    """
    noise = noise_power(table, noise_variance)
    relative = _padded(power * (1 / noise).astype(np.float32), 1.0)
    gains = [_padded(values / noise, 0.0) for values in (table.value, table.first, table.second)]
    scales, heights = _refine(relative, *gains, start, reach, table.step, 1 / dispersion)
    padding = relative.shape[2] - noise.shape[1]
    constant = ((np.log(noise).sum(axis=1) - padding) / dispersion).sum(axis=1)
    return scales, heights - constant[:, None].astype(np.float32)


@njit(cache=True, parallel=True, fastmath=FAST_BUT_NAN, nogil=True)
def _refine(
    relative: Float32,
    value: Float32,
    first: Float32,
    second: Float32,
    start: Float32,
    reach: float,
    step: float,
    weight: Float32,
) -> tuple[Float32, Float32]:
    scales = start.copy()
    heights = np.full(start.shape, -np.inf, np.float32)
    stop = (value.shape[0] - 1) * step
    for point in prange(start.shape[0]):
        strength = np.empty(relative.shape[1], np.float32)
        for k in range(start.shape[1]):
            scale = np.float64(start[point, k])
            if np.isnan(scale):
                continue
            low, high = max(scale - reach, 0.0), min(scale + reach, stop)
            strength[:] = np.float32(1e3)
            for newton in range(_NEWTON_ROUNDS + 1):
                height, slope, curvature = 0.0, 0.0, 0.0
                index = int(np.rint(scale / step))
                for direction in range(relative.shape[1]):
                    deviance, gradient, hessian, s = _deviance_and_derivatives(
                        relative[point, direction],
                        value[index, direction],
                        first[index, direction],
                        second[index, direction],
                        np.float32(scale - index * step),
                        strength[direction],
                        _NEXT_ROUNDS if newton else _FIRST_ROUNDS,
                    )
                    strength[direction] = s
                    height -= weight[point, direction] * deviance
                    slope += weight[point, direction] * gradient
                    curvature += weight[point, direction] * hessian
                if height <= heights[point, k]:
                    break
                scales[point, k], heights[point, k] = scale, height
                move = -slope / curvature if curvature > 0 else -np.sign(slope) * reach / 4
                scale = min(max(scale + move, low), high)
    return scales, heights


@njit(cache=True, fastmath=True, nogil=True, inline="always")
def _deviance_and_derivatives(
    q: Float32,
    value: Float32,
    first: Float32,
    second: Float32,
    offset: float,
    s: float,
    rounds: int,
) -> tuple[np.floating, np.floating, np.floating, float]:
    """Return min_s of the deviance at one scale, its first two derivatives, and that s.

    The minimum over s has derivative f_r and second derivative f_rr - f_rs^2 / f_ss.
    """
    a = value + offset * (first + np.float32(0.5) * offset * second)
    for _ in range(rounds):
        s = _next_strength(q, a, s)
    one, two = np.float32(1), np.float32(2)
    f_r, f_rr, f_rs, f_ss = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
    for i in range(q.shape[0]):
        slope = first[i] + offset * second[i]
        inverse = one / (one + s * a[i])
        f_u = (one - q[i] * inverse) * inverse
        f_uu = (two * q[i] * inverse - one) * inverse * inverse
        f_r += f_u * s * slope
        f_rr += f_uu * (s * slope) ** 2 + f_u * s * second[i]
        f_rs += f_uu * a[i] * s * slope + f_u * slope
        f_ss += f_uu * a[i] * a[i]
    deviance = _deviance(q, a, s)
    return deviance, f_r, f_rr - f_rs * f_rs / f_ss if f_ss > 0 else f_rr, s

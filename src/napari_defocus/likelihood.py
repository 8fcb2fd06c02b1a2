"""The likelihood of a blur scale given local power spectra: (5), (9), (11).

Powers are taken relative to the noise spectrum: q_i = |g_i|^2 / sigma_ni^2 and
a_i(r) = sigma_i^2(r) / sigma_ni^2, so that the variance in (5) is sigma_ni^2 (1 + s a_i) and

    -log p = sum_i  q_i / (1 + s a_i) + log(1 + s a_i) + log sigma_ni^2.

Both gradients are used: their log-likelihoods, each with its own s, are added.

Pictures are not what (2) assumes: fences, stems and borders put their power into few of the
frequencies. Where the model fits badly, its likelihood is far too sure of itself. So each
gradient's log-likelihood is divided by its dispersion, the mean square of
q_i / (1 + s a_i) - 1 at the likely scales, which is 1 for the exponential distribution of (5),
and is taken as at least 1: a quasi-likelihood (McCullagh and Nelder, Generalized Linear
Models, chapter 9). Everything here takes the dispersion as given; 1 is the paper's likelihood.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from napari_defocus.spectrum import SpectrumTable

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]

SILENCE = 1e-12
"""Smallest noise variance in use: a picture without any noise still has finite likelihoods."""

_LANES = 16
_LEAST_LOG, _LARGEST_LOG, _LOG_STEP = np.float32(-20), np.float32(60), np.float32(0.5)
_LEAST_SIGNAL = np.float32(0.1)
_ABOVE_LEAST = np.float32(3)
_MOST_ROUNDS = 6
_RETRY = 4
_NEARLY_BEST = np.float32(6)
_SETTLED = np.float32(0.02)

_SMALLEST = np.float32(1e-6)
_FIRST_ROUNDS = 16

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
    return _curves(power, table, scales, noise_variance, quasi=False)[0]


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
    return _curves(power, table, scales, noise_variance, quasi=True)


def _curves(
    power: Float32, table: SpectrumTable, scales: Float64, noise_variance: float, quasi: bool
) -> tuple[Float32, Float32]:
    noise = noise_power(table, noise_variance)
    relative = power * (1 / noise).astype(np.float32)
    offset = np.log(noise).sum(axis=1).astype(np.float32)
    return _profile_curves(relative, *_curve_tables(table, tuple(scales)), offset, quasi)


@lru_cache(maxsize=16)
def _curve_tables(table: SpectrumTable, scales: tuple[float, ...]) -> tuple[Float32, Float32]:
    """Return a_i(r) for noise of variance 1, and sum_i log(1 + s a_i(r)) over log s.

    The sum does not depend on the picture, so that it need not be taken for every window. It is
    kept with its derivative in log s, for cubic Hermite interpolation.

    Returns
    -------
    gain : (R, 2, F) float32 ndarray
    log_sums : (R, 2, 2, T) float32 ndarray
        Value, and derivative times _LOG_STEP, at log s = _LEAST_LOG, _LEAST_LOG + _LOG_STEP, ...
    """
    gain = table.at(np.array(scales)) / table.noise
    log_s = np.arange(_LEAST_LOG, _LARGEST_LOG + _LOG_STEP / 2, _LOG_STEP)
    log_sums = np.empty((*gain.shape[:2], 2, len(log_s)), np.float32)
    for t, strength in enumerate(np.exp(log_s)):
        variance = 1 + strength * gain
        log_sums[..., 0, t] = np.log(variance).sum(axis=-1)
        log_sums[..., 1, t] = _LOG_STEP * (1 - 1 / variance).sum(axis=-1)
    return gain.astype(np.float32), log_sums


@njit(cache=True, parallel=True, fastmath=True, nogil=True)
def _profile_curves(
    relative: Float32, gain: Float32, log_sums: Float32, offset: Float32, quasi: bool
) -> tuple[Float32, Float32]:
    """Follow the best s from scale to scale, for _LANES windows at a time.

    The lanes are those of the processor's vectors: no sum over frequencies goes across them.
    """
    points, directions, frequencies = relative.shape
    count, zero, one = gain.shape[0], np.float32(0), np.float32(1)
    curves = np.empty((points, count), np.float32)
    dispersion = np.ones((points, directions), np.float32)
    for group in prange((points + _LANES - 1) // _LANES):
        first = group * _LANES
        lanes = min(_LANES, points - first)
        q = np.ones((directions, frequencies, _LANES), np.float32)
        for lane in range(lanes):
            for direction in range(directions):
                for i in range(frequencies):
                    q[direction, i, lane] = relative[first + lane, direction, i]
        height = np.empty((directions, count, _LANES), np.float32)
        total = np.zeros((count, _LANES), np.float32)
        strength = np.empty((directions, count, _LANES), np.float32)
        s, log_s = np.empty(_LANES, np.float32), np.empty(_LANES, np.float32)
        before, deviance = np.empty(_LANES, np.float32), np.empty(_LANES, np.float32)
        at_zero = np.empty(_LANES, np.float32)
        q_v, q_vv = np.empty(_LANES, np.float32), np.empty(_LANES, np.float32)
        q_vvv, moving = np.empty(_LANES, np.float32), np.empty(_LANES, np.float32)
        for direction in range(directions):
            for lane in range(_LANES):
                at_zero[lane] = q[direction, :, lane].sum()
                log_s[lane] = first_log_strength(q[direction, :, lane], gain[0, direction])
                before[lane] = log_s[lane]
            for scale in range(count):
                a, log_sum = gain[scale, direction], log_sums[scale, direction]
                least = np.log(_LEAST_SIGNAL / a.max())
                for lane in range(_LANES):
                    # s changes by nearly the same factor from scale to scale.
                    change = min(max(log_s[lane] - before[lane], -one), one)
                    before[lane] = log_s[lane]
                    log_s[lane] = min(max(log_s[lane] + change, least), _LARGEST_LOG)
                    if scale % _RETRY == _RETRY - 1 and deviance[lane] >= at_zero[lane]:
                        # s = 0 was best, but that may be one of two minima.
                        log_s[lane] = least + _ABOVE_LEAST
                    s[lane] = np.exp(log_s[lane])
                    moving[lane] = one
                for _ in range(_MOST_ROUNDS if scale > 0 else _FIRST_ROUNDS):
                    _moments(q[direction], a, s, q_v, q_vv, q_vvv)
                    _scoring_step(
                        log_sum, least, at_zero, q_v, q_vv, q_vvv, s, log_s, deviance, moving
                    )
                    if moving.max() == zero:
                        break
                for lane in range(_LANES):
                    least_deviance = min(deviance[lane], at_zero[lane]) + offset[direction]
                    height[direction, scale, lane] = -least_deviance
                    total[scale, lane] -= least_deviance
                    strength[direction, scale, lane] = s[lane]
        for lane in range(lanes):
            row = first + lane
            if quasi:
                best, weight = total[:, lane].max(), zero
                misfit = np.zeros(directions, np.float32)
                for scale in range(count):
                    below = best - total[scale, lane]
                    if below > _NEARLY_BEST:
                        continue
                    share = np.exp(-below)
                    weight += share
                    for direction in range(directions):
                        misfit[direction] += share * _misfit(
                            relative[row, direction],
                            gain[scale, direction],
                            strength[direction, scale, lane],
                        )
                for direction in range(directions):
                    mean_square = misfit[direction] / (weight * frequencies)
                    dispersion[row, direction] = max(one, mean_square)
            for scale in range(count):
                curves[row, scale] = 0
                for direction in range(directions):
                    curves[row, scale] += (
                        height[direction, scale, lane] / dispersion[row, direction]
                    )
    return curves, dispersion


@njit(cache=True, fastmath=True, nogil=True, inline="always")
def _exp(x: np.float32) -> np.float32:
    """Return exp(x) to 1e-5 of it for |x| up to 1: Pade's approximant of order (3, 3)."""
    even = np.float32(120) + np.float32(12) * x * x
    odd = x * (np.float32(60) + x * x)
    return (even + odd) / (even - odd)


@njit(cache=True, fastmath=True, nogil=True, inline="always")
def _moments(
    q: Float32, a: Float32, s: Float32, q_v: Float32, q_vv: Float32, q_vvv: Float32
) -> None:
    """Sum q / v, q / v^2 and q / v^3 over the frequencies, with v = 1 + s a, in every lane."""
    one = np.float32(1)
    for lane in range(_LANES):
        q_v[lane] = 0
        q_vv[lane] = 0
        q_vvv[lane] = 0
    for i in range(a.shape[0]):
        a_i = a[i]
        for lane in range(_LANES):
            inverse = one / (one + s[lane] * a_i)
            first = q[i, lane] * inverse
            second = first * inverse
            q_v[lane] += first
            q_vv[lane] += second
            q_vvv[lane] += second * inverse


@njit(cache=True, fastmath=True, nogil=True, inline="always")
def _scoring_step(
    log_sum: Float32,
    least: float,
    at_zero: Float32,
    q_v: Float32,
    q_vv: Float32,
    q_vvv: Float32,
    s: Float32,
    log_s: Float32,
    deviance: Float32,
    moving: Float32,
) -> None:
    """Move s of every lane that is `moving`, 1, towards the least deviance, in place.

    Newton's step in log s where the deviance is convex in it; elsewhere (11), which is a step
    of Fisher scoring in s. `deviance` is left as that at the new place, to second order. A lane
    stays, 0, after a step that gained little, whatever the others do: what a window says does
    not depend on its neighbours.
    """
    zero, half, one = np.float32(0), np.float32(0.5), np.float32(1)
    two, three = np.float32(2), np.float32(3)
    last = np.float32(log_sum.shape[1] - 2)
    for lane in range(_LANES):
        position = (log_s[lane] - _LEAST_LOG) * (one / _LOG_STEP)
        whole = np.float32(np.int32(min(max(position, zero), last)))
        u = position - whole
        index = np.int32(whole)
        low, high = log_sum[0, index], log_sum[0, index + 1]
        start, end = log_sum[1, index], log_sum[1, index + 1]
        rise = high - low
        second, third = three * rise - two * start - end, start + end - two * rise
        value = low + u * (start + u * (second + u * third))
        slope = (start + u * (two * second + three * u * third)) * (one / _LOG_STEP)
        bend = (two * second + np.float32(6) * u * third) * (one / (_LOG_STEP * _LOG_STEP))
        score = q_v[lane] - q_vv[lane] - slope
        curvature = bend + q_v[lane] - three * q_vv[lane] + two * q_vvv[lane]
        information = max(slope - bend, np.float32(1e-9))
        convex = curvature > np.float32(0.25) * information
        step = score / (curvature if convex else information)
        step = min(max(step, -one), one)
        step = max(step, least - log_s[lane])
        here = q_v[lane] + value
        newton = step * (score - half * step * curvature)
        # Where s = 0 is better, no more can be gained on the way there than it has to give.
        downhill = step < zero and here > at_zero[lane]
        fisher = min(score * step, here - at_zero[lane]) if downhill else score * step
        gained = newton if convex else fisher
        there = here - (min(newton, _SETTLED) if convex else zero)
        moves = moving[lane] > zero
        deviance[lane] = there if moves else deviance[lane]
        log_s[lane] += step if moves else zero
        s[lane] *= _exp(step) if moves else one
        moving[lane] = one if moves and gained >= _SETTLED else zero


# After a change here, touch maxima.py: numba's cache looks at the caller's own file only.
@njit(cache=True, fastmath=True, nogil=True, inline="always")
def first_log_strength(q: Float32, a: Float32) -> np.float32:
    """Return log s of the best s of one scale by (11), from the least-squares one."""
    one = np.float32(1)
    total, squares = np.float32(0), np.float32(0)
    for i in range(q.shape[0]):
        total += a[i] * (q[i] - one)
        squares += a[i] * a[i]
    s = max(total / squares, _SMALLEST / a[0])
    for _ in range(_FIRST_ROUNDS):
        score, information = np.float32(0), np.float32(0)
        for i in range(q.shape[0]):
            inverse = one / (one + s * a[i])
            weight = a[i] * inverse
            score += weight * (q[i] * inverse - one)
            information += weight * weight
        if information <= np.float32(0):  # below single precision: no noise is that small
            break
        before = s
        s = max(s + score / information, _SMALLEST / a[0])
        if abs(s - before) < np.float32(0.1) * before:
            break
    return min(np.log(s), _LARGEST_LOG)


@njit(cache=True, fastmath=True, nogil=True, inline="always")
def _misfit(q: Float32, a: Float32, s: float) -> np.float32:
    """Return the sum of squares of q / (1 + s a) - 1, each expected to be 1."""
    total = np.float32(0)
    for i in range(q.shape[0]):
        total += (q[i] / (np.float32(1) + s * a[i]) - np.float32(1)) ** 2
    return total

"""The profile likelihood of a blur scale given local power spectra: (5), (9), (11).

Powers are taken relative to the noise spectrum: q_i = |g_i|^2 / sigma_ni^2 and
a_i(r) = sigma_i^2(r) / sigma_ni^2, so that the variance in (5) is sigma_ni^2 (1 + s a_i) and

    -log p = sum_i  q_i / (1 + s a_i) + log(1 + s a_i) + log sigma_ni^2.

Of the variance s of the sharp picture's gradients nothing is known, and there is no prior on it:
the best one is taken for each scale.

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
from numpy.typing import NDArray

from napari_defocus.core.compiled import compiled, compiled_inline
from napari_defocus.core.threads import in_bands
from napari_defocus.likelihood.blur_spectra import SpectrumTable

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]

SILENCE = 1e-12
"""Smallest noise variance in use, for a contrast of 1: a picture without any noise still has finite
likelihoods. Chosen by hand.
"""

_LANES = 16
"""Windows that are worked on at once."""

_S, _LOG_S, _BEFORE, _DEVIANCE, _AT_ZERO, _Q_V, _Q_VV, _Q_VVV, _MOVING = range(9)
"""Rows of the state of these windows: s and log s now, log s at the scale before; -log p now and
for s = 0; sums of `_moments`; 1 while s still moves."""

_LEAST_LOG, LARGEST_LOG, _LOG_STEP = np.float32(-20), np.float32(60), np.float32(0.5)
"""log s of the tables: first, last, and from one to the next. Chosen by hand."""

_LEAST_SIGNAL = np.float32(0.1)
"""s a_i at the strongest frequency, below which s counts as 0. Chosen by hand."""

_ABOVE_LEAST, _RETRY = np.float32(3), 4
"""Where s = 0 was best, the search begins again with log s so far above its least, at every so many
scales: there may be two minima. Chosen by hand.
"""

_MOST_ROUNDS = 6
"""Steps in log s at a scale, at most; one or two are usual (docs/decisions.md)."""

_NEARLY_BEST = np.float32(6)
"""Units of log-likelihood below the best scale that still count for the dispersion. By hand."""

_SETTLED = np.float32(0.02)
"""Units of log-likelihood: a step that gains less is the last. Chosen by hand."""

SMALLEST = np.float32(1e-6)
"""Least s, relative to that which makes signal and noise alike at the first frequency. By hand."""

FIRST_ROUNDS = 16
"""The most rounds of (11), or of Newton steps, at the first scale. Chosen by hand."""


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
    log_s = np.arange(_LEAST_LOG, LARGEST_LOG + _LOG_STEP / 2, _LOG_STEP)
    log_sums = np.empty((*gain.shape[:2], 2, len(log_s)), np.float32)
    for t, strength in enumerate(np.exp(log_s)):
        variance = 1 + strength * gain
        log_sums[..., 0, t] = np.log(variance).sum(axis=-1)
        log_sums[..., 1, t] = _LOG_STEP * (1 - 1 / variance).sum(axis=-1)
    return gain.astype(np.float32), log_sums


def _profile_curves(
    relative: Float32, gain: Float32, log_sums: Float32, offset: Float32, quasi: bool
) -> tuple[Float32, Float32]:
    """Return log p(r) of each window, (P, R), and the dispersion of its gradients, (P, 2)."""
    points, directions, _ = relative.shape
    height = np.empty((directions, points, len(gain)), np.float32)
    strength = np.empty_like(height)
    for direction in range(directions):
        in_bands(
            _follow,
            points,
            _in_fours(relative[:, direction]),
            _in_fours(gain[:, direction]),
            np.ascontiguousarray(log_sums[:, direction]),
            offset[direction],
            height[direction],
            strength[direction],
            least=_LANES,
        )
    if not quasi:
        return height.sum(axis=0), np.ones((points, directions), np.float32)
    curves = np.empty(height.shape[1:], np.float32)
    dispersion = np.empty((points, directions), np.float32)
    in_bands(_temper, points, relative, gain, height, strength, curves, dispersion, least=_LANES)
    return curves, dispersion


def _in_fours(values: Float32) -> Float32:
    """Fill the last axis up to a multiple of four with 0, which adds nothing to `_moments`."""
    missing = -values.shape[1] % 4
    filled = np.pad(values, ((0, 0), (0, missing))) if missing else values
    return np.ascontiguousarray(filled)


@compiled
def _follow(
    start: int,
    stop: int,
    relative: Float32,
    gain: Float32,
    log_sums: Float32,
    offset: np.float32,
    height: Float32,
    strength: Float32,
) -> None:
    """Follow the best s of one gradient from scale to scale, for _LANES windows at a time.

    The lanes are those of the processor's vectors: no sum over frequencies goes across them.
    Writes log p(r) to `height` and s to `strength`, (P, R) each.
    """
    frequencies, zero, one = relative.shape[1], np.float32(0), np.float32(1)
    q = np.empty((frequencies, _LANES), np.float32)
    state = np.zeros((9, _LANES), np.float32)
    for first in range(start, stop, _LANES):
        for lane in range(_LANES):
            # What is missing in the last group is its last window once more.
            window = min(first + lane, stop - 1)
            total = zero
            for i in range(frequencies):
                q[i, lane] = relative[window, i]
                total += relative[window, i]
            state[_AT_ZERO, lane] = total
            state[_LOG_S, lane] = _first_log_strength(relative[window], gain[0])
            state[_BEFORE, lane] = state[_LOG_S, lane]
        for scale in range(gain.shape[0]):
            largest = gain[scale, 0]
            for i in range(1, frequencies):
                largest = max(largest, gain[scale, i])
            least = np.log(_LEAST_SIGNAL / largest)
            for lane in range(_LANES):
                # s changes by nearly the same factor from scale to scale.
                change = min(max(state[_LOG_S, lane] - state[_BEFORE, lane], -one), one)
                state[_BEFORE, lane] = state[_LOG_S, lane]
                state[_LOG_S, lane] = min(max(state[_LOG_S, lane] + change, least), LARGEST_LOG)
                if scale % _RETRY == _RETRY - 1 and state[_DEVIANCE, lane] >= state[_AT_ZERO, lane]:
                    # s = 0 was best, but that may be one of two minima.
                    state[_LOG_S, lane] = least + _ABOVE_LEAST
                state[_S, lane] = np.exp(state[_LOG_S, lane])
                state[_MOVING, lane] = one
            for _ in range(_MOST_ROUNDS if scale > 0 else FIRST_ROUNDS):
                _moments(q, gain, scale, state)
                _scoring_step(log_sums, scale, least, state)
                still = zero
                for lane in range(_LANES):
                    still += state[_MOVING, lane]
                if still == zero:
                    break
            for lane in range(min(_LANES, stop - first)):
                height[first + lane, scale] = -(
                    min(state[_DEVIANCE, lane], state[_AT_ZERO, lane]) + offset
                )
                strength[first + lane, scale] = state[_S, lane]


@compiled
def _temper(
    start: int,
    stop: int,
    relative: Float32,
    gain: Float32,
    height: Float32,
    strength: Float32,
    curves: Float32,
    dispersion: Float32,
) -> None:
    """Divide each gradient's log p(r) by its dispersion, and add both."""
    directions, _, count = height.shape
    frequencies, one = relative.shape[2], np.float32(1)
    misfit = np.empty((directions, frequencies), np.float32)
    for row in range(start, stop):
        best = -np.float32(np.inf)
        for scale in range(count):
            total = np.float32(0)
            for direction in range(directions):
                total += height[direction, row, scale]
            curves[row, scale] = total
            best = max(best, total)
        weight = np.float32(0)
        for direction in range(directions):
            for i in range(frequencies):
                misfit[direction, i] = 0
        for scale in range(count):
            below = best - curves[row, scale]
            if below > _NEARLY_BEST:
                continue
            share = np.exp(-below)
            weight += share
            for direction in range(directions):
                s = strength[direction, row, scale]
                # Frequency by frequency: nothing is summed across a vector's lanes.
                for i in range(frequencies):
                    ratio = relative[row, direction, i] / (one + s * gain[scale, direction, i])
                    misfit[direction, i] += share * (ratio - one) * (ratio - one)
        for direction in range(directions):
            total = np.float32(0)
            for i in range(frequencies):
                total += misfit[direction, i]
            dispersion[row, direction] = max(one, total / (weight * frequencies))
        for scale in range(count):
            total = np.float32(0)
            for direction in range(directions):
                total += height[direction, row, scale] / dispersion[row, direction]
            curves[row, scale] = total


@compiled_inline
def _exp(x: np.float32) -> np.float32:
    """Return exp(x) to 1e-5 of it for |x| up to 1: Pade's approximant of order (3, 3)."""
    even = np.float32(120) + np.float32(12) * x * x
    odd = x * (np.float32(60) + x * x)
    return (even + odd) / (even - odd)


@compiled_inline
def _moments(q: Float32, gain: Float32, scale: int, state: Float32) -> None:
    """Sum q / v, q / v^2 and q / v^3 over the frequencies, with v = 1 + s a, in every lane.

    Four frequencies at a time, so that sums are fetched and put back less often. One division
    serves two.
    """
    one = np.float32(1)
    for lane in range(_LANES):
        state[_Q_V, lane] = 0
        state[_Q_VV, lane] = 0
        state[_Q_VVV, lane] = 0
    for i in range(0, gain.shape[1], 4):
        a_1, a_2 = gain[scale, i], gain[scale, i + 1]
        a_3, a_4 = gain[scale, i + 2], gain[scale, i + 3]
        for lane in range(_LANES):
            v, w = one + state[_S, lane] * a_1, one + state[_S, lane] * a_2
            x, y = one + state[_S, lane] * a_3, one + state[_S, lane] * a_4
            of_v_w, of_x_y = one / (v * w), one / (x * y)
            v, w, x, y = w * of_v_w, v * of_v_w, y * of_x_y, x * of_x_y
            q_1, q_2 = q[i, lane] * v, q[i + 1, lane] * w
            q_3, q_4 = q[i + 2, lane] * x, q[i + 3, lane] * y
            state[_Q_V, lane] += (q_1 + q_2) + (q_3 + q_4)
            q_1, q_2, q_3, q_4 = q_1 * v, q_2 * w, q_3 * x, q_4 * y
            state[_Q_VV, lane] += (q_1 + q_2) + (q_3 + q_4)
            state[_Q_VVV, lane] += (q_1 * v + q_2 * w) + (q_3 * x + q_4 * y)


@compiled_inline
def _scoring_step(log_sums: Float32, scale: int, least: np.float32, state: Float32) -> None:
    """Move s of every lane that is `moving`, 1, towards the least deviance, in place.

    Newton's step in log s where the deviance is convex in it; elsewhere (11), which is a step
    of Fisher scoring in s. `deviance` is left as that at the new place, to second order. A lane
    stays, 0, after a step that gained little, whatever the others do: what a window says does
    not depend on its neighbours.
    """
    zero, half, one = np.float32(0), np.float32(0.5), np.float32(1)
    two, three = np.float32(2), np.float32(3)
    last = np.float32(log_sums.shape[2] - 2)
    for lane in range(_LANES):
        position = (state[_LOG_S, lane] - _LEAST_LOG) * (one / _LOG_STEP)
        # Written so that a position that is not a number has an index inside the table, too.
        inside = position if position > zero else zero
        whole = np.float32(np.int32(inside if inside < last else last))
        u = position - whole
        index = np.int32(whole)
        low, high = log_sums[scale, 0, index], log_sums[scale, 0, index + 1]
        start, end = log_sums[scale, 1, index], log_sums[scale, 1, index + 1]
        rise = high - low
        second, third = three * rise - two * start - end, start + end - two * rise
        value = low + u * (start + u * (second + u * third))
        slope = (start + u * (two * second + three * u * third)) * (one / _LOG_STEP)
        bend = (two * second + np.float32(6) * u * third) * (one / (_LOG_STEP * _LOG_STEP))
        score = state[_Q_V, lane] - state[_Q_VV, lane] - slope
        curvature = (
            bend + state[_Q_V, lane] - three * state[_Q_VV, lane] + two * state[_Q_VVV, lane]
        )
        information = max(slope - bend, np.float32(1e-9))
        convex = curvature > np.float32(0.25) * information
        step = score / (curvature if convex else information)
        step = min(max(step, -one), one)
        step = max(step, least - state[_LOG_S, lane])
        here = state[_Q_V, lane] + value
        newton = step * (score - half * step * curvature)
        # Where s = 0 is better, no more can be gained on the way there than it has to give.
        downhill = step < zero and here > state[_AT_ZERO, lane]
        fisher = min(score * step, here - state[_AT_ZERO, lane]) if downhill else score * step
        gained = newton if convex else fisher
        there = here - (min(newton, _SETTLED) if convex else zero)
        moves = state[_MOVING, lane] > zero
        state[_DEVIANCE, lane] = there if moves else state[_DEVIANCE, lane]
        state[_LOG_S, lane] += step if moves else zero
        state[_S, lane] *= _exp(step) if moves else one
        state[_MOVING, lane] = one if moves and gained >= _SETTLED else zero


@compiled_inline
def _first_log_strength(q: Float32, a: Float32) -> np.float32:
    """Return log s of the best s of one scale by (11), from the least-squares one."""
    one = np.float32(1)
    total, squares = np.float32(0), np.float32(0)
    for i in range(q.shape[0]):
        total += a[i] * (q[i] - one)
        squares += a[i] * a[i]
    s = max(total / squares, SMALLEST / a[0])
    for _ in range(FIRST_ROUNDS):
        score, information = np.float32(0), np.float32(0)
        for i in range(q.shape[0]):
            inverse = one / (one + s * a[i])
            weight = a[i] * inverse
            score += weight * (q[i] * inverse - one)
            information += weight * weight
        if information <= np.float32(0):  # below single precision: no noise is that small
            break
        before = s
        s = max(s + score / information, SMALLEST / a[0])
        if abs(s - before) < np.float32(0.1) * before:
            break
    return min(np.log(s), LARGEST_LOG)

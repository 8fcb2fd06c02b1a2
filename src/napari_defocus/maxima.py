"""The best local maxima of the likelihood of a window, between the table's scales, too."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from napari_defocus.likelihood import FAST_BUT_NAN, first_log_strength, noise_power
from napari_defocus.spectrum import LABEL_STEP, SpectrumTable

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]

CANDIDATES = 3
"""How many of a window are kept."""

_INDISTINCT = 1e-6
_FLAT = 1e-3

_PADDED = 16
_NEWTON_ROUNDS = 8
_LIMIT = np.float32(1)
_CLOSE_ENOUGH = 5e-4


def local_maxima(
    power: Float32,
    curve: Float32,
    table: SpectrumTable,
    scales: Float64,
    noise_variance: float,
    dispersion: Float32,
) -> tuple[Float32, Float32]:
    """Find the best three local maxima of log p(r) in the continuous domain.

    Parameters
    ----------
    power : (P, 2, F) float32 ndarray
    curve : (P, L) float32 ndarray
        log p(r) at `scales`.
    table : SpectrumTable
    scales : (L,) float64 ndarray
    noise_variance : float
    dispersion : (P, 2) float32 ndarray

    Returns
    -------
    radii, log_likelihoods : (P, 3) float32 ndarray
        Best first; NaN and -inf where there are fewer.
    """
    blurs = table.at(scales)
    pointlike = int(np.sum(np.abs(blurs / blurs[0] - 1).max(axis=(1, 2)) < _INDISTINCT)) - 1
    start = _pick_maxima(curve, scales.astype(np.float32), pointlike)
    radii, heights = refine_maxima(power, table, start, LABEL_STEP, noise_variance, dispersion)
    flat = np.ptp(curve, axis=1) < _FLAT
    radii[flat], heights[flat] = np.nan, -np.inf
    radii[radii <= scales[pointlike] + _INDISTINCT] = scales[pointlike] / 2
    order = np.argsort(-heights, axis=1)
    return np.take_along_axis(radii, order, 1), np.take_along_axis(heights, order, 1)


@njit(cache=True, parallel=True, nogil=True)
def _pick_maxima(curve: Float32, scales: Float32, first: int) -> Float32:
    points, length = curve.shape
    picked = np.full((points, CANDIDATES), np.nan, np.float32)
    for point in prange(points):
        height = np.full(CANDIDATES, -np.inf, np.float32)
        c = curve[point]
        for k in range(first, length):
            rises = k == first or c[k] > c[k - 1]
            falls = k == length - 1 or c[k] >= c[k + 1]
            if not (rises and falls and c[k] > height[CANDIDATES - 1]):
                continue
            place = CANDIDATES - 1
            while place > 0 and c[k] > height[place - 1]:
                height[place] = height[place - 1]
                picked[point, place] = picked[point, place - 1]
                place -= 1
            height[place] = c[k]
            picked[point, place] = scales[k]
    return picked


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
    scales, heights = _refine(
        relative, *_refinement_tables(table), start, reach, table.step, 1 / dispersion
    )
    padding = relative.shape[2] - noise.shape[1]
    constant = ((np.log(noise).sum(axis=1) - padding) / dispersion).sum(axis=1)
    return scales, heights - constant[:, None].astype(np.float32)


@lru_cache(maxsize=16)
def _refinement_tables(table: SpectrumTable) -> tuple[Float32, Float32]:
    """Return a_i(r) for noise of variance 1, and its change over a step of the table: (M, 2, F)."""
    return (
        _padded(table.value / table.noise, 0.0),
        _padded(table.step * table.first / table.noise, 0.0),
    )


def _padded(values: NDArray[np.floating], filling: float) -> Float32:
    """Fill the last axis up to whole vector registers; a_i = 0, q_i = 1 adds the constant 1."""
    missing = -values.shape[-1] % _PADDED
    widths = [(0, 0)] * (values.ndim - 1) + [(0, missing)]
    return np.pad(values, widths, constant_values=filling).astype(np.float32)


@njit(cache=True, parallel=True, fastmath=FAST_BUT_NAN, nogil=True)
def _refine(
    relative: Float32,
    gain: Float32,
    change: Float32,
    start: Float32,
    reach: float,
    step: float,
    weight: Float32,
) -> tuple[Float32, Float32]:
    """Newton's method in r, kept between places where the curve rises and falls."""
    scales = start.copy()
    heights = np.full(start.shape, -np.inf, np.float32)
    last = gain.shape[0] - 1
    directions = relative.shape[1]
    for point in prange(start.shape[0]):
        log_s = np.empty(directions, np.float32)
        moves = np.empty((directions, 2), np.float32)
        for k in range(start.shape[1]):
            scale = np.float64(start[point, k])
            if np.isnan(scale):
                continue
            low, high = max(scale - reach, 0.0), min(scale + reach, last * step)
            index = int(np.rint(scale / step))
            for direction in range(directions):
                log_s[direction] = first_log_strength(
                    relative[point, direction], gain[index, direction]
                )
            for _ in range(_NEWTON_ROUNDS):
                height, slope, curvature = 0.0, 0.0, 0.0
                index = min(int(scale / step), last - 1)
                for direction in range(directions):
                    least, d_r, d_rr, move, coupling = _profile_step(
                        relative[point, direction],
                        gain[index, direction],
                        change[index, direction],
                        gain[index + 1, direction],
                        change[index + 1, direction],
                        np.float32(scale / step - index),
                        log_s[direction],
                    )
                    moves[direction, 0], moves[direction, 1] = move, coupling
                    height -= weight[point, direction] * least
                    slope += weight[point, direction] * d_r / step
                    curvature += weight[point, direction] * d_rr / step**2
                if height > heights[point, k]:
                    scales[point, k], heights[point, k] = scale, height
                # The deviance falls towards its least place, which is a maximum of log p(r).
                if slope > 0:
                    high = scale
                else:
                    low = scale
                moved = -slope / curvature if curvature > 0 else np.inf
                if not low <= scale + moved <= high:
                    moved = 0.5 * (low + high) - scale
                scale += moved
                for direction in range(directions):
                    coupled = moves[direction, 1] * moved / step
                    log_s[direction] += moves[direction, 0] + min(max(coupled, -_LIMIT), _LIMIT)
                if abs(moved) < _CLOSE_ENOUGH:
                    break
            if abs(scale - scales[point, k]) < _CLOSE_ENOUGH:
                scales[point, k] = scale
    return scales, heights


@njit(cache=True, fastmath=True, nogil=True, inline="always")
def _profile_step(
    q: Float32,
    gain: Float32,
    change: Float32,
    next_gain: Float32,
    next_change: Float32,
    x: np.float32,
    log_s: float,
) -> tuple[np.floating, np.floating, np.floating, np.floating, np.floating]:
    """Return the least deviance over s near a place (r, log s), and Newton's step from there.

    a(r) is interpolated between two scales of the table, by their values and derivatives; x in
    [0, 1] is the place between them, and derivatives are those in x. With u = s a, v = 1 + u,
    p = u / v and t = log s, the deviance f has f_t = sum p (1 - q/v) and
    f_tt = sum p (1 - p) (1 - q/v) + p^2 q/v. To second order its least over t is
    f - f_t^2 / 2 f_tt, where its derivatives in x are f_x - f_xt f_t / f_tt and
    f_xx - f_xt^2 / f_tt.

    Returns
    -------
    least, d_x, d_xx : float
    move, coupling : float
        Of log s: it moves by `move` plus `coupling` times the move of x.
    """
    half, one, two, three = np.float32(0.5), np.float32(1), np.float32(2), np.float32(3)
    s = np.exp(log_s)
    f_t, f_x, f_tt, f_xt, f_xx = (
        np.float32(0), np.float32(0), np.float32(0), np.float32(0), np.float32(0)
    )  # fmt: skip
    total = np.float32(0)
    logarithm = 0.0
    for block in range(0, q.shape[0], _PADDED):
        product = 1.0
        for i in range(block, block + _PADDED):
            rise = next_gain[i] - gain[i]
            second = three * rise - two * change[i] - next_change[i]
            third = change[i] + next_change[i] - two * rise
            a = gain[i] + x * (change[i] + x * (second + x * third))
            a_x = change[i] + x * (two * second + three * x * third)
            a_xx = two * second + np.float32(6) * x * third
            inverse = one / (one + s * a)
            ratio = q[i] * inverse
            excess = (one - ratio) * inverse
            bend = (two * ratio - one) * inverse * inverse
            product *= one + s * a
            total += ratio
            f_t += a * excess
            f_x += a_x * excess
            f_tt += a * (excess + s * a * bend)
            f_xt += a_x * (excess + s * a * bend)
            f_xx += s * a_x * a_x * bend + a_xx * excess
        logarithm += np.log(product)
    deviance = total + logarithm
    f_t, f_x, f_tt, f_xt, f_xx = s * f_t, s * f_x, s * f_tt, s * f_xt, s * f_xx
    if f_tt <= 0:
        return deviance, f_x, f_xx, np.float32(0), np.float32(0)
    move, coupling = -f_t / f_tt, -f_xt / f_tt
    return (
        deviance + half * f_t * move,
        f_x + f_xt * move,
        f_xx + f_xt * coupling,
        min(max(move, -_LIMIT), _LIMIT),
        coupling,
    )

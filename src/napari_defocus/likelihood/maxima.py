"""The best local maxima of the likelihood of a window, between the table's scales, too."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.compiled import compiled, compiled_inline
from napari_defocus.core.threads import in_bands
from napari_defocus.likelihood.blur_spectra import (
    INDISTINCT,
    LABEL_STEP,
    SpectrumTable,
    is_pointlike,
)
from napari_defocus.likelihood.profile_likelihood import (
    FIRST_ROUNDS,
    LARGEST_LOG,
    SMALLEST,
    noise_power,
)

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]

CANDIDATES = 3
"""How many maxima of a window are kept: up to 3 (Section III)."""

_FLAT = 1e-3
"""Units of log-likelihood: curves that rise less say nothing. Chosen by hand."""

_LEAST_WINDOWS = 256
"""The fewest windows that are worth a thread. Results do not depend on it."""

_PADDED = 16
"""Frequencies that are worked on at once: lanes of the processor's vectors."""

_NEWTON_ROUNDS = 8
"""The most Newton steps to one maximum. Chosen by hand."""

_LIMIT = np.float32(1)
"""The longest step in log s. Chosen by hand."""

_CLOSE_ENOUGH = 5e-4
"""px: a shorter step is the last one. Maxima are exact to 0.005 px (tests against `reference`)."""


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
    pointlike = largest_point(table, scales)
    start = _pick_maxima(curve, scales.astype(np.float32), pointlike)
    radii, heights = refine_maxima(power, table, start, LABEL_STEP, noise_variance, dispersion)
    flat = np.ptp(curve, axis=1) < _FLAT
    radii[flat], heights[flat] = np.nan, -np.inf
    radii[radii <= scales[pointlike] + INDISTINCT] = scales[pointlike] / 2
    order = np.argsort(-heights, axis=1)
    return np.take_along_axis(radii, order, 1), np.take_along_axis(heights, order, 1)


def largest_point(table: SpectrumTable, scales: Float64) -> int:
    """Return the index of the largest scale that cannot be told from a point."""
    return int(np.sum(is_pointlike(table.at(scales)))) - 1


def joined_maxima(
    curve: Float32, scales: Float64, point: int, exact: Float32
) -> tuple[Float32, Float32]:
    """Find the best three local maxima of curves of several levels, by parabolas on their axis.

    Parameters
    ----------
    curve : (P, L) float32 ndarray
    scales : (L,) float64 ndarray
        The axis, in px.
    point : int
        Index of the largest scale that cannot be told from a point; half of it stands for these.
    exact : (P, 3) float32 ndarray
        Maxima of level 0, in the continuous domain: taken where one is within 0.1 px.

    Returns
    -------
    radii, log_likelihoods : (P, 3) float32 ndarray
        Best first; NaN and -inf where there are fewer.
    """
    picked = _pick_maxima(curve, scales.astype(np.float32), point)
    picked[np.ptp(curve, axis=1) < _FLAT] = np.nan
    present = np.isfinite(picked)
    index = np.searchsorted(scales, np.where(present, picked, 0) - LABEL_STEP / 2).astype(int)
    heights = np.where(present, np.take_along_axis(curve, index, 1), np.float32(-np.inf))
    middle = np.clip(index, 1, len(scales) - 2)
    x0, x1, x2 = (scales[middle + step] for step in (-1, 0, 1))
    y0, y1, y2 = (np.take_along_axis(curve, middle + step, 1) for step in (-1, 0, 1))
    rise, fall = (y1 - y0) / (x1 - x0), (y1 - y2) / (x2 - x1)
    inside = (index == middle) & (rise >= 0) & (fall >= 0) & (rise + fall > 0)
    vertex = (x0 + x1) / 2 + (x2 - x0) / 2 * rise / np.where(inside, rise + fall, 1)
    radii = np.where(inside, np.clip(vertex, x0, x2), scales[index])
    radii = np.where(index == point, scales[point] / 2, radii)
    for known in exact.T[:, :, None]:
        radii = np.where(np.abs(known - radii) <= LABEL_STEP, known, radii)
    return np.where(present, radii, np.nan).astype(np.float32), heights.astype(np.float32)


def _pick_maxima(curve: Float32, scales: Float32, first: int) -> Float32:
    """Return the scales of the best three local maxima from index `first` on, else NaN: (P, 3)."""
    picked = np.full((len(curve), CANDIDATES), np.nan, np.float32)
    in_bands(_pick_some, len(curve), curve, scales, first, picked, least=_LEAST_WINDOWS)
    return picked


@compiled
def _pick_some(
    start: int, stop: int, curve: Float32, scales: Float32, first: int, picked: Float32
) -> None:
    length = curve.shape[1]
    height = np.empty(CANDIDATES, np.float32)
    for point in range(start, stop):
        for place in range(CANDIDATES):
            height[place] = -np.inf
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
    scales, heights = start.copy(), np.full(start.shape, -np.inf, np.float32)
    in_bands(
        _refine,
        len(start),
        relative,
        *_refinement_tables(table),
        reach,
        table.step,
        1 / dispersion,
        scales,
        heights,
        least=_LEAST_WINDOWS,
    )
    padding = -noise.shape[1] % _PADDED
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
    """Lay the last axis out as whole vector registers; a_i = 0, q_i = 1 adds the constant 1."""
    missing = -values.shape[-1] % _PADDED
    widths = [(0, 0)] * (values.ndim - 1) + [(0, missing)]
    padded = np.pad(values, widths, constant_values=filling).astype(np.float32)
    return padded.reshape(*values.shape[:-1], -1, _PADDED)


@compiled
def _refine(
    start: int,
    stop: int,
    relative: Float32,
    gain: Float32,
    change: Float32,
    reach: float,
    step: float,
    weight: Float32,
    scales: Float32,
    heights: Float32,
) -> None:
    """Newton's method in r, kept between places where the curve rises and falls."""
    last = gain.shape[0] - 1
    directions = relative.shape[1]
    log_s = np.empty(directions, np.float32)
    moves = np.empty((directions, 2), np.float32)
    sums = np.empty((6, _PADDED), np.float32)
    product = np.empty(_PADDED, np.float64)
    for point in range(start, stop):
        for k in range(scales.shape[1]):
            scale = np.float64(scales[point, k])
            if np.isnan(scale):
                continue
            low, high = max(scale - reach, 0.0), min(scale + reach, last * step)
            index = int(np.rint(scale / step))
            for direction in range(directions):
                log_s[direction] = _first_log_strength(
                    relative, gain, point, direction, index, sums
                )
            for _ in range(_NEWTON_ROUNDS):
                height, slope, curvature = 0.0, 0.0, 0.0
                index = min(int(scale / step), last - 1)
                for direction in range(directions):
                    least, d_r, d_rr, move, coupling = _profile_step(
                        relative,
                        gain,
                        change,
                        point,
                        direction,
                        index,
                        np.float32(scale / step - index),
                        log_s[direction],
                        sums,
                        product,
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


@compiled_inline
def _first_log_strength(
    relative: Float32, gain: Float32, point: int, direction: int, index: int, sums: Float32
) -> np.float32:
    """Return log s of the best s of one scale by (11), from the least-squares one.

    See `_profile_step` for the parameters.
    """
    one, smallest = np.float32(1), SMALLEST / gain[index, direction, 0, 0]
    _clear(sums, 2)
    for i in range(relative.shape[2]):
        for lane in range(_PADDED):
            a = gain[index, direction, i, lane]
            sums[0, lane] += a * (relative[point, direction, i, lane] - one)
            sums[1, lane] += a * a
    _add_lanes(sums, 2)
    s = max(sums[0, 0] / sums[1, 0], smallest)
    for _ in range(FIRST_ROUNDS):
        _clear(sums, 2)
        for i in range(relative.shape[2]):
            for lane in range(_PADDED):
                a = gain[index, direction, i, lane]
                inverse = one / (one + s * a)
                weight = a * inverse
                sums[0, lane] += weight * (relative[point, direction, i, lane] * inverse - one)
                sums[1, lane] += weight * weight
        _add_lanes(sums, 2)
        if sums[1, 0] <= np.float32(0):  # below single precision: no noise is that small
            break
        before = s
        s = max(s + sums[0, 0] / sums[1, 0], smallest)
        if abs(s - before) < np.float32(0.1) * before:
            break
    return min(np.float32(np.log(s)), LARGEST_LOG)


@compiled_inline
def _clear(sums: Float32, count: int) -> None:
    for k in range(count):
        for lane in range(_PADDED):
            sums[k, lane] = 0


@compiled_inline
def _add_lanes(sums: Float32, count: int) -> None:
    """Add halves of the lanes to each other until the first one holds all of them."""
    for k in range(count):
        for lane in range(8):
            sums[k, lane] += sums[k, lane + 8]
        for lane in range(4):
            sums[k, lane] += sums[k, lane + 4]
        sums[k, 0] = (sums[k, 0] + sums[k, 2]) + (sums[k, 1] + sums[k, 3])


@compiled_inline
def _profile_step(
    relative: Float32,
    gain: Float32,
    change: Float32,
    point: int,
    direction: int,
    index: int,
    x: np.float32,
    log_s: np.float32,
    sums: Float32,
    product: Float64,
) -> tuple[np.floating, np.floating, np.floating, np.floating, np.floating]:
    """Return the least deviance over s near a place (r, log s), and Newton's step from there.

    a(r) is interpolated between two scales of the table, by their values and derivatives; x in
    [0, 1] is the place between them, and derivatives are those in x. With u = s a, v = 1 + u,
    p = u / v and t = log s, the deviance f has f_t = sum p (1 - q/v) and
    f_tt = sum p (1 - p) (1 - q/v) + p^2 q/v. To second order its least over t is
    f - f_t^2 / 2 f_tt, where its derivatives in x are f_x - f_xt f_t / f_tt and
    f_xx - f_xt^2 / f_tt.

    `sums`, (6, _PADDED), and `product`, (_PADDED,), are room for one sum a lane of the
    processor's vectors: every _PADDED-th frequency is in the same one, whatever the processor.

    Returns
    -------
    least, d_x, d_xx : float
    move, coupling : float
        Of log s: it moves by `move` plus `coupling` times the move of x.
    """
    half, one, two, three = np.float32(0.5), np.float32(1), np.float32(2), np.float32(3)
    s = np.float32(np.exp(log_s))
    _clear(sums, 6)
    for lane in range(_PADDED):
        product[lane] = 1
    for i in range(relative.shape[2]):
        for lane in range(_PADDED):
            here, there = gain[index, direction, i, lane], gain[index + 1, direction, i, lane]
            leaves, arrives = (
                change[index, direction, i, lane],
                change[index + 1, direction, i, lane],
            )
            rise = there - here
            second = three * rise - two * leaves - arrives
            third = leaves + arrives - two * rise
            a = here + x * (leaves + x * (second + x * third))
            a_x = leaves + x * (two * second + three * x * third)
            a_xx = two * second + np.float32(6) * x * third
            inverse = one / (one + s * a)
            ratio = relative[point, direction, i, lane] * inverse
            excess = (one - ratio) * inverse
            bend = (two * ratio - one) * inverse * inverse
            product[lane] *= one + s * a
            sums[0, lane] += ratio
            sums[1, lane] += a * excess
            sums[2, lane] += a_x * excess
            sums[3, lane] += a * (excess + s * a * bend)
            sums[4, lane] += a_x * (excess + s * a * bend)
            sums[5, lane] += s * a_x * a_x * bend + a_xx * excess
    logarithm = 0.0
    for lane in range(0, _PADDED, 4):
        logarithm += np.log(
            (product[lane] * product[lane + 1]) * (product[lane + 2] * product[lane + 3])
        )
    _add_lanes(sums, 6)
    deviance = sums[0, 0] + logarithm
    f_t, f_x, f_tt, f_xt, f_xx = (
        s * sums[1, 0], s * sums[2, 0], s * sums[3, 0], s * sums[4, 0], s * sums[5, 0]
    )  # fmt: skip
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

"""The paper's own search (Section III-A), and the likelihood (9) without any table.

Slow and in double precision: what the fast path is measured against. As in `profile_likelihood`,
q_i = |g_i|^2 / sigma_ni^2, a_i(r) = sigma_i^2(r) / sigma_ni^2, and

    -log p(r, s) = sum_i  q_i / (1 + s a_i(r)) + log(1 + s a_i(r)) + log sigma_ni^2.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.fft import fft2, next_fast_len
from scipy.interpolate import CubicHermiteSpline

from napari_defocus.likelihood.blur_spectra import SpectrumTable, is_pointlike
from napari_defocus.likelihood.gabor import frequencies
from napari_defocus.likelihood.maxima import CANDIDATES
from napari_defocus.likelihood.profile_likelihood import SILENCE, noise_power
from napari_defocus.psf.families import PSFFamily

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]

_ALIKE = 0.01
"""px: maxima that lie closer are one. Chosen by hand."""

_STRENGTH_ROUNDS = 50
"""The most rounds of (11). Chosen by hand."""

_LONGEST_STEP, _LONGER, _SHORTER = 0.1, 1.5, 0.5
"""px of a step down (13) at most, and the factors of the next one. Chosen by hand."""

_SETTLED, _SETTLED_SHARE = 1e-6, 1e-7
"""A shorter step in px, and a smaller share of s, are the last ones. By hand: this is the
reference.
"""

_LARGE, _SMALLEST = 1e3, 1e-6
"""s to begin with; and the least s, relative to that which makes signal and noise alike at the
first frequency. Chosen by hand.
"""

_SHARES, _BISECTIONS = np.append(np.geomspace(1, 1e-12, 60), 0), 40
"""Shares of the largest possible s that are tried, and halvings around the best. By hand."""


def fixed_point_maxima(
    power: Float32,
    table: SpectrumTable,
    noise_variance: float,
    dispersion: Float32 | None = None,
    starts: Float64 | None = None,
) -> tuple[Float32, Float32]:
    """Find the best three local maxima of (5) as the paper does: r and s in turn.

    From every start, s is found by the fixed point (11) for the present r, then r by steepest
    descent of (13) for the present s, until r settles. Ends that are the same are merged. Both
    gradients are used, each with its own s; their log-likelihoods are added.

    Parameters
    ----------
    power : (P, 2, F) float32 ndarray
        |g_i|^2 of P windows.
    table : SpectrumTable
    noise_variance : float
    dispersion : (P, 2) float32 ndarray, optional
        What each gradient's log-likelihood is divided by; 1, the paper's likelihood, by
        default.
    starts : (K,) float64 ndarray, optional
        Initial scales, in px; 1, 2, ... px over the table by default.

    Returns
    -------
    radii, log_likelihoods : (P, 3) float32 ndarray
        Best first; NaN and -inf where there are fewer. A scale that cannot be told from a
        point is given as half the largest of these.
    """
    if dispersion is None:
        dispersion = np.ones(power.shape[:2], np.float32)
    if starts is None:
        starts = np.arange(1.0, table.scales[-1] + 1e-6)
    noise = noise_power(table, noise_variance)
    gain = CubicHermiteSpline(table.scales, table.value / noise, table.first / noise)
    ends = [_climb(power / noise, gain, 1 / dispersion, float(start)) for start in starts]
    radii, heights = (np.stack(values, axis=1) for values in zip(*ends, strict=True))
    heights -= (np.log(noise).sum(axis=1) / dispersion).sum(axis=1)[:, None]
    last = table.scales[is_pointlike(table.value)][-1]
    radii[radii < last + _ALIKE] = last / 2
    return _best_distinct(radii, heights)


def _climb(
    q: Float64, gain: CubicHermiteSpline, weight: Float64, start: float
) -> tuple[Float64, Float64]:
    """Steps 1 to 5 of Section III-A: r of each window and the logarithm of (5) there, (P,).

    `gain` is a_i(r), (2, F).

    One step down (13) between two solutions of (11). It is half as long as the one before it
    where (13) rose or turned, and longer otherwise.
    """
    windows = len(q)
    radius, height, slope = np.empty(windows), np.full(windows, -np.inf), np.zeros(windows)
    trial, step = np.full(windows, start), np.full(windows, _LONGEST_STEP)
    strength = np.full(q.shape[:2], _LARGE)
    moving = np.arange(windows)
    while moving.size:
        a, a_slope = gain(trial[moving]), gain(trial[moving], 1)
        s = _best_strength(q[moving], a, strength[moving])
        deviance, deviance_slope = _deviance(q[moving], a, a_slope, s, weight[moving])
        falls = -deviance > height[moving]
        turns = deviance_slope * slope[moving] < 0
        step[moving] *= np.where(falls & ~turns, _LONGER, _SHORTER)
        step = np.minimum(step, _LONGEST_STEP)
        better = moving[falls]
        radius[better], strength[better] = trial[better], s[falls]
        height[better], slope[better] = -deviance[falls], deviance_slope[falls]
        trial = np.clip(radius - np.sign(slope) * step, 0, gain.x[-1])
        moving = moving[step[moving] > _SETTLED]
    return radius, height


def _best_strength(q: Float64, a: Float64, s: Float64) -> Float64:
    """Repeat (11) until no s moves: (P, 2). Alone it can go to and fro; each turn is halved."""
    last = np.zeros_like(s)
    for _ in range(_STRENGTH_ROUNDS):
        rho = (1 + 1 / (s[..., None] * a)) ** -2
        new = np.sum(rho * (q - 1) / a, axis=2) / rho.sum(axis=2)
        new = np.maximum(new, _SMALLEST / a[..., 0])
        new = np.where((new - s) * last < 0, (new + s) / 2, new)
        s, last = new, new - s
        if np.all(np.abs(last) < _SETTLED_SHARE * s):
            break
    return s


def _deviance(
    q: Float64, a: Float64, a_slope: Float64, s: Float64, weight: Float64
) -> tuple[Float64, Float64]:
    """Return -log p(r, s) without sum_i log sigma_ni^2, and its slope in r: (P,) each."""
    s = s[..., None]
    variance = 1 + s * a
    terms = np.sum(q / variance + np.log(variance), axis=2)
    slopes = np.sum((1 - q / variance) * s * a_slope / variance, axis=2)
    return np.sum(weight * terms, axis=1), np.sum(weight * slopes, axis=1)


def _best_distinct(radii: Float64, heights: Float64) -> tuple[Float32, Float32]:
    """Keep the best of those that are alike, and the best three of these: (P, K) to (P, 3)."""
    radii, heights = _best_first(radii, heights)
    alike = np.abs(radii[:, :, None] - radii[:, None, :]) < _ALIKE
    known = (alike & np.tri(radii.shape[1], k=-1, dtype=bool)).any(axis=2)
    radii[known], heights[known] = np.nan, -np.inf
    radii, heights = (values[:, :CANDIDATES] for values in _best_first(radii, heights))
    missing = (0, 0), (0, CANDIDATES - radii.shape[1])
    return (
        np.pad(radii, missing, constant_values=np.nan).astype(np.float32),
        np.pad(heights, missing, constant_values=-np.inf).astype(np.float32),
    )


def _best_first(radii: Float64, heights: Float64) -> tuple[Float64, Float64]:
    order = np.argsort(-heights, axis=1)
    return np.take_along_axis(radii, order, 1), np.take_along_axis(heights, order, 1)


def exact_log_likelihood(
    power: Float32,
    psf: PSFFamily,
    window: int,
    row_fraction: float,
    column_fraction: float,
    scales: Float64,
    noise_variance: float,
) -> Float64:
    """Evaluate log p(r) of (9) from its definition, with nothing tabulated.

    The filters are those of (3) and (7), the blur spectrum (6) comes from the kernel of each
    scale, and s is the best of all: the best of a dense grid, then bisection.

    Parameters
    ----------
    power : (P, 2, F) float32 ndarray
        |g_i|^2 of P windows.
    psf : PSFFamily
    window : int
        N.
    row_fraction, column_fraction : float
        Fractional part, 0 or 0.5, of the windows' centres in px.
    scales : (R,) float64 ndarray
        In px.
    noise_variance : float

    Returns
    -------
    (P, R) float64 ndarray
        Both gradients added.
    """
    size = next_fast_len(window + len(psf.kernel(psf.max_scale)))
    filters = _filter_power(window, row_fraction, column_fraction, size)
    blur = np.array([_energy(psf.kernel(float(scale)), filters) for scale in scales])
    differences = np.array([[1.0, -1.0]]), np.array([[1.0], [-1.0]])
    noise = np.array([_energy(differences[i], filters[i]) for i in (0, 1)])
    noise *= max(noise_variance, SILENCE)
    return _best_of_all_strengths(power[:, None] / noise, blur / noise) - np.log(noise).sum()


@lru_cache(maxsize=4)
def _filter_power(window: int, row_fraction: float, column_fraction: float, size: int) -> Float64:
    """Return |T_i|^2 of the filters (3) of both gradients, on an FFT grid: (2, F, size, size)."""
    row, column = (cycles[:, None, None] / window for cycles in frequencies(window).T)
    power = []
    for offset in ((0.0, 0.5), (0.5, 0.0)):
        y, x = (
            np.arange(-(window - 1) / 2 + abs(part - half), (window - 1) / 2 + 0.1)
            for part, half in zip((row_fraction, column_fraction), offset, strict=True)
        )
        y = y[:, None]
        envelope = np.exp(-(x**2 + y**2) / (2 * (window / 4) ** 2))
        envelope /= np.sqrt(np.sum(envelope**2))
        waves = envelope * np.exp(-2j * np.pi * (row * y + column * x))
        power.append(np.abs(fft2(waves, (size, size))) ** 2)
    return np.array(power)


def _energy(kernel: Float64, filter_power: Float64) -> Float64:
    """Evaluate sum |h * t_i|^2, (6) or (7), by Parseval's theorem: (..., F)."""
    size = filter_power.shape[-1]
    kernel_power = np.abs(fft2(kernel, (size, size))) ** 2
    return np.einsum("...ij,ij->...", filter_power, kernel_power) / size**2


def _best_of_all_strengths(q: Float64, a: Float64) -> Float64:
    """Return max_s of (5) without sum_i log sigma_ni^2, gradients added: (P, 1, 2, F) to (P, R).

    The slope in s is positive wherever s a_i > q_i - 1 for every i: no s beyond that is best.
    """

    def deviance(s: Float64) -> Float64:
        variance = 1 + s[..., None] * a
        return np.sum(q / variance + np.log(variance), axis=-1)

    def slope(s: Float64) -> Float64:
        variance = 1 + s[..., None] * a
        return np.sum((1 - q / variance) * a / variance, axis=-1)

    largest = np.maximum(np.max((q - 1) / a, axis=-1), 0)
    ladder = largest * _SHARES[:, None, None, None]
    best = np.argmin([deviance(s) for s in ladder], axis=0)[None]
    high = np.take_along_axis(ladder, np.maximum(best - 1, 0), 0)[0]
    low = np.take_along_axis(ladder, np.minimum(best + 1, len(ladder) - 1), 0)[0]
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        rising = slope(middle) > 0
        low, high = np.where(rising, low, middle), np.where(rising, middle, high)
    return -deviance((low + high) / 2).sum(axis=2)

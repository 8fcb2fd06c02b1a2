"""The best local maxima of the likelihood of a window, between the table's scales, too."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from napari_defocus.likelihood import refine_maxima
from napari_defocus.spectrum import LABEL_STEP, SpectrumTable

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]

CANDIDATES = 3
"""How many of a window are kept."""

_INDISTINCT = 1e-6
_FLAT = 1e-3


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

"""The local Fourier filter bank and the local power spectra of a picture, (3) and (4).

A Gabor filter is separable, so a window's spectrum is the product of row filters and column
filters. Spectra of +a1 and -a1 come from the same four real sums (cos cos, sin sin, sin cos,
cos sin), and only the sampled rows and columns are computed.

Gradients live half-way between pixels. Windows are therefore centred on the pixel (or, for an
even stride, on the block of pixels) that they speak for, and the taps of each axis are taken
where its samples lie; a flipped picture has exactly the flipped spectra.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.compiled import compiled
from napari_defocus.core.threads import in_bands

Float32 = NDArray[np.float32]

MIN_WINDOW = 17
"""px: the smallest window N with frequencies in every direction: (N - 1) / 8 has to be 2."""

_TILE = 256
"""Samples that are filtered at once: their sums stay in the processor's nearest cache."""


@dataclass(frozen=True)
class AxisFilters:
    """The 1-D halves of the Gabor filters along one axis.

    Attributes
    ----------
    first : float
        Position of the first tap relative to the window's centre, in px.
    taps : (L, 2 K + 1) float32 ndarray
        Cosines of 0, 2, ..., 2 K cycles a window, then sines of 2, ..., 2 K, times the Gaussian
        window of unit energy.
    """

    first: float
    taps: Float32

    @property
    def order(self) -> int:
        """K, the number of frequencies above zero."""
        return self.taps.shape[1] // 2

    @cached_property
    def folded(self) -> Float32:
        """The first half of the taps, an even number of them, (L', 2 K + 1): see `_filter_some`.

        A tap at the centre is halved, since its sample is added to itself.
        """
        half = -(-len(self.taps) // 2)
        folded = np.zeros((half + half % 2, self.taps.shape[1]), np.float32)
        folded[:half] = self.taps[:half]
        if len(self.taps) % 2:
            folded[half - 1] /= 2
        return folded


@lru_cache(maxsize=16)
def axis_filters(window: int, fraction: float) -> AxisFilters:
    """Make the filters of one axis.

    Parameters
    ----------
    window : int
        N, the side of the analysis window in px.
    fraction : float
        0 if samples lie a whole number of px from the window's centre, 0.5 if half-way between.
    """
    reach = (window - 1) // 2 - fraction
    position = np.arange(-reach, reach + 1)
    envelope = np.exp(-0.5 * (position / (window / 4)) ** 2)
    envelope /= np.sqrt(np.sum(envelope**2))
    cycles = 2 * np.arange((window - 1) // 8 + 1) / window
    phase = 2 * np.pi * position[:, None] * cycles
    waves = np.hstack([np.cos(phase), np.sin(phase[:, 1:])])
    return AxisFilters(-reach, np.ascontiguousarray(envelope[:, None] * waves, np.float32))


def frequencies(window: int) -> NDArray[np.int64]:
    """Return the (a_row, a_column) of every filter, in cycles a window: one half-plane, no DC.

    For N = 41 these are 60. The real picture's spectrum is the same at -a and a.
    """
    order = (window - 1) // 8
    positive = range(2, 2 * order + 1, 2)
    pairs = [(0, column) for column in positive]
    for row in positive:
        pairs += [(row, 0), *((row, a) for a in positive), *((row, -a) for a in positive)]
    return np.array(pairs)


def window_centers(length: int, stride: int) -> NDArray[np.floating]:
    """Return the centres of the analysed windows along one axis, in px, symmetric in it."""
    count = -(-length // stride)
    offset = np.arange(count, dtype=np.float64) - (count - 1) / 2
    return (length - 1) / 2 + offset * stride


def within_picture(centers: NDArray[np.floating], length: int, window: int) -> NDArray[np.floating]:
    """Move windows that reach over the border inside, to the nearest place where they fit."""
    fraction = centers[0] % 1
    margin = (window - 1) // 2 + fraction
    return np.clip(centers, margin, length - 1 - margin)


def padding(length: int, window: int) -> int:
    """Return how many pixels each end of an axis lacks for a window to fit."""
    return max(0, -(-(window + 1 - length) // 2))


@dataclass(frozen=True)
class Gradients:
    """Differences of neighbouring pixels, extended so that every window fits.

    Attributes
    ----------
    along_columns, along_rows : (H, W - 1) and (H - 1, W) float32 ndarray
        Horizontal and vertical differences; zero beside transparent pixels.
    pad : (int, int)
        Rows and columns added on each side of a picture smaller than a window.
    """

    along_columns: Float32
    along_rows: Float32
    pad: tuple[int, int]


def gradients(
    luminance: Float32,
    opaque: NDArray[np.bool_] | None,
    window: int,
    weight: Float32 | None = None,
) -> Gradients:
    """Take both gradients of a picture, (2), mirrored outwards if it is smaller than a window.

    They are multiplied by the `weight` of the pixels, (H, W), if it is given.
    """
    pad = (padding(luminance.shape[0], window), padding(luminance.shape[1], window))
    if any(pad):
        widths = [(amount, amount) for amount in pad]
        luminance = np.pad(luminance, widths, mode="symmetric")
        opaque = None if opaque is None else np.pad(opaque, widths, mode="symmetric")
        weight = None if weight is None else np.pad(weight, widths, mode="symmetric")
    across = np.diff(luminance, axis=1)
    down = np.diff(luminance, axis=0)
    if opaque is not None:
        across *= opaque[:, 1:] & opaque[:, :-1]
        down *= opaque[1:] & opaque[:-1]
    if weight is not None:
        across *= np.float32(0.5) * (weight[:, 1:] + weight[:, :-1])
        down *= np.float32(0.5) * (weight[1:] + weight[:-1])
    return Gradients(across, down, pad)


def local_power(
    gradient: Gradients,
    rows: NDArray[np.floating],
    columns: NDArray[np.floating],
    window: int,
) -> Float32:
    """Compute |g_i|^2 of (4) for a lattice of windows.

    Parameters
    ----------
    gradient : Gradients
    rows, columns : (R,) and (C,) float64 ndarray
        Centres of the windows, in px of the (padded) picture, evenly spaced, inside it.
    window : int
        N.

    Returns
    -------
    (R, C, 2, F) float32 ndarray
        Power of the horizontal, then of the vertical gradient, at the F `frequencies`.
    """
    row_fraction, column_fraction = rows[0] % 1, columns[0] % 1
    power = np.empty((len(rows), len(columns), 2, len(frequencies(window))), np.float32)
    for direction, samples in enumerate((gradient.along_columns, gradient.along_rows)):
        offset = (0.0, 0.5) if direction == 0 else (0.5, 0.0)
        row_filters = axis_filters(window, abs(row_fraction - offset[0]))
        column_filters = axis_filters(window, abs(column_fraction - offset[1]))
        first_row = np.rint(rows - offset[0] + row_filters.first).astype(int)
        first_column = np.rint(columns - offset[1] + column_filters.first).astype(int)
        sums = _separable_sums(samples, first_row, first_column, row_filters, column_filters)
        _power_of_sums(sums, power[:, :, direction])
    return power


def _separable_sums(
    samples: Float32,
    first_row: NDArray[np.int64],
    first_column: NDArray[np.int64],
    row_filters: AxisFilters,
    column_filters: AxisFilters,
) -> Float32:
    """Filter along columns, then along rows: (R, 2 K + 1, C, 2 K + 1).

    Every sum is taken in the same order whatever the size of the arrays, so that a part of a
    picture has the bits of the whole. No matrix product of a library promises that.
    """
    top, bottom = first_row[0], first_row[-1] + len(row_filters.taps)
    left, right = first_column[0], first_column[-1] + len(column_filters.taps)
    columns = np.ascontiguousarray(samples[top:bottom, left:right].T)
    lines = _filtered(columns, first_column - left, column_filters)  # (C, 2 K + 1, rows)
    lines = np.ascontiguousarray(lines.reshape(-1, bottom - top).T)
    sums = _filtered(lines, first_row - top, row_filters)  # (R, 2 K + 1, C * (2 K + 1))
    return sums.reshape(*sums.shape[:2], len(first_column), -1)


def _filtered(samples: Float32, first: NDArray[np.int64], filters: AxisFilters) -> Float32:
    """Filter along the first axis: (n, W) to (len(first), 2 K + 1, W)."""
    length, count = filters.taps.shape
    result = np.empty((len(first), count, samples.shape[1]), np.float32)
    in_bands(_filter_some, len(first), samples, first, filters.folded, length, result)
    return result


@compiled
def _filter_some(
    start: int,
    stop: int,
    samples: Float32,
    first: NDArray[np.int64],
    folded: Float32,
    length: int,
    result: Float32,
) -> None:
    """Add up the products of samples and taps, two pairs of samples at a time.

    Cosines are even about the window's centre and sines odd: the samples at equal distances from
    it are added for the former and subtracted for the latter, before they are multiplied.
    """
    half, count = folded.shape
    cosines = count // 2 + 1
    sums = np.empty((count, _TILE), np.float32)
    even, odd = np.zeros((2, _TILE), np.float32), np.zeros((2, _TILE), np.float32)
    for window in range(start, stop):
        for left in range(0, samples.shape[1], _TILE):
            width = min(_TILE, samples.shape[1] - left)
            for k in range(count):
                for x in range(_TILE):
                    sums[k, x] = 0
            for pair in range(0, half, 2):
                for member in range(2):
                    # The last pair may be the centre, twice, with half its weight; or have none.
                    low = first[window] + min(pair + member, (length - 1) // 2)
                    high = first[window] + max(length - 1 - pair - member, length // 2)
                    before = samples[low, left : left + width]
                    after = samples[high, left : left + width]
                    for x in range(width):
                        even[member, x] = before[x] + after[x]
                        odd[member, x] = before[x] - after[x]
                for k in range(cosines):
                    weight, next_weight = folded[pair, k], folded[pair + 1, k]
                    for x in range(_TILE):
                        sums[k, x] += weight * even[0, x] + next_weight * even[1, x]
                for k in range(cosines, count):
                    weight, next_weight = folded[pair, k], folded[pair + 1, k]
                    for x in range(_TILE):
                        sums[k, x] += weight * odd[0, x] + next_weight * odd[1, x]
            for k in range(count):
                for x in range(width):
                    result[window, k, left + x] = sums[k, x]


def _power_of_sums(sums: Float32, power: Float32) -> None:
    """Turn the four real sums of each frequency pair into the power at +a and -a."""
    order = sums.shape[1] // 2
    even_rows, odd_rows = sums[:, : order + 1], sums[:, order + 1 :]
    even, odd = slice(0, order + 1), slice(order + 1, None)
    power[..., :order] = even_rows[:, 0, :, 1 : order + 1] ** 2 + even_rows[:, 0, :, odd] ** 2
    for k in range(order):
        block = power[..., order + k * (2 * order + 1) : order + (k + 1) * (2 * order + 1)]
        cc, cs = even_rows[:, k + 1, :, even], even_rows[:, k + 1, :, odd]
        sc, ss = odd_rows[:, k, :, even], odd_rows[:, k, :, odd]
        block[..., 0] = cc[..., 0] ** 2 + sc[..., 0] ** 2
        block[..., 1 : order + 1] = (cc[..., 1:] - ss) ** 2 + (sc[..., 1:] + cs) ** 2
        block[..., order + 1 :] = (cc[..., 1:] + ss) ** 2 + (sc[..., 1:] - cs) ** 2

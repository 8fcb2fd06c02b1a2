"""How far blocks of a plane have moved: the peaks of cross-correlations, to a part of a pixel.

The cross-correlation of two blocks is a sum of waves, whose amplitudes are the product of their
spectra. Its highest pixel is found by an FFT. From there, Newton's method finds the peak of the sum
itself. So no correlation is drawn finer than the pixels.
"""

from __future__ import annotations

import math

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from napari_defocus.core.compiled import compiled
from napari_defocus.core.threads import in_bands

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Complex = NDArray[np.complex64]

_STEPS, _SETTLED = 10, 1e-4
"""Steps of Newton's method at most, and px: a step that is smaller is the last."""

_LONGEST, _FARTHEST = 0.5, 1.0
"""px: the longest step, and how far the peak may lie from the highest pixel. Chosen by hand."""


def block_spectra(blocks: Float32) -> Complex:
    """Return the Fourier transforms of blocks, (N, S, S): (N, S, S // 2 + 1)."""
    found: Complex = scipy.fft.rfft2(blocks)
    return found


def block_shifts(first: Complex, second: Complex, side: int) -> Float64:
    """Return how far each second block shows things beside where the first one does: (N, 2) px.

    Parameters
    ----------
    first, second : (N, S, S // 2 + 1) complex64 ndarray
        From `block_spectra`.
    side : int
        S.
    """
    product = second * first.conj()
    correlation = scipy.fft.irfft2(product, s=(side, side)).reshape(-1, side * side)
    rows, columns = np.divmod(correlation.argmax(axis=1), side)
    shifts = np.stack([rows, columns], axis=1).astype(np.float64)
    shifts[shifts > side // 2] -= side
    in_bands(_climb, len(product), product, side, shifts)
    return shifts


@compiled
def _climb(start: int, stop: int, product: Complex, side: int, shifts: Float64) -> None:
    """Move each shift from the highest pixel to the peak beside it."""
    unit = 2 * math.pi / side
    for block in range(start, stop):
        row, column = shifts[block]
        for _ in range(_STEPS):
            down, across = _newton_step(product[block], side, unit, row, column)
            row, column = row + down, column + across
            if abs(down) + abs(across) < _SETTLED:
                break
        if max(abs(row - shifts[block, 0]), abs(column - shifts[block, 1])) <= _FARTHEST:
            shifts[block, 0], shifts[block, 1] = row, column


@compiled
def _newton_step(
    product: Complex, side: int, unit: float, row: float, column: float
) -> tuple[float, float]:
    """Return Newton's step to the peak of a correlation; none where it has no peak."""
    waves = product.shape[1]
    along = np.empty(waves, np.complex128)
    for wave in range(waves):
        # Waves of the other sign are the conjugates of these, except for the first and the last.
        twice = 1.0 if wave == 0 or 2 * wave == side else 2.0
        along[wave] = twice * complex(
            math.cos(unit * wave * column), math.sin(unit * wave * column)
        )
    of_row = of_column = 0.0
    of_rows = of_columns = of_both = 0.0
    for wave in range(side):
        number = wave if 2 * wave <= side else wave - side
        turn = complex(math.cos(unit * number * row), math.sin(unit * number * row))
        value, slope, bend = 0j, 0j, 0j
        for other in range(waves):
            part = product[wave, other] * along[other]
            value += part
            slope += other * part
            bend += other * other * part
        value, slope, bend = value * turn, slope * turn, bend * turn
        of_row -= number * value.imag
        of_column -= slope.imag
        of_rows -= number * number * value.real
        of_columns -= bend.real
        of_both -= number * slope.real
    determinant = of_rows * of_columns - of_both * of_both
    if not (of_rows < 0 and determinant > 0):
        return 0.0, 0.0
    down = (of_both * of_column - of_columns * of_row) / determinant / unit
    across = (of_both * of_row - of_rows * of_column) / determinant / unit
    longest = max(abs(down), abs(across))
    if longest > _LONGEST:
        down, across = down * _LONGEST / longest, across * _LONGEST / longest
    return down, across

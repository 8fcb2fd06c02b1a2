"""The steps to which JPEG has rounded a picture, read off its pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

_BLOCK = 8
"""px: the side of JPEG's blocks (Wallace, CACM 34(4), 1991)."""

_MOST_LINES = 1024
"""Rows and columns that are looked at for blocks, about. Chosen by hand."""

_LEAST_SCORE, _LEAST_SUM_OF_SCORES = 5.0, 7.0
"""t-scores from which on there are blocks: of one direction, or of both together. By hand."""

_LEAST_STEP = 1e-4
"""The least difference between neighbours whose logarithm is taken, if a level of 8 bits is 1/255.
Chosen by hand.
"""

_MOST_BLOCKS = 4096
"""Blocks that are transformed, about. Chosen by hand."""

_COEFFICIENTS = ((0, 1, 1, 0, 2, 1, 2, 2, 0, 3), (1, 0, 1, 2, 0, 2, 1, 2, 3, 0))
"""Rows and columns of the ten slowest cosine coefficients but the mean, whose steps count."""

_JPEG_STEPS = range(2, 80)
"""Steps that are looked for, in levels of 8 bits. Chosen by hand."""

_FEWEST_COEFFICIENTS = 30
"""So many coefficients have to be rounded to another multiple than 0 for a step to be seen. By
hand.
"""

_LEAST_COMB, _COMB_DEVIATIONS = 0.25, 2.5
"""How near coefficients lie to multiples, as the mean cosine of their phase: at least so much, and
so many standard errors, of one over the square root of their number. Chosen by hand.
"""

LEVELS = 255
"""Levels of 8 bits from black to white."""


def quantization_step(luminance: Float32, level: float) -> float | None:
    """Return the step of JPEG in levels of 8 bits, None if there was none.

    `level` is how large a level is in the picture.
    """
    luminance = luminance / np.float32(LEVELS * level)
    origin = _origin_of_blocks(luminance)
    step = _step_of_blocks(luminance, origin or (0, 0))
    return None if origin is None and step <= 1 else step


def _origin_of_blocks(luminance: Float32) -> tuple[int, int] | None:
    """Find where JPEG's blocks of 8 px begin, in rows and columns; None if there are none.

    Neighbours differ more between blocks than within.
    """
    row_step, column_step = (-(-length // _MOST_LINES) for length in luminance.shape)
    # The median sees blocks in the flat part of a picture, the mean in its texture.
    for typical in (np.median, np.mean):
        (row, row_score), (column, column_score) = (
            _blockiness(typical(np.abs(np.diff(some, axis=0)), axis=1))
            for some in (luminance[:, ::column_step], luminance[::row_step].T)
        )
        if (
            max(row_score, column_score) > _LEAST_SCORE
            or row_score + column_score > _LEAST_SUM_OF_SCORES
        ):
            return row, column
    return None


def _blockiness(steps: NDArray[np.floating]) -> tuple[int, float]:
    """Return the phase of 8 px where the picture steps most, and its t-score against the others.

    Step i leads from line i to line i + 1.
    """
    if len(steps) < 4 * _BLOCK:
        return 0, 0.0
    log_steps = np.log(steps + _LEAST_STEP)
    bend = log_steps[1:-1] - 0.5 * (log_steps[:-2] + log_steps[2:])
    line = (np.arange(len(bend)) + 2) % _BLOCK
    scores = [_welch(bend[line == k], bend[line != k]) for k in range(_BLOCK)]
    return int(np.argmax(scores)), float(max(scores))


def _welch(some: Float64, others: Float64) -> float:
    """Return the t-score of a difference of means, variances unequal (Welch, Biometrika 34, 1947).

    As `scipy.stats.ttest_ind`, which takes thirty times as long to get there; NaN for constants.
    """
    squared_error = sum(values.var(ddof=1) / len(values) for values in (some, others))
    with np.errstate(divide="ignore", invalid="ignore"):
        return float((some.mean() - others.mean()) / np.sqrt(squared_error))


def _step_of_blocks(luminance: Float32, origin: tuple[int, int]) -> float:
    """Return the step to which JPEG has rounded slow changes within blocks, in levels of 8 bits.

    The cosine coefficients (Wallace, CACM 34(4), 1991) lie near multiples of their step. The
    largest step that they keep to counts, the median of ten coefficients; 1 if there is none.
    """
    row, column = origin
    rows, columns = (luminance.shape[0] - row) // _BLOCK, (luminance.shape[1] - column) // _BLOCK
    inside = luminance[row : row + rows * _BLOCK, column : column + columns * _BLOCK]
    grid = inside.reshape(rows, _BLOCK, columns, _BLOCK).swapaxes(1, 2)
    blocks = grid.reshape(-1, _BLOCK, _BLOCK)
    some = blocks[:: max(1, len(blocks) // _MOST_BLOCKS)]
    coefficients = LEVELS * dctn(some, axes=(1, 2), norm="ortho")[:, *_COEFFICIENTS]
    return float(np.median([_comb(values) for values in coefficients.T]))


def _comb(values: Float32) -> int:
    """Return the largest step whose multiples values lie near, 1 if there is none."""
    largest = 1
    for step in _JPEG_STEPS:
        rounded = values[np.abs(values) > step / 2]  # to another multiple than 0
        if len(rounded) < _FEWEST_COEFFICIENTS:
            break
        nearness = np.cos(2 * np.pi / step * rounded).mean()
        if nearness > _LEAST_COMB + _COMB_DEVIATIONS / np.sqrt(len(rounded)):
            largest = step
    return largest

"""Where what is sharp meets what is blurred by much: there, the blur may jump at a low price.

By (15), a jump from 0 to 30 px costs ten times as much as one from 5 to 8 px. A flower in front
of a far ground then takes its surroundings along, and a stem is taken for ground. But such a jump
is no less likely than another one. So the windows are first told apart by three classes,

    r <= 3 px,    3 px < r <= 8 px,    r > 8 px,

with the least of D in each class as its cost, and the pairwise weights times a number of labels a
step. Between neighbours of the first and of the last class, the weights of (14)
are then small.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from napari_defocus.labeling.graph_cuts import minimize_energy_of_few
from napari_defocus.labeling.multigrid import HALF, STEPS

Float32 = NDArray[np.float32]

_LITTLE, _MUCH = 31, 80
"""Labels of the first class end before 3.1 px, those of the last one begin with 8 px."""

_PRICE = np.float32(80)
"""Labels that a jump from the first class to the last one costs. With 40, outlines before 20 px are
less exact (docs/decisions.md)."""

_BEYOND = np.float32(0.6)
"""Share of the weights at blurred edges in these classes' weights, beside those of (16)."""

_LEFT = np.float32(0.1)
"""What is left of the weights where the first class meets the last one; 0.4 gives the same."""


def less_at_wide_jumps(weights: Float32, data: Float32) -> Float32:
    """Return weights between blocks, less where what is sharp meets what is blurred by much.

    Parameters
    ----------
    weights : (8, R, C) float32 ndarray
        See `minimize_energy`.
    data : (R, C, L) float32 ndarray
        D, the cost of each label at each block. With radii up to 8 px, nothing is done.

    Returns
    -------
    (8, R, C) float32 ndarray
    """
    if data.shape[2] <= _MUCH + 1:
        return weights
    classes = _classes(weights, data)
    rows, columns = classes.shape
    lessened = weights.copy()
    for number, (down, right) in enumerate(STEPS):
        left, end = max(0, -right), columns - max(0, right)
        here, there = classes[: rows - down, left:end], classes[down:, left + right : end + right]
        jump = np.abs(here - there) > 1
        for half in (number, number + HALF):
            lessened[half, : rows - down, left:end][jump] *= _LEFT
    return lessened


def _classes(weights: Float32, data: Float32) -> NDArray[np.int32]:
    """Return 0, 1 or 2 for each block: little, medium or much blur."""
    limits = (0, _LITTLE), (_LITTLE, _MUCH), (_MUCH, data.shape[2])
    cost = np.stack([data[..., slice(*limit)].min(axis=2) for limit in limits], axis=2)
    each = (1 - _BEYOND) * weights[:HALF] + _BEYOND * weights[HALF:]
    return minimize_energy_of_few(cost, _PRICE / 2 * each)

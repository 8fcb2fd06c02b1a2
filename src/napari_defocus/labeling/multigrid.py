"""Grids of labels, their neighbours, and the same with half as many rows and columns."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.compiled import compiled, compiled_inline
from napari_defocus.core.threads import in_bands

Float32 = NDArray[np.float32]
Labels = NDArray[np.int32]

STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""From a node to the half of its 8 neighbours that comes after it: row and column steps."""

HALF = len(STEPS)
"""Weights of a node with its neighbours, if all labels have the same ones."""

WIDE = 50
"""The label of 5 px. Differences beyond it may have their own weights, as edges of what is blurred
by more show only in the picture smoothed over 8 px (docs/decisions.md).
"""

_RELAXATION = np.float32(0.4)
"""Share of its edges' weights that a joined node pays to leave the common label. With 1, edges
inside of the joined node would count as well. Chosen by the energy on ramps and photographs.
"""


class AnyCosts(Protocol):
    """Costs (R, C, L) of which parts can be taken: an array, or what works them out."""

    @property
    def shape(self) -> tuple[int, ...]:
        """(R, C, L)."""
        ...

    def __len__(self) -> int: ...

    def __getitem__(self, part: slice | tuple[slice, slice], /) -> Float32: ...


_PIECE = 32
"""Rows of a grid that are worked on at once; even."""


def pieces(length: int) -> Iterator[slice]:
    """Cut rows into pieces, so that what is worked out for each takes little memory."""
    for start in range(0, length, _PIECE):
        yield slice(start, min(start + _PIECE, length))


def coarser(data: AnyCosts, weights: Float32, *, agreed: bool = False) -> tuple[Float32, Float32]:
    """Join nodes two by two: costs add up, and so do the weights across the seams.

    Parameters
    ----------
    data, weights : ndarray
        As for `minimize_energy`.
    agreed : bool, optional
        Joined nodes pay for the label that they have in common; else each may leave it at the
        price of its own edges.

    Returns
    -------
    data, weights : ndarray
        The same for half as many rows and columns, rounded up.
    """
    rows, columns = (-(-length // 2) for length in data.shape[:2])
    joined = np.zeros((rows, columns, data.shape[2]), np.float32)
    for some in pieces(len(data)):
        costs, into = data[some], joined[some.start // 2 : -(-some.stop // 2)]
        price = np.full((2, *costs.shape[:2]), np.inf if agreed else 0, np.float32)
        if not agreed:
            for half, part in enumerate((weights[:HALF, some], weights[-HALF:, some])):
                price[half] = _RELAXATION * part.sum(axis=0)
        in_bands(_join_costs, len(into), costs, price, into)
    row_block, column_block = (np.arange(length) // 2 for length in data.shape[:2])
    return joined, _joined_weights(weights, row_block, column_block)


def finer(labels: Labels, rows: int, columns: int) -> Labels:
    """Return labels of joined nodes for each of so many rows and columns of them."""
    return labels.take(np.arange(columns) // 2, 1).take(np.arange(rows) // 2, 0)


@compiled
def _join_costs(start: int, stop: int, data: Float32, price: Float32, joined: Float32) -> None:
    """Add up the costs of two by two nodes, each of which may leave the common label at a price.

    Their costs become min_m D(m) + w |l - m|: joined nodes need not agree on one label, as they
    cannot where the blur is steep. An infinite price makes them agree.
    """
    rows, columns, count = data.shape
    cost = np.empty(count, np.float32)
    for i in range(2 * start, min(2 * stop, rows)):
        for j in range(columns):
            for label in range(count):
                cost[label] = data[i, j, label]
            for label in range(1, count):
                cost[label] = min(cost[label], cost[label - 1] + price[int(label > WIDE), i, j])
            for label in range(count - 2, -1, -1):
                cost[label] = min(cost[label], cost[label + 1] + price[int(label >= WIDE), i, j])
            for label in range(count):
                joined[i // 2, j // 2, label] += cost[label]


@compiled
def _joined_weights(
    weights: Float32, row_block: NDArray[np.int64], column_block: NDArray[np.int64]
) -> Float32:
    rows, columns = weights.shape[1:]
    joined = np.zeros((len(weights), row_block[-1] + 1, column_block[-1] + 1), np.float32)
    for k in range(len(weights)):
        down, right = STEPS[k % HALF]
        into = joined[k - k % HALF : k - k % HALF + HALF]
        for i in range(rows - down):
            for j in range(max(0, -right), columns - max(0, right)):
                join_blocks(
                    into,
                    row_block[i],
                    column_block[j],
                    row_block[i + down],
                    column_block[j + right],
                    weights[k, i, j],
                )
    return joined


@compiled_inline
def join_blocks(joined: Float32, i: int, j: int, i_to: int, j_to: int, weight: float) -> None:
    """Add the weight of one pair of members to the pair of blocks that they belong to."""
    down, right = i_to - i, j_to - j
    if down == 0 and right == 1:
        joined[0, i, j] += weight
    elif down == 0 and right == -1:
        joined[0, i, j_to] += weight
    elif down == 1 and right == 0:
        joined[1, i, j] += weight
    elif down == 1 and right == 1:
        joined[2, i, j] += weight
    elif down == 1 and right == -1:
        joined[3, i, j] += weight

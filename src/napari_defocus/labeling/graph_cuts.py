"""Labels of low energy on a grid of nodes, by moves that are minimum cuts.

The energy is (14): sum_x D_x(l_x) + sum_(x, v) w_xv |l_x - l_v|, over the 8 neighbours of each
node. |l - m| counts the thresholds between two labels, and those beyond the label `WIDE` may have
weights of their own. Two kinds of minimum cuts change many labels at once:

- a fusion offers every node one other label, any label (`fusions`); it is an expansion if all
  offers are the same label;
- Ishikawa's graph, with a node for each threshold between two labels, gives the exact optimum
  over all labels; it is for few nodes, or few labels.

`coarse_to_fine` makes them on coarser and coarser grids first; fusions are made part by part
(`parts`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.compiled import compiled
from napari_defocus.core.progress import Progress, silent, within
from napari_defocus.core.threads import in_order
from napari_defocus.labeling.data_term import Costs
from napari_defocus.labeling.fusions import change_of, fuse, fuse_in_place, weighted
from napari_defocus.labeling.minimum_cuts import sink_side_of_one
from napari_defocus.labeling.multigrid import HALF, STEPS, WIDE, AnyCosts
from napari_defocus.labeling.parts import Part, groups_of_parts

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]
Labels = NDArray[np.int32]
Mask = NDArray[np.bool_]
Places = NDArray[np.int64]
Free = tuple[int, int, int, int]
Moves = Callable[[Labels, Float32, Float32, Free], None]

CHOOSING_LABELS = "Choosing labels"
"""What progress is told."""

_EVERYWHERE = 8
"""On finer grids, every 8th label is offered to all nodes."""

_LEAST_GAIN = 1e-6
"""Expansions go on while a round gains at least this share of the energy."""

_NEVER = 1e12
"""Capacity of edges that no cut may separate; energies stay far below."""


class _Sweep(NamedTuple):
    """Which labels are offered to which nodes: every `step`-th, near the nodes that have it.

    Attributes
    ----------
    reach : int
        Labels that differ by no more count as the same.
    grow : int
        How many nodes around are offered it, too.
    step : int
    """

    reach: int
    grow: int
    step: int


_CLOSE = _Sweep(reach=1, grow=1, step=1)
"""Offers of a label that a neighbour has, or one beside it."""

_FAR = _Sweep(reach=16, grow=6, step=4)
"""Offers of labels that are found farther away."""


def solve_exactly(data: Float32, weights: Float32, wide: int = WIDE) -> Labels:
    """Find the labels of least energy by one cut: for few nodes, or few labels.

    Parameters and result are those of `minimize_energy`; the cut has R x C x (L - 1) nodes.
    Among fewer labels, `wide` is the number of `WIDE`.
    """
    rows, columns, count = data.shape
    if count == 2:
        low = np.zeros((rows, columns), np.int32)
        return fuse_labels(low, low + np.int32(1), data, weights)
    edges = Edges.of_grid(weights)
    graph = _threshold_graph(data.reshape(-1, count), *edges.arrays, wide)
    return sink_side_of_one(*graph).reshape(rows, columns, count - 1).sum(axis=2, dtype=np.int32)


def improve(
    start: Labels,
    data: AnyCosts,
    weights: Float32,
    *,
    everywhere: bool = False,
    progress: Progress = silent,
) -> Labels:
    """Lower the energy of labels, such as those of a coarser level.

    Nodes are offered their own best label and those beside them; then labels are offered where
    they may win, which is near where they are: at first far around, then nearby.

    Parameters
    ----------
    start : (R, C) int32 ndarray
    data, weights : ndarray
        As for `minimize_energy`.
    everywhere : bool, optional
        Offer some labels to all nodes instead of farther, which takes long on fine grids.
    progress : callable, optional

    Returns
    -------
    (R, C) int32 ndarray
    """

    def first(labels: Labels, data: Float32, weights: Float32, free: Free) -> None:
        _offer_best_and_beside(labels, data, weights, free)
        if everywhere:
            _sweep(labels, data, weights, free, *_CLOSE)
            _offer_to_all(labels, data, weights, free, _EVERYWHERE)
        else:
            _sweep(labels, data, weights, free, *_FAR)

    def last(labels: Labels, data: Float32, weights: Float32, free: Free) -> None:
        _sweep(labels, data, weights, free, *_CLOSE)

    labels = _in_parts(first, start, data, weights, False, within(progress, 0, 0.7))
    return _in_parts(last, labels, data, weights, True, within(progress, 0.7, 1))


def _in_parts(
    moves: Moves,
    start: Labels,
    data: AnyCosts,
    weights: Float32,
    shifted: bool,
    progress: Progress,
) -> Labels:
    """Lower the energy of the parts of a grid, while what is around each is held."""
    labels = start.copy()

    def moved(part: Part) -> Labels:
        rows, columns = part.seen
        own = labels[part.seen].copy()
        costs = np.ascontiguousarray(data[part.seen])
        moves(own, costs, np.ascontiguousarray(weights[:, rows, columns]), part.free)
        return own

    groups = groups_of_parts(labels.shape, shifted=shifted)
    done, total = 0, sum(len(group) for group in groups)
    for group in groups:
        for part, own in zip(group, in_order(moved, group), strict=True):
            progress(CHOOSING_LABELS, done / total)
            top, bottom, left, right = part.free
            mine = own[top:bottom, left:right]
            labels[slice(*part.rows), slice(*part.columns)] = mine
            done += 1
    return labels


def _offer_best_and_beside(labels: Labels, data: Float32, weights: Float32, free: Free) -> None:
    """Offer nodes their own best label, then the least and the largest of those beside them."""
    own = slice(free[0], free[1]), slice(free[2], free[3])
    offers: tuple[Callable[[], NDArray[Any]], ...] = (
        lambda: data[own].argmin(axis=2),
        lambda: _of_those_around(np.minimum, labels)[own],
        lambda: _of_those_around(np.maximum, labels)[own],
    )
    for offer in offers:
        proposal = labels.copy()
        proposal[own] = offer()
        place = np.flatnonzero(labels != proposal)
        fuse_in_place(labels, proposal, place, change_of(labels, proposal, place, data), weights)


def _of_those_around(extreme: np.ufunc, labels: Labels) -> Labels:
    """Return the least or the largest label of each node and its 8 neighbours."""
    padded = np.pad(labels, 1, mode="edge")
    of_rows = extreme(extreme(padded[:-2], padded[1:-1]), padded[2:])
    found: Labels = extreme(extreme(of_rows[:, :-2], of_rows[:, 1:-1]), of_rows[:, 2:])
    return found


def _offer_to_all(labels: Labels, data: Float32, weights: Float32, free: Free, step: int) -> None:
    """Offer every so many labels to all nodes."""
    mine = np.zeros(labels.shape, np.bool_)
    mine[free[0] : free[1], free[2] : free[3]] = True
    proposal = labels.copy()
    for alpha in range(0, data.shape[2], step):
        place = np.flatnonzero(mine & (labels != alpha))
        _expand_at(labels, proposal, alpha, place, data, weights)


def _sweep(
    labels: Labels,
    data: Float32,
    weights: Float32,
    free: Free,
    reach: int,
    grow: int,
    step: int,
) -> None:
    """Offer labels to the nodes near those that have about this label."""
    count = data.shape[2]
    proposal = labels.copy()
    # Labels that may be there: those at the beginning, and those that were offered.
    present = np.zeros(count, np.bool_)
    present[labels] = True
    for alpha in range(0, count, step):
        if present[max(alpha - reach, 0) : alpha + reach + 1].any():
            place = _near(labels, alpha, reach, grow, free)
            _expand_at(labels, proposal, alpha, place, data, weights)
            present[alpha] = True


def _expand_at(
    labels: Labels, proposal: Labels, alpha: int, place: Places, data: Float32, weights: Float32
) -> None:
    """Let a label take nodes among some. `proposal` is as the labels are, before and after."""
    if not len(place):
        return
    np.put(proposal, place, alpha)
    fuse_in_place(labels, proposal, place, change_of(labels, proposal, place, data), weights)
    np.put(proposal, place, labels.take(place))


@compiled
def _near(labels: Labels, alpha: int, reach: int, grow: int, free: Free) -> Places:
    """Return the free nodes of other labels around those whose label is near alpha."""
    rows, columns = labels.shape
    along = np.zeros((rows, columns), np.uint8)
    for i in range(rows):
        done = 0
        for j in range(columns):
            if abs(labels[i, j] - alpha) <= reach:
                stop = min(j + grow + 1, columns)
                for x in range(max(done, j - grow), stop):
                    along[i, x] = 1
                done = stop
    # How many of the rows within reach are marked, at each column.
    marked = np.zeros(columns, np.uint8)
    for i in range(max(free[0] - grow, 0), min(free[0] + grow, rows)):
        for j in range(columns):
            marked[j] += along[i, j]
    place = np.empty(rows * columns, np.int64)
    count = 0
    for i in range(free[0], free[1]):
        if i + grow < rows:
            for j in range(columns):
                marked[j] += along[i + grow, j]
        if i - grow - 1 >= max(free[0] - grow, 0):
            for j in range(columns):
                marked[j] -= along[i - grow - 1, j]
        for j in range(free[2], free[3]):
            if marked[j] and labels[i, j] != alpha:
                place[count] = i * columns + j
                count += 1
    return place[:count].copy()


def expand_until_settled(
    data: Float32, weights: Float32, progress: Progress = silent, start: Labels | None = None
) -> Labels:
    """Find labels by expansion moves over all labels alone, until none lowers the energy.

    The paper's way, from each node's best label unless others are given; slower than
    `minimize_energy` and a reference for it. The other parameters and the result are the same.
    """
    count = data.shape[2]
    labels = data.argmin(axis=2).astype(np.int32) if start is None else start
    before, after = np.inf, energy_of(labels, data, weights)
    left = 1.0  # of the bar: nobody knows how many rounds there will be
    while after < before - _LEAST_GAIN * abs(after):
        for alpha in range(count):
            progress(CHOOSING_LABELS, 1 - left * (1 - 0.5 * alpha / count))
            labels = expand(labels, alpha, data, weights)
        before, after = after, energy_of(labels, data, weights)
        left /= 2
    return labels


def expand(labels: Labels, alpha: int, data: Float32, weights: Float32) -> Labels:
    """Let the label alpha take the nodes that it should have: an expansion move."""
    expanded = labels.copy()
    place = np.flatnonzero(labels != alpha)
    _expand_at(expanded, labels.copy(), alpha, place, data, weights)
    return expanded


def fuse_labels(
    labels: Labels, proposal: Labels, data: Float32 | Costs, weights: Float32
) -> Labels:
    """Return labels whose every node has the better one of two, by one cut: a fusion."""
    place = np.flatnonzero(labels != proposal)
    if isinstance(data, Costs):
        change = data.change(labels, proposal, place)
    else:
        change = change_of(labels, proposal, place, data)
    return fuse(labels, proposal, place, change, weights)


@dataclass(frozen=True)
class Edges:
    """Pairs of nodes whose labels should be alike.

    Attributes
    ----------
    first, second : (E,) int32 ndarray
        Numbers of the two nodes.
    weight : (E,) float32 ndarray
    beyond : (E,) float32 ndarray
        The weight of differences beyond the label `WIDE`.
    """

    first: Labels
    second: Labels
    weight: Float32
    beyond: Float32

    @property
    def arrays(self) -> tuple[Labels, Labels, Float32, Float32]:
        """All of them, as kernels take them."""
        return self.first, self.second, self.weight, self.beyond

    @classmethod
    def of_grid(cls, weights: Float32) -> Edges:
        """Return the pairs of a grid whose nodes are numbered row by row."""
        columns = weights.shape[2]
        k, i, j = np.nonzero(weights[:HALF])
        first = i * columns + j
        step = np.array([down * columns + right for down, right in STEPS])
        second = (first + step[k]).astype(np.int32)
        beyond = weights[-HALF:][k, i, j]
        return cls(first.astype(np.int32), second, weights[k, i, j], beyond)


@compiled
def energy_of(labels: Labels, data: Float32, weights: Float32) -> float:
    """Evaluate (14) for labels (R, C), costs (R, C, L) and weights (4 or 8, R, C)."""
    rows, columns = labels.shape
    energy = 0.0
    beyond = len(weights) - HALF
    for i in range(rows):
        for j in range(columns):
            energy += data[i, j, labels[i, j]]
            for k, (down, right) in enumerate(STEPS):
                y, x = i + down, j + right
                if y < rows and 0 <= x < columns:
                    low = min(labels[i, j], labels[y, x])
                    high = max(labels[i, j], labels[y, x])
                    given = weights[k, i, j], weights[beyond + k, i, j]
                    energy += weighted(low, high, *given)
    return energy


@compiled
def _threshold_graph(
    data: Float32, first: Labels, second: Labels, weight: Float32, beyond: Float32, wide: int
) -> tuple[Float64, Labels, Labels, Float64, Float64]:
    """Return unary costs and arcs over the variables "the label of node i is above t".

    D, (N, L), telescopes into one unary cost a variable, w |l - m| into one pair a threshold.
    """
    nodes, labels = data.shape
    steps = labels - 1
    arcs = nodes * max(steps - 1, 0) + len(first) * steps
    cost = np.empty(nodes * steps)
    tail, head = np.empty(arcs, np.int32), np.empty(arcs, np.int32)
    forth, back = np.empty(arcs), np.zeros(arcs)
    count = 0
    for i in range(nodes):
        for t in range(steps):
            variable = i * steps + t
            cost[variable] = data[i, t + 1] - data[i, t]
            if t + 1 < steps:
                tail[count], head[count], forth[count] = variable, variable + 1, _NEVER
                count += 1
    for edge in range(len(first)):
        for t in range(steps):
            tail[count], head[count] = first[edge] * steps + t, second[edge] * steps + t
            forth[count] = weight[edge] if t < wide else beyond[edge]
            back[count] = forth[count]
            count += 1
    return cost, tail, head, forth, back

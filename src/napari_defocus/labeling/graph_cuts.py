"""Labels of low energy on a grid of nodes, by moves that are minimum cuts.

The energy is (14): sum_x D_x(l_x) + sum_(x, v) w_xv |l_x - l_v|, over the 8 neighbours of each
node. |l - m| counts the thresholds between two labels, and those beyond the label `WIDE` may have
weights of their own. Two kinds of minimum cuts change many labels at once:

- a fusion offers every node one other label, any label, and is a plain minimum cut, because
  |a - b| is submodular in "the node has the larger of its two labels"; it is an expansion if all
  offers are the same label;
- Ishikawa's graph, with a node for each threshold between two labels, gives the exact optimum
  over all labels; it is for few nodes, or few labels.

The coarsest grid is solved exactly; fusions go on from there. Most of the flow of a cut is
found by passing messages before PyMaxflow looks for paths. This is the only file that knows
PyMaxflow.
"""

from __future__ import annotations

from dataclasses import dataclass

import maxflow
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from napari_defocus.core.progress import Progress, silent, within
from napari_defocus.labeling.multigrid import HALF, STEPS, WIDE, coarser, finer

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]
Labels = NDArray[np.int32]
Mask = NDArray[np.bool_]
Places = NDArray[np.int64]

_STEP = "Choosing labels"

_COARSEST = 2600
"""The most nodes of the coarsest grid, which is solved exactly."""

_COARSE_STEP = 4
"""There, every 4th label is a choice (every 2nd: no better a map, three times the time)."""

_EVERYWHERE = 8
"""On finer grids, every 8th label is offered to all nodes."""

_LEAST_GAIN = 1e-6
"""Expansions go on while a round gains at least this share of the energy."""

_NEVER = 1e12
"""Capacity of edges that no cut may separate; energies stay far below."""

_ROUNDS = 10
"""Of message passing to and fro before a cut: speed only, the cut is the same."""

_NEGLIGIBLE = 1e-4
"""If leaving all nodes as they are, or giving all one side, costs at most so much a node more than
the best cut, that is taken; a pixel with clear evidence has 360. Without texture, what message
passing leaves is rounding and takes long to cut: 48 s for a map of 800 x 800 px of noise, now 2.
"""

_SHARE = np.float32(0.25)
"""The share of a node's cost that each neighbour gets: a node has 4 edges on either side."""


@dataclass(frozen=True)
class _Sweep:
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


def minimize_energy(
    data: Float32,
    weights: Float32,
    progress: Progress = silent,
    *,
    coarse: bool = False,
    finest: bool = True,
) -> Labels:
    """Find labels of low energy, from coarse to fine.

    Parameters
    ----------
    data : (R, C, L) float32 ndarray
        D, the cost of each label at each node.
    weights : (4, R, C) or (8, R, C) float32 ndarray
        w between a node and its neighbour at each of `STEPS`; 0 where there is none. If there are
        eight, the last four are those of differences beyond the label `WIDE`.
    progress : callable, optional
    coarse : bool, optional
        Stop before the finest grid: two by two nodes have a label in common.
    finest : bool, optional
        Whether this grid is the finest one. If not, it is worth more work: see
        `minimize_energy_from`.

    Returns
    -------
    (R, C) int32 ndarray
    """
    levels = [(data, weights)]
    while levels[-1][1][0].size > _COARSEST:
        levels.append(coarser(*levels[-1]))
    labels = _coarse_start(*levels[-1])
    for depth, (level_data, level_weights) in enumerate(reversed(levels), 1):
        rows, columns = level_data.shape[:2]
        start = finer(labels, rows, columns) if depth > 1 else labels
        # Each level has four times the nodes of the one before it.
        last = depth == len(levels)
        if last and coarse and depth > 1:
            return start
        report = within(progress, 0.25 ** (len(levels) - depth + 1), 0.25 ** (len(levels) - depth))
        everywhere = not (last and finest)
        labels = improve(start, level_data, level_weights, everywhere=everywhere, progress=report)
    progress(_STEP, 1.0)
    return labels


def minimize_energy_from(
    start: Labels, data: Float32, weights: Float32, progress: Progress = silent
) -> Labels:
    """Find labels of low energy from those of a coarser grid.

    If they come from `minimize_energy` of this grid's own costs, joined by `coarser`, the result
    is that of `minimize_energy` of this grid.

    Parameters
    ----------
    start : (r, c) int32 ndarray
        r is R / 2, R / 4 or so, rounded up.
    data, weights
        As for `minimize_energy`.
    progress : callable, optional

    Returns
    -------
    (R, C) int32 ndarray
    """
    levels = [(data, weights)]
    while -(-levels[-1][0].shape[0] // 2) > start.shape[0]:
        levels.append(coarser(*levels[-1]))
    labels = start
    for depth in reversed(range(len(levels))):
        level_data, level_weights = levels[depth]
        labels = improve(
            finer(labels, *level_data.shape[:2]),
            level_data,
            level_weights,
            everywhere=depth > 0,
            progress=within(progress, 0.25 ** (depth + 1), 0.25**depth),
        )
    progress(_STEP, 1.0)
    return labels


def _coarse_start(data: Float32, weights: Float32) -> Labels:
    """Find the labels of least energy among every fourth: they decide about whole regions."""
    every = np.ascontiguousarray(data[..., ::_COARSE_STEP])
    weights = weights * np.float32(_COARSE_STEP)
    return _COARSE_STEP * solve_exactly(every, weights, WIDE // _COARSE_STEP)


def solve_exactly(data: Float32, weights: Float32, wide: int = WIDE) -> Labels:
    """Find the labels of least energy by one cut: for few nodes, or few labels.

    Parameters and result are those of `minimize_energy`; the cut has R x C x (L - 1) nodes.
    Among fewer labels, `wide` is the number of `WIDE`.
    """
    rows, columns, count = data.shape
    if count == 2:
        low = np.zeros((rows, columns), np.int32)
        return _fuse_labels(low, low + np.int32(1), data, weights)
    edges = Edges.of_grid(weights)
    graph = _threshold_graph(data.reshape(-1, count), *edges.arrays, wide)
    return _sink_side(*graph).reshape(rows, columns, count - 1).sum(axis=2, dtype=np.int32)


def improve(
    start: Labels,
    data: Float32,
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
    labels = _fuse_labels(start, data.argmin(axis=2).astype(np.int32), data, weights)
    for beside in (minimum_filter, maximum_filter):
        labels = _fuse_labels(labels, beside(labels, 3), data, weights)
    if everywhere:
        labels = _expand_near(labels, _CLOSE, data, weights, within(progress, 0, 0.3))
        for alpha in range(0, data.shape[2], _EVERYWHERE):
            labels = expand(labels, alpha, data, weights)
    else:
        labels = _expand_near(labels, _FAR, data, weights, within(progress, 0, 0.6))
    return _expand_near(labels, _CLOSE, data, weights, within(progress, 0.6, 1))


def _expand_near(
    labels: Labels,
    sweep: _Sweep,
    data: Float32,
    weights: Float32,
    progress: Progress,
) -> Labels:
    """Offer labels to the nodes near those that have about this label."""
    count = data.shape[2]
    for alpha in range(0, count, sweep.step):
        progress(_STEP, alpha / count)
        place = _near(labels, alpha, sweep.reach, sweep.grow)
        labels = _expand_at(labels, alpha, place, data, weights)
    return labels


@njit(cache=True, error_model="numpy", nogil=True)
def _near(labels: Labels, alpha: int, reach: int, grow: int) -> Places:
    """Return the nodes of other labels around those whose label is near alpha."""
    rows, columns = labels.shape
    near = np.zeros((rows, columns), np.bool_)
    first, last = rows, -1
    for i in range(rows):
        for j in range(columns):
            if abs(labels[i, j] - alpha) <= reach:
                for y in range(max(0, i - grow), min(rows, i + grow + 1)):
                    for x in range(max(0, j - grow), min(columns, j + grow + 1)):
                        near[y, x] = True
                first, last = min(first, i - grow), i + grow
    place = np.empty(rows * columns, np.int64)
    count = 0
    for i in range(max(first, 0), min(last + 1, rows)):
        for j in range(columns):
            if near[i, j] and labels[i, j] != alpha:
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
            progress(_STEP, 1 - left * (1 - 0.5 * alpha / count))
            labels = expand(labels, alpha, data, weights)
        before, after = after, energy_of(labels, data, weights)
        left /= 2
    return labels


def expand(labels: Labels, alpha: int, data: Float32, weights: Float32) -> Labels:
    """Let the label alpha take the nodes that it should have: an expansion move."""
    return _expand_at(labels, alpha, np.flatnonzero(labels != alpha), data, weights)


def _expand_at(
    labels: Labels, alpha: int, place: Places, data: Float32, weights: Float32
) -> Labels:
    proposal = labels.copy()
    proposal.ravel()[place] = alpha
    return fuse(labels, proposal, place, _change(labels, proposal, place, data), weights)


def _fuse_labels(labels: Labels, proposal: Labels, data: Float32, weights: Float32) -> Labels:
    place = np.flatnonzero(labels != proposal)
    return fuse(labels, proposal, place, _change(labels, proposal, place, data), weights)


@njit(cache=True, error_model="numpy", nogil=True)
def _change(labels: Labels, proposal: Labels, place: Places, data: Float32) -> Float64:
    """Return D of the proposed label minus D of the present one, at some nodes."""
    columns = labels.shape[1]
    change = np.empty(len(place))
    for k in range(len(place)):
        i, j = place[k] // columns, place[k] % columns
        change[k] = data[i, j, proposal[i, j]] - data[i, j, labels[i, j]]
    return change


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


@njit(cache=True, error_model="numpy", nogil=True)
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
                    energy += _weighted(low, high, *given)
    return energy


@njit(cache=True, error_model="numpy", nogil=True)
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


def _sink_side(cost: Float64, tail: Labels, head: Labels, forth: Float64, back: Float64) -> Mask:
    """Cut a graph at the least cost and return which nodes are on the sink's side.

    `cost` is paid by each node on that side, `forth` by each arc from the source's side to it,
    `back` by each arc the other way.
    """
    if not len(cost):
        return np.zeros(0, bool)
    graph = maxflow.GraphFloat(len(cost), len(tail))
    nodes = graph.add_nodes(len(cost))
    graph.add_edges(tail, head, forth, back)
    graph.add_grid_tedges(nodes, np.maximum(cost, 0), np.maximum(-cost, 0))
    graph.maxflow()
    return graph.get_grid_segments(nodes)


def fuse(
    labels: Labels, proposal: Labels, place: Places, change: Float64, weights: Float32
) -> Labels:
    """Take the proposed label at the best set of nodes: one minimum cut.

    Parameters
    ----------
    labels, proposal : (R, C) int32 ndarray
    place : (P,) int64 ndarray
        Where they differ, as places in the flat grid, in order.
    change : (P,) float64 ndarray
        D of the proposed label minus D of the present one.
    weights : (4, R, C) or (8, R, C) float32 ndarray

    Returns
    -------
    (R, C) int32 ndarray
    """
    if not len(place):
        return labels
    cost, tail, head, capacity = _fusion_graph(labels, proposal, place, change, weights)
    forth, back = _flow(cost, tail, head, capacity)
    now, new = labels.ravel()[place], proposal.ravel()[place]
    for upper in (now > new, np.zeros(len(cost), bool), np.ones(len(cost), bool)):
        if _most_gained(upper, cost, tail, head, forth, back) <= _NEGLIGIBLE * len(cost):
            break
    else:
        upper = _sink_side(cost, tail, head, forth, back)
    fused = labels.copy()
    fused.ravel()[place] = np.where(upper, np.maximum(now, new), np.minimum(now, new))
    return fused


@njit(cache=True, error_model="numpy", nogil=True)
def _most_gained(
    upper: Mask, cost: Float64, tail: Labels, head: Labels, forth: Float64, back: Float64
) -> float:
    """Return how far the cost of a cut is above all that any cut may cost less."""
    gain = 0.0
    for node in range(len(cost)):
        gain += max(cost[node], 0.0) if upper[node] else max(-cost[node], 0.0)
    for edge in range(len(tail)):
        if upper[tail[edge]] != upper[head[edge]]:
            gain += forth[edge] if upper[head[edge]] else back[edge]
    return gain


@njit(cache=True, error_model="numpy", nogil=True)
def _fusion_graph(
    labels: Labels, proposal: Labels, place: Places, change: Float64, weights: Float32
) -> tuple[Float64, Labels, Labels, Float32]:
    """Return unary costs and edges of the binary variables "the node has its larger label".

    |l - m| is a sum over thresholds: those between a node's two labels join it to a neighbour if
    they are between that one's two labels as well, and are unary costs if not.
    """
    rows, columns = labels.shape
    node = np.full((rows, columns), -1, np.int32)
    for here in range(len(place)):
        node[place[here] // columns, place[here] % columns] = here
    cost = np.zeros(len(place))
    beyond = len(weights) - HALF
    tail, head = np.empty(4 * len(place), np.int32), np.empty(4 * len(place), np.int32)
    capacity = np.empty(4 * len(place), np.float32)
    edges = 0
    for here in range(len(place)):
        i, j = place[here] // columns, place[here] % columns
        low, high = labels[i, j], proposal[i, j]
        if low < high:
            cost[here] += change[here]
        else:
            low, high = high, low
            cost[here] -= change[here]
        for k, (down, right) in enumerate(STEPS):
            y, x = i + down, j + right
            if y < rows and 0 <= x < columns:
                there = node[y, x]
                given = weights[k, i, j], weights[beyond + k, i, j]
                least = min(labels[y, x], proposal[y, x])
                most = max(labels[y, x], proposal[y, x])
                cost[here] += _outside(low, high, least, most, *given)
                if there >= 0:
                    cost[there] += _outside(least, most, low, high, *given)
                    bottom, top = max(low, least), min(high, most)
                    if top > bottom:
                        tail[edges], head[edges] = here, there
                        capacity[edges] = _weighted(bottom, top, *given)
                        edges += 1
            y, x = i - down, j - right
            if y >= 0 and 0 <= x < columns and node[y, x] < 0:
                beside = labels[y, x]
                given = weights[k, y, x], weights[beyond + k, y, x]
                cost[here] += _outside(low, high, beside, beside, *given)
    return cost, tail[:edges], head[:edges], capacity[:edges]


@njit(cache=True, error_model="numpy", nogil=True, forceinline=True)
def _weighted(low: int, high: int, weight: np.float32, beyond: np.float32) -> np.float32:
    """Add up the weights of the thresholds from one label to a higher one."""
    near = min(high, WIDE) - min(low, WIDE)
    return weight * near + beyond * (high - low - near)


@njit(cache=True, error_model="numpy", nogil=True, forceinline=True)
def _outside(
    low: int, high: int, least: int, most: int, weight: np.float32, beyond: np.float32
) -> np.float32:
    """Add up thresholds from low to high that are above most, less those below least."""
    above = _weighted(max(low, most), max(high, most), weight, beyond)
    return above - _weighted(min(low, least), min(high, least), weight, beyond)


@njit(cache=True, error_model="numpy", nogil=True)
def _flow(cost: Float64, tail: Labels, head: Labels, capacity: Float32) -> tuple[Float64, Float64]:
    """Send most of the flow by passing messages; return what is left of each edge, there and back.

    Some rounds of TRW-S: a node tells its neighbours the share of its own cost that they may
    have, to and fro. Any flow within the capacities leaves the same cut the least one, and the
    search for paths has less to do. Edges are sorted by tail, and a tail comes before its head.
    """
    count = len(tail)
    total = cost.astype(np.float32)
    sent, returned = np.zeros(count, np.float32), np.zeros(count, np.float32)
    for _ in range(_ROUNDS):
        for edge in range(count):
            limit = capacity[edge]
            message = _SHARE * total[tail[edge]] - returned[edge]
            message = min(max(message, -limit), limit)
            total[head[edge]] += message - sent[edge]
            sent[edge] = message
        for edge in range(count - 1, -1, -1):
            limit = capacity[edge]
            message = _SHARE * total[head[edge]] - sent[edge]
            message = min(max(message, -limit), limit)
            total[tail[edge]] += message - returned[edge]
            returned[edge] = message
    forth, back = np.empty(count), np.empty(count)
    for edge in range(count):
        flow = np.float32(0.5) * (sent[edge] - returned[edge])
        flow = min(max(flow, -capacity[edge]), capacity[edge])
        cost[head[edge]] += flow
        cost[tail[edge]] -= flow
        forth[edge], back[edge] = capacity[edge] - flow, capacity[edge] + flow
    return forth, back

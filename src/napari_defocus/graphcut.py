"""Labels of low energy on a grid of nodes, by moves that are minimum cuts.

The energy is (14): sum_x D_x(l_x) + sum_(x, v) w_xv |l_x - l_v|, over the 8 neighbours of each
node. Two kinds of moves change many labels at once, each the best of its kind:

- a range move finds the best labels within a range of labels at each node (Ishikawa's graph,
  one node for each threshold within the range); over all labels it is the exact optimum;
- a fusion offers every node one other label. It is a plain minimum cut if all offers are the
  same label (expansion), or lie nowhere above, or nowhere below, the present labels, because
  |a - b| is submodular.

They are applied from coarse to fine. This is the only file that knows PyMaxflow.
"""

from __future__ import annotations

from dataclasses import dataclass

import maxflow
import numpy as np
from numba import njit
from numpy.typing import NDArray

from napari_defocus.progress import Progress, silent, within

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]
Labels = NDArray[np.int32]

STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""From a node to the half of its 8 neighbours that comes after it: row and column steps."""

_STEP = "Choosing labels"
_COARSEST = 20
_RANGE = np.int32(6)
_RELAXATION = np.float32(0.4)
_LEAST_GAIN = 1e-6
_NEVER = 1e12
_NODES_A_STRIP = 16384


def minimize_energy(data: Float32, weights: Float32, progress: Progress = silent) -> Labels:
    """Find labels of low energy, from coarse to fine.

    Parameters
    ----------
    data : (R, C, L) float32 ndarray
        D, the cost of each label at each node.
    weights : (4, R, C) float32 ndarray
        w between a node and its neighbour at each of `STEPS`; 0 where there is none.
    progress : callable, optional

    Returns
    -------
    (R, C) int32 ndarray
    """
    levels = [(data, weights)]
    while max(levels[-1][0].shape[:2]) > _COARSEST:
        levels.append(_coarser(*levels[-1]))
    labels = solve_exactly(*levels[-1])
    for depth, (level_data, level_weights) in enumerate(reversed(levels[:-1]), 1):
        rows, columns = level_data.shape[:2]
        start = labels.repeat(2, 0).repeat(2, 1)[:rows, :columns]
        finest = depth == len(levels) - 1
        # Each level has four times the nodes of the one before it.
        report = within(progress, 0.25 ** (len(levels) - depth), 0.25 ** (len(levels) - 1 - depth))
        labels = _improve(start, level_data, level_weights, finest, report)
    progress(_STEP, 1.0)
    return labels


def solve_exactly(data: Float32, weights: Float32) -> Labels:
    """Find the labels of least energy by one cut: for few nodes, or few labels.

    Parameters and result are those of `minimize_energy`; the cut has R x C x (L - 1) nodes.
    """
    rows, columns, count = data.shape
    low = np.zeros(rows * columns, np.int32)
    high = low + np.int32(count - 1)
    edges = Edges.of_grid(weights)
    return best_in_range(low, high, data.reshape(-1, count), edges).reshape(rows, columns)


def _improve(
    start: Labels, data: Float32, weights: Float32, finest: bool, progress: Progress
) -> Labels:
    """Lower the energy of labels from a coarser level: expansions, then range moves.

    Small things appear as the grid gets finer, so that labels from all over are offered (those
    between are the range move's); on the finest grid, those that are present.
    """
    costs, edges = data.reshape(-1, data.shape[2]), Edges.of_grid(weights)
    labels = _better(start.ravel(), costs.argmin(axis=1).astype(np.int32), costs, edges)
    offers = np.unique(labels) if finest else range(0, data.shape[2], 3)
    for done, alpha in enumerate(offers):
        progress(_STEP, 0.7 * done / len(offers))
        labels = expand(labels, int(alpha), costs, edges)
    labels = labels.reshape(start.shape)
    rows, columns = data.shape[:2]
    height = max(1, _NODES_A_STRIP // columns)
    for top in range(0, rows, height):
        progress(_STEP, 0.7 + 0.3 * top / rows)
        _move_strip(labels, top, top + height, _RANGE, data, weights)
    return labels


def _better(first: Labels, second: Labels, data: Float32, edges: Edges) -> Labels:
    """Return the labels of less energy: where neighbours owe little, each node's own best."""
    energies = [labeling_energy(labels, data, edges) for labels in (first, second)]
    return first if energies[0] <= energies[1] else second


def _move_strip(
    labels: Labels, top: int, bottom: int, reach: np.int32, data: Float32, weights: Float32
) -> None:
    """Make the range move of some rows, in place; the rows beside them keep their labels."""
    around = slice(max(top - 1, 0), bottom + 1)
    present = labels[around]
    free = np.zeros((len(present), 1), bool)
    free[top - around.start : bottom - around.start] = True
    low = np.where(free, np.maximum(present - reach, 0), present)
    high = np.where(free, np.minimum(present + reach, data.shape[2] - 1), present)
    inner = weights[:, around].copy()
    inner[1:, -1] = 0
    costs = data[around].reshape(-1, data.shape[2])
    moved = best_in_range(
        low.ravel().astype(np.int32), high.ravel().astype(np.int32), costs, Edges.of_grid(inner)
    )
    labels[around] = moved.reshape(present.shape)


def expand_until_settled(data: Float32, weights: Float32, progress: Progress = silent) -> Labels:
    """Find labels by expansion moves over all labels alone, until none lowers the energy.

    The paper's way, from each node's best label; slower than `minimize_energy` and a reference
    for it. Parameters and result are the same.
    """
    count = data.shape[2]
    costs, edges = data.reshape(-1, count), Edges.of_grid(weights)
    labels = costs.argmin(axis=1).astype(np.int32)
    before, after = np.inf, labeling_energy(labels, costs, edges)
    left = 1.0  # of the bar: nobody knows how many rounds there will be
    while after < before - _LEAST_GAIN * abs(after):
        for alpha in range(count):
            progress(_STEP, 1 - left * (1 - 0.5 * alpha / count))
            labels = expand(labels, alpha, costs, edges)
        before, after = after, labeling_energy(labels, costs, edges)
        left /= 2
    return labels.reshape(data.shape[:2])


def expand(labels: Labels, alpha: int, data: Float32, edges: Edges) -> Labels:
    """Let the label alpha take the nodes that it should have: an expansion move."""
    change = data[:, alpha] - data[np.arange(len(labels)), labels]
    return fuse(labels, np.full_like(labels, alpha), change, edges)


def _coarser(data: Float32, weights: Float32) -> tuple[Float32, Float32]:
    """Join nodes two by two: costs add up, and so do the weights across the seams."""
    rows, columns = (-(-length // 2) for length in data.shape[:2])
    padded = np.zeros((2 * rows, 2 * columns, data.shape[2]), np.float32)
    padded[: data.shape[0], : data.shape[1]] = _relaxed(data, weights)
    joined = padded.reshape(rows, 2, columns, 2, -1).sum(axis=(1, 3))
    row_block, column_block = (np.arange(length) // 2 for length in data.shape[:2])
    return joined, _joined_weights(weights, row_block, column_block)


@njit(cache=True, nogil=True)
def _relaxed(data: Float32, weights: Float32) -> Float32:
    """Let each node leave the common label at the price of its own edges.

    Returns min_m D(m) + w |l - m|: joined nodes need not agree on one label, as they cannot
    where the blur is steep.
    """
    rows, columns, count = data.shape
    relaxed = data.copy()
    for i in range(rows):
        for j in range(columns):
            price = _RELAXATION * weights[:, i, j].sum()
            cost = relaxed[i, j]
            for label in range(1, count):
                cost[label] = min(cost[label], cost[label - 1] + price)
            for label in range(count - 2, -1, -1):
                cost[label] = min(cost[label], cost[label + 1] + price)
    return relaxed


@njit(cache=True, nogil=True)
def _joined_weights(
    weights: Float32, row_block: NDArray[np.int64], column_block: NDArray[np.int64]
) -> Float32:
    rows, columns = weights.shape[1:]
    joined = np.zeros((4, row_block[-1] + 1, column_block[-1] + 1), np.float32)
    for k, (down, right) in enumerate(STEPS):
        for i in range(rows - down):
            for j in range(max(0, -right), columns - max(0, right)):
                join_blocks(
                    joined,
                    row_block[i],
                    column_block[j],
                    row_block[i + down],
                    column_block[j + right],
                    weights[k, i, j],
                )
    return joined


@njit(cache=True, nogil=True, inline="always")
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


@dataclass(frozen=True)
class Edges:
    """Pairs of nodes whose labels should be alike.

    Attributes
    ----------
    first, second : (E,) int32 ndarray
        Numbers of the two nodes.
    weight : (E,) float32 ndarray
    """

    first: Labels
    second: Labels
    weight: Float32

    @classmethod
    def of_grid(cls, weights: Float32) -> Edges:
        """Return the pairs of a grid whose nodes are numbered row by row."""
        columns = weights.shape[2]
        k, i, j = np.nonzero(weights)
        first = i * columns + j
        step = np.array([down * columns + right for down, right in STEPS])
        return cls(first.astype(np.int32), (first + step[k]).astype(np.int32), weights[k, i, j])


def labeling_energy(labels: Labels, data: Float32, edges: Edges) -> float:
    """Evaluate (14) for labels (N,), costs (N, L) and pairs."""
    costs = data[np.arange(len(labels)), labels].sum(dtype=np.float64)
    jumps = np.abs(labels[edges.first] - labels[edges.second])
    return float(costs + np.sum(edges.weight * jumps, dtype=np.float64))


def best_in_range(low: Labels, high: Labels, data: Float32, edges: Edges) -> Labels:
    """Find the labels of least energy with low <= label <= high at every node: one minimum cut.

    Parameters
    ----------
    low, high : (N,) int32 ndarray
        Both ends included.
    data : (N, L) float32 ndarray
        D, the cost of each label at each node.
    edges : Edges

    Returns
    -------
    (N,) int32 ndarray
    """
    start = np.concatenate([[0], np.cumsum(high - low)])
    cost, *arcs = _threshold_graph(low, high, data, edges.first, edges.second, edges.weight, start)
    passed = _sink_side(cost, *arcs)
    total = np.concatenate([[0], np.cumsum(passed)])
    return (low + total[start[1:]] - total[start[:-1]]).astype(np.int32)


@njit(cache=True, nogil=True)
def _threshold_graph(
    low: Labels,
    high: Labels,
    data: Float32,
    first: Labels,
    second: Labels,
    weight: Float32,
    start: NDArray[np.int64],
) -> tuple[Float64, Labels, Labels, Float64, Float64]:
    """Return unary costs and arcs over the variables "the label of node i is above t".

    D telescopes into one unary cost a variable, w |l - m| into one pair a common threshold;
    thresholds that the other node cannot cross are unary costs too.
    """
    nodes = len(low)
    pairs = start[-1]
    for edge in range(len(first)):
        i, j = first[edge], second[edge]
        pairs += max(0, min(high[i], high[j]) - max(low[i], low[j]))
    cost = np.zeros(start[-1])
    tail, head = np.empty(pairs, np.int32), np.empty(pairs, np.int32)
    forth, back = np.empty(pairs), np.zeros(pairs)
    count = 0
    for i in range(nodes):
        for t in range(low[i], high[i]):
            variable = start[i] + t - low[i]
            cost[variable] += data[i, t + 1] - data[i, t]
            if t + 1 < high[i]:
                tail[count], head[count], forth[count] = variable, variable + 1, _NEVER
                count += 1
    for edge in range(len(first)):
        i, j, w = first[edge], second[edge], weight[edge]
        for t in range(low[i], high[i]):
            variable = start[i] + t - low[i]
            if low[j] <= t < high[j]:
                tail[count], head[count] = variable, start[j] + t - low[j]
                forth[count], back[count] = w, w
                count += 1
            else:
                cost[variable] += w if t >= high[j] else -w
        for t in range(low[j], high[j]):
            if not low[i] <= t < high[i]:
                cost[start[j] + t - low[j]] += w if t >= high[i] else -w
    return cost, tail[:count], head[:count], forth[:count], back[:count]


def _sink_side(
    cost: Float64, tail: Labels, head: Labels, forth: Float64, back: Float64
) -> NDArray[np.bool_]:
    """Cut a graph at the least cost and return which nodes are on the sink's side.

    `cost` is paid by each node on that side, `forth` by each arc from the source's side to it,
    `back` by each arc the other way.
    """
    graph = maxflow.GraphFloat(len(cost), len(tail))
    nodes = graph.add_nodes(len(cost))
    graph.add_edges(tail, head, forth, back)
    graph.add_grid_tedges(nodes, np.maximum(cost, 0), np.maximum(-cost, 0))
    graph.maxflow()
    return graph.get_grid_segments(nodes)


def fuse(labels: Labels, proposal: Labels, change: NDArray[np.floating], edges: Edges) -> Labels:
    """Take the proposed label at the best set of nodes: one minimum cut.

    Parameters
    ----------
    labels, proposal : (N,) int32 ndarray
        One constant, one common step, or ordered: see the module's text.
    change : (N,) ndarray
        D of the proposed label minus D of the present one.
    edges : Edges

    Returns
    -------
    (N,) int32 ndarray
    """
    cost, capacity = _cut_costs(labels, proposal, change, edges.first, edges.second, edges.weight)
    taken = _sink_side(cost, edges.first, edges.second, capacity, np.zeros_like(capacity))
    return np.where(taken, proposal, labels)


@njit(cache=True, nogil=True)
def _cut_costs(
    labels: Labels,
    proposal: Labels,
    change: NDArray[np.floating],
    first: Labels,
    second: Labels,
    weights: Float32,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return what each node's change costs alone, and the capacity of each edge.

    With 0 for keep and 1 for take, a pair's E(x, y) is E00 + (E10 - E00) x + (E11 - E10) y
    + (E01 + E10 - E00 - E11) (1 - x) y.
    """
    cost = change.astype(np.float64)
    capacity = np.empty(len(weights))
    for edge in range(len(weights)):
        i, j, weight = first[edge], second[edge], weights[edge]
        keep_keep = abs(labels[i] - labels[j])
        keep_take = abs(labels[i] - proposal[j])
        take_keep = abs(proposal[i] - labels[j])
        take_take = abs(proposal[i] - proposal[j])
        cost[i] += weight * (take_keep - keep_keep)
        cost[j] += weight * (take_take - take_keep)
        capacity[edge] = weight * (keep_take + take_keep - keep_keep - take_take)
    return cost, capacity

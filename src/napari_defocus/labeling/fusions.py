"""Fusions: each node keeps its label or takes another one that it is offered, by a minimum cut.

|a - b| is submodular in "the node has the larger of its two labels", so one cut of a graph of two
choices a node finds the best mixture, whatever is offered. Most of its flow is found by passing
messages before paths are looked for.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.compiled import compiled, compiled_inline
from napari_defocus.labeling.minimum_cuts import sink_side
from napari_defocus.labeling.multigrid import HALF, STEPS, WIDE

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]
Labels = NDArray[np.int32]
Mask = NDArray[np.bool_]
Places = NDArray[np.int64]

_ROUNDS = 10
"""Of message passing to and fro before a cut: speed only, the cut is the same."""

_GOES_ON = (0.5, 0.7, 1.0)
"""Shares that each edge takes of the costs that go on along it, by rounds: speed only. They save
three quarters of the time for paths; more rounds take longer than they save.
"""

_NEGLIGIBLE = 1e-4
"""If leaving all nodes as they are, or giving all one side, costs at most so much a node more than
the best cut, that is taken; a pixel with clear evidence has 360. Without texture, what message
passing leaves is rounding and takes long to cut.
"""

_SHARE = np.float32(0.25)
"""The share of a node's cost that each neighbour gets: a node has 4 edges on either side."""


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
    fused = labels.copy()
    fuse_in_place(fused, proposal, place, change, weights)
    return fused


def fuse_in_place(
    labels: Labels, proposal: Labels, place: Places, change: Float64, weights: Float32
) -> None:
    """Do what `fuse` does, and write it into the labels."""
    if not len(place):
        return
    cost, tail, head, capacity = _fusion_graph(labels, proposal, place, change, weights)
    forth, back = _flow(cost, tail, head, capacity)
    now, new = labels.take(place), proposal.take(place)
    upper = _nearly_best(now > new, cost, tail, head, forth, back)
    np.put(labels, place, np.where(upper == (new > now), new, now))


def _nearly_best(
    kept: Mask, cost: Float64, tail: Labels, head: Labels, forth: Float64, back: Float64
) -> Mask:
    """Return which nodes have their larger label in the best cut, or one that is as good."""
    none, all_of_them = np.zeros(len(cost), np.bool_), np.ones(len(cost), np.bool_)
    for pushed in range(2):
        if pushed:
            _push(cost, tail, head, forth, back)
        for side in (kept, none, all_of_them):
            if _most_gained(side, cost, tail, head, forth, back) <= _NEGLIGIBLE * len(cost):
                return side
    return sink_side(cost, tail, head, forth, back)


@compiled
def change_of(labels: Labels, proposal: Labels, place: Places, data: Float32) -> Float64:
    """Return D of the proposed label minus D of the present one, at some nodes."""
    columns = labels.shape[1]
    change = np.empty(len(place))
    for k in range(len(place)):
        i, j = place[k] // columns, place[k] % columns
        change[k] = data[i, j, proposal[i, j]] - data[i, j, labels[i, j]]
    return change


@compiled
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


@compiled
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
                        capacity[edges] = weighted(bottom, top, *given)
                        edges += 1
            y, x = i - down, j - right
            if y >= 0 and 0 <= x < columns and node[y, x] < 0:
                beside = labels[y, x]
                given = weights[k, y, x], weights[beyond + k, y, x]
                cost[here] += _outside(low, high, beside, beside, *given)
    return cost, tail[:edges], head[:edges], capacity[:edges]


@compiled_inline
def weighted(low: int, high: int, weight: np.float32, beyond: np.float32) -> np.float32:
    """Add up the weights of the thresholds from one label to a higher one."""
    near = min(high, WIDE) - min(low, WIDE)
    return weight * near + beyond * (high - low - near)


@compiled_inline
def _outside(
    low: int, high: int, least: int, most: int, weight: np.float32, beyond: np.float32
) -> np.float32:
    """Add up thresholds from low to high that are above most, less those below least."""
    above = weighted(max(low, most), max(high, most), weight, beyond)
    return above - weighted(min(low, least), min(high, least), weight, beyond)


@compiled
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


@compiled
def _push(cost: Float64, tail: Labels, head: Labels, forth: Float64, back: Float64) -> None:
    """Let costs go on along edges, to and fro, until they meet some of the other sign.

    Messages spread a cost over its surroundings. What is left of them has far to go, and paths that
    go so far, one by one, take long. This is a flow, too: the least cut stays.
    """
    count = len(tail)
    for share in _GOES_ON:
        for edge in range(count):
            flow = _going_on(cost[tail[edge]], cost[head[edge]], forth[edge], back[edge], share)
            cost[tail[edge]] -= flow
            cost[head[edge]] += flow
            forth[edge] -= flow
            back[edge] += flow
        for edge in range(count - 1, -1, -1):
            flow = _going_on(cost[head[edge]], cost[tail[edge]], back[edge], forth[edge], share)
            cost[head[edge]] -= flow
            cost[tail[edge]] += flow
            back[edge] -= flow
            forth[edge] += flow


@compiled_inline
def _going_on(cost: float, met: float, forth: float, back: float, share: float) -> float:
    """Return what goes from a node to the next: a share, or what it takes to make up for both."""
    if cost > 0:
        return min(min(cost, -met) if met < 0 else share * cost, forth)
    return -min(min(-cost, met) if met > 0 else -share * cost, back)

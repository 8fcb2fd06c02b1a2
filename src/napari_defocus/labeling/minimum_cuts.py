"""Minimum cuts of a graph, by paths from two trees that grow towards each other.

From the source and from the sink grows a tree of nodes that flow can still reach. Where they meet,
a path is found and filled; nodes that lose their parent by that look for another one in their tree
(Boykov, Kolmogorov, IEEE Trans. PAMI 26(9), 2004). When the trees cannot grow any more, the sink's
holds the fewest nodes that are on its side in any least cut. So the result does not depend on the
order of paths, but for rounding.

The kernel runs without the GIL, so that cuts of several parts of a grid run at once. One large
graph is cut by PyMaxflow, which has the same result, where it is installed: Python 3.14 has no
wheel of it. This is the only file that knows PyMaxflow.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.compiled import compiled, compiled_inline

try:
    import maxflow
except ModuleNotFoundError:
    maxflow = None

Float64 = NDArray[np.floating]
Mask = NDArray[np.bool_]
Numbers = NDArray[np.int32]
Arcs = tuple[Numbers, Numbers, Numbers, Float64]

_SOURCE, _SINK = 1, 2
"""Whose tree a node is in."""

_FREE, _ROOT, _ORPHAN = -1, -2, -3
"""Instead of the arc to a node's parent: it is in no tree; it hangs on the source or the sink
itself; it has lost its parent."""

_ENDLESS = 2**30


def sink_side_of_one(
    cost: Float64, tail: Numbers, head: Numbers, forth: Float64, back: Float64
) -> Mask:
    """Do what `sink_side` does for one large graph, by PyMaxflow if there is one."""
    if maxflow is None or not len(cost):
        return sink_side(cost, tail, head, forth, back)
    graph = maxflow.GraphFloat(len(cost), len(tail))
    nodes = graph.add_nodes(len(cost))
    graph.add_edges(tail, head, forth, back)
    graph.add_grid_tedges(nodes, np.maximum(cost, 0), np.maximum(-cost, 0))
    graph.maxflow()
    side: Mask = graph.get_grid_segments(nodes)
    return side


def sink_side(cost: Float64, tail: Numbers, head: Numbers, forth: Float64, back: Float64) -> Mask:
    """Cut a graph at the least cost and return which nodes are on the sink's side.

    Parameters
    ----------
    cost : (N,) float64 ndarray
        What each node costs on that side, which may be negative.
    tail, head : (E,) int32 ndarray
        The nodes of each edge.
    forth, back : (E,) float64 ndarray
        What it costs if only the head, or only the tail, is on the sink's side.

    Returns
    -------
    (N,) bool ndarray
    """
    excess = cost.copy()
    arcs = _arcs_of(len(cost), tail, head, forth, back)
    tree, parent = _filled(excess, arcs)
    side: Mask = (tree == _SINK) & (parent != _FREE)
    return side


@compiled
def _arcs_of(nodes: int, tail: Numbers, head: Numbers, forth: Float64, back: Float64) -> Arcs:
    """Return edges as arcs, there and back, sorted by the nodes that they leave.

    Those of node i are start[i] to start[i + 1]; each has the node that it leads to, its `sister`
    the other way, and the rest of its capacity.
    """
    start = np.zeros(nodes + 1, np.int32)
    for edge in range(len(tail)):
        start[tail[edge] + 1] += 1
        start[head[edge] + 1] += 1
    for node in range(nodes):
        start[node + 1] += start[node]
    place = start[:nodes].copy()
    to, sister = np.empty(2 * len(tail), np.int32), np.empty(2 * len(tail), np.int32)
    rest = np.empty(2 * len(tail))
    for edge in range(len(tail)):
        there, here = place[tail[edge]], place[head[edge]]
        place[tail[edge]] += 1
        place[head[edge]] += 1
        to[there], to[here] = head[edge], tail[edge]
        sister[there], sister[here] = here, there
        rest[there], rest[here] = forth[edge], back[edge]
    return start, to, sister, rest


@compiled
def _filled(excess: Float64, arcs: Arcs) -> tuple[NDArray[np.int8], Numbers]:
    """Fill paths until there are none; return each node's tree, and the arc to its parent.

    `excess` is what still flows from the source to a node, or from it to the sink if negative.
    `stamp` says when the distance to the root was last known to be right.
    """
    start, to, sister, rest = arcs
    nodes = len(excess)
    tree, parent = np.zeros(nodes, np.int8), np.full(nodes, _FREE, np.int32)
    stamp, distance = np.zeros(nodes, np.int32), np.zeros(nodes, np.int32)
    # Nodes that may grow wait in a ring; its first place and its length are in `waiting`.
    ring, orphans = np.empty(nodes, np.int32), np.empty(nodes, np.int32)
    waits, waiting = np.zeros(nodes, np.bool_), np.zeros(2, np.int32)
    for node in range(nodes):
        if excess[node] != 0:
            tree[node] = _SOURCE if excess[node] > 0 else _SINK
            parent[node], distance[node] = _ROOT, 1
            _wait(node, ring, waits, waiting)
    time = 0
    node = -1
    while waiting[1] > 0 or node >= 0:
        if node < 0:
            node = ring[waiting[0]]
            waiting[0] = (waiting[0] + 1) % nodes
            waiting[1] -= 1
            waits[node] = False
        middle = -1
        if parent[node] != _FREE:
            for arc in range(start[node], start[node + 1]):
                if _left(arc, tree[node], sister, rest) <= 0:
                    continue
                there = to[arc]
                if parent[there] == _FREE:
                    tree[there] = tree[node]
                    _wait(there, ring, waits, waiting)
                elif tree[there] != tree[node]:
                    middle = arc if tree[node] == _SOURCE else sister[arc]
                    break
                elif stamp[there] > stamp[node] or distance[there] <= distance[node]:
                    continue
                parent[there] = sister[arc]
                stamp[there], distance[there] = stamp[node], distance[node] + 1
        if middle < 0:
            node = -1
            continue
        time += 1
        lost = _fill(middle, excess, to, sister, rest, parent, orphans)
        _adopt(time, lost, orphans, arcs, tree, parent, stamp, distance, ring, waits, waiting)
    return tree, parent


@compiled_inline
def _left(arc: int, tree: int, sister: Numbers, rest: Float64) -> float:
    """Return what still flows along an arc: away from the source, or towards the sink."""
    return rest[arc] if tree == _SOURCE else rest[sister[arc]]


@compiled_inline
def _wait(node: int, ring: Numbers, waits: Mask, waiting: Numbers) -> None:
    if not waits[node]:
        waits[node] = True
        ring[(waiting[0] + waiting[1]) % len(ring)] = node
        waiting[1] += 1


@compiled_inline
def _fill(
    middle: int,
    excess: Float64,
    to: Numbers,
    sister: Numbers,
    rest: Float64,
    parent: Numbers,
    orphans: Numbers,
) -> int:
    """Send all that flows along a path over the arc between the trees; return how many orphans."""
    most = rest[middle]
    for from_sink in range(2):
        node = to[middle] if from_sink else to[sister[middle]]
        while parent[node] != _ROOT:
            arc = parent[node]
            most = min(most, rest[arc] if from_sink else rest[sister[arc]])
            node = to[arc]
        most = min(most, abs(excess[node]))
    rest[middle] -= most
    rest[sister[middle]] += most
    lost = 0
    for from_sink in range(2):
        node = to[middle] if from_sink else to[sister[middle]]
        while parent[node] != _ROOT:
            arc = parent[node]
            along = arc if from_sink else sister[arc]
            rest[along] -= most
            rest[sister[along]] += most
            if rest[along] == 0:
                parent[node] = _ORPHAN
                orphans[lost] = node
                lost += 1
            node = to[arc]
        excess[node] -= -most if from_sink else most
        if excess[node] == 0:
            parent[node] = _ORPHAN
            orphans[lost] = node
            lost += 1
    return lost


@compiled_inline
def _adopt(
    time: int,
    lost: int,
    orphans: Numbers,
    arcs: Arcs,
    tree: NDArray[np.int8],
    parent: Numbers,
    stamp: Numbers,
    distance: Numbers,
    ring: Numbers,
    waits: Mask,
    waiting: Numbers,
) -> None:
    """Find each orphan a parent near the root, or make orphans of its children."""
    start, to, sister, rest = arcs
    while lost > 0:
        lost -= 1
        node = orphans[lost]
        best, least = _FREE, _ENDLESS
        for arc in range(start[node], start[node + 1]):
            there = to[arc]
            known = tree[there] == tree[node] and parent[there] != _FREE
            if known and _left(sister[arc], tree[node], sister, rest) > 0:
                away = _distance_to_root(there, time, to, parent, stamp, distance)
                if away < least:
                    best, least = arc, away
        parent[node] = best
        if best != _FREE:
            stamp[node], distance[node] = time, least + 1
            continue
        for arc in range(start[node], start[node + 1]):
            there = to[arc]
            if tree[there] != tree[node] or parent[there] == _FREE:
                continue
            if _left(sister[arc], tree[node], sister, rest) > 0:
                _wait(there, ring, waits, waiting)
            if parent[there] >= 0 and to[parent[there]] == node:
                parent[there] = _ORPHAN
                orphans[lost] = there
                lost += 1


@compiled_inline
def _distance_to_root(
    node: int, time: int, to: Numbers, parent: Numbers, stamp: Numbers, distance: Numbers
) -> int:
    """Return how many arcs lead to the root, and note it on the way; endless below an orphan."""
    away, here = 0, node
    while stamp[here] != time:
        away += 1
        if parent[here] == _ROOT:
            stamp[here], distance[here] = time, 1
            away -= 1
            break
        if parent[here] == _ORPHAN:
            return _ENDLESS
        here = to[parent[here]]
    away += distance[here]
    left, here = away, node
    while stamp[here] != time:
        stamp[here], distance[here] = time, left
        left -= 1
        here = to[parent[here]]
    return away

"""From chosen candidates to routes: connected stretches of directed edges with one path coordinate."""

from heapq import heappop, heappush
from typing import Any

import numpy as np

from fleetlog.compiling import inner, kernel, outer
from fleetlog.core.arrays import Floats, Index, Mask
from fleetlog.roads.kernels.distances import path_between
from fleetlog.roads.kernels.records import Candidates, Choice, Roads, Routes, Store

LONGEST = 4096  # edges of a path between two groups at most
AHEAD = 0.5  # an end this much farther along the edge can be reached without a way round [m]
Graph = tuple[Index, Index, Floats, Floats, Mask, Floats, float]


def build_routes(
    store: Store, roads: Roads, near: Candidates, choice: Choice, moved: Floats, back: float
) -> Routes:
    """Pieces of all stretches, end to end."""
    groups = len(choice.chosen)
    capacity, n, stretches = groups + LONGEST, -1, 0
    path, firsts = np.empty(LONGEST, np.int32), np.empty(groups + 1, np.int64)
    spans, (of, piece) = np.empty((2, groups), np.int64), np.full((2, groups), -1)
    while n < 0:
        capacity *= 2
        edges, values = np.empty(capacity, np.int32), np.empty((3, capacity))
        room = Routes(edges, values, firsts, spans, of, piece, np.zeros(groups))
        n, stretches = _build(store, roads, near, choice, moved, back, path, room)
    firsts, spans = firsts[: stretches + 1], spans[:, :stretches].copy()
    return room._replace(edge=edges[:n].copy(), value=values[:, :n].copy(), firsts=firsts, spans=spans)


@outer
def _build(
    store: Store, roads: Roads, near: Candidates, choice: Choice, moved: Floats, back: float, path: Index,
    out: Routes,
) -> Any:  # fmt: skip
    """Fill ``out``; how many pieces and stretches there are, -1 pieces where there is no room for them."""
    chosen, linked, edge, value, length = choice.chosen, choice.linked, near.edge, near.value, roads.length
    p_edge, p_value, firsts, spans, of, piece, place = out
    groups = len(chosen)
    n = stretches = 0
    for g in range(groups):
        if chosen[g] < 0:
            continue
        e, s = edge[chosen[g]], value[0, chosen[g]]
        if n + len(path) + 8 > len(p_edge):
            return -1, 0
        fresh = not linked[g] or g == 0 or chosen[g - 1] < 0
        if not fresh:
            last, at = p_edge[n - 1], value[0, chosen[g - 1]]
            kind = _kind(store, roads, last, at, e, s, moved[g - 1], back)
            if kind == 2:  # a turn in mid edge
                turned = max(at, length[e] - s, p_value[0, n - 1])
                p_value[1, n - 1] = turned
                n = _append(p_edge, p_value, n, e, length[e] - turned, length[e])
            elif kind == 1:
                m = path_between(store, last, e, path)
                if m < 0:
                    fresh = True
                else:
                    for i in range(m):
                        n = _append(p_edge, p_value, n, path[i], 0.0, length[path[i]])
                    n = _append(p_edge, p_value, n, e, 0.0, length[e])
        if fresh:
            firsts[stretches] = n
            spans[0, stretches] = g
            stretches += 1
            p_edge[n], p_value[0, n], p_value[1, n], p_value[2, n] = e, 0.0, length[e], 0.0
            n += 1
        of[g] = stretches - 1
        spans[1, stretches - 1] = g
        piece[g] = n - 1
        place[g] = p_value[2, n - 1] + s - p_value[0, n - 1]
    firsts[stretches] = n
    return n, stretches


@inner
def _append(p_edge: Index, p_value: Floats, n: int, e: int, begin: float, end: float) -> Any:
    p_edge[n], p_value[0, n], p_value[1, n] = e, begin, end
    p_value[2, n] = p_value[2, n - 1] + p_value[1, n - 1] - p_value[0, n - 1]
    return n + 1


@inner
def _kind(store: Store, roads: Roads, a: int, s: float, b: int, t: float, moved: float, back: float) -> Any:
    """How one step goes, as the model priced it: 0 along its edge, 1 by a path, 2 by a turn in mid edge."""
    length = roads.length
    by_path = np.inf
    for q in range(store.begin[a], store.begin[a] + store.reached[a]):
        if store.target[q] == b:
            by_path = abs(store.away[q] + length[a] - s + t - moved)
            break
    if a == b and t - s >= -back and abs(t - s - moved) <= by_path:
        return 0
    if roads.reverse[a] == b and (by_path == np.inf or abs(abs(length[a] - s - t) - moved) + 1.0 < by_path):
        return 2
    return 1


@outer
def route_posterior(choice: Choice, near: Candidates, routes: Routes, out: Floats) -> None:
    """Posterior (G,) of the candidates on the previous, same and following piece of the route."""
    chosen, posterior, firsts = choice.chosen, choice.posterior, routes.firsts
    for g in range(len(chosen)):
        if chosen[g] < 0:
            continue
        p, s = routes.piece[g], routes.of[g]
        lo, hi = max(p - 1, firsts[s]), min(p + 2, firsts[s + 1])
        total = 0.0
        for c in range(near.ptr[g], near.ptr[g + 1]):
            for q in range(lo, hi):
                if routes.edge[q] == near.edge[c]:
                    total += posterior[c + g]
                    break
        out[g] = min(total, 1.0)


@kernel()
def astar(graph: Graph, source: np.int32, target: np.int32, most: float) -> tuple[Index, Floats]:
    """Cheapest chain of edges from ``source`` to ``target``; and the cost at each.  Empty if there is none,
    or none whose cost up to the target is below ``most``.  Among equal costs the predecessor with the lower
    number wins.

    The ``graph`` has ``next_first`` and ``next_edges``, the cost of driving all of an edge, that of the turn
    next_edges[k], closed edges, starts (E, 3), and cost per metre: times the straight line never more than
    the cost from start to start (consistent: the first arrival is the best)."""
    next_first, next_edges, cost, turn_cost, closed, starts, least = graph
    edges = len(cost)
    best = np.full(edges, np.inf)
    came = np.full(edges, -1, dtype=np.int32)
    done = np.zeros(edges, dtype=np.bool_)
    best[source] = 0.0
    end = starts[target]
    heap = [(0.0, source)]
    while len(heap) > 0:
        bound, i = heappop(heap)
        if bound >= most:
            break
        if done[i]:
            continue
        done[i] = True
        if i == target:
            break
        onward = best[i] + cost[i]
        for k in range(next_first[i], next_first[i + 1]):
            j = next_edges[k]
            if closed[j] or done[j]:
                continue
            there = onward + turn_cost[k]
            if there < best[j] or (there == best[j] and i < came[j]):
                best[j] = there
                came[j] = i
                x, y, z = starts[j, 0] - end[0], starts[j, 1] - end[1], starts[j, 2] - end[2]
                heappush(heap, (there + least * np.sqrt(x * x + y * y + z * z), j))
    if not done[target]:
        return np.empty(0, dtype=np.int32), np.empty(0, dtype=np.float64)
    chain = [target]
    while chain[-1] != source:
        chain.append(came[chain[-1]])
    edges_of = np.array(chain[::-1], dtype=np.int32)
    return edges_of, best[edges_of]


@kernel()
def quickest(
    graph: Graph, starts: Index, at: Floats, before: Floats, ends: Index, ends_at: Floats, after: Floats,
    most: float,
) -> Any:  # fmt: skip
    """The cheapest way from an offset ``at`` [m] of one of ``starts`` to offset ``ends_at`` of one of
    ``ends``: numbers of both, edges, cost; -1 if none costs less than ``most``.  ``before`` and ``after`` are
    what start and end add to the cost of all edges, both ends whole."""
    next_first, next_edges, cost = graph[:3]
    start, end, best = -1, -1, np.empty(0, np.int32)
    for i in range(len(starts)):
        for j in range(len(ends)):
            a, z = starts[i], ends[j]
            # Round the block where the end lies behind.
            behind = a == z and ends_at[j] <= at[i] + AHEAD
            over = before[i] + after[j] + cost[z] + (cost[a] if behind else 0.0)
            for first in next_edges[next_first[a] : next_first[a + 1]] if behind else starts[i : i + 1]:
                chain, entered = astar(graph, first, z, most - over)
                if len(chain) > 0:
                    start, end, most = i, j, entered[-1] + over
                    best = np.append(starts[i : i + 1], chain) if behind else chain
    return start, end, best, most

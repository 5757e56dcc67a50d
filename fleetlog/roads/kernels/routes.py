"""From chosen candidates to routes: connected stretches of directed edges with one path coordinate."""

from heapq import heappop, heappush
from typing import Any

import numpy as np

from fleetlog.compiling import inner, kernel, outer
from fleetlog.core.arrays import Floats, Index, Mask
from fleetlog.roads.kernels.distances import path_between
from fleetlog.roads.kernels.records import Candidates, Choice, Roads, Routes, Store, Wide

LONGEST = 4096  # edges of a path between two groups at most
BY_EDGE, BY_PATH, BY_TURN = 0, 1, 2
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
    given = store, roads, near.edge, near.offset, choice.chosen, choice.linked, moved, back, path
    while n < 0:
        capacity *= 2
        columns = np.empty(capacity, np.int32), *np.empty((3, capacity))
        room = Routes._make([*columns, firsts, spans, of, piece, np.zeros(groups)])
        n, stretches = _build(*given, room)
    firsts, spans = firsts[: stretches + 1], spans[:, :stretches].copy()
    return Routes._make([*(c[:n].copy() for c in columns), firsts, spans, of, piece, room.centre])


@outer
def _build(
    store: Store, roads: Roads, edge: Index, offset: Floats, chosen: Wide, linked: Mask, moved: Floats,
    back: float, path: Index, out: Routes,
) -> Any:  # fmt: skip
    """Fill ``out``; how many pieces and stretches there are, -1 pieces where there is no room for them."""
    length = roads.length
    n = stretches = 0
    at = 0.0
    for g in range(len(chosen)):
        if chosen[g] < 0:
            continue
        if n + len(path) + 8 > len(out.edge):
            return -1, 0
        e, s = edge[chosen[g]], offset[chosen[g]]
        m = -1
        if linked[g] and g > 0 and chosen[g - 1] >= 0:
            last = out.edge[n - 1]
            m = _kind(store, roads, last, at, e, s, moved[g - 1], back)
            if m == BY_TURN:
                at = max(max(at, length[e] - s), out.begin[n - 1])
                out.end[n - 1] = at
                n = _append(out, n, e, length[e] - at, length[e])
            elif m == BY_PATH:
                m = path_between(store, last, e, path)
                for i in range(m + 1):
                    f = path[i] if i < m else e
                    n = _append(out, n, f, 0.0, length[f])
        if m < 0:
            out.firsts[stretches], out.spans[0, stretches] = n, g
            stretches += 1
            out.edge[n], out.begin[n], out.end[n], out.place[n] = e, 0.0, length[e], 0.0
            n += 1
        out.of[g], out.piece[g], out.spans[1, stretches - 1] = stretches - 1, n - 1, g
        out.centre[g] = out.place[n - 1] + s - out.begin[n - 1]
        at = s
    out.firsts[stretches] = n
    return n, stretches


@inner
def _append(out: Routes, n: int, e: int, begin: float, end: float) -> Any:
    out.edge[n], out.begin[n], out.end[n] = e, begin, end
    out.place[n] = out.place[n - 1] + out.end[n - 1] - out.begin[n - 1]
    return n + 1


@inner
def _kind(store: Store, roads: Roads, a: int, s: float, b: int, t: float, moved: float, back: float) -> Any:
    """How one step goes, as the model priced it: along its edge, by a path, by a turn in mid edge."""
    length = roads.length
    by_path = np.inf
    for q in range(store.begin[a], store.begin[a] + store.reached[a]):
        if store.target[q] == b:
            by_path = abs(store.away[q] + length[a] - s + t - moved)
            break
    if a == b and t - s >= -back and abs(t - s - moved) <= by_path:
        return BY_EDGE
    if roads.reverse[a] == b and (by_path == np.inf or abs(abs(length[a] - s - t) - moved) + 1.0 < by_path):
        return BY_TURN
    return BY_PATH


def route_posterior(choice: Choice, near: Candidates, routes: Routes) -> Floats:
    """(G,) posterior of the candidates on the previous, same and following piece of the route."""
    size, piece = np.diff(near.ptr), routes.piece
    on, edge = np.zeros(len(near.edge), np.bool_), np.append(routes.edge, -1)
    for beside in (-1, 0, 1):
        other = np.clip(piece + beside, 0, len(routes.edge))
        apart = (routes.firsts[routes.of] > other) | (routes.firsts[routes.of + 1] <= other)
        on |= near.edge == np.repeat(np.where(apart, -1, edge[other]), size)
    group = np.repeat(np.arange(len(size)), size)[on]
    return np.minimum(np.bincount(group, choice.posterior[np.flatnonzero(on) + group], len(size)), 1.0)


@kernel()
def astar(graph: Graph, source: int, target: int, most: float) -> tuple[Index, Floats]:
    """Cheapest chain of edges from ``source`` to ``target``, and the cost at each.  Empty if none has a cost
    below ``most`` up to the target.  Among equal costs the predecessor with the lower number wins.

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
    heap: list[tuple[float, Any]] = [(0.0, source)]
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
            j = np.int64(next_edges[k])
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
    chain: list[Any] = [target]
    while chain[-1] != source:
        chain.append(np.int64(came[chain[-1]]))
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

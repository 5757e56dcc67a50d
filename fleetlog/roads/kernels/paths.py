"""Searches on directed edges, compiled.  Ties are broken by edge number, so one input has one answer."""

from heapq import heappop, heappush

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fleetlog.roads.kernels.distances import forget, search
from fleetlog.roads.kernels.growing import longer
from fleetlog.roads.kernels.records import Store

Floats = NDArray[np.float64]
Index = NDArray[np.int32]


@njit(cache=True)
def bounded(
    s: Store, next_first: Index, next_edges: Index, length: Floats, limit: float, sources: Index
) -> tuple[NDArray[np.int64], Index, Floats]:
    """CSR of the distances [m] from the start of each source to the starts of the edges within ``limit``.

    Row k holds the reached edges in the order of distance, then of edge number, the source itself first;
    ``s`` is an empty store.
    """
    first = np.zeros(len(sources) + 1, dtype=np.int64)
    edges, away = np.empty(0, dtype=np.int32), np.empty(0)
    end = 0
    for row in range(len(sources)):
        source, start = sources[row], first[row]
        rest = limit - length[source]
        count = 0
        if rest >= 0.0:
            count = search(
                source, rest, next_first, next_edges, length, s.best, s.before, s.heap_d, s.heap_e, s.found
            )
        if start + count + 1 > len(edges):
            edges, away = longer(edges, 2 * (start + count + 1)), longer(away, 2 * (start + count + 1))
        edges[start], away[start] = source, 0.0
        end = start + 1
        reached = np.sort(s.found[:count])
        for e in reached[np.argsort(s.best[reached], kind="mergesort")]:
            if e != source:
                edges[end], away[end] = e, length[source] + s.best[e]
                end += 1
        forget(source, count, next_first, next_edges, s.best, s.found)
        first[row + 1] = end
    return first, edges[:end].copy(), away[:end].copy()


@njit(cache=True)
def astar(
    next_first: Index, next_edges: Index, cost: Floats, turn_cost: Floats, closed: NDArray[np.bool_],
    bound: Floats, source: np.int32, target: np.int32,
) -> tuple[Index, Floats]:  # fmt: skip
    """Cheapest chain of edges from ``source`` to ``target``, empty if none; and the cost at each.

    ``cost[i]`` is that of driving all of edge i, ``turn_cost[k]`` that of the turn next_edges[k],
    ``bound[j]`` never more than the cost from the start of edge j to that of the target (consistent: the
    first arrival is the best).  Among equal costs the predecessor with the lower number wins.
    """
    edges = len(cost)
    best = np.full(edges, np.inf)
    came = np.full(edges, -1, dtype=np.int32)
    done = np.zeros(edges, dtype=np.bool_)
    best[source] = 0.0
    heap = [(bound[source], source)]
    while len(heap) > 0:
        _, i = heappop(heap)
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
                heappush(heap, (there + bound[j], j))
    if not done[target]:
        return np.empty(0, dtype=np.int32), np.empty(0, dtype=np.float64)
    chain = [target]
    while chain[-1] != source:
        chain.append(came[chain[-1]])
    edges_of = np.array(chain[::-1], dtype=np.int32)
    return edges_of, best[edges_of]

"""Label-setting searches on directed edges, compiled.
Ties are broken by edge number, so one input has one answer.
"""

from __future__ import annotations

from heapq import heappop, heappush

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Index = NDArray[np.int32]
Wide = NDArray[np.int64]


@njit(cache=True)
def bounded(
    next_first: Index, next_edges: Index, length: Floats, limit: float, sources: Index
) -> tuple[Wide, Index, Floats]:
    """CSR of the distances [m] from the start of each source to the starts of the edges within ``limit``.

    Dijkstra from every source in turn; the scratch arrays are cleared only where they were touched.  Row k
    holds the reached edges in the order of distance, then of edge number; the first is the source itself with
    0.
    """
    edges = len(length)
    best = np.full(edges, np.inf)
    done = np.zeros(edges, dtype=np.bool_)
    first = np.zeros(len(sources) + 1, dtype=np.int64)
    found = np.empty(max(16, 8 * len(sources)), dtype=np.int32)
    distance = np.empty(len(found), dtype=np.float64)
    touched = np.empty(edges, dtype=np.int32)
    count = 0
    for row in range(len(sources)):
        source = sources[row]
        best[source] = 0.0
        touched[0] = source
        marks = 1
        heap = [(0.0, source)]
        while len(heap) > 0:
            d, i = heappop(heap)
            if done[i]:
                continue
            done[i] = True
            if count == len(found):
                found, distance = _grown(found, distance)
            found[count] = i
            distance[count] = d
            count += 1
            onward = d + length[i]
            if onward > limit:
                continue
            for k in range(next_first[i], next_first[i + 1]):
                j = next_edges[k]
                if onward < best[j]:
                    if best[j] == np.inf:
                        touched[marks] = j
                        marks += 1
                    best[j] = onward
                    heappush(heap, (onward, j))
        for k in range(marks):
            best[touched[k]] = np.inf
            done[touched[k]] = False
        first[row + 1] = count
    return first, found[:count].copy(), distance[:count].copy()


@njit(cache=True)
def _grown(found: Index, distance: Floats) -> tuple[Index, Floats]:
    larger = np.empty(2 * len(found), dtype=np.int32)
    larger[: len(found)] = found
    longer = np.empty(2 * len(distance), dtype=np.float64)
    longer[: len(distance)] = distance
    return larger, longer


@njit(cache=True)
def astar(
    next_first: Index,
    next_edges: Index,
    cost: Floats,
    turn_cost: Floats,
    closed: NDArray[np.bool_],
    bound: Floats,
    source: np.int32,
    target: np.int32,
) -> tuple[Index, Floats]:
    """Cheapest chain of edges from ``source`` to ``target`` and the cost at which each is entered; empty if
    none.

    ``cost[i]`` is that of driving all of edge i, ``turn_cost[k]`` that of the turn next_edges[k],
    ``bound[j]`` never more than the cost from the start of edge j to the start of the target (consistent, so
    the first arrival is the best). Among equal costs the predecessor with the lower number wins.
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
    n = 1
    i = target
    while i != source:
        i = came[i]
        n += 1
    chain = np.empty(n, dtype=np.int32)
    i = target
    for k in range(n - 1, -1, -1):
        chain[k] = i
        if k > 0:
            i = came[i]
    return chain, best[chain]

"""Bounded network distances from the end of an edge, found when first asked for and kept."""

from typing import Any

import numpy as np

from fleetlog.compiling import inner, once
from fleetlog.core.arrays import Floats, Index
from fleetlog.roads.kernels.records import Roads, Store


@once
def _push(heap_d: Floats, heap_e: Index, size: int, d: float, e: int) -> Any:
    """Add edge ``e`` at distance ``d`` to a heap of ``size`` entries; returns its new size."""
    i = size
    while i > 0:
        up = (i - 1) >> 1
        if heap_d[up] <= d:
            break
        heap_d[i], heap_e[i] = heap_d[up], heap_e[up]
        i = up
    heap_d[i], heap_e[i] = d, e
    return size + 1


@once
def _pop(heap_d: Floats, heap_e: Index, size: int) -> Any:
    """Drop the top, which the caller has read; returns the new size."""
    size -= 1
    d, e = heap_d[size], heap_e[size]
    i = 0
    while True:
        child = 2 * i + 1
        if child >= size:
            break
        if child + 1 < size and heap_d[child + 1] < heap_d[child]:
            child += 1
        if heap_d[child] >= d:
            break
        heap_d[i], heap_e[i] = heap_d[child], heap_e[child]
        i = child
    heap_d[i], heap_e[i] = d, e
    return size


def new_store(edges: int, arcs: int) -> Store:
    """An empty store for a network of ``edges`` edges and ``arcs`` turns."""
    room = arcs + edges + 8
    return Store(
        np.full(edges, -1.0), np.zeros(edges, np.int64), np.zeros(edges, np.int64), np.empty(1024, np.int32),
        np.empty(1024, np.int32), np.empty(1024), np.zeros(1, np.int64), np.full(edges, np.inf),
        np.full(edges, -1, np.int32), np.empty(room), np.empty(room, np.int32), np.empty(edges + 1, np.int32),
    )  # fmt: skip


def roomier(store: Store) -> Store:
    """The store with twice the rows."""
    twice = {n: np.resize(getattr(store, n), 2 * len(store.target)) for n in ("target", "previous", "away")}
    return store._replace(**twice)


@inner
def ensure(store: Store, roads: Roads, source: int, bound: float) -> Any:
    """Store everything within ``bound`` of the end of ``source``; whether there was room for it.

    Dijkstra's algorithm over edges that start within ``bound``; ``best`` is infinite on entry and return."""
    if store.known[source] >= bound:
        return True
    onward, follow, best, before = roads.next_first, roads.next_edges, store.best, store.before
    found, heap_d, heap_e = store.found, store.heap_d, store.heap_e
    heap_d[0], heap_e[0], size, count = -roads.length[source], source, 1, 0
    while size > 0:
        e, d = heap_e[0], heap_d[0]
        size = _pop(heap_d, heap_e, size)
        if d > best[e]:
            continue
        found[count] = e
        count += 1
        through = d + roads.length[e]
        if through <= bound:
            for q in range(onward[e], onward[e + 1]):
                f = follow[q]
                if through < best[f]:
                    best[f], before[f] = through, e
                    size = _push(heap_d, heap_e, size, through, f)
    start = store.used[0]
    fits = start + count - 1 <= len(store.target)
    if fits:
        for i in range(1, count):
            f, at = found[i], start + i - 1
            store.target[at], store.previous[at], store.away[at] = f, before[f], best[f]
        store.known[source], store.begin[source], store.reached[source] = bound, start, count - 1
        store.used[0] = start + count - 1
    for i in range(count):  # what lies beyond the bound was touched too
        for q in range(onward[found[i]], onward[found[i] + 1]):
            best[follow[q]] = np.inf
    return fits


@inner
def path_between(store: Store, source: int, goal: int, path: Index) -> Any:
    """Edges between ``source``, whose reach is stored, and ``goal`` into ``path``; how many, or -1."""
    target, previous = store.target, store.previous
    a, b = store.begin[source], store.begin[source] + store.reached[source]
    m = 0
    at = goal
    while m < len(path):
        row = -1
        for i in range(a, b):
            if target[i] == at:
                row = i
                break
        if row < 0:
            return -1
        at = previous[row]
        if at == source:
            for i in range(m // 2):
                path[i], path[m - 1 - i] = path[m - 1 - i], path[i]
            return m
        path[m] = at
        m += 1
    return -1

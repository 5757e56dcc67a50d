"""Numba kernels of the density analysis."""

import numpy as np

from fleetlog.compiling import kernel
from fleetlog.core.arrays import Floats, Index, Ints
from fleetlog.roads.kernels.distances import forget, longer, search


@kernel()
def reachable(
    length: Floats, next_first: Index, next_edges: Index, limit: float
) -> tuple[Ints, Index, Floats, Index]:
    """Edges that start within ``limit`` metres of the end of each edge: CSR (first, edges, distances, skip).

    Bounded Dijkstra from the end of every edge on the line graph, so that turns that the network forbids,
    U-turns among them, are never implied.  The entries of an edge are its shortest-path tree in preorder; the
    ``skip[i]`` entries from i on are the subtree of entry i, itself included.
    """
    n = len(length)
    first = np.zeros(n + 1, np.int64)
    size, used = 16 * n + 16, 0
    edges, distances, skip = np.empty(size, np.int32), np.empty(size), np.empty(size, np.int32)
    best, before, place = np.full(n, np.inf), np.empty(n, np.int32), np.empty(n, np.int32)
    room = len(next_edges) + n + 8
    heap_d, heap_e = np.empty(room), np.empty(room, np.int32)
    found, away, parent = np.empty(n, np.int32), np.empty(n), np.empty(n, np.int32)
    for source in range(n):
        count = search(source, limit, next_first, next_edges, length, best, before, heap_d, heap_e, found)
        for i in range(count):
            e = found[i]
            # A way back through the source never is the shorter one: after it come only the edges that the
            # search began with.
            away[i], place[e] = best[e], i
            parent[i] = -1 if before[e] == source else place[before[e]]
        forget(source, count, next_first, next_edges, best, found)
        if used + count > size:
            size = 2 * (used + count)
            edges, distances, skip = longer(edges, size), longer(distances, size), longer(skip, size)
        _preorder(found, away, parent, count, edges, distances, skip, used)
        used += count
        first[source + 1] = used
    return first, edges[:used].copy(), distances[:used].copy(), skip[:used].copy()


@kernel()
def _preorder(
    tree_e: Index, tree_d: Floats, parent: Index, n: int, edges: Index, distances: Floats, skip: Index,
    at: int,
) -> None:  # fmt: skip
    """Write a tree, given with parents before children, in preorder from position ``at``."""
    below = np.ones(n, np.int32)
    for i in range(n - 1, -1, -1):
        if parent[i] >= 0:
            below[parent[i]] += below[i]
    cursor = np.empty(n, np.int64)
    top = at
    for i in range(n):
        if parent[i] >= 0:
            here = cursor[parent[i]]
            cursor[parent[i]] += below[i]
        else:
            here, top = top, top + below[i]
        cursor[i] = here + 1
        edges[here], distances[here], skip[here] = tree_e[i], tree_d[i], below[i]


@kernel()
def _root(parent: Index, i: int) -> int:
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@kernel()
def cluster_steps(
    edge: Index, offset: Floats, length: Floats, first: Ints, edges: Index, distances: Floats,
    skip: Index, limit: float,
) -> tuple[Index, Index, Ints]:  # fmt: skip
    """Weakly connected components of the arcs not longer than ``limit``, at every time step.

    Parameters
    ----------
    edge, offset : (T, V); edge -1 where a truck is absent or masked.
    first, edges, distances, skip : from :func:`reachable`.

    Returns
    -------
    labels : (T, V) the smallest truck index of the cluster; -1 absent.
    arcs : (A, 2) the arcs that join clusters (a spanning subset), truck to truck.
    arc_first : (T + 1,) arcs of step t are arcs[arc_first[t]:arc_first[t + 1]].

    Notes
    -----
    On one edge it is enough to join neighbours in order, and between edges the last truck of the one with the
    first of the other: any other pair within the limit is then joined through them, since distances along a
    way only add.  For the same reason nothing behind an occupied edge has to be looked at.
    """
    steps, trucks = edge.shape
    labels = np.full((steps, trucks), -1, np.int32)
    n = len(length)
    head, tail = np.full(n, -1, np.int32), np.full(n, -1, np.int32)
    after = np.empty(trucks, np.int32)
    parent = np.empty(trucks, np.int32)
    occupied = np.empty(trucks, np.int32)
    size, used = 4 * trucks + 16, 0
    arcs = np.empty((size, 2), np.int32)
    arc_first = np.zeros(steps + 1, np.int64)
    for t in range(steps):
        busy = 0
        for v in range(trucks):
            parent[v] = v
            e = edge[t, v]
            if e < 0:
                continue
            s = offset[t, v]
            if head[e] < 0:
                occupied[busy] = e
                busy += 1
                head[e], tail[e], after[v] = v, v, -1
            elif s < offset[t, head[e]]:
                after[v], head[e] = head[e], v
            else:
                p = head[e]
                while after[p] >= 0 and offset[t, after[p]] <= s:
                    p = after[p]
                after[v], after[p] = after[p], v
                if after[v] < 0:
                    tail[e] = v
        if used + 2 * trucks + busy * busy > size:
            size = 2 * (used + 2 * trucks + busy * busy)
            arcs = np.concatenate((arcs[:used], np.empty((size - used, 2), np.int32)))
        for b in range(busy):
            e = occupied[b]
            p = head[e]
            while after[p] >= 0:
                q = after[p]
                if offset[t, q] - offset[t, p] <= limit:
                    used = _join(parent, arcs, used, p, q)
                p = q
            k = tail[e]
            rest = limit - (length[e] - offset[t, k])
            if rest < 0.0:
                continue
            i = first[e]
            while i < first[e + 1]:
                m = head[edges[i]]
                near = distances[i] <= rest
                if near and m >= 0 and distances[i] + offset[t, m] <= rest:
                    used = _join(parent, arcs, used, k, m)
                i += 1 if near and m < 0 else skip[i]
        for v in range(trucks):
            if edge[t, v] >= 0:
                labels[t, v] = _root(parent, v)
        for b in range(busy):
            head[occupied[b]] = -1
        arc_first[t + 1] = used
    return labels, arcs[:used].copy(), arc_first


@kernel()
def _join(parent: Index, arcs: Index, used: int, a: int, b: int) -> int:
    ra, rb = _root(parent, a), _root(parent, b)
    if a != b:
        arcs[used, 0], arcs[used, 1] = a, b
        used += 1
    parent[max(ra, rb)] = min(ra, rb)
    return used

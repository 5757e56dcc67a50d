"""Numba kernels of the analyses: clusters of trucks along the roads, and the sums of a heat map."""

from typing import Any

import numpy as np

from fleetlog.compiling import kernel, outer
from fleetlog.core.arrays import Floats, Index, Ints, Mask
from fleetlog.core.network import Network
from fleetlog.roads.candidates import prepare
from fleetlog.roads.kernels.distances import ensure, new_store, roomier
from fleetlog.roads.kernels.records import Roads, Store


@outer
def _reach(store: Store, roads: Roads, most: float, begin: int) -> Any:
    """Store what lies within ``most`` [m] of edge ``begin`` and later ones; the first without room for it."""
    for source in range(begin, len(roads.length)):
        if not ensure(store, roads, source, most):
            return source
    return len(roads.length)


def reachable(network: Network, most: float) -> tuple[Ints, Ints, Index, Floats]:
    """The edges that start within ``most`` metres of the end of each edge, nearest first: of edge e those of
    the rows from begin[e] on, count[e] of them: (begin, count, edge, distance). Along turns that the network
    allows, so that forbidden ones, U-turns among them, are never implied."""
    at, roads, store = 0, prepare(network).roads, new_store(len(network), len(network.next_edges))
    while (at := _reach(store, roads, most, at)) < len(network):
        store = roomier(store)
    return store.begin, store.reached, store.target, store.away


@kernel()
def _root(parent: Index, i: int) -> int:
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@kernel()
def cluster_steps(
    edge: Index, offset: Floats, length: Floats, begin: Ints, count: Ints, edges: Index, distances: Floats,
    limit: float,
) -> tuple[Index, Index, Ints]:  # fmt: skip
    """Weakly connected components of the arcs not longer than ``limit``, at every time step.

    edge, offset : (T, V); edge -1 where a truck is absent or masked.
    begin, count, edges, distances : from :func:`reachable`.

    Returns labels (T, V), the smallest truck index of the cluster, -1 absent; arcs (A, 2), truck to truck,
    that hold each cluster together, as few as can be; of step t those from arc_first[t] to arc_first[t + 1].

    On one edge it is enough to join neighbours in order, and between edges the last truck of the one with
    the first of the other: any other pair within the limit is then joined through them, since distances
    along a way only add."""
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
        if used + trucks > size:
            size = 2 * (used + trucks)
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
            for i in range(begin[e], begin[e] + count[e]):
                if distances[i] > rest:
                    break
                m = head[edges[i]]
                if m >= 0 and distances[i] + offset[t, m] <= rest:
                    used = _join(parent, arcs, used, k, m)
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
    if ra != rb:
        arcs[used, 0], arcs[used, 1] = a, b
        used += 1
    parent[max(ra, rb)] = min(ra, rb)
    return used


@kernel()
def accumulate(
    x: Floats, y: Floats, time: Ints, speed: Floats, power: Floats, standing: float, use: Mask,
    x0: float, y0: float, cell: float, max_gap: float, out: Floats,
) -> None:  # fmt: skip
    """Add everything that a heat map shows to ``out`` (6, rows, columns).

    Layers: time [s], distance [m], energy [J], standing time [s], passages (times a truck came into the
    cell), and the part of the time in which the power was known [s].  Each interval between two rows is
    spread along the straight line between them in pieces no longer than half a cell, so that sparse sampling
    leaves no holes; energy takes the mean of both powers where both are known."""
    _, rows, columns = out.shape
    flat = out.reshape(6, rows * columns)
    last = -1
    for i in range(len(x) - 1):
        dt = (time[i + 1] - time[i]) * 1e-6
        dx, dy = x[i + 1] - x[i], y[i + 1] - y[i]
        length = np.hypot(dx, dy)
        if not (0.0 < dt <= max_gap and use[i] and length < 1e7):
            last = -1
            continue
        pieces = int(length / (0.5 * cell)) + 1
        part = dt / pieces
        v, w = 0.5 * (speed[i] + speed[i + 1]), 0.5 * (power[i] + power[i + 1])
        for k in range(pieces):
            f = (k + 0.5) / pieces
            c, r = (x[i] + f * dx - x0) / cell, (y[i] + f * dy - y0) / cell
            here = int(r) * columns + int(c) if 0.0 <= c < columns and 0.0 <= r < rows else -1
            came, last = here != last, here
            if here < 0:
                continue
            flat[0, here] += part
            if v == v:
                flat[1, here] += v * part
                if v < standing:
                    flat[3, here] += part
            if w == w:
                flat[2, here] += w * part
                flat[5, here] += part
            if came:
                flat[4, here] += 1.0

"""Numba kernels of the analyses: clusters of trucks along the roads, and the sums of a heat map."""

import math
from typing import Any

import numpy as np

from fleetlog.compiling import inner, kernel, outer
from fleetlog.core.arrays import Floats, Index, Ints, Mask
from fleetlog.core.network import Network
from fleetlog.roads.candidates import prepare
from fleetlog.roads.kernels.distances import ensure, new_store, roomier
from fleetlog.roads.kernels.records import Roads, Store


@outer
def _reach(store: Store, roads: Roads, most: float, begin: int) -> Any:
    """Store what lies within ``most`` [m] of edge ``begin`` and later ones; the first without room for it."""
    for source in range(begin, len(roads.length)):
        if not ensure(store, roads, np.int32(source), most):  # type: ignore[arg-type]  # as the matcher does
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
    the first of the other: these join any other pair within the limit, as distances along a way only add."""
    used, (steps, trucks) = 0, edge.shape
    labels = np.full((steps, trucks), -1, np.int32)
    head, tail = np.full((2, len(length)), -1, np.int32)
    after, parent, occupied = np.empty((3, trucks), np.int32)
    # An arc joins two clusters, so a step has fewer arcs than trucks.
    arcs, arc_first = np.empty((steps * trucks, 2), np.int32), np.zeros(steps + 1, np.int64)
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


@outer
def accumulate(
    x: Floats, y: Floats, time: Ints, speed: Floats, power: Floats, standing: float, use: Mask,
    x0: float, y0: float, cell: float, max_gap: float, columns: int, out: Floats,
) -> None:  # fmt: skip
    """Add everything that a heat map shows to ``out`` (cells, 6): cell c of row r is r times ``columns`` + c.

    Layers: time [s], distance [m], energy [J], standing time [s], passages (times a truck came into the
    cell), and the part of the time in which the power was known [s].  Each interval between two rows is
    spread along the straight line between them in pieces no longer than half a cell, so that sparse sampling
    leaves no holes; energy takes the mean of both powers where both are known.  Where both rows lie in one
    cell, so does all between them."""
    rows, per_metre = len(out) // columns, 1.0 / cell
    last, at = -1, _cell(x[0], y[0], x0, y0, per_metre, columns, rows) if len(x) else -1
    for i in range(len(x) - 1):
        dt = (time[i + 1] - time[i]) * 1e-6
        dx, dy = x[i + 1] - x[i], y[i + 1] - y[i]
        onto, pieces, length = _cell(x[i + 1], y[i + 1], x0, y0, per_metre, columns, rows), 1, 0.0
        if onto < 0 or onto != at:
            length = math.sqrt(dx * dx + dy * dy)
            pieces = int(length / (0.5 * cell)) + 1 if length < 1e7 else 0
        at = onto
        if not (0.0 < dt <= max_gap and pieces > 0):
            last = -1
            continue
        # The way is followed through rows that do not count: no truck comes anew where they end.
        spent, part, one = 0.0, dt / pieces if use[i] else 0.0, 1.0 / pieces
        v, w = 0.5 * (speed[i] + speed[i + 1]), 0.5 * (power[i] + power[i + 1])
        for k in range(pieces):
            f = (k + 0.5) * one
            here = _cell(x[i] + f * dx, y[i] + f * dy, x0, y0, per_metre, columns, rows)
            if here != last:
                _spend(out, last, spent, v, w, standing)
                spent, last = 0.0, here
                if here >= 0 and use[i]:
                    out[here, 4] += 1.0
            spent += part
        _spend(out, last, spent, v, w, standing)


@inner
def _cell(x: float, y: float, x0: float, y0: float, per_metre: float, columns: int, rows: int) -> int:
    """The number of the cell of a place, -1 outside."""
    c, r = (x - x0) * per_metre, (y - y0) * per_metre
    return int(r) * columns + int(c) if 0.0 <= c < columns and 0.0 <= r < rows else -1


@inner
def _spend(out: Floats, here: int, spent: float, v: float, w: float, standing: float) -> None:
    """Add a stay in a cell at speed ``v`` and power ``w``; either may be unknown."""
    if here < 0 or spent == 0.0:
        return
    out[here, 0] += spent
    if v == v:
        out[here, 1] += v * spent
        if v < standing:
            out[here, 3] += spent
    if w == w:
        out[here, 2] += w * spent
        out[here, 5] += spent

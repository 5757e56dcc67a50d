"""A network made ready for matching: segments in a grid, turns, and distances found so far."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from fleetlog.compiling import fast_inner, fast_outer
from fleetlog.core.arrays import Floats, Index
from fleetlog.core.network import Network
from fleetlog.roads.kernels.decoding import ensure_all
from fleetlog.roads.kernels.distances import new_store, roomier
from fleetlog.roads.kernels.records import Candidates, Grid, Groups, Lines, Roads, Store, Wide

MOST_CANDIDATES = 24  # of one position, the nearest: more never changed a decision on aisle grids


@dataclass
class Prepared:
    """What the loops need of a network; kept as long as the network lives, ``store`` grows with use."""

    roads: Roads
    lines: Lines
    grid: Grid
    store: Store

    def candidates(self, x: Floats, y: Floats, radius: float, margin: float) -> Candidates:
        """The edges within ``radius`` of every position, ``margin`` [m] behind the nearest at most."""
        n, room = len(x), 8 * len(x) + MOST_CANDIDATES
        columns = np.empty(room, np.int32), *np.empty((4, room))
        ptr, nearest = np.zeros(n + 1, np.int64), np.empty(MOST_CANDIDATES // 2, np.int64)
        feet = np.empty((2, len(nearest)))
        at = 0
        given = x, y, self.lines, self.roads.length, self.grid, radius, margin
        while (at := _find(*given, at, Candidates(ptr, *columns), nearest, *feet)) < n:
            columns = tuple(np.resize(c, 2 * len(c)) for c in columns)
        return Candidates(ptr, *(c[: ptr[-1]].copy() for c in columns))

    def reach(self, near: Candidates, groups: Groups, beta: float) -> None:
        """Find the distances that the steps between candidates need."""
        at = 0
        wanted = near.ptr, near.edge, groups.chain, groups.moved, beta
        while (at := ensure_all(self.store, self.roads, *wanted, at)) < len(groups.t):
            self.store = roomier(self.store)


def prepare(network: Network) -> Prepared:
    """The prepared form of ``network``, made once and kept with it, as a cached property is."""
    kept: dict[str, Prepared] = vars(network)
    if "_prepared" in kept:
        return kept["_prepared"]
    # equal alternatives are decided by the edges' names, so that the order of a map file means nothing
    rank = np.empty(len(network), np.int64)
    rank[np.argsort(np.array(network.edge_ids))] = np.arange(len(network))
    first = network.first.astype(np.int64)
    owner = np.repeat(np.arange(len(network), dtype=np.int32), np.diff(first))
    # the reverse of an edge where it is the very same line, else -1
    twin = np.full(len(network), -1, np.int32)
    for e, back in enumerate(network.reverse.tolist()):
        if back > e and np.array_equal(network.polyline(e), network.polyline(back)[::-1]):
            twin[e], twin[back] = back, e
    turns = network.reverse, network.next_first, network.next_edges
    reverse, onward, follow = (v.astype(np.int32) for v in turns)
    length = np.ascontiguousarray(network.length)
    roads = Roads(length, reverse, onward, follow, rank)
    x, y, along = (np.ascontiguousarray(v) for v in (*network.points[:, :2].T, network.distance))
    dx, dy, run = (np.diff(v, append=v[-1:]) for v in (x, y, along))
    flat = np.maximum(np.hypot(dx, dy), 1e-12)
    lines = Lines(first, owner, x, y, along, flat, dx / flat, dy / flat, np.maximum(run, 1e-12) / flat, twin)
    kept["_prepared"] = Prepared(roads, lines, _grid(lines, length), new_store(len(network), len(follow)))
    return kept["_prepared"]


def _grid(lines: Lines, length: Floats) -> Grid:
    """The segments of every cell that their bands cross, by first vertex; of twins only the first edge's."""
    k = np.flatnonzero(lines.owner[1:] == lines.owner[:-1])
    twin = lines.twin[lines.owner[k]]
    k = k[(twin < 0) | (twin >= lines.owner[k])]
    low, high = np.array([[v.min(), v.max()] for v in (lines.x, lines.y)]).T
    cell = float(np.clip(np.median(length), 5.0, 50.0))
    cell = max(cell, float(np.sqrt((high - low + 1.0).prod() / 2e6)))  # at most two million of them
    nx, ny = ((high - low) / cell).astype(int) + 1
    a, b = (np.column_stack([lines.x[n], lines.y[n]]) for n in (k, k + 1))
    first, last = (((v - low) / cell).astype(np.int64) for v in (np.minimum(a, b), np.maximum(a, b)))
    wide, tall = (last - first + 1).T
    found = []
    # by millions of cells, so that a map of long lines takes time and not memory
    for some in np.split(np.arange(len(k)), np.flatnonzero(np.diff(np.cumsum(wide * tall) // 1_000_000)) + 1):
        count = (wide * tall)[some]
        which = np.repeat(some, count)
        nth = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
        at = first[which] + np.column_stack([nth // tall[which], nth % tall[which]])
        to_cell, along = low + (at + 0.5) * cell - a[which], (b - a)[which]
        # the cell's half diagonal is 0.707
        aside = np.abs(to_cell[:, 0] * along[:, 1] - to_cell[:, 1] * along[:, 0])
        crossed = aside <= 0.75 * cell * np.hypot(*along.T)
        found.append((at[crossed] @ [ny, 1], which[crossed]))
    of, which = (np.concatenate(f) for f in zip(*found, strict=True))
    order = np.argsort(of, kind="stable")
    starts = np.searchsorted(of[order], np.arange(nx * ny + 1))
    return Grid(float(low[0]), float(low[1]), cell, int(nx), int(ny), starts, k[which[order]])


@fast_outer
def _find(
    x: Floats, y: Floats, lines: Lines, length: Floats, grid: Grid, radius: float, margin: float, begin: int,
    out: Candidates, nearest: Wide, square: Floats, ahead: Floats,
) -> Any:  # fmt: skip
    """Edges within ``radius`` and not more than ``margin`` farther than the nearest, into ``out``.

    One candidate an edge: its nearest point; beyond an end the lateral distance is the whole one.  Begins at
    position ``begin`` and returns where it ended: at the first for which ``out`` has no room, or after the
    last.  ``nearest``, ``square`` and ``ahead`` (K,) are the K nearest lines of one position, the squares of
    their distances, and how far along them the foot lies."""
    total = out.ptr[begin]
    for p in range(begin, len(x)):
        if total + 2 * len(nearest) > len(out.edge):
            return p
        m = 0
        best = cut = radius * radius
        east, north = x[p] - grid.x0, y[p] - grid.y0
        i1 = min(int((east + radius) / grid.cell), grid.nx - 1)
        j1 = min(int((north + radius) / grid.cell), grid.ny - 1)
        for i in range(int(max((east - radius) / grid.cell, 0.0)), i1 + 1):
            for j in range(int(max((north - radius) / grid.cell, 0.0)), j1 + 1):
                cell = i * grid.ny + j
                for q in range(grid.starts[cell], grid.starts[cell + 1]):
                    k = grid.items[q]
                    dx, dy = x[p] - lines.x[k], y[p] - lines.y[k]
                    foot = min(max(dx * lines.ux[k] + dy * lines.uy[k], 0.0), lines.flat[k])
                    dx, dy = dx - foot * lines.ux[k], dy - foot * lines.uy[k]
                    d2 = dx * dx + dy * dy
                    if d2 > cut:
                        continue
                    if d2 < best:
                        best = d2
                        cut = min((math.sqrt(best) + margin) ** 2, radius * radius)
                    at = _room(nearest, square, m, k, d2, lines.owner)
                    if at >= 0:
                        nearest[at], square[at], ahead[at] = k, d2, foot
                        m = max(m, at + 1)
        for c in range(m):
            if square[c] > cut:
                continue
            k = nearest[c]
            e, ux, uy = lines.owner[k], lines.ux[k], lines.uy[k]
            offset, aside = lines.along[k] + ahead[c] * lines.stretch[k], math.sqrt(square[c])
            if ux * (y[p] - lines.y[k]) < uy * (x[p] - lines.x[k]):
                aside = -aside
            for _ in range(2):
                out.edge[total], out.offset[total], out.lateral[total] = e, offset, aside
                out.ux[total], out.uy[total] = ux, uy
                total += 1
                offset, aside, ux, uy = length[e] - offset, -aside, -ux, -uy
                e = lines.twin[e]
                if e < 0:
                    break
        out.ptr[p + 1] = total
    return len(x)


@fast_inner
def _room(nearest: Wide, square: Floats, m: int, k: int, d2: float, owner: Index) -> Any:
    """Where a foot is entered among ``m``, or -1: of an edge the nearest stays, of many the farthest goes."""
    at = -1
    for c in range(m):
        if owner[nearest[c]] == owner[k]:
            return c if d2 < square[c] else -1
        if at < 0 or square[c] > square[at]:
            at = c
    return m if m < len(nearest) else at if d2 < square[at] else -1

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
from fleetlog.roads.kernels.records import Candidates, Grid, Groups, Roads, Store, Wide

MOST_CANDIDATES = 24  # of one position, the nearest: more never changed a decision on aisle grids


@dataclass
class Prepared:
    """What the loops need of a network; kept as long as the network lives, ``store`` grows with use."""

    roads: Roads
    grid: Grid
    store: Store

    def candidates(self, x: Floats, y: Floats, radius: float, margin: float) -> Candidates:
        """The edges within ``radius`` of every position, ``margin`` [m] behind the nearest at most."""
        n, room = len(x), 8 * len(x) + MOST_CANDIDATES
        found = Candidates(np.zeros(n + 1, np.int64), np.empty(room, np.int32), np.empty((4, room)))
        lines = np.empty(MOST_CANDIDATES // 2, np.int64), np.empty((2, MOST_CANDIDATES // 2))
        at = 0
        while (at := _find(x, y, self.roads, self.grid, radius, margin, at, found, *lines)) < n:
            wider = np.concatenate([found.value, np.empty_like(found.value)], axis=1)
            found = Candidates(found.ptr, np.resize(found.edge, 2 * len(found.edge)), wider)
        total = found.ptr[-1]
        return Candidates(found.ptr, found.edge[:total].copy(), found.value[:, :total].copy())

    def reach(self, near: Candidates, groups: Groups, beta: float) -> None:
        """Find the distances that the steps between candidates need."""
        at = 0
        while (at := ensure_all(self.store, self.roads, near, groups, beta, at)) < len(groups.t):
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
    lines = *network.points[:, :2].T, network.distance, network.length
    x, y, away, length = (np.ascontiguousarray(v) for v in lines)
    # the reverse of an edge where it is the very same line, else -1
    twin = np.full(len(network), -1, np.int32)
    for e, back in enumerate(network.reverse.tolist()):
        if back > e and np.array_equal(network.polyline(e), network.polyline(back)[::-1]):
            twin[e], twin[back] = back, e
    turns = network.reverse, network.next_first, network.next_edges
    reverse, onward, follow = (v.astype(np.int32) for v in turns)
    roads = Roads(x, y, first, away, owner, length, reverse, twin, onward, follow, rank)
    kept["_prepared"] = Prepared(roads, _grid(roads), new_store(len(network), len(follow)))
    return kept["_prepared"]


def _grid(roads: Roads) -> Grid:
    """The segments of every cell that their bands cross, by first vertex; of twins only the first edge's.
    Cells are 5 to 50 m wide, and at most two million."""
    k = np.flatnonzero(roads.owner[1:] == roads.owner[:-1])
    twin = roads.twin[roads.owner[k]]
    k = k[(twin < 0) | (twin >= roads.owner[k])]
    low, high = np.array([[v.min(), v.max()] for v in (roads.px, roads.py)]).T
    cell = float(np.clip(np.median(roads.length), 5.0, 50.0))
    cell = max(cell, float(np.sqrt((high - low + 1.0).prod() / 2e6)))
    nx, ny = ((high - low) / cell).astype(int) + 1
    a, b = (np.column_stack([roads.px[n], roads.py[n]]) for n in (k, k + 1))
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


@fast_inner
def _project(px: Floats, py: Floats, k: int, x: float, y: float) -> Any:
    """Foot of (x, y) on segment k: squared distance, and the share of the segment passed."""
    ax, ay = px[k], py[k]
    dx, dy = px[k + 1] - ax, py[k + 1] - ay
    along, square = (x - ax) * dx + (y - ay) * dy, dx * dx + dy * dy
    share = 0.0 if along <= 0.0 else (1.0 if along >= square else along / square)
    ex, ey = x - ax - share * dx, y - ay - share * dy
    return ex * ex + ey * ey, share


@fast_outer
def _find(
    x: Floats, y: Floats, roads: Roads, grid: Grid, radius: float, margin: float, begin: int,
    out: Candidates, near_k: Wide, near: Floats,
) -> Any:  # fmt: skip
    """Edges within ``radius`` and not more than ``margin`` farther than the nearest, into ``out``.

    One candidate an edge: its nearest point; beyond an end the lateral distance is the whole one.  Begins at
    position ``begin`` and returns where it ended: at the first for which ``out`` has no room, or after the
    last.  ``near_k`` (K,) and ``near`` (2, K) are for the K nearest lines of one position."""
    px, py, dist = roads.px, roads.py, roads.dist
    ptr, edge, value = out
    total = ptr[begin]
    for p in range(begin, len(x)):
        if total + 2 * len(near_k) > len(edge):
            return p
        m = 0
        best = cut = radius * radius
        i0 = max(int(np.floor((x[p] - radius - grid.x0) / grid.cell)), 0)
        i1 = min(int(np.floor((x[p] + radius - grid.x0) / grid.cell)), grid.nx - 1)
        j0 = max(int(np.floor((y[p] - radius - grid.y0) / grid.cell)), 0)
        j1 = min(int(np.floor((y[p] + radius - grid.y0) / grid.cell)), grid.ny - 1)
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                for q in range(grid.starts[i * grid.ny + j], grid.starts[i * grid.ny + j + 1]):
                    k = grid.items[q]
                    d2, share = _project(px, py, k, x[p], y[p])
                    if d2 > cut:
                        continue
                    if d2 < best:
                        best = d2
                        cut = min((math.sqrt(best) + margin) ** 2, radius * radius)
                    m = _keep(near_k, near, m, k, d2, share, roads.owner)
        for c in range(m):
            if near[0, c] > cut:
                continue
            k, e = near_k[c], roads.owner[near_k[c]]
            dx, dy = px[k + 1] - px[k], py[k + 1] - py[k]
            scale = 1.0 / max(math.sqrt(dx * dx + dy * dy), 1e-12)
            left = dx * (y[p] - py[k]) - dy * (x[p] - px[k]) >= 0.0
            offset = dist[k] + near[1, c] * (dist[k + 1] - dist[k])
            aside = math.sqrt(near[0, c]) if left else -math.sqrt(near[0, c])
            edge[total], value[0, total], value[1, total] = e, offset, aside
            value[2, total], value[3, total] = dx * scale, dy * scale
            total += 1
            if roads.twin[e] >= 0:
                edge[total], value[0, total] = roads.twin[e], roads.length[e] - offset
                value[1, total] = -aside
                value[2, total], value[3, total] = -dx * scale, -dy * scale
                total += 1
        ptr[p + 1] = total
    return len(x)


@fast_inner
def _keep(near_k: Wide, near: Floats, m: int, k: int, d2: float, share: float, owner: Index) -> Any:
    """Enter a foot of one position: of an edge the nearest stays, of too many edges the farthest goes."""
    at = -1
    for c in range(m):
        if owner[near_k[c]] == owner[k]:
            at = c
            if d2 >= near[0, c]:
                return m
            break
    if at < 0:
        if m < len(near_k):
            at = m
            m += 1
        else:
            at = 0
            for c in range(1, m):
                if near[0, c] > near[0, at]:
                    at = c
            if near[0, at] <= d2:
                return m
    near_k[at], near[0, at], near[1, at] = k, d2, share
    return m

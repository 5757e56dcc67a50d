"""A network made ready for matching: segments in a grid, turns, and distances found so far."""

import weakref
from dataclasses import dataclass

import numpy as np

from fleetlog.core.network import Floats, Network
from fleetlog.roads.kernels.candidates import find_candidates
from fleetlog.roads.kernels.decoding import ensure_all
from fleetlog.roads.kernels.distances import new_store, roomier
from fleetlog.roads.kernels.records import Candidates, Grid, Groups, Roads, Store

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
        while (at := find_candidates(x, y, self.roads, self.grid, radius, margin, at, found, *lines)) < n:
            wider = np.concatenate([found.value, np.empty_like(found.value)], axis=1)
            found = Candidates(found.ptr, np.resize(found.edge, 2 * len(found.edge)), wider)
        total = found.ptr[-1]
        return Candidates(found.ptr, found.edge[:total].copy(), found.value[:, :total].copy())

    def reach(self, near: Candidates, groups: Groups, beta: float) -> None:
        """Find the distances that the steps between candidates need."""
        at = 0
        while (at := ensure_all(self.store, self.roads, near, groups, beta, at)) < len(groups.t):
            self.store = roomier(self.store)


_PREPARED: dict[int, tuple[weakref.ref[Network], Prepared]] = {}


def prepare(network: Network) -> Prepared:
    """The prepared form of ``network``, made once."""
    key = id(network)
    held = _PREPARED.get(key)
    if held is not None and held[0]() is network:
        return held[1]
    prepared = _prepare(network)
    _PREPARED[key] = (weakref.ref(network, lambda _: _PREPARED.pop(key, None)), prepared)
    return prepared


def _prepare(network: Network) -> Prepared:
    # equal alternatives are decided by the edges' names, so that the order of a map file means nothing
    rank = np.empty(len(network), np.int64)
    rank[np.argsort(np.array(network.edge_ids))] = np.arange(len(network))
    first = network.first.astype(np.int64)
    owner = np.repeat(np.arange(len(network), dtype=np.int32), np.diff(first))
    x, y, away, length = (
        np.ascontiguousarray(v)
        for v in (network.points[:, 0], network.points[:, 1], network.distance, network.length)
    )
    # the reverse of an edge where it is the very same line, else -1
    twin = np.full(len(network), -1, np.int32)
    for e, back in enumerate(network.reverse.tolist()):
        if back > e and np.array_equal(network.polyline(e), network.polyline(back)[::-1]):
            twin[e], twin[back] = back, e
    reverse, onward, follow = (
        v.astype(np.int32) for v in (network.reverse, network.next_first, network.next_edges)
    )
    roads = Roads(x, y, first, away, owner, length, reverse, twin, onward, follow, rank)
    return Prepared(roads, _grid(roads), new_store(len(network), len(follow)))


def _grid(roads: Roads) -> Grid:
    """The segments of every cell that their bands cross, by first vertex; of twins only the first edge's.

    Cells are 5 to 50 m wide, and at most two million.
    """
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

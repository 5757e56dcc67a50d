"""A network made ready for matching: segments in a grid, turns, and distances found so far."""

import weakref
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.network import Network
from fleetlog.roads.kernels.records import Candidates, Grid, Roads, Steps, Store

Floats = NDArray[np.float64]

MOST_CANDIDATES = 24
"""Candidates kept for one position, nearest first: more never changed a decision on aisle grids."""


@dataclass
class Prepared:
    """What the loops need of a network; kept as long as the network lives, ``store`` grows with use."""

    roads: Roads
    grid: Grid
    store: Store

    def candidates(self, x: Floats, y: Floats, radius: float, margin: float) -> Candidates:
        """The edges within ``radius`` of every position, ``margin`` [m] behind the nearest at most."""
        from fleetlog.roads.kernels.candidates import find_candidates

        n, room = len(x), 8 * len(x) + MOST_CANDIDATES
        found = Candidates(np.zeros(n + 1, np.int64), np.empty(room, np.int32), np.empty((4, room)))
        lines = np.empty(MOST_CANDIDATES // 2, np.int64), np.empty((2, MOST_CANDIDATES // 2))
        at = 0
        while (at := find_candidates(x, y, self.roads, self.grid, radius, margin, at, found, *lines)) < n:
            wider = np.concatenate([found.value, np.empty_like(found.value)], axis=1)
            found = Candidates(found.ptr, np.resize(found.edge, 2 * len(found.edge)), wider)
        total = found.ptr[-1]
        return Candidates(found.ptr, found.edge[:total].copy(), found.value[:, :total].copy())

    def reach(self, near: Candidates, steps: Steps, beta: float) -> None:
        """Find the distances that the steps between candidates need."""
        from fleetlog.roads.kernels.decoding import ensure_all
        from fleetlog.roads.kernels.distances import roomier

        at = 0
        while (at := ensure_all(self.store, self.roads, near, steps, beta, at)) < len(steps.chain):
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
    from fleetlog.roads.kernels.candidates import build_grid
    from fleetlog.roads.kernels.distances import new_store

    # equal alternatives are decided by the edges' names, so that the order of a map file means nothing
    rank = np.empty(len(network), np.int64)
    rank[np.argsort(np.array(network.edge_ids))] = np.arange(len(network))
    first = network.first.astype(np.int64)
    owner = np.repeat(np.arange(len(network), dtype=np.int32), np.diff(first))
    x, y, away, length = (
        np.ascontiguousarray(v)
        for v in (network.points[:, 0], network.points[:, 1], network.distance, network.length)
    )
    reverse, onward, follow = (
        v.astype(np.int32) for v in (network.reverse, network.next_first, network.next_edges)
    )
    roads = Roads(x, y, first, away, owner, length, reverse, _twins(network), onward, follow, rank)
    return Prepared(roads, build_grid(roads, _frame_of(network)), new_store(len(network), len(follow)))


def _frame_of(network: Network) -> tuple[float, float, float, int, int]:
    """Origin, cell size and cell counts: cells of 5 to 50 m, at most two million of them."""
    xmin, ymin, xmax, ymax = network.extent
    cell = float(np.clip(np.median(network.length), 5.0, 50.0))
    cell = max(cell, float(np.sqrt((xmax - xmin + 1.0) * (ymax - ymin + 1.0) / 2e6)))
    return xmin, ymin, cell, int((xmax - xmin) / cell) + 1, int((ymax - ymin) / cell) + 1


def _twins(network: Network) -> NDArray[np.int32]:
    """(E,) the reverse of an edge where it is the very same line, else -1."""
    twin = np.full(len(network), -1, np.int32)
    for e, back in enumerate(network.reverse.tolist()):
        if back > e and np.array_equal(network.polyline(e), network.polyline(back)[::-1]):
            twin[e], twin[back] = back, e
    return twin

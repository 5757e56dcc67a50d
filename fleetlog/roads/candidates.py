"""A network made ready for matching: segments in a grid, turns, and distances found so far."""

from __future__ import annotations

import weakref
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.network import Network

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

MOST_CANDIDATES = 24
"""Candidates kept for one position, nearest first:
more never changed a decision on the aisle grids that were tried.
"""


@dataclass
class Prepared:
    """What the loops need of a network; kept as long as the network lives, ``store`` grows with use."""

    px: Floats
    py: Floats
    first: Ints
    dist: Floats
    owner: NDArray[np.int32]
    twin: NDArray[np.int32]
    grid: tuple[float, float, float, int, int]
    starts: Ints
    items: Ints
    rank: Ints
    length: Floats
    reverse: NDArray[np.int32]
    next_first: NDArray[np.int32]
    next_edges: NDArray[np.int32]
    store: Any

    def candidates(
        self, x: Floats, y: Floats, radius: float, margin: float
    ) -> tuple[Ints, NDArray[np.int32], Floats]:
        """CSR of the edges near every position:
        starts (N + 1,), edges (C,), and (4, C) offset, lateral distance, tangent.
        """
        from fleetlog.roads.matchkernels.kernels.candidates import find_candidates

        found: tuple[Ints, NDArray[np.int32], Floats] = find_candidates(
            x, y, self.px, self.py, self.dist, self.length, self.owner, self.twin, self.grid, self.starts,
            self.items, radius, margin, MOST_CANDIDATES,
        )  # fmt: skip
        return found


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
    from fleetlog.roads.matchkernels.kernels.candidates import build_grid
    from fleetlog.roads.matchkernels.kernels.distances import new_store

    px, py = np.ascontiguousarray(network.points[:, 0]), np.ascontiguousarray(network.points[:, 1])
    first = network.first.astype(np.int64)
    grid = _grid_of(network, px, py)
    twin = _twins(network)
    starts, items = build_grid(px, py, first, twin, *grid)
    # equal alternatives are decided by the edges' names, so that the order of a map file means nothing
    rank = np.empty(len(network), np.int64)
    rank[np.argsort(np.array(network.edge_ids))] = np.arange(len(network))
    return Prepared(
        px, py, first, np.ascontiguousarray(network.distance),
        np.repeat(np.arange(len(network), dtype=np.int32), np.diff(first)), twin, grid, starts, items, rank,
        np.ascontiguousarray(network.length), network.reverse.astype(np.int32),
        network.next_first.astype(np.int32), network.next_edges.astype(np.int32),
        new_store(len(network), len(network.next_edges)),
    )  # fmt: skip


def _grid_of(network: Network, px: Floats, py: Floats) -> tuple[float, float, float, int, int]:
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

"""Ways through a network: the quickest route between edges, and distances within a bound."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.network import Network
from fleetlog.errors import DataError

Floats = NDArray[np.float64]
Index = NDArray[np.int32]
BOUNDS = 256
"""Targets whose lower bounds are kept."""


class Distances(NamedTuple):
    """Driving distances from start to start, in compressed rows.

    From the start of edge ``i`` (row i) the start of edge ``edge[k]`` is ``distance[k]`` metres away for k
    in first[i]:first[i + 1], by the shortest chain of allowed turns.  Rows are sorted by distance, then by
    edge; the first entry is the edge itself with 0.  From ``offset_from`` on edge i to ``offset_to`` on
    another one it is ``distance - offset_from + offset_to``.
    """

    first: NDArray[np.int64]
    edge: Index
    distance: Floats


def bounded_distances(network: Network, limit: float, sources: Index | None = None) -> Distances:
    """Driving distances [m] from every edge to all edges at most ``limit`` [m] away, start to start.

    ``sources`` (S,) are the edges to start from; all by default, then row i is edge i.
    """
    from fleetlog.roads.kernels import paths
    from fleetlog.roads.kernels.distances import new_store

    store = new_store(len(network), len(network.next_edges))
    rows = np.arange(len(network), dtype=np.int32) if sources is None else np.asarray(sources, dtype=np.int32)
    found = paths.bounded(store, network.next_first, network.next_edges, network.length, float(limit), rows)
    return Distances(*found)


@dataclass(frozen=True)
class Route:
    """A chain of edges (n,); ``cost`` [s] and ``length`` [m] from its start to its end."""

    edges: Index
    cost: float
    length: float


class Router:
    """Quickest routes on one network, for many questions.

    Parameters
    ----------
    network : the roads.
    speed : (E,) m/s to plan with; by default the limit, and ``default_speed`` where it is unknown.
    default_speed : m/s.
    turn_time : s charged for every change of heading, by its share of a half turn (0 at straight on).

    Notes
    -----
    A* over directed edges (Hart, Nilsson and Raphael 1968) with the straight-line time at the highest speed
    as the lower bound.  Equal costs are decided by edge number: the same question has the same answer on
    every machine.
    """

    def __init__(
        self,
        network: Network,
        speed: Floats | None = None,
        default_speed: float = 5.0,
        turn_time: float = 0.0,
    ) -> None:
        limit = network.speed_limit if speed is None else np.asarray(speed, dtype=np.float64)
        self.network = network
        self.speed = np.where(np.isfinite(limit) & (limit > 0.0), limit, default_speed)
        self.time = network.length / self.speed
        self._starts = network.points[network.first[:-1]]
        self._jump = _widest_gap(network)
        self._turn = _turn_costs(network, turn_time)
        self._open = np.zeros(len(network), dtype=bool)
        self._bound = lru_cache(maxsize=BOUNDS)(self._bound_of)

    def route(self, source: int, target: int, closed: Iterable[int] = ()) -> Route | None:
        """The quickest chain from all of edge ``source`` to all of edge ``target``, or None.

        ``closed`` edges are not entered (the source may be closed: who stands there may leave).
        """
        from fleetlog.roads.kernels import paths

        n = self.network
        for edge in (source, target):
            if not 0 <= edge < len(n):
                raise DataError(f"no edge with the number {edge}; the network has {len(n)}")
        shut = self._open
        if numbers := list(closed):
            shut = shut.copy()
            shut[numbers] = True
        bound, ends = self._bound(target), (np.int32(source), np.int32(target))
        chain, entered = paths.astar(n.next_first, n.next_edges, self.time, self._turn, shut, bound, *ends)
        if not len(chain):
            return None
        return Route(chain, float(entered[-1] + self.time[target]), float(n.length[chain].sum()))

    def _bound_of(self, target: int) -> Floats:
        """(E,) time that the way from each edge's start to the target's takes at least [s]."""
        if self._jump > 1e-6:
            # Where ends do not meet exactly, a straight line can be longer than the way: no bound.
            return np.zeros(len(self.network))
        straight = np.linalg.norm(self._starts - self._starts[target], axis=1)
        # A little less than the straight line: rounding must not make the bound inconsistent.
        return np.asarray(straight * (1.0 - 1e-9) / self.speed.max(), dtype=np.float64)


def _owners(network: Network) -> NDArray[np.intp]:
    return np.repeat(np.arange(len(network)), np.diff(network.next_first))


def _widest_gap(network: Network) -> float:
    """Largest distance between an edge's end and the start of one that follows [m]."""
    if not len(network.next_edges):
        return 0.0
    ends = network.points[network.first[1:] - 1][_owners(network)]
    starts = network.points[network.first[:-1]][network.next_edges]
    return float(np.linalg.norm(ends - starts, axis=1).max())


def _turn_costs(network: Network, turn_time: float) -> Floats:
    """(len(next_edges),) time charged for each turn [s]."""
    if not turn_time:
        return np.zeros(len(network.next_edges))
    every = np.arange(len(network), dtype=np.int32)
    leave = network.heading(every, network.length)[_owners(network)]
    enter = network.heading(every, np.zeros(len(network)))[network.next_edges]
    turn = np.abs((enter - leave + np.pi) % (2.0 * np.pi) - np.pi)
    return np.asarray(turn_time * turn / np.pi, dtype=np.float64)

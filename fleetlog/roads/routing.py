"""Ways through a network: the quickest route between edges."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fleetlog.core.arrays import Floats, Index
from fleetlog.core.network import Network
from fleetlog.errors import DataError
from fleetlog.roads.kernels.routes import Graph, quickest

DEFAULT_SPEED = 5.0  # On edges without a limit [m/s]


@dataclass(frozen=True)
class Route:
    """A chain of edges (n,); ``cost`` [s] and ``length`` [m] from its start to its end."""

    edges: Index
    cost: float
    length: float


class Router:
    """Quickest routes on one network, for many questions.

    network : the roads.
    speed : (E,) m/s to plan with; by default the limit, and ``DEFAULT_SPEED`` where it is unknown.
    turn_time : s charged for every change of heading, by its share of a half turn (0 at straight on).

    A* over directed edges (Hart, Nilsson and Raphael 1968) with the straight-line time at the highest speed
    as the lower bound.  Equal costs are decided by edge number: the answer is the same on every machine."""

    def __init__(self, network: Network, speed: Floats | None = None, turn_time: float = 0.0) -> None:
        limit = network.speed_limit if speed is None else np.asarray(speed, dtype=np.float64)
        self.network = network
        self.speed = np.where(np.isfinite(limit) & (limit > 0.0), limit, DEFAULT_SPEED)
        self.time = network.length / self.speed
        self._starts = network.points[network.first[:-1]]
        before = np.repeat(np.arange(len(network), dtype=np.int32), np.diff(network.next_first))
        after = network.next_edges
        gaps = network.points[network.first[1:] - 1][before] - self._starts[after]
        # A little less than the straight line: rounding must not make the bound inconsistent.  Where ends do
        # not meet exactly, a straight line can be longer than the way: no bound.
        meet = np.linalg.norm(gaps, axis=1).max(initial=0.0) <= 1e-6
        self._least = (1.0 - 1e-9) / float(self.speed.max()) if meet else 0.0
        turn = network.heading(after, np.zeros(len(after))) - network.heading(before, network.length[before])
        self._turn = turn_time * np.abs((turn + np.pi) % (2.0 * np.pi) - np.pi) / np.pi

    def route(self, source: int, target: int, closed: Iterable[int] = ()) -> Route | None:
        """The quickest chain from all of edge ``source`` to all of edge ``target``, or None. ``closed`` edges
        are not entered (the source may be closed: who stands there may leave)."""
        n = self.network
        for edge in (source, target):
            if not 0 <= edge < len(n):
                raise DataError(f"no edge with the number {edge}; the network has {len(n)}")
        (first, last), none = np.array([[source], [target]], np.int32), np.zeros(1)
        ends = first, none, none, last, none + np.inf, none
        start, _, chain, cost = quickest(self.graph(closed), *ends, np.inf)
        return Route(chain, cost, float(n.length[chain].sum())) if start >= 0 else None

    def graph(self, closed: Iterable[int] = ()) -> Graph:
        """What ``quickest`` searches, without ``closed`` edges."""
        n, shut = self.network, np.zeros(len(self.network), dtype=bool)
        shut[list(closed)] = True
        return n.next_first, n.next_edges, self.time, self._turn, shut, self._starts, self._least

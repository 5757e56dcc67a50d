"""Ways through a network: the quickest route between edges."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from heapq import heappop, heappush

import numpy as np

from fleetlog.compiling import kernel
from fleetlog.core.arrays import Floats, Index, Mask
from fleetlog.core.network import Network
from fleetlog.errors import DataError

DEFAULT_SPEED = 5.0  # On edges without a limit [m/s]
BOUNDS = 256  # targets whose lower bounds are kept


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
    as the lower bound.  Equal costs are decided by edge number: the same question has the same answer on
    every machine."""

    def __init__(self, network: Network, speed: Floats | None = None, turn_time: float = 0.0) -> None:
        limit = network.speed_limit if speed is None else np.asarray(speed, dtype=np.float64)
        self.network = network
        self.speed = np.where(np.isfinite(limit) & (limit > 0.0), limit, DEFAULT_SPEED)
        self.time = network.length / self.speed
        self._starts = network.points[network.first[:-1]]
        before = np.repeat(np.arange(len(network), dtype=np.int32), np.diff(network.next_first))
        after = network.next_edges
        gaps = network.points[network.first[1:] - 1][before] - self._starts[after]
        self._jump = float(np.linalg.norm(gaps, axis=1).max(initial=0.0))
        turn = network.heading(after, np.zeros(len(after))) - network.heading(before, network.length[before])
        self._turn = turn_time * np.abs((turn + np.pi) % (2.0 * np.pi) - np.pi) / np.pi
        self._open = np.zeros(len(network), dtype=bool)
        self._bound = lru_cache(maxsize=BOUNDS)(self._bound_of)

    def route(self, source: int, target: int, closed: Iterable[int] = ()) -> Route | None:
        """The quickest chain from all of edge ``source`` to all of edge ``target``, or None. ``closed`` edges
        are not entered (the source may be closed: who stands there may leave)."""
        n = self.network
        for edge in (source, target):
            if not 0 <= edge < len(n):
                raise DataError(f"no edge with the number {edge}; the network has {len(n)}")
        shut = self._open
        if numbers := list(closed):
            shut = shut.copy()
            shut[numbers] = True
        bound, ends = self._bound(target), (np.int32(source), np.int32(target))
        chain, entered = _astar(n.next_first, n.next_edges, self.time, self._turn, shut, bound, *ends)
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


@kernel()
def _astar(
    next_first: Index, next_edges: Index, cost: Floats, turn_cost: Floats, closed: Mask,
    bound: Floats, source: np.int32, target: np.int32,
) -> tuple[Index, Floats]:  # fmt: skip
    """Cheapest chain of edges from ``source`` to ``target``, empty if none; and the cost at each.

    ``cost[i]`` is that of driving all of edge i, ``turn_cost[k]`` that of the turn next_edges[k],
    ``bound[j]`` never more than the cost from the start of edge j to that of the target (consistent: the
    first arrival is the best).  Among equal costs the predecessor with the lower number wins."""
    edges = len(cost)
    best = np.full(edges, np.inf)
    came = np.full(edges, -1, dtype=np.int32)
    done = np.zeros(edges, dtype=np.bool_)
    best[source] = 0.0
    heap = [(bound[source], source)]
    while len(heap) > 0:
        _, i = heappop(heap)
        if done[i]:
            continue
        done[i] = True
        if i == target:
            break
        onward = best[i] + cost[i]
        for k in range(next_first[i], next_first[i + 1]):
            j = next_edges[k]
            if closed[j] or done[j]:
                continue
            there = onward + turn_cost[k]
            if there < best[j] or (there == best[j] and i < came[j]):
                best[j] = there
                came[j] = i
                heappush(heap, (there + bound[j], j))
    if not done[target]:
        return np.empty(0, dtype=np.int32), np.empty(0, dtype=np.float64)
    chain = [target]
    while chain[-1] != source:
        chain.append(came[chain[-1]])
    edges_of = np.array(chain[::-1], dtype=np.int32)
    return edges_of, best[edges_of]

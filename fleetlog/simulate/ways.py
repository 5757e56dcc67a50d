"""The quickest ways between bays, over all their doors."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fleetlog.roads.routing import Router
from fleetlog.simulate.arrays import Index
from fleetlog.simulate.spurs import Door
from fleetlog.simulate.track import Track

CROSSING = 3.0
"""What crossing a lane on the way into a bay or out of it costs in choosing a way [s]."""
AHEAD = 0.5
"""A door this much farther along the lane can be reached without a way round [m]."""


class Itinerary(NamedTuple):
    """Out of door ``out`` (-1: on the road already) along ``pieces`` and in by ``door``; ``cost`` [s]."""

    out: int
    door: int
    pieces: Index
    cost: float


class Ways:
    """Answers for one site; those without closed edges are kept."""

    def __init__(self, track: Track, router: Router, doors: list[Door], bays: int) -> None:
        self.track, self.router, self.doors = track, router, doors
        self.of_bay: list[list[int]] = [[] for _ in range(bays)]
        for d, door in enumerate(doors):
            self.of_bay[door.bay].append(d)
        self.pace = router.time / np.maximum(router.network.length, 1e-9)
        self._known: dict[tuple[int, int, bool], tuple[Index, float] | None] = {}

    def between(self, start: int, end: int, closed: Iterable[int] = (), only: int = -1) -> Itinerary | None:
        """The quickest way from bay ``start`` to bay ``end``; with ``only`` out of that door."""
        shut, found = tuple(closed), []
        for a in self.of_bay[start] if only < 0 else [only]:
            door = self.doors[a]
            way = self.onward(door.lane, door.at, end, shut)
            if way is not None:
                found.append(way._replace(out=a, cost=way.cost + self._extra(a)))
        return min(found, key=lambda w: w.cost, default=None)

    def onward(self, lane: int, at: float, end: int, closed: Iterable[int] = ()) -> Itinerary | None:
        """The quickest way from offset ``at`` [m] of a lane to bay ``end``."""
        shut, found = tuple(closed), []
        for b in self.of_bay[end]:
            door = self.doors[b]
            way = self._lanes(lane, door.lane, door.at > at + AHEAD, shut)
            if way is not None:
                rest = float(self.track.length[door.lane]) - door.at
                cost = way[1] - at * self.pace[lane] - rest * self.pace[door.lane] + self._extra(b)
                found.append(Itinerary(-1, b, way[0], cost))
        return min(found, key=lambda w: w.cost, default=None)

    def _extra(self, door: int) -> float:
        return CROSSING if self.doors[door].crosses >= 0 else 0.0

    def _lanes(self, a: int, b: int, onward: bool, shut: tuple[int, ...]) -> tuple[Index, float] | None:
        key = (a, b, onward or a != b)
        if shut:
            return self._search(*key, shut)
        if key not in self._known:
            self._known[key] = self._search(*key, shut)
        return self._known[key]

    def _search(self, a: int, b: int, onward: bool, shut: tuple[int, ...]) -> tuple[Index, float] | None:
        """Pieces from lane ``a`` to ``b``, round the block if it lies behind on the same one; cost [s]."""
        time = self.router.time
        if a == b and onward:
            return np.array([a], dtype=np.int32), float(time[a])
        if a != b:
            route = self.router.route(a, b, shut)
            return None if route is None else (self._pieces(route.edges), route.cost)
        options = [self.router.route(int(s), b, shut) for s in self.track.network.successors(a)]
        best = min((r for r in options if r is not None), key=lambda r: r.cost, default=None)
        if best is None:
            return None
        return self._pieces(np.concatenate([[a], best.edges])), float(time[a]) + best.cost

    def _pieces(self, edges: NDArray[np.integer]) -> Index:
        return np.array(self.track.pieces(edges), dtype=np.int32)

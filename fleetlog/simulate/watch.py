"""Who makes no progress, and for whom it waits: rings of trucks that wait for one another are deadlocks."""

from collections.abc import Iterable

import numpy as np

from fleetlog.simulate.arrays import Flags, Floats, Index, Ints
from fleetlog.simulate.state import Fleet, Mode, Roads

NEAR = 8.0
"""A truck this close on a lane can be in the way of one that comes out onto it [m]."""


class Watch:
    """Remembers when each truck last moved, and answers who is in whose way."""

    def __init__(self, roads: Roads, fleet: Fleet) -> None:
        self.roads, self.fleet = roads, fleet
        self._moved = fleet.moved.copy()
        self._since = np.zeros(len(fleet.mode))
        self.longest = 0.0
        """Longest time that any truck which wanted to move stood [s]."""

    def still(self, now: float) -> Floats:
        """(V,) seconds for which trucks have wanted to move and have not, 0 where they do not want to."""
        f = self.fleet
        busy = np.isin(f.mode, (Mode.WANTS_OUT, Mode.LEAVING, Mode.DRIVING, Mode.AT_BAY, Mode.ENTERING))
        self._since[(f.moved > self._moved + 0.05) | ~busy] = now
        self._moved[:] = f.moved
        out = now - self._since
        self.longest = max(self.longest, float(out.max(initial=0.0)))
        return out

    def blockers(self, trucks: list[int]) -> dict[int, int]:
        """For each of the trucks the one that has to move first, -1 where none is found."""
        truck, way = holdings(self.roads, self.fleet)
        holders = dict(zip(way.tolist(), truck.tolist(), strict=True))
        return {v: self._blocker(v, holders) for v in trucks}

    def _blocker(self, v: int, holders: dict[int, int]) -> int:
        f, r = self.fleet, self.roads
        if f.mode[v] == Mode.DRIVING:
            if f.ahead[v] >= 0:
                return int(f.ahead[v])
            if f.why[v] == 2:
                lane = self.next_lane(v)
                first = self._between(lane, -np.inf, np.inf, -1)
                return first if first >= 0 else int(f.asks[lane])
            if f.why[v] == 1:
                _, wanted = passages(r, f, np.array([v]), f.at[[v]], np.array([self._end(v)]))
                return self._holder(wanted, v, holders)
            return self._in_front(v)
        door = int(f.door[v])
        found = self._holder([len(r.length) + 2 * len(r.clear) + door], v, holders)
        if found < 0 and r.door_crosses[door] >= 0:
            found = self._between(int(r.door_crosses[door]), r.door_low[door], r.door_high[door], v)
        if found < 0:
            found = self._between(int(r.door_lane[door]), r.door_at[door] - NEAR, r.door_at[door] + NEAR, v)
        return found

    def _in_front(self, v: int) -> int:
        """Who stands on, crosses, or is let out onto the next pieces of a truck's way."""
        f = self.fleet
        for k in range(int(f.at[v]), self._end(v) + 1):
            piece = int(f.route[v, k])
            found = [int(f.tail[piece])] if k > f.at[v] else []
            if piece < len(self.roads.clear):
                found += [int(f.crossed[piece]), int(f.asks[piece])]
            for u in found:
                if u not in (-1, v):
                    return u
        return -1

    def _holder(self, wanted: Iterable[int], v: int, holders: dict[int, int]) -> int:
        r = self.roads
        for what in wanted:
            for other in r.conflicts[r.conflict_first[what] : r.conflict_first[what + 1]]:
                if holders.get(int(other), v) != v:
                    return holders[int(other)]
        return -1

    def _between(self, lane: int, low: float, high: float, v: int) -> int:
        f = self.fleet
        on = np.flatnonzero((f.piece == lane) & (f.s >= low) & (f.s <= high) & (np.arange(len(f.s)) != v))
        return int(on[np.argmax(f.s[on])]) if len(on) else -1

    def _end(self, v: int) -> int:
        f = self.fleet
        ahead = np.arange(f.at[v] + 1, f.last[v])
        safe = ahead[is_safe_lane(self.roads, f.route[v, ahead])]
        return int(safe[0] if len(safe) else f.last[v])

    def next_lane(self, v: int) -> int:
        """The lane that truck ``v`` needs room on before it may go on."""
        return int(self.fleet.route[v, self._end(v)])


def is_safe_lane(r: Roads, piece: Index) -> Flags:
    """Whether trucks may wait on pieces."""
    lanes = len(r.clear)
    return np.asarray((piece < lanes) & (r.capacity[np.minimum(piece, lanes - 1)] > 0))


def passages(r: Roads, f: Fleet, trucks: Ints, low: Index, high: Index) -> tuple[Ints, Ints]:
    """Trucks and resources of positions ``low`` to ``high`` of routes: see ``kernels.reserve.resource``."""
    count = np.maximum(high - low + 1, 0)
    of = np.repeat(np.arange(len(trucks)), count)
    k = np.arange(len(of)) - (np.cumsum(count) - count - low)[of]
    way = f.route[trucks[of], k].astype(np.int64)
    pieces, lanes = len(r.length), len(r.clear)
    part = np.where(k == high[of], pieces + lanes, np.where(k == low[of], pieces, 0))
    return trucks[of], way + np.where(is_safe_lane(r, way), part, 0)


def holdings(r: Roads, f: Fleet) -> tuple[Ints, Ints]:
    """Trucks and the resources that they have reserved, spurs included."""
    truck, way = passages(r, f, np.arange(len(f.mode)), f.held_from, f.held_to)
    on_spur = np.flatnonzero(np.isin(f.mode, (Mode.LEAVING, Mode.ENTERING)) | f.entry)
    spurs = len(r.length) + 2 * len(r.clear) + f.door[on_spur]
    return np.concatenate([truck, on_spur]), np.concatenate([way, spurs])


def rings(blocker: dict[int, int]) -> list[list[int]]:
    """Trucks that wait for one another in a ring; each ring once."""
    import networkx as nx

    return list(nx.simple_cycles(nx.DiGraph(blocker.items())))

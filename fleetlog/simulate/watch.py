"""Who makes no progress, and for whom it waits: rings of trucks that wait for one another are deadlocks."""

import numpy as np

from fleetlog.simulate.arrays import Floats
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
        holders = self._holders()
        return {v: self._blocker(v, holders) for v in trucks}

    def _blocker(self, v: int, holders: dict[int, int]) -> int:
        f, r = self.fleet, self.roads
        if f.mode[v] == Mode.DRIVING:
            if f.ahead[v] >= 0:
                return int(f.ahead[v])
            if f.why[v] == 2:
                return self._first_on(self.next_lane(v))
            if f.why[v] == 1:
                return self._holder(self._passage(v, int(f.at[v]), self._end(v)), v, holders)
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

    def _holders(self) -> dict[int, int]:
        """The truck that holds each reserved resource."""
        f, spurs = self.fleet, len(self.roads.length) + 2 * len(self.roads.clear)
        out = {
            way: int(v)
            for v in np.flatnonzero(f.held_to >= f.held_from)
            for way in self._passage(int(v), int(f.held_from[v]), int(f.held_to[v]))
        }
        on_spur = np.isin(f.mode, (Mode.LEAVING, Mode.ENTERING)) | f.entry
        return out | {spurs + int(f.door[v]): int(v) for v in np.flatnonzero(on_spur)}

    def _passage(self, v: int, low: int, high: int) -> list[int]:
        """Resources of route positions ``low`` to ``high``; see ``kernels.reserve.resource``."""
        pieces, lanes = len(self.roads.length), len(self.roads.clear)
        out: list[int] = self.fleet.route[v, low : high + 1].tolist()
        for k, part in ((0, pieces), (-1, pieces + lanes)):
            out[k] = int(self.fleet.route[v, (low, high)[k]])
            out[k] += part if self._safe(out[k]) else 0
        return out

    def _holder(self, wanted: list[int], v: int, holders: dict[int, int]) -> int:
        r = self.roads
        for what in wanted:
            for other in r.conflicts[r.conflict_first[what] : r.conflict_first[what + 1]]:
                if holders.get(int(other), v) != v:
                    return holders[int(other)]
        return -1

    def _first_on(self, lane: int) -> int:
        first = self._between(lane, -np.inf, np.inf, -1)
        return first if first >= 0 else int(self.fleet.asks[lane])

    def _between(self, lane: int, low: float, high: float, v: int) -> int:
        f = self.fleet
        on = np.flatnonzero((f.piece == lane) & (f.s >= low) & (f.s <= high) & (np.arange(len(f.s)) != v))
        return int(on[np.argmax(f.s[on])]) if len(on) else -1

    def _safe(self, piece: int) -> bool:
        return bool(piece < len(self.roads.clear) and self.roads.capacity[piece] > 0)

    def _end(self, v: int) -> int:
        f = self.fleet
        k = int(f.at[v]) + 1
        while k < f.last[v] and not self._safe(int(f.route[v, k])):
            k += 1
        return min(k, int(f.last[v]))

    def next_lane(self, v: int) -> int:
        """The lane that truck ``v`` needs room on before it may go on."""
        return int(self.fleet.route[v, self._end(v)])


def rings(blocker: dict[int, int]) -> list[list[int]]:
    """Trucks that wait for one another in a ring; each ring once."""
    out: list[list[int]] = []
    done: set[int] = set()
    for start in blocker:
        seen: list[int] = []
        v = start
        while v in blocker and v not in seen and v not in done:
            seen.append(v)
            v = blocker[v]
        if v in seen:
            out.append(seen[seen.index(v) :])
        done |= set(seen)
    return out

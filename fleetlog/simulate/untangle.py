"""Trucks that wait for one another: rings are found and released, others look for another way."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fleetlog.simulate.state import AT_BAY, DRIVING, EMPTY, PARKED, WANTS_OUT, Fleet
from fleetlog.simulate.ways import Way
from fleetlog.simulate.world import World

STUCK = 30.0
"""After this wait at a junction somebody looks for a deadlock [s]."""
PASS = 20.0
"""After this wait a truck that cannot turn into its bay drives on to another door [s]."""
CHANGE = 40.0
"""After this wait a truck that cannot back out of its bay tries the other door [s]."""
DETOUR = 45.0
"""After this wait a truck tries another way [s]."""


@dataclass
class Count:
    """What happened."""

    tasks_given: int = 0
    tasks_done: int = 0
    deadlocks: int = 0
    deadlocks_released: int = 0
    detours: int = 0
    made_room: int = 0
    charges: int = 0
    empty: list[str] = field(default_factory=list)


class Untangler:
    """The part of a dispatcher that watches for standstill."""

    def __init__(self, world: World, fleet: Fleet) -> None:
        self.world, self.fleet, self.count = world, fleet, Count()

    def _take(self, v: int, way: Way) -> None:
        """Give a truck its way: out of a bay, or onward from the lane it is on."""
        f = self.fleet
        f.route[v, : len(way.pieces)] = way.pieces
        f.last[v], f.at[v] = len(way.pieces) - 1, 0
        f.goal[v] = way.door
        if way.out < 0:
            f.door[v] = way.door
        else:
            f.door[v], f.spur[v] = way.out, self.world.doors[way.out].length

    def _closed(self) -> list[int]:
        """Edges on which a truck with an empty battery stands."""
        f = self.fleet
        stands = f.piece[np.flatnonzero((f.mode == EMPTY) & (f.piece >= 0))]
        return sorted({int(p) for p in stands if p < len(self.world.track.network)})

    def _untangle(self, now: float) -> None:
        f = self.fleet
        self._pass_on(now)
        waiting = np.flatnonzero((f.mode == DRIVING) & (f.why > 0) & (now - f.waits > STUCK))
        if not len(waiting):
            return
        blocker = {int(v): self._blocker(int(v)) for v in waiting}
        released: set[int] = set()
        for v in blocker:
            ring = self._ring(v, blocker)
            if ring and not released & set(ring):
                released |= set(ring)
                self.count.deadlocks += 1
                if any(f.why[u] == 2 for u in ring):
                    f.force[np.array(ring)] = True
                    self.count.deadlocks_released += 1
        for v in blocker:
            if v not in released and f.why[v] == 2 and now - f.waits[v] > DETOUR:
                self._detour(v)

    def _pass_on(self, now: float) -> None:
        """Who cannot turn into its bay, or back out of it, for too long takes another door; on the road it drives on to it."""
        f, ways = self.fleet, self.world.ways
        late = now - f.waits > np.where(f.mode == AT_BAY, PASS, CHANGE)
        for v in np.flatnonzero(((f.mode == AT_BAY) | (f.mode == WANTS_OUT)) & late & ~f.entry):
            door, out = self.world.doors[f.door[v]], f.mode[v] == WANTS_OUT
            if out:
                others = [d for d in ways.of_bay[door.bay] if d != f.door[v]]
                way = (
                    ways.between(door.bay, self.world.doors[f.goal[v]].bay, only=others[0])
                    if others
                    else None
                )
            else:
                way = ways.onward(int(f.piece[v]), float(f.s[v]), door.bay, self._closed())
            if way is None:
                continue
            f.asks[f.asks == v] = -1
            self._take(int(v), way)
            f.waits[v] = np.inf
            f.mode[v] = WANTS_OUT if out else DRIVING
            self.count.detours += 1

    def _ring(self, v: int, blocker: dict[int, int]) -> list[int]:
        seen: list[int] = []
        while v in blocker and v not in seen:
            seen.append(v)
            v = blocker[v]
        return seen[seen.index(v) :] if v in seen else []

    def _blocker(self, v: int) -> int:
        """The truck that has to move first: the head of the full lane, or who holds the junction."""
        f = self.fleet
        lane = self._next_lane(v)
        if f.why[v] == 2:
            on = np.flatnonzero((f.piece == lane) & (f.mode != PARKED))
            return int(on[np.argmax(f.s[on])]) if len(on) else -1
        holders = np.flatnonzero(f.held_to >= f.held_from)
        holders = holders[holders != v]
        mine = f.s[v], f.piece[v]
        near = [int(u) for u in holders if int(f.piece[u]) != mine[1]]
        return near[0] if len(near) == 1 else -1

    def _next_lane(self, v: int) -> int:
        f = self.fleet
        k = int(f.at[v]) + 1
        while k < f.last[v] and not (
            f.route[v, k] < len(self.world.roads.clear) and self.world.roads.capacity[f.route[v, k]] > 0
        ):
            k += 1
        return int(f.route[v, k])

    def _detour(self, v: int) -> None:
        """Take another way where there is one that is not three times as long."""
        f = self.fleet
        lane, goal = int(f.piece[v]), self.world.doors[f.door[v]]
        old = f.route[v, f.at[v] : f.last[v] + 1]
        closed = sorted({self._next_lane(v), *self._closed()})
        if goal.lane in closed or lane == goal.lane:
            return
        way = self.world.ways.onward(lane, float(f.s[v]), goal.bay, closed)
        length = self.world.track.length
        if way is not None and length[way.pieces].sum() < 3.0 * length[old].sum() + 50.0:
            self._take(v, way)
            f.waits[v] = np.inf
            self.count.detours += 1

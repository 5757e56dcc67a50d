"""Trucks that wait for one another: rings are found and released, others look for another way."""

from dataclasses import dataclass, field

import numpy as np

from fleetlog.simulate.state import Fleet, Mode
from fleetlog.simulate.watch import Watch, rings
from fleetlog.simulate.ways import Itinerary
from fleetlog.simulate.world import World

STUCK = 30.0
"""Trucks that want to move and have not for so long are looked at: do they wait for one another? [s]"""
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
        self.watch = Watch(world.roads, fleet)
        self._changed: dict[int, float] = {}
        """When a truck last tried another door [s]."""
        self._known: dict[frozenset[int], bool] = {}
        """Rings that stand at present, and whether they were broken already."""

    def _take(self, v: int, way: Itinerary) -> None:
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
        stands = f.piece[np.flatnonzero((f.mode == Mode.EMPTY) & (f.piece >= 0))]
        return sorted({int(p) for p in stands if p < len(self.world.track.network)})

    def _untangle(self, now: float) -> None:
        """Look for trucks that make no progress: rings of them are broken, others look for another way."""
        f = self.fleet
        for v in np.flatnonzero((f.mode == Mode.AT_BAY) | (f.mode == Mode.WANTS_OUT)).tolist():
            since = max(float(f.waits[v]), self._changed.get(v, 0.0))
            # Twice as long at each door: on a full lane others need time to make room.
            patience = PASS if f.mode[v] == Mode.AT_BAY else max(CHANGE, 0.5 * (now - float(f.waits[v])))
            if now - since > patience:
                self._changed[v] = now
                self._other_door(v)
        still = self.watch.still(now)
        stuck: list[int] = np.flatnonzero(still > STUCK).tolist()
        if not stuck:
            self._known = {}
            return
        found = {frozenset(ring) for ring in rings(self.watch.blockers(stuck))}
        for ring in sorted(found, key=min):
            released = self._break(sorted(ring))
            self.count.deadlocks += ring not in self._known
            self.count.deadlocks_released += released and not self._known.get(ring, False)
            self._known[ring] = released or self._known.get(ring, False)
        self._known = {ring: done for ring, done in self._known.items() if ring in found}
        for v in stuck:
            if f.mode[v] == Mode.DRIVING and f.why[v] == 2 and now - f.waits[v] > DETOUR:
                self._detour(v)

    def _break(self, ring: list[int]) -> bool:
        """Send one truck of a ring another way, or let all move up if all wait for room on full lanes."""
        f = self.fleet
        if any(self._other_door(v) if f.mode[v] != Mode.DRIVING else self._detour(v) for v in ring):
            return True
        full = any(f.why[v] == 2 for v in ring)
        if full:
            f.force[np.array(ring)] = True
        return full

    def _other_door(self, v: int) -> bool:
        """Send who cannot get into its bay, or out of it, by another door; on the road it drives on."""
        f, ways, door = self.fleet, self.world.ways, self.world.doors[self.fleet.door[v]]
        if f.entry[v] or f.mode[v] not in (Mode.AT_BAY, Mode.WANTS_OUT):
            return False
        if f.held_to[v] >= f.held_from[v]:
            # What it has reserved is counted along its old way.
            return False
        if f.mode[v] == Mode.WANTS_OUT:
            others = [d for d in ways.of_bay[door.bay] if d != f.door[v]]
            way = ways.between(door.bay, self.world.doors[f.goal[v]].bay, only=others[0]) if others else None
        else:
            way = ways.onward(int(f.piece[v]), float(f.s[v]), door.bay, self._closed())
        if way is None:
            return False
        f.asks[f.asks == v] = -1
        self._take(v, way)
        if f.mode[v] == Mode.AT_BAY:
            # In a bay it has not begun to wait anew: who waits longest asks first.
            f.mode[v], f.waits[v] = Mode.DRIVING, np.inf
        self.count.detours += 1
        return True

    def _detour(self, v: int) -> bool:
        """Take another way where there is one that is not three times as long."""
        f = self.fleet
        if f.held_to[v] >= f.held_from[v] or f.ahead[v] >= 0 or f.at[v] == f.last[v]:
            return False
        lane, goal = int(f.piece[v]), self.world.doors[f.door[v]]
        old = f.route[v, f.at[v] : f.last[v] + 1]
        closed = sorted({self.watch.next_lane(v), *self._closed()})
        if goal.lane in closed or lane == goal.lane:
            return False
        way = self.world.ways.onward(lane, float(f.s[v]), goal.bay, closed)
        length = self.world.track.length
        if way is None or length[way.pieces].sum() > 3.0 * length[old].sum() + 50.0:
            return False
        self._take(v, way)
        f.waits[v] = np.inf
        self.count.detours += 1
        return True

"""Who makes no progress, and for whom it waits: rings of trucks, deadlocks, are found and released."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from fleetlog.core.arrays import Floats, Index, Ints, Mask
from fleetlog.simulate.state import STANDS, Fleet, Mode, Roads
from fleetlog.simulate.ways import Itinerary
from fleetlog.simulate.world import TURN_TIME, World

NEAR = 8.0  # A truck this close on a lane can be in the way of one that comes out onto it [m]
STUCK = 30.0  # Trucks that have wanted to move for so long are looked at: do they wait for one another? [s]
PASS = 20.0  # After this wait a truck that cannot turn into its bay drives on to another door [s]
CHANGE = 40.0  # After this wait a truck that cannot back out of its bay tries the other door [s]
QUEUED = 8.0  # Lost by who comes behind a truck that stands; from 5 to 20 throughput is the same [s]


class Watch:
    """Remembers when each truck last moved, and answers who is in whose way."""

    def __init__(self, roads: Roads, fleet: Fleet) -> None:
        self.roads, self.fleet, self._moved = roads, fleet, fleet.moved.copy()
        self._since = np.zeros(len(fleet.mode))
        self.longest = 0.0  # Longest time that any truck which wanted to move stood [s]

    def still(self, now: float) -> Floats:
        """(V,) seconds for which trucks have wanted to move and have not, 0 where they do not want to."""
        f = self.fleet
        # Who goes into a bay or out of it has all that it needs.
        busy = np.isin(f.mode, (Mode.WANTS_OUT, Mode.DRIVING, Mode.AT_BAY))
        self._since[(f.moved > self._moved + 0.05) | ~busy | (now < f.until)] = now
        self._moved[:] = f.moved
        out = now - self._since
        self.longest = max(self.longest, float(out.max(initial=0.0)))
        return out

    def blockers(self, trucks: list[int]) -> dict[int, int]:
        """For each of the trucks the one that has to move first, -1 where none is found."""
        truck, way = holdings(self.roads, self.fleet)
        holders = dict(zip(way.tolist(), truck.tolist(), strict=True))
        return {v: next((u for u in self._in_the_way(v, holders) if u >= 0), -1) for v in trucks}

    def _in_the_way(self, v: int, holders: dict[int, int]) -> Iterator[int]:
        """Who may have to move before truck ``v`` can, the likeliest first; -1: nobody."""
        f, r, door = self.fleet, self.roads, int(self.fleet.door[v])
        if f.mode[v] != Mode.DRIVING:
            yield from self._holders([len(r.length) + 2 * len(r.clear) + door], v, holders)
            if r.door_crosses[door] >= 0:
                yield self._between(int(r.door_crosses[door]), r.door_low[door], r.door_high[door], v)
            lane, at = int(r.door_lane[door]), float(r.door_at[door])
            # Not who stops for it, nor who stands behind it.
            behind = at if f.mode[v] == Mode.AT_BAY else at - NEAR
            low = f.ask_at[lane] + 0.1 if f.asks[lane] == v else behind
            yield self._between(lane, low, at + NEAR, v)
        elif f.ahead[v] >= 0:
            yield int(f.ahead[v])
        elif f.why[v] == 2:
            lane = int(f.route[v, self.end(v)])
            yield self._between(lane, -np.inf, np.inf, -1)
            yield int(f.asks[lane])
        elif f.why[v] == 1:
            _, wanted = passages(r, f, np.array([v]), f.at[[v]], np.array([self.end(v)]))
            yield from self._holders(wanted, v, holders)
        else:
            # Who stands on, crosses, or is let out onto the next pieces of its way.
            for k in range(int(f.at[v]), self.end(v) + 1):
                piece = int(f.route[v, k])
                found = [f.tail[piece]] if k > f.at[v] else []
                found += np.flatnonzero(f.crosses & (r.door_crosses[f.door] == piece)).tolist()
                # Who is past the mark does not stop there.
                if piece < len(r.clear) and (k > f.at[v] or f.s[v] < f.ask_at[piece] + 0.1):
                    found.append(f.asks[piece])
                yield from (int(u) for u in found if u != v)

    def _holders(self, wanted: Iterable[int], v: int, holders: dict[int, int]) -> Iterator[int]:
        r = self.roads
        for what in wanted:
            for other in r.conflicts[r.conflict_first[what] : r.conflict_first[what + 1]].tolist():
                if holders.get(other, v) != v:
                    yield holders[other]

    def _between(self, lane: int, low: float, high: float, v: int) -> int:
        f = self.fleet
        on = np.flatnonzero((f.piece == lane) & (f.s >= low) & (f.s <= high) & (np.arange(len(f.s)) != v))
        return int(on[np.argmax(f.s[on])]) if len(on) else -1

    def end(self, v: int) -> int:
        """Position on its route of the lane that truck ``v`` needs room on before it may go on."""
        f = self.fleet
        ahead = np.arange(f.at[v] + 1, f.last[v])
        safe = ahead[is_safe_lane(self.roads, f.route[v, ahead])]
        return int(safe[0] if len(safe) else f.last[v])


def is_safe_lane(r: Roads, piece: Index) -> Mask:
    """Whether trucks may wait on pieces."""
    lanes = len(r.clear)
    return np.asarray((piece < lanes) & (r.capacity[np.minimum(piece, lanes - 1)] > 0))


def passages(r: Roads, f: Fleet, trucks: Ints, low: Index, high: Index) -> tuple[Ints, Ints]:
    """Trucks and resources of positions ``low`` to ``high`` of routes: see ``kernels.lanes.resource``."""
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


@dataclass
class Count:
    """What happened."""

    tasks_given: int = 0
    tasks_done: int = 0
    tasks_later: int = 0  # Given, but for a time after the end
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
        self._changed: dict[int, float] = {}  # When a truck last tried another door [s]
        self._known: dict[frozenset[int], bool] = {}  # Rings that stand, and whether they were broken already

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
        if round(now) % 10 == 0:
            self._reroute()
        for v in np.flatnonzero((f.mode == Mode.AT_BAY) | (f.mode == Mode.WANTS_OUT)).tolist():
            # Twice as long at each door: on a full lane others need time to make room.
            patience = PASS if f.mode[v] == Mode.AT_BAY else max(CHANGE, 0.5 * (now - float(f.waits[v])))
            if now - max(float(f.waits[v]), self._changed.get(v, 0.0)) > patience:
                self._changed[v] = now
                self._other_door(v)
        stuck: list[int] = np.flatnonzero(self.watch.still(now) > STUCK).tolist()
        found = {frozenset(ring) for ring in rings(self.watch.blockers(stuck))} if stuck else set()
        known, self._known = self._known, {}
        for ring in sorted(found, key=min):
            before, released = known.get(ring), any(self._other_door(v) for v in sorted(ring))
            self.count.deadlocks += before is None
            self.count.deadlocks_released += released and not before
            self._known[ring] = released or bool(before)

    def _reroute(self) -> None:
        """Routes go by the traffic: who comes to a queue takes another way if that is quicker."""
        f, ways, shut, capacity = self.fleet, self.world.ways, self._closed(), self.watch.roads.capacity
        on = np.flatnonzero((f.piece >= 0) & (f.piece < len(capacity)))
        stands, comes = on[f.v[on] < STANDS], on[f.at[on] + 2 <= f.last[on]]
        following = np.full(len(f.mode), -1)
        following[comes] = f.route[comes, f.at[comes] + 2]
        # Who waits for a single-lane aisle, or is in it, makes others wait at both of its ends.
        wanted, back = following[stands], self.world.track.network.reverse
        among = np.bincount(np.append(wanted[wanted >= 0], f.piece[on]), minlength=len(capacity))
        among[capacity > 0] = 0
        queue = np.bincount(f.piece[stands], minlength=len(capacity)) + among
        queue += np.where(back >= 0, among[back], 0)
        ways.lose(np.asarray(QUEUED * queue, dtype=np.float64))
        queue[shut] += 1
        may = (f.mode[comes] == Mode.DRIVING) & (f.held_to[comes] < f.held_from[comes])
        for v in comes[may & (queue[following[comes]] > 0)].tolist():
            way, at, door = f.route[v, f.at[v] : f.last[v] + 1], float(f.s[v]), int(f.door[v])
            most = np.inf if following[v] in shut else ways.rest(way, at, door) - TURN_TIME
            if (new := ways.onward(int(way[0]), at, self.world.doors[door].bay, shut, most)) is not None:
                self._take(v, new)
                self.count.detours += 1

    def _other_door(self, v: int) -> bool:
        """Send who cannot get into its bay, or out of it, by another door; on the road it drives on."""
        f, ways, door = self.fleet, self.world.ways, self.world.doors[self.fleet.door[v]]
        stands = f.mode[v] in (Mode.AT_BAY, Mode.WANTS_OUT) and not f.entry[v]
        if not stands or f.held_to[v] >= f.held_from[v]:
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

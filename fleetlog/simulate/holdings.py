"""Which pieces of the road each truck has reserved, second by second."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.trajectory import Labels
from fleetlog.simulate.state import ENTERING, LEAVING, Fleet
from fleetlog.simulate.world import World
from fleetlog.store.events import WAYS, Columns, Lines

Ints = NDArray[np.int64]


class Held(NamedTuple):
    """(N,) truck, way, since when it has it, and when it was seen last with it or first without it [ms]."""

    truck: Ints
    way: Ints
    since: Ints
    until: Ints


class Looks(NamedTuple):
    """(M,) trucks that were looked at, and when [ms]."""

    truck: Ints
    time: Ints


KINDS = tuple(WAYS)
"""In the order of the numbers of ways; see :mod:`fleetlog.simulate.junctions`."""
NOTHING = Held(*(np.zeros(0, np.int64) for _ in Held._fields))
NOBODY = Looks(*(np.zeros(0, np.int64) for _ in Looks._fields))


class Holdings:
    """Looks at the reservations once a second; only trucks whose own have changed are written down.

    A *way* is a resource of :mod:`fleetlog.simulate.junctions`.  Those that exclude nothing, such as a bend of a lone
    road, are left out.
    """

    def __init__(self, world: World, fleet: Fleet) -> None:
        r = world.roads
        self.world, self.fleet = world, fleet
        self.pieces, self.lanes = len(r.length), len(r.clear)
        self.matters = np.diff(r.conflict_first) > 0
        self.safe = np.zeros(self.pieces, dtype=bool)
        self.safe[: self.lanes] = r.capacity > 0
        self.seen = np.zeros(len(self.matters), dtype=bool)
        trucks = len(fleet.mode)
        self._low, self._high = np.zeros(trucks, np.int32), np.full(trucks, -1, np.int32)
        self._spur = np.full(trucks, -1, np.int32)
        self._written: list[tuple[NDArray[np.generic], ...]] = []
        self._open, self._last = NOTHING, NOBODY
        self.rows = 0
        """Written down since the last :meth:`ended`."""

    def tick(self, now: int) -> None:
        """Look; ``now`` [ms]."""
        f = self.fleet
        on_spur = (f.mode == LEAVING) | (f.mode == ENTERING) | f.entry
        spur = np.where(on_spur, f.door, -1)
        changed = (f.held_from != self._low) | (f.held_to != self._high) | (spur != self._spur)
        trucks = np.flatnonzero(changed)
        if not len(trucks):
            return
        self._low[:], self._high[:], self._spur[:] = f.held_from, f.held_to, spur
        low, high = f.held_from[trucks], f.held_to[trucks]
        row, at = _each(low, high)
        pieces = f.route[trucks[row], at]
        self._written.append((trucks, np.full(len(trucks), now), low, high, spur[trucks], pieces))
        self.rows += len(trucks) + len(row)

    def ended(self, end: int | None = None) -> Held:
        """What was given back since the last call, in order of time; with the ``end`` [ms] also what is still held."""
        held, looks = self._read()
        # Looks at one truck that follow on each other have numbers that do.
        order = np.lexsort((looks.time, looks.truck))
        who, when = looks.truck[order], looks.time[order]
        size = int(when.max(initial=0)) + 1
        number = np.searchsorted(who * size + when, held.truck * size + held.until)
        order = np.lexsort((number, held.way, held.truck))
        truck, way, since, number = held.truck[order], held.way[order], held.since[order], number[order]
        breaks = np.flatnonzero((np.diff(truck) != 0) | (np.diff(way) != 0) | (np.diff(number) != 1))
        last = np.append(breaks, len(truck) - 1) if len(truck) else breaks
        first = np.insert(last[:-1] + 1, 0, 0) if len(truck) else breaks
        after = np.minimum(number[last] + 1, max(len(who) - 1, 0))
        over = (after > number[last]) & (who[after] == truck[last])
        until = when[np.where(over, after, number[last])]
        every = Held(truck[last], way[last], since[first], until)
        self._open = Held(*(c[~over] for c in every))
        newest = np.flatnonzero(np.diff(who, append=-1) != 0)
        self._last = Looks(who[newest], when[newest])
        if end is not None:
            over, every = np.ones(len(last), dtype=bool), every._replace(until=np.where(over, until, end))
        done = np.flatnonzero(over)
        out = Held(*(c[done[np.argsort(every.until[done], kind="stable")]] for c in every))
        self.seen[out.way] = True
        return out

    def _read(self) -> tuple[Held, Looks]:
        """What every look found, and all looks; with what was open at the last call."""
        if not self._written:
            return self._open, self._last
        truck, now, low, high, spur, piece = (np.concatenate(c) for c in zip(*self._written, strict=True))
        self._written, self.rows = [], 0
        row, at = _each(low, high)
        # As in kernels.reserve.resource: only the ends of a passage lie on lanes where a truck can stand.
        end = np.where(at == high[row], self.pieces + self.lanes, np.where(at == low[row], self.pieces, 0))
        inside = np.flatnonzero(spur >= 0)
        way = np.concatenate([piece + self.safe[piece] * end, self.pieces + 2 * self.lanes + spur[inside]])
        row = np.concatenate([row, inside])
        keep = self.matters[way]
        way, row = way[keep], row[keep]
        found = Held(truck[row], way, now[row], now[row])
        looks = Looks(truck, now)
        return (
            Held(*(np.concatenate(c) for c in zip(self._open, found, strict=True))),
            Looks(*(np.concatenate(c) for c in zip(self._last, looks, strict=True))),
        )

    def ways(self) -> Columns:
        """The table of the ways that were ever reserved."""
        way = np.flatnonzero(self.seen)
        track, doors = self.world.track, self.world.doors
        kind, piece = self._kinds(way)
        turn, bay = kind == KINDS.index("turn"), kind == KINDS.index("bay")
        joint = np.where(turn, piece, 0)
        door = np.where(bay, piece - self.pieces, 0)
        lane, of_bay = (np.array([getattr(d, name) for d in doors])[door] for name in ("lane", "bay"))
        edge = np.where(bay, lane, np.where(turn, track.source[joint], piece))
        edges, places = track.network.edge_ids, tuple(b.place.id for b in self.world.bays)
        return {
            "way": way, "kind": Labels(kind.astype(np.int32), KINDS), "edge_id": Labels(edge.astype(np.int32), edges),
            "to_edge": Labels(np.where(turn, track.target[joint], -1).astype(np.int32), edges),
            "place": Labels(np.where(bay, of_bay, -1).astype(np.int32), places), **self._lines(kind, piece),
        }  # fmt: skip

    def _kinds(self, way: Ints) -> tuple[Ints, Ints]:
        """(N,) place in ``KINDS`` of ways, and the piece of the ground that each lies on."""
        bounds = [self.lanes, self.pieces, self.pieces + self.lanes, self.pieces + 2 * self.lanes]
        kind = np.searchsorted(bounds, way, side="right")
        shift = np.array([0, 0, self.pieces, self.pieces + self.lanes, 2 * self.lanes])
        return kind, way - shift[kind]

    def _lines(self, kind: Ints, piece: Ints) -> dict[str, Lines]:
        """Middle lines, to the millimetre; of the ends of a lane as far as the next sample."""
        g, r = self.world.ground, self.world.roads
        first, last, step = g.first[piece], g.first[piece + 1] - 1, g.spacing[piece]
        leaves, enters = kind == KINDS.index("exit"), kind == KINDS.index("entry")
        lane = np.where(leaves | enters, piece, 0)
        stop, clear = np.floor(r.stop[lane] / step).astype(int), np.ceil(r.clear[lane] / step).astype(int)
        last = np.where(enters, np.minimum(first + np.maximum(clear, 1), last), last)
        first = np.where(leaves, np.minimum(first + stop, last - 1), first)
        row, sample = _each(first, last)
        lengths = np.bincount(row, minlength=len(piece))
        return {axis: Lines(np.round(getattr(g, axis)[sample], 3), lengths) for axis in "xyz"}


def _each(low: NDArray[np.integer], high: NDArray[np.integer]) -> tuple[Ints, Ints]:
    """Every whole number from ``low[i]`` to ``high[i]``, for every i: the i, and the number."""
    count = high - low + 1
    row = np.repeat(np.arange(len(count)), count)
    return row, np.arange(len(row)) + np.repeat(low - (np.cumsum(count) - count), count)

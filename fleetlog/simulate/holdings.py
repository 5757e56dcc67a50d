"""Which pieces of the road each truck has reserved, second by second."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.trajectory import Labels
from fleetlog.simulate.arrays import Ints
from fleetlog.simulate.world import World
from fleetlog.store.events import WAYS, Columns, Lines


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
    """Makes stretches of time of what :mod:`fleetlog.simulate.kernels.look` saw of the reservations.

    A *way* is a resource of :mod:`fleetlog.simulate.junctions`.  Those that exclude nothing, such as a bend
    of a lone road, are left out.
    """

    def __init__(self, world: World) -> None:
        r = world.roads
        self.world = world
        self.pieces, self.lanes = len(r.length), len(r.clear)
        self.matters = np.diff(r.conflict_first) > 0
        self.safe = np.zeros(self.pieces, dtype=bool)
        self.safe[: self.lanes] = r.capacity > 0
        self.used = np.zeros(len(self.matters), dtype=bool)
        self._open, self._last = NOTHING, NOBODY

    def ended(self, looks: Ints, held: Ints, end: int | None = None) -> Held:
        """What was given back, in order of time.

        Parameters
        ----------
        looks : (2, M) trucks whose reservations had changed, and when [ms], since the last call.
        held : (3, N) truck, way and time of every way that was held then.
        end : of the simulation [ms]: also what is still held.
        """
        join = np.concatenate
        found = Held(*(join(c) for c in zip(self._open, (*held, held[2]), strict=True)))
        who, when = (join(c) for c in zip(self._last, looks, strict=True))
        # Looks at one truck that follow on each other have numbers that do.
        order = np.lexsort((when, who))
        who, when = who[order], when[order]
        size = int(when.max(initial=0)) + 1
        number = np.searchsorted(who * size + when, found.truck * size + found.until)
        pair = found.truck * len(self.matters) + found.way
        order = np.argsort(pair * (len(who) + 1) + number)
        pair, since, number = pair[order], found.since[order], number[order]
        breaks = np.flatnonzero((np.diff(pair) != 0) | (np.diff(number) != 1))
        last = np.append(breaks, len(pair) - 1) if len(pair) else breaks
        first = np.insert(last[:-1] + 1, 0, 0) if len(pair) else breaks
        truck, way = np.divmod(pair[last], len(self.matters))
        after = np.minimum(number[last] + 1, max(len(who) - 1, 0))
        over = (after > number[last]) & (who[after] == truck)
        until = when[np.where(over, after, number[last])]
        every = Held(truck, way, since[first], until)
        self._open = Held(*(c[~over] for c in every))
        newest = np.flatnonzero(np.diff(who, append=-1) != 0)
        self._last = Looks(who[newest], when[newest])
        if end is not None:
            over, every = np.ones(len(last), dtype=bool), every._replace(until=np.where(over, until, end))
        done = np.flatnonzero(over)
        out = Held(*(c[done[np.argsort(every.until[done], kind="stable")]] for c in every))
        self.used[out.way] = True
        return out

    def ways(self) -> Columns:
        """The table of the ways that were ever reserved."""
        way = np.flatnonzero(self.used)
        track, doors = self.world.track, self.world.doors
        kind, piece = self._kinds(way)
        turn, bay = kind == KINDS.index("turn"), kind == KINDS.index("bay")
        joint = np.where(turn, piece, 0)
        door = np.where(bay, piece - self.pieces, 0)
        lane, of_bay = (np.array([getattr(d, name) for d in doors])[door] for name in ("lane", "bay"))
        edge = np.where(bay, lane, np.where(turn, track.source[joint], piece))
        edges, places = track.network.edge_ids, tuple(b.place.id for b in self.world.bays)
        return {
            "way": way,
            "kind": Labels(kind.astype(np.int32), KINDS),
            "edge_id": Labels(edge.astype(np.int32), edges),
            "to_edge": Labels(np.where(turn, track.target[joint], -1).astype(np.int32), edges),
            "place": Labels(np.where(bay, of_bay, -1).astype(np.int32), places),
            **self._lines(kind, piece),
        }

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

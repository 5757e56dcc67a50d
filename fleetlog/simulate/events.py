"""What each truck does, what it has reserved, and what becomes of the tasks: looked at once a second and written beside the rows.

Nothing here acts on the simulation.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.trajectory import Labels
from fleetlog.simulate.dispatch import Dispatcher
from fleetlog.simulate.holdings import Holdings
from fleetlog.simulate.state import (
    AT_BAY,
    CHARGING,
    DRIVING,
    EMPTY,
    ENTERING,
    HANDLING,
    LEAVING,
    PARKED,
    WANTS_OUT,
)
from fleetlog.simulate.taskbook import LATER, LEFT_OUT
from fleetlog.store.events import ACTIVITIES, Columns
from fleetlog.store.writer import DatasetWriter

Ints = NDArray[np.int64]
STANDS = 0.05
"""Slower than this a truck on the road waits [m/s]: as in the summary's time of waiting."""
NAMES = tuple(ACTIVITIES)
EMPTY_RUN, LADEN_RUN, WAIT, WAIT_PLACE, PICK, DROP, CHARGE, WAIT_CHARGER, PARK, DEAD = range(len(NAMES))
OF_MODE = np.zeros(9, np.int64)
for _mode, _activity in {
    PARKED: PARK, HANDLING: PICK, WANTS_OUT: WAIT, LEAVING: EMPTY_RUN, DRIVING: EMPTY_RUN, AT_BAY: WAIT,
    ENTERING: EMPTY_RUN, CHARGING: CHARGE, EMPTY: DEAD,
}.items():  # fmt: skip
    OF_MODE[_mode] = _activity
KEPT = 1 << 16
"""Rows that are kept as they come before columns are made of them."""
NONE: tuple[Ints, ...] = (np.zeros(0, np.int64),) * 4


class EventLog:
    """Writes the tables of a run; times inside are milliseconds after its start, at ``start`` microseconds since 1970."""

    def __init__(self, dispatcher: Dispatcher, writer: DatasetWriter, start: int) -> None:
        self.dispatcher, self.start = dispatcher, start
        self.tables = writer.tables
        world, fleet = dispatcher.world, dispatcher.fleet
        self.fleet, self.vehicles = fleet, tuple(dispatcher.names)
        self.holdings = Holdings(world, fleet)
        places = {bay.place.id: None for bay in world.bays}
        self.places = tuple(places)
        code = {place: k for k, place in enumerate(places)}
        self.place_of_bay = np.array([code[b.place.id] for b in world.bays], dtype=np.int64)
        self.place_of_door = self.place_of_bay[[d.bay for d in world.doors]]
        self._key = np.full(len(fleet.mode), -1, np.int64)
        self._since = np.zeros(len(fleet.mode), np.int64)
        self._done = [NONE]
        self._rows = 0

    def tick(self, now: float) -> None:
        """After the decisions of a second; ``now`` [s]."""
        ms = round(now * 1000.0)
        self.holdings.tick(ms)
        key = self._keys()
        changed = np.flatnonzero(key != self._key)
        if len(changed):
            if ms > 0:
                self._end(changed, ms)
            self._key[changed], self._since[changed] = key[changed], ms
        if self._rows + self.holdings.rows > KEPT:
            self._write()

    def close(self, now: float) -> None:
        """The end, at ``now`` [s]."""
        ms = round(now * 1000.0)
        self._end(np.arange(len(self._key)), ms)
        self._write(ms)
        d, book = self.dispatcher, self.dispatcher.book
        book.never(d.pending[d.given :], LATER)
        book.never(d.demand.left_out, LEFT_OUT)
        self.tables.add("tasks", book.columns(self.start))
        self.tables.add("ways", self.holdings.ways())
        self.tables.add("bays", self._bays())

    def _bays(self) -> Columns:
        world = self.dispatcher.world
        ends = world.ground.first[len(world.track) + 1 : len(world.track) + 1 + len(world.bays)] - 1
        shape = np.round([b.path[-1, :3] for b in world.bays], 3).T
        kinds = ("pick", "drop", "park", "charge")
        codes = np.array([kinds.index(b.place.kind) for b in world.bays])
        return {
            "place": _labels(self.place_of_bay, self.places), "kind": _labels(codes, kinds), "x": shape[0], "y": shape[1],
            "z": np.round(world.ground.z[ends], 3), "heading": np.round(np.angle(np.exp(1j * shape[2])), 4),
        }  # fmt: skip

    def activities(self) -> Ints:
        """(V,) what each truck does."""
        f, task = self.fleet, self.dispatcher.book.of
        out = OF_MODE[f.mode]
        # Who has just been sent off has not been kept waiting yet.
        out[(f.mode == WANTS_OUT) & (f.waits == np.inf)] = EMPTY_RUN
        out[(f.mode == DRIVING) & (f.v < STANDS)] = WAIT
        out[(out == EMPTY_RUN) & (f.load > 0.0)] = LADEN_RUN
        out[(out == PICK) & (f.hand_after <= 0.0)] = DROP
        out[(out == PARK) & (task >= 0)] = WAIT_PLACE
        d = self.dispatcher
        if d.queue:
            queue = np.array(d.queue)
            # Who could go on does the next task; only who must charge waits for it.
            out[queue[(out[queue] == PARK) & (d.soc[queue] < d.policy.low)]] = WAIT_CHARGER
        return out

    def _keys(self) -> Ints:
        """(V,) one number for activity, place and task."""
        f, doing = self.fleet, self.activities()
        on_the_way = (doing <= LADEN_RUN) & (f.goal >= 0)
        place = self.place_of_door[np.where(on_the_way, f.goal, f.door)]
        task = self.dispatcher.book.of + 1
        return np.asarray((task * len(self.places) + place) * len(NAMES) + doing)

    def _end(self, trucks: NDArray[np.intp], now: int) -> None:
        self._done.append((trucks, self._key[trucks], self._since[trucks], np.full(len(trucks), now)))
        self._rows += len(trucks)

    def _write(self, end: int | None = None) -> None:
        truck, key, since, until = (np.concatenate(c) for c in zip(*self._done, strict=True))
        rest = key // len(NAMES)
        self.tables.add("activities", {
            **self._stretch(truck, since, until), "activity": _labels(key % len(NAMES), NAMES),
            "place": _labels(rest % len(self.places), self.places), "task": rest // len(self.places) - 1,
        })  # fmt: skip
        held = self.holdings.ended(end)
        self.tables.add(
            "reservations", {**self._stretch(held.truck, held.since, held.until), "way": held.way}
        )
        self._done, self._rows = [NONE], 0

    def _stretch(self, truck: Ints, since: Ints, until: Ints) -> Columns:
        return {
            "vehicle_id": _labels(truck, self.vehicles), "start": self.start + 1000 * since,
            "end": self.start + 1000 * until,
        }  # fmt: skip


def _labels(codes: Ints, names: tuple[str, ...]) -> Labels:
    return Labels(codes.astype(np.int32), names)

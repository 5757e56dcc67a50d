"""What each truck does, what it has reserved, and what becomes of the tasks: looked at once a second and
written beside the rows.

Nothing here acts on the simulation.
"""

from __future__ import annotations

import numpy as np

from fleetlog.core.trajectory import Labels
from fleetlog.simulate.arrays import Ints
from fleetlog.simulate.dispatch import Dispatcher
from fleetlog.simulate.holdings import Holdings
from fleetlog.simulate.taskbook import LATER, LEFT_OUT
from fleetlog.store.events import ACTIVITIES, Columns
from fleetlog.store.writer import DatasetWriter

NAMES = tuple(ACTIVITIES)
KEPT = 1 << 16
"""Changes of each kind that are kept before they are written; at least as many as a route has pieces."""


class EventLog:
    """Writes the tables of a run; times inside are milliseconds after its start,
    at ``start`` microseconds since 1970.
    """

    def __init__(self, dispatcher: Dispatcher, writer: DatasetWriter, start: int) -> None:
        from fleetlog.simulate.kernels.look import Ground, Pages, Seen, Trucks

        self.dispatcher, self.start = dispatcher, start
        self.tables = writer.tables
        world, fleet = dispatcher.world, dispatcher.fleet
        self.vehicles = tuple(dispatcher.names)
        self.holdings = h = Holdings(world)
        places = {bay.place.id: None for bay in world.bays}
        self.places = tuple(places)
        code = {place: k for k, place in enumerate(places)}
        self.place_of_bay = np.array([code[b.place.id] for b in world.bays], dtype=np.int64)
        at_door = self.place_of_bay[[d.bay for d in world.doors]]
        n = len(self.vehicles)
        own = {name: getattr(fleet, name) for name in Trucks._fields if name in fleet._fields}
        self.trucks = Trucks(**own, task=dispatcher.book.of, lacks=dispatcher.lacks)
        self.ground = Ground(at_door, h.safe, h.matters, len(places), h.lanes)
        none = np.full(n, -1, np.int32)
        self.seen = Seen(
            np.full(n, -1, np.int64), np.zeros(n, np.int64), np.zeros(n, np.int32), none, none.copy()
        )
        stretches, looks, held = (np.zeros((KEPT, k), np.int64) for k in (4, 2, 3))
        self.pages = Pages(stretches, looks, held, np.zeros(3, np.int64))

    def tick(self, now: float) -> None:
        """After the decisions of a second; ``now`` [s]."""
        from fleetlog.simulate.kernels.look import look

        ms, v = round(now * 1000.0), 0
        while (v := look(self.trucks, self.ground, self.seen, self.pages, v, ms)) < len(self.vehicles):
            self._write()

    def close(self, now: float) -> None:
        """The end, at ``now`` [s]."""
        ms, n = round(now * 1000.0), len(self.vehicles)
        self._write(ms)
        self._stretches(np.column_stack([np.arange(n), self.seen.key, self.seen.since, np.full(n, ms)]))
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
        # Four decimals of a half turn are more than a half turn.
        heading = np.clip(np.round(np.angle(np.exp(1j * shape[2])), 4), -3.1415, 3.1415)
        kinds = ("pick", "drop", "park", "charge")
        codes = np.array([kinds.index(b.place.kind) for b in world.bays])
        return {
            "place": _labels(self.place_of_bay, self.places),
            "kind": _labels(codes, kinds),
            "x": shape[0],
            "y": shape[1],
            "z": np.round(world.ground.z[ends], 3),
            "heading": heading,
        }

    def _write(self, end: int | None = None) -> None:
        """Empty the pages; with the ``end`` [ms] also what is still held."""
        p = self.pages
        self._stretches(p.stretches[: p.filled[0]])
        held = self.holdings.ended(p.looks[: p.filled[1]].T, p.held[: p.filled[2]].T, end)
        self.tables.add(
            "reservations", {**self._stretch(held.truck, held.since, held.until), "way": held.way}
        )
        p.filled[:] = 0

    def _stretches(self, rows: Ints) -> None:
        truck, key, since, until = rows.T
        rest = key // len(NAMES)
        self.tables.add("activities", {
            **self._stretch(truck, since, until), "activity": _labels(key % len(NAMES), NAMES),
            "place": _labels(rest % len(self.places), self.places), "task": rest // len(self.places) - 1,
        })  # fmt: skip

    def _stretch(self, truck: Ints, since: Ints, until: Ints) -> Columns:
        return {
            "vehicle_id": _labels(truck, self.vehicles), "start": self.start + 1000 * since,
            "end": self.start + 1000 * until,
        }  # fmt: skip


def _labels(codes: Ints, names: tuple[str, ...]) -> Labels:
    return Labels(codes.astype(np.int32), names)

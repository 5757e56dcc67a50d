"""What each truck does and has reserved, and what becomes of tasks: looked at once a second, no more."""

import numpy as np

from fleetlog.core.trajectory import Labels
from fleetlog.simulate.arrays import Ints
from fleetlog.simulate.dispatch import Dispatcher
from fleetlog.simulate.taskbook import LATER, LEFT_OUT
from fleetlog.simulate.waytable import WayTable
from fleetlog.store.events import ACTIVITIES, Columns
from fleetlog.store.writer import DatasetWriter

NAMES = tuple(ACTIVITIES)
KEPT = 1 << 16
"""Changes of each kind that are kept before they are written; at least as many as a route has pieces."""


class EventLog:
    """Writes the tables of a run that begins at ``start`` [us since 1970]; times inside are ms from there."""

    def __init__(self, dispatcher: Dispatcher, writer: DatasetWriter, start: int) -> None:
        from fleetlog.simulate.kernels.look import Ground, Pages, Seen, Trucks

        self.dispatcher, self.start, self.tables = dispatcher, start, writer.tables
        world, fleet, r = dispatcher.world, dispatcher.fleet, dispatcher.world.roads
        self.vehicles, self.places = tuple(dispatcher.names), tuple(dispatcher.places)
        self.ways = WayTable(world)
        own = {name: getattr(fleet, name) for name in Trucks._fields if name in fleet._fields}
        self.trucks = Trucks(**own, task=dispatcher.book.of, lacks=dispatcher.lacks)
        at_door = dispatcher.place_of[[d.bay for d in world.doors]]
        matters = np.diff(r.conflict_first) > 0
        self.ground = Ground(at_door, matters, len(self.places), r.length, r.clear, r.capacity)
        n, most = len(self.vehicles), fleet.route.shape[1] + 1
        self.seen = Seen(
            np.full(n, -1, np.int64), np.zeros(n, np.int64), np.zeros(n, np.int32), np.full(n, -1, np.int32),
            np.full(n, -1, np.int32), np.zeros(n, np.int32), np.zeros((n, most), np.int32),
            np.zeros((n, most), np.int64), np.zeros(most, np.int32), np.zeros(most, np.int64),
        )  # fmt: skip
        self.pages = Pages(
            np.zeros((KEPT, 4), np.int64), np.zeros((KEPT, 4), np.int64), np.zeros(2, np.int64)
        )

    def tick(self, now: float) -> None:
        """After the decisions of a second; ``now`` [s]."""
        from fleetlog.simulate.kernels.look import look

        ms, v = round(now * 1000.0), 0
        while (v := look(self.trucks, self.ground, self.seen, self.pages, v, ms)) < len(self.vehicles):
            self._write()

    def close(self, now: float) -> None:
        """The end, at ``now`` [s]: what is still done and still held ends here."""
        s, ms, n = self.seen, round(now * 1000.0), len(self.vehicles)
        owner, k = np.nonzero(np.arange(s.way.shape[1]) < s.reserved[:, None])
        still = np.column_stack([owner, s.way[owner, k], s.start[owner, k], np.full(len(owner), ms)])
        self._write(still)
        self._stretches(np.column_stack([np.arange(n), s.key, s.since, np.full(n, ms)]))
        d, book = self.dispatcher, self.dispatcher.book
        book.never(d.pending[d.given :], LATER)
        book.never(d.demand.left_out, LEFT_OUT)
        self.tables.add("tasks", book.columns(self.start))
        self.tables.add("ways", self.ways.table())
        self.tables.add("bays", self._bays())

    def _bays(self) -> Columns:
        world = self.dispatcher.world
        ends = world.ground.first[len(world.track) + 1 : len(world.track) + 1 + len(world.bays)] - 1
        shape = np.round([b.door.path[-1, :3] for b in world.bays], 3).T
        # Four decimals of a half turn are more than a half turn.
        heading = np.clip(np.round(np.angle(np.exp(1j * shape[2])), 4), -3.1415, 3.1415)
        kinds = ("pick", "drop", "park", "charge")
        codes = np.array([kinds.index(b.place.kind) for b in world.bays])
        return {
            "place": _labels(self.dispatcher.place_of, self.places),
            "kind": _labels(codes, kinds),
            "x": shape[0],
            "y": shape[1],
            "z": np.round(world.ground.z[ends], 3),
            "heading": heading,
        }

    def _write(self, still: Ints | None = None) -> None:
        """Empty the pages; reservations that are ``still`` held are written too."""
        p = self.pages
        self._stretches(p.stretches[: p.filled[0]])
        held = p.held[: p.filled[1]] if still is None else np.concatenate([p.held[: p.filled[1]], still])
        truck, way, since, until = held[np.lexsort((held[:, 1], held[:, 0], held[:, 3]))].T
        self.ways.used[way] = True
        self.tables.add("reservations", {**self._stretch(truck, since, until), "way": way})
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

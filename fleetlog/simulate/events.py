"""What each truck does and has reserved, and what becomes of tasks: looked at once a second, no more."""

import numpy as np

from fleetlog.core.arrays import Ints, Mask
from fleetlog.core.trajectory import Labels
from fleetlog.simulate.dispatch import Dispatcher
from fleetlog.simulate.state import CHARGER, STANDS, Mode
from fleetlog.simulate.tasks import LATER, LEFT_OUT
from fleetlog.simulate.watch import holdings
from fleetlog.simulate.world import World
from fleetlog.store.events import ACTIVITIES, WAYS, Columns, Lines
from fleetlog.store.writer import DatasetWriter

NAMES, KINDS = tuple(ACTIVITIES), tuple(WAYS)
KEPT = 300  # Seconds whose changes are kept before they are written


class EventLog:
    """Writes the tables of a run that begins at ``start`` [us since 1970]; times inside are ms from there."""

    def __init__(self, dispatcher: Dispatcher, writer: DatasetWriter, start: int) -> None:
        self.dispatcher, self.start, self.tables = dispatcher, start, writer.tables
        world, trucks = dispatcher.world, len(dispatcher.names)
        self.place_of_door = dispatcher.place_of[[d.bay for d in world.doors]]
        self.matters = np.diff(world.roads.conflict_first) > 0
        """(R,) whether a way, a resource of :mod:`fleetlog.simulate.junctions`, excludes others."""
        self.used = np.zeros(len(self.matters), dtype=bool)
        self.doing, self.since = np.full((3, trucks), -1), np.zeros(trucks, np.int64)
        """(3, V) activity, place and task; and since when."""
        self.held = np.zeros((2, 0), np.int64)  # (2, N) number of truck and way, and since when
        self._stretches: list[Ints] = []
        self._reserved: list[Ints] = []

    def tick(self, now: float) -> None:
        """After the decisions of a second; ``now`` [s]."""
        ms, doing = round(now * 1000.0), self._doing()
        changed = (doing != self.doing).any(axis=0)
        self._end_stretches(changed & (self.since < ms), ms)
        self.doing[:, changed], self.since[changed] = doing[:, changed], ms
        truck, way = holdings(self.dispatcher.world.roads, self.dispatcher.fleet)
        held = np.unique((truck * len(self.matters) + way)[self.matters[way]])
        _, before, still = np.intersect1d(self.held[0], held, assume_unique=True, return_indices=True)
        since = np.full(len(held), ms)
        since[still] = self.held[1, before]
        self._end_reservations(np.delete(self.held, before, axis=1), ms)
        self.held = np.array([held, since])
        if len(self._stretches) == KEPT:
            self._write()

    def close(self, now: float) -> None:
        """The end, at ``now`` [s]: what is still done and still held ends here."""
        d, book, ms = self.dispatcher, self.dispatcher.book, round(now * 1000.0)
        self._end_stretches(self.since < ms, ms)
        self._end_reservations(self.held[:, self.held[1] < ms], ms)
        self._write()
        for status, tasks in ((LATER, d.pending), (LEFT_OUT, d.demand.left_out)):
            for task in tasks:
                book.give(task, status)
        self.tables.add("tasks", book.columns(self.start))
        self.tables.add("ways", way_table(d.world, np.flatnonzero(self.used)))
        self.tables.add("bays", bay_table(d.world))

    def _doing(self) -> Ints:
        """(3, V) what every truck does, the place where it is or goes, and its task, -1: none."""
        d, f = self.dispatcher, self.dispatcher.fleet
        parked, works = f.mode == Mode.PARKED, f.mode == Mode.HANDLING
        # Who has just been sent off has not been kept waiting yet.
        kept_in = (f.mode == Mode.WANTS_OUT) & np.isfinite(f.waits)
        stands = (f.mode == Mode.AT_BAY) | kept_in | ((f.mode == Mode.DRIVING) & (f.v < STANDS))
        first_of = {
            "wait_charger": parked & (d.lacks == CHARGER),
            "wait_place": parked & ((d.lacks > 0) | (d.book.of >= 0)), "park": parked,
            "pick": works & (f.hand_after > 0.0), "drop": works, "charge": f.mode == Mode.CHARGING,
            "battery_empty": f.mode == Mode.EMPTY, "wait": stands, "drive_laden": f.load > 0.0,
        }  # fmt: skip
        does = np.full(len(parked), NAMES.index("drive_empty"))
        for name, which in reversed(first_of.items()):
            does[which] = NAMES.index(name)
        drives = does <= NAMES.index("drive_laden")
        place = self.place_of_door[np.where(drives & (f.goal >= 0), f.goal, f.door)]
        return np.array([does, place, d.book.of])

    def _end_stretches(self, of: Mask, ms: int) -> None:
        truck = np.flatnonzero(of)
        doing = (truck, *self.doing[:, truck], self.since[truck], np.full_like(truck, ms))
        self._stretches.append(np.array(doing))

    def _end_reservations(self, ended: Ints, ms: int) -> None:
        self._reserved.append(np.array([*ended, np.full_like(ended[0], ms)]))

    def _write(self) -> None:
        """Write and forget what has ended."""
        truck, does, place, task, since, until = np.concatenate(self._stretches, axis=1)
        self.tables.add("activities", {
            **self._stretch(truck, since, until), "activity": _labels(does, NAMES),
            "place": _labels(place, tuple(self.dispatcher.places)), "task": task,
        })  # fmt: skip
        held, since, until = np.concatenate(self._reserved, axis=1)
        truck, way = np.divmod(held, len(self.matters))
        self.used[way] = True
        self.tables.add("reservations", {**self._stretch(truck, since, until), "way": way})
        self._stretches, self._reserved = [], []

    def _stretch(self, truck: Ints, since: Ints, until: Ints) -> Columns:
        return {
            "vehicle_id": _labels(truck, tuple(self.dispatcher.names)),
            "start": self.start + 1000 * since, "end": self.start + 1000 * until,
        }  # fmt: skip


def bay_table(world: World) -> Columns:
    """One row a bay."""
    x, y, heading = np.round([b.door.path[-1, :3] for b in world.bays], 3).T
    ends = world.ground.first[len(world.track) + 1 :][: len(world.bays)] - 1
    kinds = ("pick", "drop", "park", "charge")
    return {
        "place": _labels(np.arange(len(world.bays)), tuple(b.place.id for b in world.bays)),
        "kind": _labels(np.array([kinds.index(b.place.kind) for b in world.bays]), kinds),
        "x": x, "y": y, "z": np.round(world.ground.z[ends], 3),
        # Four decimals of a half turn are more than a half turn.
        "heading": np.clip(np.round(np.angle(np.exp(1j * heading)), 4), -3.1415, 3.1415),
    }  # fmt: skip


def way_table(world: World, way: Ints) -> Columns:
    """One row a way, a resource of :mod:`fleetlog.simulate.junctions`: its kind and where it lies."""
    track, doors, pieces, lanes = world.track, world.doors, len(world.roads.length), len(world.roads.clear)
    # In the order of KINDS; ends of lanes lie on the lane, bays on the spur behind the pieces of the track.
    kind = np.searchsorted([lanes, pieces, pieces + lanes, pieces + 2 * lanes], way, side="right")
    piece = way - np.array([0, 0, pieces, pieces + lanes, 2 * lanes])[kind]
    turn, bay = kind == KINDS.index("turn"), kind == KINDS.index("bay")
    joint, door = np.where(turn, piece, 0), np.where(bay, piece - pieces, 0)
    lane, of_bay = np.array([(d.lane, d.bay) for d in doors])[door].T
    edge = np.where(bay, lane, np.where(turn, track.source[joint], piece))
    edges = track.network.edge_ids
    return {
        "way": way, "kind": _labels(kind, KINDS), "edge_id": _labels(edge, edges),
        "to_edge": _labels(np.where(turn, track.target[joint], -1), edges),
        "place": _labels(np.where(bay, of_bay, -1), tuple(b.place.id for b in world.bays)),
        **_lines(world, kind, piece),
    }  # fmt: skip


def _lines(world: World, kind: Ints, piece: Ints) -> dict[str, Lines]:
    """Middle lines, to the millimetre; of the ends of a lane as far as the next sample."""
    g, r = world.ground, world.roads
    first, last, step = g.first[piece], g.first[piece + 1] - 1, g.spacing[piece]
    leaves, enters = kind == KINDS.index("exit"), kind == KINDS.index("entry")
    lane = np.where(leaves | enters, piece, 0)
    stop, clear = np.floor(r.stop[lane] / step).astype(int), np.ceil(r.clear[lane] / step).astype(int)
    last = np.where(enters, np.minimum(first + np.maximum(clear, 1), last), last)
    first = np.where(leaves, np.minimum(first + stop, last - 1), first)
    every = np.concatenate([np.arange(a, b + 1) for a, b in zip(first, last, strict=True)] or [first])
    return {axis: Lines(np.round(getattr(g, axis)[every], 3), last - first + 1) for axis in "xyz"}


def _labels(codes: Ints, names: tuple[str, ...]) -> Labels:
    return Labels(codes.astype(np.int32), names)

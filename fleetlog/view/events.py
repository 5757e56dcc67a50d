"""Tasks, reservations, charging and activities in a recording of a simulation.

Signal first, vehicle second, as for everything else::

    PREFIX/tasks/ID        an arc from source to target: dashed while the truck fetches the load, then whole
    PREFIX/tasks/waiting   arcs of tasks that no truck has taken
    PREFIX/reserved/ID     the pieces of road that only this truck may be on
    PREFIX/charging/...    rings and a bolt at a charger while a truck charges there
    PREFIX/state/ID        what the truck does, over time
    PREFIX/activity/NAME   trucks that do this, and PREFIX/open/NAME open tasks by stage, as curves

Large fleets have no arcs, which would hide the floor, one entity for all reservations, curves for states."""

import itertools
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import rerun as rr

from fleetlog.core.arrays import DataFrame, Floats, Ints
from fleetlog.core.network import reduced
from fleetlog.core.site import Place, PlaceKind
from fleetlog.store import Dataset
from fleetlog.store.events import ACTIVITIES, TABLES, read_table
from fleetlog.view import palette, ribbons
from fleetlog.view.clock import OneDay
from fleetlog.view.fleet import Lane, curve_style, log_curve
from fleetlog.view.palette import Colour
from fleetlog.view.scene import log_places
from fleetlog.view.stream import Stream, entity, ui_points

NEVER = np.iinfo(np.int64).max  # A time that has not come [us]
TRUE, CORNERS = 0.08, 4  # How true ways are drawn for a small fleet [m], and points of each for a large one
STATES = 20  # Trucks up to which each has a lane of its states
STEP = 2_000_000  # Between two rows of the reservations of a large fleet [us]
BLOCK = 200_000  # Lines held in memory at once
MOST_WAITING = 60  # Arcs of waiting tasks that are drawn at most
CURVE_POINTS = 120  # Of a curve, each a mean over the time to the next: of a long shift it were else a band
FLOOR, UP = np.array([0.0, 0.0, 0.14]), np.array([0.0, 0.0, 0.6])  # Reservations, arcs' ends: height [m]


@dataclass(frozen=True)
class Happenings:
    """What a simulated dataset says beside its rows. The tables ``tasks``, ``activities`` and
    ``reservations`` with times [us, int64], ``NEVER`` where not reached; ``spots`` x, y, z [m] by place;
    ``lines`` (n, 3) m by way; ``drawn`` places that the simulation drew along the roads."""

    tasks: DataFrame
    activities: DataFrame
    reservations: DataFrame
    spots: DataFrame
    lines: dict[int, Floats]
    drawn: tuple[Place, ...]

    def where(self, table: DataFrame, column: str) -> Floats:
        """(N, 3) m of the places that a column names, NaN where none."""
        return self.spots.reindex(table[column].astype(object)).to_numpy(np.float64)


def happenings_of(dataset: Dataset, shift: int) -> Happenings | None:
    """None for a dataset without them; times are moved by ``shift`` [us]."""
    tasks, doing, held, ways, bays = (read_table(dataset, name, compact=True) for name in TABLES)
    if tasks is None or doing is None or held is None or ways is None or bays is None:
        return None
    first, last = (isinstance(dataset, OneDay) and dataset.span) or (-NEVER, NEVER)

    def clocked(table: DataFrame) -> DataFrame:
        """What lies outside the time that is shown is moved to its ends."""
        columns = table.select_dtypes("datetimetz")
        times = {str(c): columns[c].dt.tz_localize(None).to_numpy("datetime64[us]") for c in columns}
        moved = {c: np.clip(t.astype(np.int64), first, last) + shift for c, t in times.items()}
        return table.assign(**{c: np.where(np.isnat(times[c]), NEVER, t) for c, t in moved.items()})

    doing, held = (t[t["end"] > t["start"]] for t in map(clocked, (doing, held)))
    spots = bays.groupby("place", observed=True)[["x", "y", "z"]].mean()
    shapes = zip(*(ways[c] for c in "xyz"), strict=True)
    lines = {int(way): np.column_stack(shape) for way, shape in zip(ways["way"], shapes, strict=True)}
    known = {p.id for p in dataset.site.places}
    rows = zip(bays["place"].astype(str), bays["kind"].astype(str), bays["x"], bays["y"], strict=True)
    drawn = tuple(Place(name, cast(PlaceKind, kind), *xy) for name, kind, *xy in rows if name not in known)
    given = clocked(tasks[tasks["status"] != "left out"])
    return Happenings(given, doing, held, spots.set_axis(spots.index.astype(str)), lines, drawn)


def rows_while(times: Ints, start: Ints, end: Ints) -> tuple[Ints, Ints]:
    """Row and stretch wherever one of the sorted ``times`` lies from ``start`` to before ``end``, by row."""
    first, last = np.searchsorted(times, start), np.searchsorted(times, end)
    count = np.maximum(last - first, 0)
    stretch = np.repeat(np.arange(len(start)), count)
    row = np.arange(len(stretch)) + np.repeat(first - (np.cumsum(count) - count), count)
    order = np.argsort(row, kind="stable")
    return row[order], stretch[order]


def log_events(stream: Stream, h: Happenings, lanes: list[Lane]) -> set[str]:
    """Those of a small fleet; the kinds that were drawn."""
    log_places(stream, h.drawn, "drawn", labels=False)
    name = lanes[0].fleet.name
    _log_tasks(stream, h, lanes, entity(name, "tasks", "waiting"))
    lines = {way: reduced(line, TRUE) + FLOOR for way, line in h.lines.items()}
    for lane in lanes:
        mine = h.reservations[h.reservations["vehicle_id"] == lane.vehicle]
        path, dim = lane.path("reserved"), palette.faded(lane.colour, 0.55, palette.ROAD)
        stream.static(path, rr.LineStrips3D.from_fields(radii=0.95, colors=[dim]))
        _log_stretches(stream, path, mine["start"], mine["end"], [[lines[w]] for w in mine["way"]])
    found = {"tasks", "reserved"} | _log_charging(stream, h, name)
    few = len(lanes) <= STATES
    for lane in lanes if few else ():
        mine = h.activities[h.activities["vehicle_id"] == lane.vehicle]
        mine, path = mine.sort_values("start"), lane.path("state")
        # Colours as numbers: in a plain list they could be taken for something else.
        colours = np.array([[*palette.ACTIVITIES[a], 255] for a in ACTIVITIES], np.uint8)
        labels = [a.replace("_", " ") for a in ACTIVITIES]
        stream.static(path, rr.StateConfiguration(values=list(ACTIVITIES), labels=labels, colors=colours))
        states = mine["activity"].astype(str)
        changed = (states != states.shift()).to_numpy()
        stream.rows(path, mine["start"].to_numpy()[changed], rr.StateChange, state=states[changed].tolist())
    return found | ({"state"} if few else set()) | _log_curves(stream, h, name, activity=not few)


def log_many(stream: Stream, h: Happenings, name: str) -> set[str]:
    """Those of a large fleet."""
    found = _log_charging(stream, h, name) | _log_curves(stream, h, name, activity=True)
    path, held = entity(name, "reserved", "fleet"), h.reservations
    stream.static(path, rr.LineStrips3D.from_fields(radii=0.7, colors=[palette.RESERVED]))
    if not len(held):
        return found
    corners = (line[np.linspace(0, len(line) - 1, CORNERS).astype(int)] for line in h.lines.values())
    lines = np.array([c + FLOOR for c in corners], np.float32)
    way = np.searchsorted(np.array(list(h.lines)), held["way"])
    times = np.arange(held["start"].min(), held["end"].max() + STEP, STEP)
    row, which = rows_while(times, held["start"].to_numpy(), held["end"].to_numpy())
    lengths = np.bincount(row, minlength=len(times))
    for rows in np.array_split(np.arange(len(times)), min(len(row) // BLOCK + 1, len(times))):
        shown = slice(*np.searchsorted(row, [rows[0], rows[-1] + 1]))
        stream.rows(path, times[rows], rr.LineStrips3D, lengths[rows], strips=lines[way[which[shown]]])
    return found | {"reserved"}


def _log_stretches(
    stream: Stream, path: str, start: Any, end: Any, lines: Sequence[Sequence[Floats]],
    colours: Sequence[Colour] = (), most: int = sys.maxsize,
) -> None:  # fmt: skip
    """At every change the ``lines`` of the stretches of time then open, of these the ``most`` oldest;
    ``colours`` are those of the lines of each stretch, where they differ."""
    start, end = np.asarray(start), np.asarray(end)
    times = np.setdiff1d(np.concatenate([start, end]), [NEVER])
    row, which = rows_while(times, start, end)
    shown = np.arange(len(row)) - np.searchsorted(row, row) < most
    row, which = row[shown], which[shown]
    parts = np.array([len(strips) for strips in lines], np.int64)
    lengths = np.bincount(row, weights=parts[which], minlength=len(times)).astype(np.int64)
    strips = [np.asarray(s, np.float32) for k in which.tolist() for s in lines[k]]
    more = {"colors": np.tile(np.array(colours, np.uint8), (len(which), 1))} if colours else {}
    stream.rows(path, times, rr.LineStrips3D, lengths, strips=strips, **more)


def _log_tasks(stream: Stream, h: Happenings, lanes: list[Lane], path: str) -> None:
    """Arcs: dashes while the load is fetched, then whole; of waiting tasks, those that wait longest."""
    source, target = h.where(h.tasks, "from_place") + UP, h.where(h.tasks, "to_place") + UP
    known = np.isfinite(source).all(axis=1) & np.isfinite(target).all(axis=1)
    tasks, ends = h.tasks[known], list(zip(source[known], target[known], strict=True))
    dashes = [ribbons.broken(*e) for e in ends]
    late = np.flatnonzero(tasks["assigned"] > tasks["earliest"])
    stream.static(path, rr.LineStrips3D.from_fields(radii=ui_points(0.8), colors=[palette.WAITING]))
    waiting, arcs = tasks.iloc[late], [dashes[k] for k in late]
    _log_stretches(stream, path, waiting["earliest"], waiting["assigned"], arcs, most=MOST_WAITING)
    for lane in lanes:
        path, which = lane.path("tasks"), np.flatnonzero(tasks["vehicle_id"] == lane.vehicle)
        stream.static(path, rr.LineStrips3D.from_fields(radii=ui_points(1.1), colors=[lane.colour]))
        mine, whole = tasks.iloc[which], [ribbons.arc(*ends[k]) for k in which]
        fetched = [[*dashes[k], ribbons.head(line)] for k, line in zip(which, whole, strict=True)]
        lines = [*fetched, *([line, ribbons.head(line)] for line in whole)]
        stages = mine[["assigned", "picked", "dropped"]].to_numpy()
        _log_stretches(stream, path, stages[:, :2].T.ravel(), stages[:, 1:].T.ravel(), lines)


def _log_charging(stream: Stream, h: Happenings, name: str) -> set[str]:
    """Rings that fade outwards and a bolt, one set at every place where a truck charges."""
    mine = h.activities[h.activities["activity"] == "charge"]
    where = h.where(mine, "place")
    mine, where = mine[np.isfinite(where[:, 0])], where[np.isfinite(where[:, 0])]
    if not len(mine):
        return set()
    path = entity(name, "charging")
    stream.static(path, rr.LineStrips3D.from_fields(radii=ui_points(2.2)))
    glow = [*(ribbons.ring(r, 0.15) for r in (2.1, 2.7, 3.3)), ribbons.bolt(1.5, 5.4)]
    tints = [palette.faded(palette.CHARGING, share) for share in (1.0, 0.65, 0.35, 1.0)]
    _log_stretches(stream, path, mine["start"], mine["end"], [[g + at for g in glow] for at in where], tints)
    return {"charging"}


def _log_curves(stream: Stream, h: Happenings, name: str, *, activity: bool) -> set[str]:
    """Open tasks by stage, and with ``activity`` the trucks by what they do, in means."""
    first, last = int(h.activities["start"].min()), int(h.activities["end"].max())
    edges = np.linspace(first, last, min(CURVE_POINTS, (last - first) // 1_000_000) + 1).astype(np.int64)
    moments = itertools.pairwise(h.tasks[["earliest", "assigned", "picked", "dropped"]].to_numpy().T)
    curves = {("open", stage): ends for stage, ends in zip(palette.STAGES, moments, strict=True)}
    for doing, rows in h.activities.groupby("activity", observed=True) if activity else ():
        curves["activity", str(doing)] = rows["start"].to_numpy(), rows["end"].to_numpy()
    for (signal, curve), (start, end) in curves.items():
        # How many there are on average between each two of the edges.
        shared = [(np.clip(end, a, b) - np.clip(start, a, b)).sum() for a, b in itertools.pairwise(edges)]
        if (number := np.asarray(shared / np.diff(edges))).any():
            path, title = entity(name, signal, curve), f"{name} {curve.replace('_', ' ')}".strip()
            tint = (palette.STAGES if signal == "open" else palette.ACTIVITIES)[curve]
            log_curve(stream, path, edges[:-1], number, curve_style(title, tint, steps=True))
    return {"open", "activity"} if activity else {"open"}

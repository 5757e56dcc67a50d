"""Tasks, reservations, charging and activities in a recording of a simulation.

Signal first, vehicle second, as for everything else::

    PREFIX/tasks/ID        an arc from source to target: dashed while the truck fetches the load, then whole
    PREFIX/tasks/waiting   arcs of tasks that no truck has taken
    PREFIX/reserved/ID     the pieces of road that only this truck may be on
    PREFIX/charging/...    rings and a bolt at a charger while a truck charges there
    PREFIX/state/ID        what the truck does, over time
    PREFIX/activity/NAME   trucks that do this, and PREFIX/open/NAME open tasks by stage, as curves

Large fleets have no arcs, which would hide the floor, one entity for all reservations, and curves in place of
states.
"""

from collections.abc import Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from fleetlog.core.trajectory import Floats, Ints
from fleetlog.roads.segments import reduced
from fleetlog.store.events import ACTIVITIES
from fleetlog.view import marks, palette
from fleetlog.view.fleet import curve_style, log_curve
from fleetlog.view.happenings import NEVER, Happenings, Tasks, counts, open_tasks, rows_while
from fleetlog.view.palette import Colour
from fleetlog.view.scene import log_places
from fleetlog.view.stream import Stream, entity, ui_points

TRUE, CORNERS = 0.08, 4
"""How true ways are drawn for a small fleet [m], and points of each for a large one."""
STATES = 20
"""Trucks up to which each has a lane of its states."""
STEP = 2_000_000
"""Between two rows of the reservations of a large fleet [us]."""
BLOCK = 200_000
"""Lines held in memory at once."""
MOST_WAITING = 60
"""Arcs of waiting tasks that are drawn at most."""
CURVE_POINTS = 120
"""Of a curve, each a mean over the time to the next: trucks of a long shift would else make a band of it."""
FLOOR, UP = np.array([0.0, 0.0, 0.14]), np.array([0.0, 0.0, 0.6])
"""Reservations lie, and arcs end, so much over the ground [m]."""
Strips = list[Floats]


def log_events(
    stream: Stream, h: Happenings, vehicles: Sequence[str], colours: Sequence[Colour], prefix: str, name: str
) -> set[str]:
    """Those of a small fleet; the kinds that were drawn."""
    log_places(stream, h.spots, "drawn", labels=False)
    _log_waiting(stream, h.tasks, entity(prefix, "tasks", "waiting"))
    lines = {way: reduced(line, TRUE) + FLOOR for way, line in h.lines.items()}
    for vehicle, colour in zip(vehicles, colours, strict=True):
        _log_tasks(stream, h.tasks, vehicle, colour, entity(prefix, "tasks", vehicle))
        _log_reserved(stream, h, lines, vehicle, colour, entity(prefix, "reserved", vehicle))
    found = {"tasks", "reserved"} | _log_charging(stream, h, entity(prefix, "charging"))
    few = len(vehicles) <= STATES
    for vehicle in vehicles if few else ():
        _log_state(stream, h, vehicle, entity(prefix, "state", vehicle))
    return found | ({"state"} if few else set()) | _log_curves(stream, h, prefix, name, activity=not few)


def log_many(stream: Stream, h: Happenings, prefix: str, name: str) -> set[str]:
    """Those of a large fleet."""
    found = _log_charging(stream, h, entity(prefix, "charging"))
    found |= _log_curves(stream, h, prefix, name, activity=True)
    path = entity(prefix, "reserved", "fleet")
    stream.static(path, rr.LineStrips3D.from_fields(radii=0.7, colors=[palette.RESERVED]))
    if not len(h.way):
        return found
    corners = (line[np.linspace(0, len(line) - 1, CORNERS).astype(int)] for line in h.lines.values())
    lines = np.array([c + FLOOR for c in corners])
    way = np.searchsorted(np.array(list(h.lines)), h.way)
    times = np.arange(h.held_from.min(), h.held_to.max() + STEP, STEP)
    row, held = rows_while(times, h.held_from, h.held_to)
    lengths = np.bincount(row, minlength=len(times))
    ends = np.cumsum(lengths)
    for first, last in _blocks(ends):
        begin = int(ends[first - 1]) if first else 0
        strips = lines[way[held[begin : int(ends[last - 1])]]].astype(np.float32)
        stream.parts(path, times[first:last], lengths[first:last], rr.LineStrips3D, strips=strips)
    return found | {"reserved"}


def _blocks(ends: Ints) -> list[tuple[int, int]]:
    """Runs of rows with no more than ``BLOCK`` lines each, unless one row has more."""
    out, first = [], 0
    while first < len(ends):
        done = int(ends[first - 1]) if first else 0
        last = max(int(np.searchsorted(ends, done + BLOCK, side="right")), first + 1)
        out.append((first, last))
        first = last
    return out


def _log_stretches(
    stream: Stream, path: str, start: Ints, end: Ints, lines: Sequence[Strips], most: int,
    colours: Sequence[Colour] = (),
) -> None:  # fmt: skip
    """At every change the ``lines`` of the stretches of time then open; of these the ``most`` oldest.

    ``colours`` are those of the lines of each stretch, where they differ.
    """
    times = np.unique(np.concatenate([start, end[end != NEVER]]))
    row, which = rows_while(times, start, end)
    shown = np.arange(len(row)) - np.searchsorted(row, row) < most
    row, which = row[shown], which[shown]
    parts = np.array([len(strips) for strips in lines], np.int64)
    lengths = np.bincount(row, weights=parts[which], minlength=len(times)).astype(np.int64)
    strips = [np.asarray(s, np.float32) for k in which.tolist() for s in lines[k]]
    more = {"colors": np.tile(np.array(colours, np.uint8), (len(which), 1))} if colours else {}
    stream.parts(path, times, lengths, rr.LineStrips3D, strips=strips, **more)


def _log_tasks(stream: Stream, t: Tasks, vehicle: str, colour: Colour, path: str) -> None:
    """Nothing, dashes or the whole arc from each change on."""
    stream.static(path, rr.LineStrips3D.from_fields(radii=ui_points(1.1), colors=[colour]))
    known = np.isfinite(t.target).all(axis=1) & np.isfinite(t.source).all(axis=1)
    changes: list[tuple[int, Strips]] = []
    for k in np.flatnonzero((t.vehicle == vehicle) & known):
        ends = t.source[k] + UP, t.target[k] + UP
        line = marks.arc(*ends)
        tip = marks.head(line)
        changes.append((int(t.assigned[k]), [*marks.broken(*ends), tip]))
        changes.append((int(t.picked[k]), [line, tip]))
        changes.append((int(t.dropped[k]), []))
    changes = sorted((c for c in changes if c[0] != NEVER), key=lambda c: c[0])
    time = np.array([when for when, _ in changes], np.int64)
    lengths = np.array([len(strips) for _, strips in changes], np.int64)
    lines = [s.astype(np.float32) for _, strips in changes for s in strips]
    stream.parts(path, time, lengths, rr.LineStrips3D, strips=lines)


def _log_waiting(stream: Stream, t: Tasks, path: str) -> None:
    """Arcs; of more than can be told apart, of the tasks that have waited longest."""
    late = (t.assigned > t.earliest) & (t.earliest != NEVER)
    waits = np.flatnonzero(late & np.isfinite(t.target).all(axis=1))
    stream.static(path, rr.LineStrips3D.from_fields(radii=ui_points(0.8), colors=[palette.WAITING]))
    arcs = [marks.broken(t.source[k] + UP, t.target[k] + UP) for k in waits]
    _log_stretches(stream, path, t.earliest[waits], t.assigned[waits], arcs, MOST_WAITING)


def _log_reserved(
    stream: Stream, h: Happenings, lines: dict[int, Floats], vehicle: str, colour: Colour, path: str
) -> None:
    mine = np.flatnonzero(h.held_by == vehicle)
    dim = palette.faded(colour, 0.55, palette.ROAD)
    stream.static(path, rr.LineStrips3D.from_fields(radii=0.95, colors=[dim]))
    ways = [[lines[w]] for w in h.way[mine].tolist()]
    _log_stretches(stream, path, h.held_from[mine], h.held_to[mine], ways, len(mine))


def _log_charging(stream: Stream, h: Happenings, path: str) -> set[str]:
    """Rings that fade outwards and a bolt, one set at every place where a truck charges."""
    mine = np.flatnonzero((h.doing == "charge") & np.isfinite(h.where).all(axis=1))
    if not len(mine):
        return set()
    stream.static(path, rr.LineStrips3D.from_fields(radii=ui_points(2.2)))
    glow = [*(marks.ring(r, 0.15) for r in (2.1, 2.7, 3.3)), marks.bolt(1.5, 5.4)]
    tints = [palette.faded(palette.CHARGING, share) for share in (1.0, 0.65, 0.35, 1.0)]
    lines = [[g + where for g in glow] for where in h.where[mine]]
    _log_stretches(stream, path, h.start[mine], h.end[mine], lines, len(mine), tints)
    return {"charging"}


def _log_state(stream: Stream, h: Happenings, vehicle: str, path: str) -> None:
    mine = np.flatnonzero(h.who == vehicle)
    mine = mine[np.argsort(h.start[mine])]
    names = list(ACTIVITIES)
    # Colours as numbers: in a plain list they could be taken for something else.
    colours = np.array([[*palette.ACTIVITIES[a], 255] for a in names], np.uint8)
    labels = [a.replace("_", " ") for a in names]
    stream.static(path, rr.StateConfiguration(values=names, labels=labels, colors=colours))
    states: NDArray[np.object_] = h.doing[mine]
    changed = np.flatnonzero(np.append(True, states[1:] != states[:-1])[: len(states)])
    stream.columns(path, h.start[mine][changed], rr.StateChange, state=states[changed].tolist())


def _log_curves(stream: Stream, h: Happenings, prefix: str, name: str, *, activity: bool) -> set[str]:
    """Open tasks by stage, and with ``activity`` the trucks by what they do."""
    first, last = int(h.start.min()), int(h.end.max())
    edges = np.linspace(first, last, min(CURVE_POINTS, (last - first) // 1_000_000) + 1).astype(np.int64)
    curves = {"open": (open_tasks(h.tasks, edges), palette.STAGES)}
    if activity:
        curves["activity"] = counts(h, edges), palette.ACTIVITIES
    for signal, (numbers, colours) in curves.items():
        for curve, n in numbers.items():
            path, title = entity(prefix, signal, curve), f"{name} {curve.replace('_', ' ')}".strip()
            stream.static(path, curve_style(title, colours[curve], steps=True))
            log_curve(stream, path, edges[:-1], n)
    return set(curves)

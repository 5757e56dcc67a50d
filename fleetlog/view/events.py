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

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from fleetlog.core.trajectory import Floats, Ints
from fleetlog.store.events import ACTIVITIES
from fleetlog.view import marks, palette, thin
from fleetlog.view.fleet import log_curve
from fleetlog.view.happenings import NEVER, Happenings, Tasks, counts, open_tasks, rows_while
from fleetlog.view.palette import Colour
from fleetlog.view.scene import log_places
from fleetlog.view.stream import Stream, entity

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
    _log_waiting(stream, h.tasks, prefix)
    lines = {way: marks.reduced(line, TRUE) + FLOOR for way, line in h.lines.items()}
    for vehicle, colour in zip(vehicles, colours, strict=True):
        _log_tasks(stream, h.tasks, vehicle, colour, prefix)
        _log_reserved(stream, h, lines, vehicle, colour, prefix)
    found = {"tasks", "reserved"} | _log_charging(stream, h, prefix)
    if len(vehicles) <= STATES:
        for vehicle in vehicles:
            _log_state(stream, h, vehicle, prefix)
        return found | {"state"} | _log_curves(stream, h, prefix, name, activity=False)
    return found | _log_curves(stream, h, prefix, name, activity=True)


def log_many(stream: Stream, h: Happenings, prefix: str, name: str) -> set[str]:
    """Those of a large fleet."""
    found = _log_charging(stream, h, prefix) | _log_curves(stream, h, prefix, name, activity=True)
    path = entity(prefix, "reserved", "fleet")
    stream.static(path, rr.LineStrips3D.from_fields(radii=0.7, colors=[palette.RESERVED]))
    if not len(h.way):
        return found
    lines = np.array(
        [line[np.linspace(0, len(line) - 1, CORNERS).astype(int)] + FLOOR for line in h.lines.values()]
    )
    way = np.searchsorted(np.array(list(h.lines)), h.way)
    times = np.arange(h.held_from.min(), h.held_to.max() + STEP, STEP)
    row, held = rows_while(times, h.held_from, h.held_to)
    lengths = np.bincount(row, minlength=len(times))
    ends = np.cumsum(lengths)
    for first, last in _blocks(ends):
        begin = int(ends[first - 1]) if first else 0
        strips = lines[way[held[begin : int(ends[last - 1])]]].astype(np.float32)
        stream.parts(path, times[first:last], lengths[first:last], partial(_columns, strips))
    return found | {"reserved"}


def _columns(strips: NDArray[np.float32], rows: slice) -> Any:
    return rr.LineStrips3D.columns(strips=strips[rows])


def _blocks(ends: Ints) -> list[tuple[int, int]]:
    """Runs of rows with no more than ``BLOCK`` lines each, unless one row has more."""
    out, first = [], 0
    while first < len(ends):
        done = int(ends[first - 1]) if first else 0
        last = max(int(np.searchsorted(ends, done + BLOCK, side="right")), first + 1)
        out.append((first, last))
        first = last
    return out


def _strips(
    stream: Stream, path: str, time: Ints, lengths: Ints, strips: Strips, colours: list[Colour] | None = None
) -> None:
    """Lines over time, ``lengths`` of them a row; ``colours`` one a line where they differ."""
    more = {} if colours is None else {"colors": np.array(colours, np.uint8).reshape(-1, 3)}

    def columns(rows: slice) -> Any:
        lines = [np.asarray(s, dtype=np.float32) for s in strips[rows]]
        return rr.LineStrips3D.columns(strips=lines, **{k: v[rows] for k, v in more.items()})

    stream.parts(path, time, lengths, columns)


def _log_tasks(stream: Stream, t: Tasks, vehicle: str, colour: Colour, prefix: str) -> None:
    """Nothing, dashes or the whole arc from each change on."""
    path = entity(prefix, "tasks", vehicle)
    stream.static(path, rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(1.1), colors=[colour]))
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
    _log_changes(stream, path, changes)


def _log_changes(stream: Stream, path: str, changes: list[tuple[int, Strips]]) -> None:
    time = np.array([c[0] for c in changes], np.int64)
    lengths = np.array([len(c[1]) for c in changes], np.int64)
    _strips(stream, path, time, lengths, [s for c in changes for s in c[1]])


def _log_waiting(stream: Stream, t: Tasks, prefix: str) -> None:
    waits = np.flatnonzero(
        (t.assigned > t.earliest) & (t.earliest != NEVER) & np.isfinite(t.target).all(axis=1)
    )
    path = entity(prefix, "tasks", "waiting")
    stream.static(path, rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(0.8), colors=[palette.WAITING]))
    start, end = t.earliest[waits], t.assigned[waits]
    times = np.unique(np.concatenate([start, end[end != NEVER]]))
    row, task = rows_while(times, start, end)
    # Of more than can be told apart, those that have waited longest.
    rank = np.arange(len(row)) - np.searchsorted(row, row)
    row, task = row[rank < MOST_WAITING], task[rank < MOST_WAITING]
    arcs = [marks.broken(t.source[k] + UP, t.target[k] + UP) for k in waits]
    parts = np.array([len(a) for a in arcs], np.int64)
    lengths = np.bincount(row, weights=parts[task], minlength=len(times)).astype(np.int64)
    _strips(stream, path, times, lengths, [s for k in task.tolist() for s in arcs[k]])


def _log_reserved(
    stream: Stream, h: Happenings, lines: dict[int, Floats], vehicle: str, colour: Colour, prefix: str
) -> None:
    mine = np.flatnonzero(h.held_by == vehicle)
    path = entity(prefix, "reserved", vehicle)
    stream.static(
        path, rr.LineStrips3D.from_fields(radii=0.95, colors=[palette.faded(colour, 0.55, palette.ROAD)])
    )
    start, end = h.held_from[mine], h.held_to[mine]
    times = np.unique(np.concatenate([start, end]))
    row, held = rows_while(times, start, end)
    strips = [lines[w] for w in h.way[mine[held]].tolist()]
    _strips(stream, path, times, np.bincount(row, minlength=len(times)), strips)


def _log_charging(stream: Stream, h: Happenings, prefix: str) -> set[str]:
    """Rings that fade outwards and a bolt, one set at every place where a truck charges."""
    mine = np.flatnonzero((h.doing == "charge") & np.isfinite(h.where).all(axis=1))
    if not len(mine):
        return set()
    path = entity(prefix, "charging")
    stream.static(path, rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(2.2)))
    rings = [marks.ring(r, 0.15) for r in (2.1, 2.7, 3.3)]
    glow = [*rings, marks.bolt(1.5, 5.4)]
    tints = [palette.faded(palette.CHARGING, share) for share in (1.0, 0.65, 0.35)] + [palette.CHARGING]
    start, end = h.start[mine], h.end[mine]
    times = np.unique(np.concatenate([start, end]))
    row, visit = rows_while(times, start, end)
    strips = [g + h.where[mine[k]] for k in visit.tolist() for g in glow]
    lengths = np.bincount(row, minlength=len(times)) * len(glow)
    _strips(stream, path, times, lengths, strips, tints * len(visit))
    return {"charging"}


def _log_state(stream: Stream, h: Happenings, vehicle: str, prefix: str) -> None:
    mine = np.flatnonzero(h.who == vehicle)
    mine = mine[np.argsort(h.start[mine])]
    path = entity(prefix, "state", vehicle)
    names = list(ACTIVITIES)
    # Colours as numbers: in a plain list they could be taken for something else.
    colours = np.array([[*palette.ACTIVITIES[a], 255] for a in names], np.uint8)
    stream.static(
        path, rr.StateConfiguration(values=names, labels=[a.replace("_", " ") for a in names], colors=colours)
    )
    states = h.doing[mine].tolist()
    changed = [k for k, a in enumerate(states) if k == 0 or a != states[k - 1]]
    time, kept = h.start[mine][changed], [states[k] for k in changed]
    stream.columns(path, time, lambda rows: rr.StateChange.columns(state=kept[rows]))


def _log_curves(stream: Stream, h: Happenings, prefix: str, name: str, *, activity: bool) -> set[str]:
    """Open tasks by stage, and with ``activity`` the trucks by what they do."""
    first, last = int(h.start.min()), int(h.end.max())
    edges = np.linspace(first, last, min(CURVE_POINTS, (last - first) // 1_000_000) + 1).astype(np.int64)
    curves: list[tuple[str, str, Floats, Colour]] = [
        ("open", stage, n, palette.STAGES[stage]) for stage, n in open_tasks(h.tasks, edges).items()
    ]
    if activity:
        curves += [("activity", a, n, palette.ACTIVITIES[a]) for a, n in counts(h, edges).items()]
    for signal, curve, n, colour in curves:
        path = entity(prefix, signal, curve)
        stream.static(path, _steps(f"{name} {curve.replace('_', ' ')}".strip(), colour))
        keep = thin.runs_collapsed(n)
        log_curve(stream, path, edges[:-1][keep], n[keep])
    return {"open", "activity"} if activity else {"open"}


def _steps(name: str, colour: Colour) -> rr.SeriesLines:
    raw = rr.components.AggregationPolicy.Off
    return rr.SeriesLines(
        names=name, colors=colour, widths=1.6, aggregation_policy=raw, interpolation_mode="StepAfter"
    )

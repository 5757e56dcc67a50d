"""Trucks in a recording, one set of entities a vehicle: body, forks, load, SOC bar, trail and curves.

Paths have the signal first and the vehicle second, because a view's filter knows only a trailing ``/**``::

    PREFIX/trucks/ID            moves with the truck            PREFIX/speed/ID    m/s
    PREFIX/trucks/ID/body/...   turns with it; fork, load       PREFIX/power/ID    kW
    PREFIX/trucks/ID/soc        bar of the state of charge      PREFIX/soc/ID      %
    PREFIX/trail/ID             where it was                    PREFIX/geo/ID      on the map
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr

from fleetlog.core.site import Site
from fleetlog.core.trajectory import Floats, Ints, Trajectory
from fleetlog.view import palette, thin
from fleetlog.view.meshes import LOAD_CENTRE, LOAD_HALF, truck_body, truck_fork
from fleetlog.view.palette import Colour
from fleetlog.view.scene import mesh3d
from fleetlog.view.stream import Stream, entity

CURVES = {"speed": ("speed", 1.0), "battery_power": ("power", 1e-3), "soc": ("soc", 100.0)}
"""Trajectory column: (signal in the recording, factor to its unit: m/s, kW, %)."""
BAR_HALF, BAR_UP, BAR_NORTH = 1.6, 3.4, 2.2
TRAIL_STEP = 4
SOC_RATE = 0.2
"""Samples a second of the SOC curve at most."""
STEP = 0.03
"""A truck is drawn anew when it has moved this far [m]: less is noise that nobody sees."""
FAR_FROM_FLOOR = 10.0
"""[m]"""
MIN_LOAD = 1.0
"""Payload [kg] above which a load is drawn."""


@dataclass
class Lane:
    """One vehicle in the recording: where its entities are, and what was written last."""

    vehicle: str
    colour: Colour
    prefix: str = ""
    fleet: str = ""
    """Said behind the vehicle where curves of two fleets share a plot."""
    origin: int | None = None
    """Start of the recording [us]; a vehicle that comes later is not shown before."""
    last: int | None = None

    def path(self, signal: str, *more: str) -> str:
        """Path of one of the vehicle's entities."""
        return entity(self.prefix, signal, self.vehicle, *more)


def quaternions(heading: Floats) -> Floats:
    """(N, 4) xyzw of turns about the vertical [rad]."""
    zero = np.zeros_like(heading)
    return np.column_stack([zero, zero, np.sin(heading / 2), np.cos(heading / 2)])


def heights(t: Trajectory, site: Site) -> Floats:
    """Height at which every row is drawn [m]: the road's where it is matched to one, else as recorded.

    A recorded height that is far from the site's floor is one above the sea or of another datum; such a truck
    is drawn on the floor.
    """
    z = t.floats("z")
    known = np.isfinite(z)
    z = (
        np.nan_to_num(z)
        if known.any() and np.median(np.abs(z[known])) <= FAR_FROM_FLOOR
        else np.zeros(len(t))
    )
    if site.network is not None:
        edge, offset = t.labels("edge_id").recode(site.network.index), t.floats("edge_offset")
        on = (edge >= 0) & np.isfinite(offset)
        z[on] = site.network.position(edge[on], offset[on])[:, 2]
    return z


def log_static(stream: Stream, lane: Lane, signals: set[str]) -> None:
    """Meshes, and the style of the curves, of one vehicle."""
    name = f"{lane.vehicle} {lane.fleet}".strip()
    stream.static(lane.path("trucks", "body"), mesh3d(truck_body(lane.colour)))
    stream.static(lane.path("trucks", "body", "fork"), mesh3d(truck_fork()))
    for signal in sorted(signals):
        stream.static(lane.path(signal), curve_style(name, lane.colour))


def log_day(stream: Stream, lane: Lane, t: Trajectory, site: Site, labels: bool) -> set[str]:
    """One day of one vehicle, already thinned; the signals that it has."""
    placed = np.isfinite(t.floats("x")) & np.isfinite(t.floats("y"))
    moving = t[placed]
    limit = thin.gap_limit(t.time)
    signals = _log_curves(stream, lane, t, limit)
    if len(moving):
        _log_motion(stream, lane, moving, site)
        _log_presence(stream, lane, moving, max(limit, thin.gap_limit(moving.time)), labels)
        _log_fork(stream, lane, moving)
        _log_trail(stream, lane, moving, site, limit)
        if site.frame is not None:
            _log_map(stream, lane, moving, site)
    lane.last = int(t.time[-1])
    return signals


def _log_curves(stream: Stream, lane: Lane, t: Trajectory, limit: int) -> set[str]:
    found = set()
    for column, (signal, factor) in CURVES.items():
        if not t.has(column):
            continue
        found.add(signal)
        slow = thin.thinned(t, SOC_RATE) if signal == "soc" else t
        time, values = with_gaps(slow.time, slow.floats(column) * factor, limit, lane.last)
        keep = thin.runs_collapsed(values)
        time, values = time[keep], values[keep]
        log_curve(stream, lane.path(signal), time, values)
    return found


def curve_style(name: str, colour: Colour) -> rr.SeriesLines:
    """A thin line through the values themselves;
    the viewer's averaging would bend it where runs were collapsed.
    """
    raw = rr.components.AggregationPolicy.Off
    return rr.SeriesLines(names=name, colors=colour, widths=1.6, aggregation_policy=raw)


def log_curve(stream: Stream, path: str, time: Ints, values: Floats) -> None:
    """A curve over time."""
    stream.columns(path, time, lambda rows: rr.Scalars.columns(scalars=values[rows]))


def with_gaps(time: Ints, values: Floats, limit: int, last: int | None) -> tuple[Ints, Floats]:
    """A NaN behind the last row before every gap, so that no line is drawn across it."""
    before = time[np.flatnonzero(np.diff(time) > limit)]
    if last is not None and time[0] - last > limit:
        before = np.concatenate([[last], before])
    where = np.searchsorted(time, before, side="right")
    return np.insert(time, where, before + 1), np.insert(values, where, np.nan)


def _log_motion(stream: Stream, lane: Lane, t: Trajectory, site: Site) -> None:
    xyz = np.column_stack([t.floats("x"), t.floats("y"), heights(t, site)])
    keep = thin.moved(STEP, *xyz.T)
    xyz = xyz[keep].astype(np.float32)
    stream.columns(
        lane.path("trucks"), t.time[keep], lambda rows: rr.Transform3D.columns(translation=xyz[rows])
    )


def _log_presence(stream: Stream, lane: Lane, t: Trajectory, limit: int, labels: bool) -> None:
    """Heading of the body, shrunk to nothing while nothing is known of the truck;
    its dot and SOC bar likewise.
    """
    cuts = thin.pieces(t.time, limit)
    begins = np.array([t.time[s.start] for s in cuts])
    ends = np.array([t.time[s.stop - 1] + limit for s in cuts])
    time, shown = np.concatenate([begins, ends]), np.repeat([1, 0], len(cuts))
    if lane.last is None and lane.origin is not None and lane.origin < begins[0]:
        time, shown = np.append(time, lane.origin), np.append(shown, 0)
    order = np.argsort(time, kind="stable")
    time, shown = time[order], shown[order]
    point = np.tile(np.array([[0.0, 0.0, 1.0]]), (int(shown.sum()), 1))
    names = [lane.vehicle] * len(point)
    stream.static(
        lane.path("trucks", "dot"),
        rr.Points3D.from_fields(radii=rr.Radius.ui_points(3.5), colors=lane.colour, show_labels=labels),
    )
    stream.parts(
        lane.path("trucks", "dot"),
        time,
        shown,
        lambda rows: rr.Points3D.columns(positions=point[rows], labels=names[rows]),
    )
    _log_heading(stream, lane, t, time[shown == 0])
    if t.has("soc"):
        _log_bar(stream, lane, t, time[shown == 0])


def _log_heading(stream: Stream, lane: Lane, t: Trajectory, hidden: Ints) -> None:
    heading = t.floats("heading")
    keep = thin.changed(heading, np.radians(2.0))
    keep = np.union1d(
        keep[np.isfinite(heading[keep])], [s.start for s in thin.pieces(t.time, thin.gap_limit(t.time))]
    )
    time = np.concatenate([t.time[keep], hidden])
    turn = np.concatenate([np.nan_to_num(heading[keep]), np.zeros(len(hidden))])
    size = np.repeat([1.0, 1e-6], [len(keep), len(hidden)])
    order = np.argsort(time, kind="stable")
    time, turn, size = time[order], turn[order], size[order]
    stream.columns(
        lane.path("trucks", "body"),
        time,
        lambda rows: rr.Transform3D.columns(
            quaternion=quaternions(turn[rows]), scale=np.repeat(size[rows, None], 3, axis=1)
        ),
    )


def _log_bar(stream: Stream, lane: Lane, t: Trajectory, hidden: Ints) -> None:
    """A dark bar with a coloured part as long as the battery is full, redrawn at every per cent."""
    soc = t.floats("soc")
    keep = thin.changed(soc, 0.01)
    starts = [s.start for s in thin.pieces(t.time, thin.gap_limit(t.time))]
    keep = np.union1d(keep, starts)
    keep = keep[np.isfinite(soc[keep])]
    time = np.concatenate([t.time[keep], hidden])
    lengths = np.repeat([2, 0], [len(keep), len(hidden)])
    order = np.argsort(time, kind="stable")
    strips: list[Any] = []
    colours: list[Colour] = []
    for value in soc[keep]:
        split = BAR_HALF * (2.0 * float(np.clip(value, 0.03, 1.0)) - 1.0)
        strips += [_bar(-BAR_HALF, split), _bar(split, BAR_HALF)]
        colours += [palette.soc_colour(float(value)), (58, 60, 66)]
    stream.static(lane.path("trucks", "soc"), rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(3.0)))
    stream.parts(
        lane.path("trucks", "soc"),
        time[order],
        lengths[order],
        lambda rows: rr.LineStrips3D.columns(
            strips=strips[rows], colors=np.array(colours[rows], np.uint8).reshape(-1, 3)
        ),
    )


def _bar(left: float, right: float) -> Floats:
    return np.array([[left, BAR_NORTH, BAR_UP], [right, BAR_NORTH, BAR_UP]])


def _log_fork(stream: Stream, lane: Lane, t: Trajectory) -> None:
    if t.has("fork_height"):
        height = np.clip(np.nan_to_num(t.floats("fork_height")), 0.0, None)
        keep = thin.changed(height, 0.02)
        lift = np.column_stack([np.zeros((len(keep), 2)), height[keep]])
        stream.columns(
            lane.path("trucks", "body", "fork"),
            t.time[keep],
            lambda rows: rr.Transform3D.columns(translation=lift[rows]),
        )
    if t.has("payload"):
        loaded = np.nan_to_num(t.floats("payload")) > MIN_LOAD
        keep = np.flatnonzero(np.diff(loaded.astype(np.int8), prepend=-1))
        lengths = loaded[keep].astype(np.int64)
        n = int(lengths.sum())
        path = lane.path("trucks", "body", "fork", "load")
        box = rr.Boxes3D.from_fields(colors=[(196, 150, 96)], fill_mode="solid")
        stream.static(path, box)
        stream.parts(
            path,
            t.time[keep],
            lengths,
            lambda rows: rr.Boxes3D.columns(
                centers=np.tile(LOAD_CENTRE, (n, 1))[rows], half_sizes=np.tile(LOAD_HALF, (n, 1))[rows]
            ),
        )


def _log_trail(stream: Stream, lane: Lane, t: Trajectory, site: Site, limit: int) -> None:
    """Short strips, each at the time of its end, so that a trailing window shows the way just driven."""
    xyz = np.column_stack([t.floats("x"), t.floats("y"), heights(t, site) + 0.12]).astype(np.float32)
    strips: list[Any] = []
    when: list[int] = []
    for piece in thin.pieces(t.time, limit):
        inner = np.arange(piece.start, piece.stop)
        inner = inner[thin.moved(5.0 * STEP, *xyz[inner].T)]
        for begin in range(0, len(inner) - 1, TRAIL_STEP):
            rows = inner[begin : begin + TRAIL_STEP + 1]
            if np.ptp(xyz[rows], axis=0).max() > 0.05:
                strips.append(xyz[rows])
                when.append(int(t.time[rows[-1]]))
    style = rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(1.8), colors=[lane.colour])
    stream.static(lane.path("trail"), style)
    stream.columns(
        lane.path("trail"),
        np.array(when, np.int64),
        lambda rows: rr.LineStrips3D.columns(strips=strips[rows]),
    )


def _log_map(stream: Stream, lane: Lane, t: Trajectory, site: Site) -> None:
    assert site.frame is not None
    slow = thin.rows_at_rate(t.time, 1.0)
    keep = slow[thin.moved(10.0 * STEP, t.floats("x")[slow], t.floats("y")[slow])]
    latitude, longitude = site.frame.to_geographic(t.floats("x")[keep], t.floats("y")[keep])
    where = np.column_stack([latitude, longitude])
    style = rr.GeoPoints.from_fields(radii=rr.Radius.ui_points(5.0), colors=[lane.colour])
    stream.static(lane.path("geo"), style)
    stream.columns(lane.path("geo"), t.time[keep], lambda rows: rr.GeoPoints.columns(positions=where[rows]))

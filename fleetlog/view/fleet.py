"""Trucks in a recording, one set of entities a vehicle: body, forks, load, SOC bar, trail and curves.

Paths have the signal first and the vehicle second, because a view's filter knows only a trailing ``/**``::

    PREFIX/trucks/ID            moves with the truck            PREFIX/speed/ID    m/s
    PREFIX/trucks/ID/body/...   turns with it; fork, load       PREFIX/power/ID    kW
    PREFIX/trucks/ID/soc        bar of the state of charge      PREFIX/soc/ID      %
    PREFIX/trail/ID             where it was                    PREFIX/geo/ID      on the map"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr

from fleetlog.core.arrays import Floats, Ints
from fleetlog.core.site import Site
from fleetlog.core.trajectory import Trajectory
from fleetlog.store import Dataset
from fleetlog.view import clock, palette
from fleetlog.view.palette import Colour
from fleetlog.view.ribbons import LOAD_CENTRE, LOAD_HALF
from fleetlog.view.stream import Stream, as_strips, entity, ui_points

CURVES = {"speed": ("speed", 1.0), "battery_power": ("power", 1e-3), "soc": ("soc", 100.0)}
"""Trajectory column: (signal in the recording, factor to its unit: m/s, kW, %)."""
BAR_HALF, BAR_UP, BAR_NORTH = 1.6, 3.4, 2.2
EMPTY = np.array([58, 60, 66], np.uint8)
TRAIL_STEP = 4
SOC_RATE = 0.2  # Samples a second of the SOC curve at most
STEP = 0.03  # A truck is drawn anew when it has moved this far [m]: less is noise that nobody sees
FAR_FROM_FLOOR = 10.0  # [m]
SAME = 1e-12  # Values of a curve that differ by less are equal
MIN_LOAD = 1.0  # Payload [kg] above which a load is drawn
FIELDS = ("x", "y", "z", "heading", "speed", "battery_power", "soc", "payload", "fork_height")
COLUMNS = (*FIELDS, "edge_id", "edge_offset")


@dataclass(frozen=True)
class Fleet:
    """One dataset in a recording: its name, which paths begin with, colour, how its clock is moved [us]."""

    dataset: Dataset
    rate_hz: float
    name: str = ""
    colour: Colour | None = None
    shift: int = 0

    def days(self, vehicle: str) -> Iterator[Trajectory]:
        """The thinned days of a vehicle on the recording's clock."""
        return (day for date in self.dataset.dates if len(day := self.day(vehicle, date)))

    def day(self, vehicle: str, date: str) -> Trajectory:
        """One of them."""
        kept = clock.thinned(self.dataset.read(vehicle, date, COLUMNS), self.rate_hz)
        return Trajectory(vehicle, kept.time + self.shift, kept.columns)

    def last_before(self, vehicle: str, date: str) -> int | None:
        """The time of the last row of a vehicle before a day [us]."""
        for day in (d for v, d in reversed(self.dataset.vehicle_days) if v == vehicle and d < date):
            if len(rows := self.dataset.read(vehicle, day, ())):
                return int(rows.time[-1]) + self.shift
        return None

    def lanes(self, origin: int | None) -> list["Lane"]:
        """Its vehicles, in a recording that starts at ``origin`` [us]."""
        one, names = self.colour, self.dataset.vehicles
        tints = [palette.shade(one, k) if one else palette.vehicle_colour(k) for k in range(len(names))]
        return [Lane(self, name, tint, origin) for name, tint in zip(names, tints, strict=True)]


@dataclass
class Lane:
    """One vehicle in the recording; its ``last`` row so far, its ``origin``: earlier it is not shown [us]."""

    fleet: Fleet
    vehicle: str
    colour: Colour
    origin: int | None
    last: int | None = None

    def path(self, signal: str, *more: str) -> str:
        """Path of one of the vehicle's entities."""
        return entity(self.fleet.name, signal, self.vehicle, *more)


def quaternions(heading: Floats) -> Floats:
    """(N, 4) xyzw of turns about the vertical [rad]."""
    zero = np.zeros_like(heading)
    return np.column_stack([zero, zero, np.sin(heading / 2), np.cos(heading / 2)])


def heights(t: Trajectory, site: Site) -> Floats:
    """Height [m] at which every row is drawn: the road's, else as recorded, the floor where that is far."""
    z = t.floats("z")
    known = np.isfinite(z)
    near = known.any() and np.median(np.abs(z[known])) <= FAR_FROM_FLOOR
    z = np.nan_to_num(z) if near else np.zeros(len(t))
    if site.network is not None:
        edge, offset = t.labels("edge_id").recode(site.network.index), t.floats("edge_offset")
        on = (edge >= 0) & np.isfinite(offset)
        z[on] = site.network.position(edge[on], offset[on])[:, 2]
    return z


def log_day(stream: Stream, lane: Lane, t: Trajectory, site: Site, labels: bool) -> set[str]:
    """One day of one vehicle, already thinned; the signals that it has."""
    moving = t[np.isfinite(t.floats("x")) & np.isfinite(t.floats("y"))]
    limit = clock.gap_limit(t.time)
    signals = set()
    for column, (signal, factor) in CURVES.items():
        if t.has(column):
            slow = clock.thinned(t, SOC_RATE) if signal == "soc" else t
            curve = with_gaps(slow.time, slow.floats(column) * factor, limit, lane.last)
            log_curve(stream, lane.path(signal), *curve)
            signals.add(signal)
    if len(moving):
        floor = np.column_stack([moving.floats("x"), moving.floats("y"), heights(moving, site)])
        keep = clock.moved(STEP, *floor.T)
        places = floor[keep].astype(np.float32)
        stream.rows(lane.path("trucks"), moving.time[keep], rr.Transform3D, translation=places)
        _log_presence(stream, lane, moving, max(limit, clock.gap_limit(moving.time)), labels)
        _log_fork(stream, lane, moving)
        _log_trail(stream, lane, moving, floor, limit)
        if site.frame is not None:
            path, x, y = lane.path("geo"), moving.floats("x"), moving.floats("y")
            seconds = clock.rows_at_rate(moving.time, 1.0)
            rows = seconds[clock.moved(10.0 * STEP, x[seconds], y[seconds])]
            where = np.column_stack(site.frame.to_geographic(x[rows], y[rows]))
            stream.static(path, rr.GeoPoints.from_fields(radii=ui_points(5.0), colors=[lane.colour]))
            stream.rows(path, moving.time[rows], rr.GeoPoints, positions=where)
    return signals


def curve_style(name: str, colour: Colour, steps: bool = False) -> rr.SeriesLines:
    """A line, or ``steps``, through the values themselves: means would bend it where runs were collapsed."""
    return rr.SeriesLines(
        names=name, colors=colour, widths=1.6, aggregation_policy=rr.components.AggregationPolicy.Off,
        interpolation_mode="StepAfter" if steps else None,
    )  # fmt: skip


def log_curve(stream: Stream, path: str, time: Ints, values: Floats, style: Any = None) -> None:
    """A curve over time, runs of equal values cut to their ends; ``style`` where it has none yet."""
    if style is not None:
        stream.static(path, style)
    keep = clock.moved(SAME, values)
    stream.rows(path, time[keep], rr.Scalars, scalars=values[keep])


def with_gaps(time: Ints, values: Floats, limit: int, last: int | None) -> tuple[Ints, Floats]:
    """A NaN behind the last row before every gap, so that no line is drawn across it."""
    before = time[np.flatnonzero(np.diff(time) > limit)]
    if last is not None and time[0] - last > limit:
        before = np.concatenate([[last], before])
    where = np.searchsorted(time, before, side="right")
    return np.insert(time, where, before + 1), np.insert(values, where, np.nan)


def _log_presence(stream: Stream, lane: Lane, t: Trajectory, limit: int, labels: bool) -> None:
    """Dot, heading and SOC bar, all nothing while nothing is known of the truck."""
    cuts = clock.pieces(t.time, limit)
    begins, hidden = t.time[[s.start for s in cuts]], t.time[[s.stop - 1 for s in cuts]] + limit
    if lane.last is None and lane.origin is not None and lane.origin < begins[0]:
        hidden = np.append(lane.origin, hidden)
    path, (time, _, shown) = lane.path("trucks", "dot"), _in_order(begins, hidden)
    stream.static(path, rr.Points3D.from_fields(radii=ui_points(3.5), colors=lane.colour, show_labels=labels))
    point, names = np.tile([0.0, 0.0, 1.0], (len(cuts), 1)), [lane.vehicle] * len(cuts)
    stream.rows(path, time, rr.Points3D, shown, positions=point, labels=names)
    starts = [s.start for s in clock.pieces(t.time, clock.gap_limit(t.time))]
    # Turns of the body, which shrinks to nothing at the times at which it is hidden.
    heading = t.floats("heading")
    keep = clock.changed(heading, np.radians(2.0))
    keep = clock.together(keep[np.isfinite(heading[keep])], starts)
    time, order, shown = _in_order(t.time[keep], hidden)
    turn = np.append(np.nan_to_num(heading[keep]), np.zeros(len(hidden)))[order]
    path, scale = lane.path("trucks", "body"), np.tile(np.maximum(shown, 1e-6)[:, None], 3)
    stream.rows(path, time, rr.Transform3D, quaternion=quaternions(turn), scale=scale)
    if t.has("soc"):
        # A dark bar with a coloured part as long as the battery is full, redrawn at every per cent.
        soc = t.floats("soc")
        keep = clock.together(clock.changed(soc, 0.01), starts)
        keep = keep[np.isfinite(soc[keep])]
        time, _, shown = _in_order(t.time[keep], hidden)
        split = BAR_HALF * (2.0 * np.clip(soc[keep], 0.03, 1.0) - 1.0)
        x = np.column_stack([np.full(len(keep), -BAR_HALF), split, split, np.full(len(keep), BAR_HALF)])
        ends = np.stack(np.broadcast_arrays(x.ravel(), BAR_NORTH, BAR_UP), axis=-1)
        strips = as_strips(ends, np.full(2 * len(keep), 2))
        full = palette.soc_colours(soc[keep])
        colours = np.stack([full, np.broadcast_to(EMPTY, full.shape)], axis=1).reshape(-1, 3)
        path = lane.path("trucks", "soc")
        stream.static(path, rr.LineStrips3D.from_fields(radii=ui_points(3.0)))
        stream.rows(path, time, rr.LineStrips3D, 2 * shown, strips=strips, colors=colours)


def _in_order(shown: Ints, hidden: Ints) -> tuple[Ints, Ints, Ints]:
    """Times at which something is shown and is not, their order, and which is which (1, 0)."""
    time = np.concatenate([shown, hidden])
    order = np.argsort(time, kind="stable")
    return time[order], order, (order < len(shown)).astype(np.int64)


def _log_fork(stream: Stream, lane: Lane, t: Trajectory) -> None:
    path = lane.path("trucks", "body", "fork")
    if t.has("fork_height"):
        height = np.clip(np.nan_to_num(t.floats("fork_height")), 0.0, None)
        keep = clock.changed(height, 0.02)
        lift = np.column_stack([np.zeros((len(keep), 2)), height[keep]])
        stream.rows(path, t.time[keep], rr.Transform3D, translation=lift)
    if t.has("payload"):
        loaded = np.nan_to_num(t.floats("payload")) > MIN_LOAD
        keep = np.flatnonzero(np.diff(loaded.astype(np.int8), prepend=-1))
        lengths = loaded[keep].astype(np.int64)
        stream.static(f"{path}/load", rr.Boxes3D.from_fields(colors=[(196, 150, 96)], fill_mode="solid"))
        centres, sizes = (np.tile(v, (int(lengths.sum()), 1)) for v in (LOAD_CENTRE, LOAD_HALF))
        stream.rows(f"{path}/load", t.time[keep], rr.Boxes3D, lengths, centers=centres, half_sizes=sizes)


def _log_trail(stream: Stream, lane: Lane, t: Trajectory, floor: Floats, limit: int) -> None:
    """Short strips, each at the time of its end, so that a trailing window shows the way just driven."""
    xyz = (floor + np.array([0.0, 0.0, 0.12])).astype(np.float32)
    rows, lengths = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for piece in clock.pieces(t.time, limit):
        inner = piece.start + clock.moved(5.0 * STEP, *xyz[piece].T)
        begin = np.arange(0, len(inner) - 1, TRAIL_STEP)
        size = np.minimum(TRAIL_STEP + 1, len(inner) - begin)
        rows.append(inner[np.arange(size.sum()) + np.repeat(begin - (np.cumsum(size) - size), size)])
        lengths.append(size)
    row, length = np.concatenate(rows), np.concatenate(lengths)
    flat, begin = xyz[row], np.cumsum(length) - length
    span = np.maximum.reduceat(flat, begin) - np.minimum.reduceat(flat, begin) if len(row) else flat
    shown = span.max(axis=1, initial=0.0) > 0.05
    path, when = lane.path("trail"), t.time[row[begin + length - 1][shown]]
    stream.static(path, rr.LineStrips3D.from_fields(radii=ui_points(1.8), colors=[lane.colour]))
    stream.rows(path, when, rr.LineStrips3D, strips=as_strips(flat[np.repeat(shown, length)], length[shown]))

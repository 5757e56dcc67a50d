"""Many trucks in a recording: one row a time step for the whole fleet, and curves of the fleet instead of
every truck.

Rows of a vehicle each would cost more than twice the file and two hundred curves in a plot say nothing::

    PREFIX/trucks/bodies   one mesh at the pose of every truck      PREFIX/speed/...  quantiles of the moving
    PREFIX/trucks/loads    loads on the forks                       PREFIX/power/...  sum of the fleet
    PREFIX/trucks/charge   a dot over each truck, coloured by SOC   PREFIX/soc/...    lowest, median, highest
    PREFIX/trail/fleet     where they were
"""

from __future__ import annotations

import math
import mmap
import tempfile
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from fleetlog.core.site import Frame, Site
from fleetlog.core.trajectory import Floats, Ints, Trajectory
from fleetlog.store import Dataset
from fleetlog.view import palette, thin
from fleetlog.view.fleet import CURVES, MIN_LOAD, curve_style, heights, log_curve, quaternions
from fleetlog.view.meshes import LOAD_CENTRE, LOAD_HALF, box, join, truck_body, truck_fork
from fleetlog.view.palette import Colour
from fleetlog.view.scene import mesh3d
from fleetlog.view.stream import Stream, entity

Singles = NDArray[Any]
"""float32: what the viewer keeps of a position anyway."""
DAY = 86_400_000_000
FIELDS = ("x", "y", "z", "heading", "speed", "battery_power", "soc", "payload", "fork_height")
BLOCK = 400_000
"""Positions held in memory at once."""
UNMAP_EVERY = 50
MOVING = 0.2
TRAIL_EVERY, MAP_EVERY = 2, 4


@dataclass(frozen=True)
class Steps:
    """A run of time steps: ``time`` (T,) us and by field a (T, V) array, NaN where a truck is not known."""

    time: Ints
    values: dict[str, Singles]

    @property
    def known(self) -> NDArray[np.bool_]:
        """(T, V) trucks with a position."""
        return np.isfinite(self.values["x"]) & np.isfinite(self.values["y"])


def at_steps(trajectory: Trajectory, ticks: Ints, site: Site) -> dict[str, Singles]:
    """The latest row at every tick, NaN where it is older than a gap."""
    if not len(trajectory):
        return {name: np.full(len(ticks), np.nan, np.float32) for name in FIELDS}
    rows = np.searchsorted(trajectory.time, ticks, side="right") - 1
    late = (rows < 0) | (ticks - trajectory.time[np.maximum(rows, 0)] > thin.gap_limit(trajectory.time))
    out = {}
    for name in FIELDS:
        values = heights(trajectory, site) if name == "z" else trajectory.floats(name)
        picked = values[np.maximum(rows, 0)].astype(np.float32)
        picked[late] = np.nan
        out[name] = picked
    return out


def log_fleet(
    stream: Stream, dataset: Dataset, site: Site, columns: Sequence[str], *, rate_hz: float, prefix: str = "",
    colour: Colour = (205, 210, 218), shift: int = 0, name: str = "",
) -> set[str]:  # fmt: skip
    """The whole fleet day by day through a scratch file, so that memory does not grow;
    the signals that it has.
    """
    step = max(round(1e6 / rate_hz), 1)
    _log_static(stream, prefix, colour)
    signals: set[str] = set()
    for date in dataset.dates:
        ticks = _ticks(dataset, date, step)
        vehicles, rows = dataset.vehicles, min(max(1, BLOCK // len(dataset.vehicles)), len(ticks))
        shape = (-(-len(ticks) // rows), len(FIELDS), len(vehicles), rows)
        padded = np.full(shape[0] * rows, np.nan, np.float32)
        with tempfile.TemporaryFile() as scratch:
            scratch.truncate(4 * math.prod(shape))
            pages = mmap.mmap(scratch.fileno(), 0)
            # What is drawn together lies together.
            table = np.frombuffer(pages, np.float32).reshape(shape)
            for k, vehicle in enumerate(vehicles):
                day = at_steps(dataset.read(vehicle, date, columns), ticks, site)
                for f, values in enumerate(day.values()):
                    padded[: len(ticks)] = values
                    table[:, f, k] = padded.reshape(-1, rows)
                if k % UNMAP_EVERY == 0:
                    _unmap(pages)
            for b, begin in enumerate(range(0, len(ticks), rows)):
                time = ticks[begin : begin + rows]
                block = {
                    name_: np.ascontiguousarray(table[b, f, :, : len(time)].T)
                    for f, name_ in enumerate(FIELDS)
                }
                _unmap(pages)
                signals |= _log_block(stream, Steps(time + shift, block), site, prefix, name)
    _style_curves(stream, prefix, signals, name, colour)
    return signals


def _unmap(pages: mmap.mmap) -> None:
    """Leave a file's pages to the system, which keeps them while it has memory to spare;
    they come back when they are touched.
    """
    if hasattr(mmap, "MADV_DONTNEED"):
        pages.madvise(mmap.MADV_DONTNEED)


def _ticks(dataset: Dataset, date: str, step: int) -> Ints:
    """Time steps of the part of a day that the dataset covers."""
    begin = int(np.datetime64(date, "us").astype(np.int64))
    first = max(begin, int(np.datetime64(dataset.meta["start"].removesuffix("Z"), "us").astype(np.int64)))
    last = min(
        begin + DAY - 1, int(np.datetime64(dataset.meta["end"].removesuffix("Z"), "us").astype(np.int64))
    )
    return np.arange(-(-first // step) * step, last + 1, step, dtype=np.int64)


def _log_static(stream: Stream, prefix: str, colour: Colour) -> None:
    low = [c - h for c, h in zip(LOAD_CENTRE, LOAD_HALF, strict=True)]
    high = [c + h for c, h in zip(LOAD_CENTRE, LOAD_HALF, strict=True)]
    truck = join([truck_body(colour), truck_fork()])
    stream.static(entity(prefix, "trucks", "bodies"), mesh3d(truck))
    stream.static(entity(prefix, "trucks", "loads"), mesh3d(box(low, high, (196, 150, 96))))
    dots = rr.Points3D.from_fields(radii=rr.Radius.ui_points(3.5))
    stream.static(entity(prefix, "trucks", "charge"), dots)
    trail = rr.Points3D.from_fields(radii=rr.Radius.ui_points(1.1), colors=[colour])
    stream.static(entity(prefix, "trail", "fleet"), trail)
    stream.static(
        entity(prefix, "geo", "fleet"),
        rr.GeoPoints.from_fields(radii=rr.Radius.ui_points(3.0), colors=[(86, 180, 233)]),
    )


def _log_block(stream: Stream, steps: Steps, site: Site, prefix: str, name: str) -> set[str]:
    known, v = steps.known, steps.values
    lengths = known.sum(axis=1).astype(np.int64)
    xyz = np.column_stack([v[c][known] for c in "xyz"])
    turn = np.nan_to_num(v["heading"][known])
    _poses(stream, entity(prefix, "trucks", "bodies"), steps.time, lengths, xyz, turn)
    loaded = known & (np.nan_to_num(v["payload"]) > MIN_LOAD)
    lifted = np.column_stack(
        [v["x"][loaded], v["y"][loaded], (v["z"] + np.nan_to_num(v["fork_height"]))[loaded]]
    )
    counts = loaded.sum(axis=1).astype(np.int64)
    _poses(
        stream,
        entity(prefix, "trucks", "loads"),
        steps.time,
        counts,
        lifted,
        np.nan_to_num(v["heading"][loaded]),
    )
    above, tints = xyz + np.array([0.0, 0.0, 3.0], np.float32), _charge_colours(v["soc"][known])
    stream.parts(
        entity(prefix, "trucks", "charge"), steps.time, lengths,
        lambda rows: rr.Points3D.columns(positions=above[rows], colors=tints[rows]),
    )  # fmt: skip
    _log_trail(stream, entity(prefix, "trail", "fleet"), steps)
    if site.frame is not None:
        _log_map(stream, entity(prefix, "geo", "fleet"), steps, site.frame)
    return _log_curves(stream, steps, prefix, name)


def _poses(stream: Stream, path: str, time: Ints, lengths: Ints, xyz: Singles, turn: Singles) -> None:
    stream.parts(
        path, time, lengths,
        lambda rows: rr.InstancePoses3D.columns(translations=xyz[rows], quaternions=quaternions(turn[rows])),
    )  # fmt: skip


def _charge_colours(soc: Singles) -> NDArray[np.uint8]:
    """(N, 3) green, yellow, red; grey where the state of charge is unknown."""
    out = np.full((len(soc), 3), 150, np.uint8)
    for above, colour in reversed(palette.SOC_CLASSES):
        out[soc > above] = colour
    return out


def _log_map(stream: Stream, path: str, steps: Steps, frame: Frame) -> None:
    rows = np.arange(0, len(steps.time), MAP_EVERY)
    seen = steps.known[rows]
    x, y = (steps.values[c][rows][seen] for c in "xy")
    where = np.column_stack(frame.to_geographic(x, y))
    lengths = seen.sum(axis=1).astype(np.int64)
    stream.parts(path, steps.time[rows], lengths, lambda part: rr.GeoPoints.columns(positions=where[part]))


def _log_trail(stream: Stream, path: str, steps: Steps) -> None:
    moving = steps.known & ~(steps.values["speed"] <= MOVING)
    rows = np.arange(0, len(steps.time), TRAIL_EVERY)
    seen = moving[rows]
    xyz = np.column_stack([steps.values[c][rows][seen] for c in "xyz"]) + np.array(
        [0.0, 0.0, 0.1], np.float32
    )
    lengths = seen.sum(axis=1).astype(np.int64)
    stream.parts(path, steps.time[rows], lengths, lambda part: rr.Points3D.columns(positions=xyz[part]))


def _log_curves(stream: Stream, steps: Steps, prefix: str, name: str) -> set[str]:
    found = set()
    for column, (signal, factor) in CURVES.items():
        values = np.where(steps.known, steps.values[column], np.nan).astype(np.float64) * factor
        if column == "speed":
            values = np.where(values > MOVING, values, np.nan)
        if not np.isfinite(values).any():
            continue
        found.add(signal)
        for curve, y in _fleet_curves(signal, values).items():
            keep = thin.runs_collapsed(y)
            log_curve(stream, entity(prefix, signal, curve), steps.time[keep], y[keep])
    return found


def _fleet_curves(signal: str, values: Floats) -> dict[str, Floats]:
    """(T,) curves of (T, V) values: what the fleet does."""
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", RuntimeWarning
        )  # a step at which nothing is known gives NaN, and is meant to
        if signal == "power":
            return {"sum": np.where(np.isfinite(values).any(axis=1), np.nansum(values, axis=1), np.nan)}
        low, middle, high = np.nanquantile(
            values, [0.0 if signal == "soc" else 0.1, 0.5, 1.0 if signal == "soc" else 0.9], axis=1
        )
    names = (
        ("lowest", "median", "highest") if signal == "soc" else ("slowest tenth", "median", "fastest tenth")
    )
    return dict(zip(names, (low, middle, high), strict=True))


def _style_curves(stream: Stream, prefix: str, signals: set[str], name: str, colour: Colour) -> None:
    tints: dict[str, Colour] = {
        "lowest": palette.SOC_EMPTY,
        "median": (225, 228, 235),
        "highest": palette.SOC_GOOD,
        "sum": (86, 180, 233),
        "slowest tenth": (213, 94, 0),
        "fastest tenth": (86, 180, 233),
    }
    for signal in signals:
        for curve in _fleet_curves(signal, np.zeros((1, 1))):
            title = f"{name} {curve}".strip() if signal != "power" else f"{name} whole fleet".strip()
            stream.static(entity(prefix, signal, curve), curve_style(title, colour if name else tints[curve]))

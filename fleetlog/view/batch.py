"""Many trucks in a recording: one row a time step for the whole fleet, and curves of the fleet instead of
every truck.

Rows of a vehicle each would cost more than twice the file and two hundred curves in a plot say nothing::

    PREFIX/trucks/bodies   one mesh at the pose of every truck      PREFIX/speed/...  quantiles of the moving
    PREFIX/trucks/loads    loads on the forks                       PREFIX/power/...  sum of the fleet
    PREFIX/trucks/charge   a dot over each truck, coloured by SOC   PREFIX/soc/...    lowest, median, highest
    PREFIX/trail/fleet     where they were
"""

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
from fleetlog.view.meshes import LOAD_CENTRE, LOAD_HALF, box, mesh3d, truck_body, truck_fork
from fleetlog.view.palette import Colour
from fleetlog.view.stream import Stream, entity, microseconds, ui_points

Singles = NDArray[Any]
"""float32: what the viewer keeps of a position anyway."""
DAY = 86_400_000_000
FIELDS = ("x", "y", "z", "heading", "speed", "battery_power", "soc", "payload", "fork_height")
BLOCK = 400_000
"""Positions held in memory at once."""
UNMAP_EVERY = 50
MOVING = 0.2
TRAIL_EVERY, MAP_EVERY = 2, 4
FLEET_CURVES: dict[str, dict[str, tuple[float, Colour]]] = {
    "speed": {"slowest tenth": (0.1, (213, 94, 0)), "median": (0.5, (225, 228, 235)),
              "fastest tenth": (0.9, (86, 180, 233))},
    "soc": {"lowest": (0.0, palette.SOC_EMPTY), "median": (0.5, (225, 228, 235)),
            "highest": (1.0, palette.SOC_GOOD)},
}  # fmt: skip
"""By signal the curves of a fleet: quantile of its trucks, and colour."""
SUM = (86, 180, 233)


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
        out[name] = np.where(late, np.nan, values[np.maximum(rows, 0)]).astype(np.float32)
    return out


def log_fleet(
    stream: Stream, dataset: Dataset, columns: Sequence[str], *, rate_hz: float, prefix: str = "",
    colour: Colour = (205, 210, 218), shift: int = 0, name: str = "",
) -> set[str]:  # fmt: skip
    """The whole fleet day by day through a scratch file, so that memory does not grow.

    Returns the signals that it has.
    """
    _log_static(stream, prefix, colour)
    signals: set[str] = set()
    for date in dataset.dates:
        ticks = _ticks(dataset, date, max(round(1e6 / rate_hz), 1))
        vehicles = dataset.vehicles
        rows = min(max(1, BLOCK // len(vehicles)), len(ticks))
        shape = (-(-len(ticks) // rows), len(FIELDS), len(vehicles), rows)
        padded = np.full(shape[0] * rows, np.nan, np.float32)
        with tempfile.TemporaryFile() as scratch:
            scratch.truncate(4 * math.prod(shape))
            pages = mmap.mmap(scratch.fileno(), 0)
            # What is drawn together lies together.
            table = np.frombuffer(pages, np.float32).reshape(shape)
            for k, vehicle in enumerate(vehicles):
                day = at_steps(dataset.read(vehicle, date, columns), ticks, dataset.site)
                for f, values in enumerate(day.values()):
                    padded[: len(ticks)] = values
                    table[:, f, k] = padded.reshape(-1, rows)
                if k % UNMAP_EVERY == 0:
                    _unmap(pages)
            for b, begin in enumerate(range(0, len(ticks), rows)):
                time = ticks[begin : begin + rows]
                block = {
                    field: np.ascontiguousarray(table[b, f, :, : len(time)].T)
                    for f, field in enumerate(FIELDS)
                }
                _unmap(pages)
                signals |= _log_block(stream, Steps(time + shift, block), dataset.site.frame, prefix)
    for signal in signals:
        _style_curves(stream, prefix, signal, name, colour)
    return signals


def _unmap(pages: mmap.mmap) -> None:
    """Leave a file's pages to the system, which keeps them while it has memory to spare."""
    if hasattr(mmap, "MADV_DONTNEED"):
        pages.madvise(mmap.MADV_DONTNEED)


def _ticks(dataset: Dataset, date: str, step: int) -> Ints:
    """Time steps of the part of a day that the dataset covers."""
    begin = int(np.datetime64(date, "us").astype(np.int64))
    start, end = (microseconds(dataset.meta[k]) for k in ("start", "end"))
    first, last = max(begin, start or begin), min(begin + DAY - 1, end or begin)
    return np.arange(-(-first // step) * step, last + 1, step, dtype=np.int64)


def _log_static(stream: Stream, prefix: str, colour: Colour) -> None:
    centre, half = np.array(LOAD_CENTRE), np.array(LOAD_HALF)
    load = box((centre - half).tolist(), (centre + half).tolist(), (196, 150, 96))
    for names, archetype in {
        ("trucks", "bodies"): mesh3d([*truck_body(colour), *truck_fork()]),
        ("trucks", "loads"): mesh3d([load]),
        ("trucks", "charge"): rr.Points3D.from_fields(radii=ui_points(3.5)),
        ("trail", "fleet"): rr.Points3D.from_fields(radii=ui_points(1.1), colors=[colour]),
        ("geo", "fleet"): rr.GeoPoints.from_fields(radii=ui_points(3.0), colors=[(86, 180, 233)]),
    }.items():
        stream.static(entity(prefix, *names), archetype)


def _log_block(stream: Stream, steps: Steps, frame: Frame | None, prefix: str) -> set[str]:
    known, v = steps.known, steps.values
    xyz = np.column_stack([v[c][known] for c in "xyz"])
    loaded = known & (np.nan_to_num(v["payload"]) > MIN_LOAD)
    lifted = np.column_stack([v[c][loaded] for c in "xyz"])
    lifted[:, 2] += np.nan_to_num(v["fork_height"][loaded])
    for part, here, places in (("bodies", known, xyz), ("loads", loaded, lifted)):
        stream.parts(
            entity(prefix, "trucks", part), steps.time, here.sum(axis=1), rr.InstancePoses3D,
            translations=places, quaternions=quaternions(np.nan_to_num(v["heading"][here])),
        )  # fmt: skip
    stream.parts(
        entity(prefix, "trucks", "charge"), steps.time, known.sum(axis=1), rr.Points3D,
        positions=xyz + np.array([0.0, 0.0, 3.0], np.float32), colors=_charge_colours(v["soc"][known]),
    )  # fmt: skip
    moving = (known & ~(v["speed"] <= MOVING))[::TRAIL_EVERY]
    trail = np.column_stack([v[c][::TRAIL_EVERY][moving] for c in "xyz"])
    stream.parts(
        entity(prefix, "trail", "fleet"), steps.time[::TRAIL_EVERY], moving.sum(axis=1), rr.Points3D,
        positions=trail + np.array([0.0, 0.0, 0.1], np.float32),
    )  # fmt: skip
    if frame is not None:
        seen = known[::MAP_EVERY]
        where = np.column_stack(frame.to_geographic(*(v[c][::MAP_EVERY][seen] for c in "xy")))
        path, time = entity(prefix, "geo", "fleet"), steps.time[::MAP_EVERY]
        stream.parts(path, time, seen.sum(axis=1), rr.GeoPoints, positions=where)
    return _log_curves(stream, steps, prefix)


def _charge_colours(soc: Singles) -> NDArray[np.uint8]:
    """(N, 3) green, yellow, red; grey where the state of charge is unknown."""
    out = np.full((len(soc), 3), 150, np.uint8)
    for above, colour in reversed(palette.SOC_CLASSES):
        out[soc > above] = colour
    return out


def _log_curves(stream: Stream, steps: Steps, prefix: str) -> set[str]:
    found = set()
    for column, (signal, factor) in CURVES.items():
        values = np.where(steps.known, steps.values[column], np.nan).astype(np.float64) * factor
        if column == "speed":
            values = np.where(values > MOVING, values, np.nan)
        if np.isfinite(values).any():
            found.add(signal)
            for curve, y in _fleet_curves(signal, values).items():
                log_curve(stream, entity(prefix, signal, curve), steps.time, y)
    return found


def _fleet_curves(signal: str, values: Floats) -> dict[str, Floats]:
    """(T,) curves of (T, V) values: what the fleet does."""
    if signal == "power":
        return {"sum": np.where(np.isfinite(values).any(axis=1), np.nansum(values, axis=1), np.nan)}
    curves = FLEET_CURVES[signal]
    with warnings.catch_warnings():
        # A step at which nothing is known gives NaN, and is meant to.
        warnings.simplefilter("ignore", RuntimeWarning)
        quantiles = np.nanquantile(values, [q for q, _ in curves.values()], axis=1)
    return dict(zip(curves, quantiles, strict=True))


def _style_curves(stream: Stream, prefix: str, signal: str, name: str, colour: Colour) -> None:
    tints = {"sum": SUM} if signal == "power" else {n: tint for n, (_, tint) in FLEET_CURVES[signal].items()}
    for curve, tint in tints.items():
        title = f"{name} {'whole fleet' if curve == 'sum' else curve}".strip()
        stream.static(entity(prefix, signal, curve), curve_style(title, colour if name else tint))

"""Many trucks in a recording: one row a time step for the whole fleet, and curves of the fleet instead of
every truck.

Rows of a vehicle each would cost more than twice the file and two hundred curves in a plot say nothing::

    PREFIX/trucks/bodies   one mesh at the pose of every truck      PREFIX/speed/...  quantiles of the moving
    PREFIX/trucks/loads    loads on the forks                       PREFIX/power/...  sum of the fleet
    PREFIX/trucks/charge   a dot over each truck, coloured by SOC   PREFIX/soc/...    lowest, median, highest
    PREFIX/trail/fleet     where they were
"""

import tempfile
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from fleetlog.core.arrays import Floats, Ints
from fleetlog.core.site import Site
from fleetlog.core.trajectory import Trajectory
from fleetlog.view import clock, palette
from fleetlog.view.clock import DAY, span_of
from fleetlog.view.fleet import COLUMNS, CURVES, MIN_LOAD, Fleet, curve_style, heights, log_curve, quaternions
from fleetlog.view.palette import Colour
from fleetlog.view.ribbons import LOAD_CENTRE, LOAD_HALF, box, mesh3d, truck_body, truck_fork
from fleetlog.view.stream import Stream, entity, ui_points

Singles = NDArray[Any]  # float32: what the viewer keeps of a position anyway
FIELDS = ("x", "y", "z", "heading", "speed", "battery_power", "soc", "payload", "fork_height")
RATE = 1.0  # Steps a second at most
BLOCK = 400_000  # Positions held in memory at once
MOVING = 0.2
TRAIL_EVERY, MAP_EVERY = 2, 4
PALE: Colour = (205, 210, 218)
FLEET_CURVES: dict[str, dict[str, tuple[float, Colour]]] = {
    "speed": {"slowest tenth": (0.1, (213, 94, 0)), "median": (0.5, (225, 228, 235)),
              "fastest tenth": (0.9, (86, 180, 233))},
    "soc": {"lowest": (0.0, palette.SOC_EMPTY), "median": (0.5, (225, 228, 235)),
            "highest": (1.0, palette.SOC_GOOD)},
    "power": {"sum": (np.nan, (86, 180, 233))},
}  # fmt: skip
"""By signal the curves of a fleet: quantile of its trucks (power is summed), and colour."""


def log_together(stream: Stream, fleet: Fleet) -> set[str]:
    """The whole fleet, day by day through a scratch file, so that memory does not grow; its signals."""
    _log_static(stream, fleet)
    signals: set[str] = set()
    dataset, vehicles = fleet.dataset, fleet.dataset.vehicles
    rows, step = max(BLOCK // len(vehicles), 1), max(round(1e6 / min(fleet.rate_hz, RATE)), 1)
    for date in dataset.dates:
        begin = int(np.datetime64(date, "us").astype(np.int64))
        start, end = span_of(dataset) or (begin, begin)
        first, last = max(begin, start), min(begin + DAY - 1, end)
        ticks = np.arange(-(-first // step) * step, last + 1, step, dtype=np.int64)
        with tempfile.TemporaryFile() as scratch:
            for vehicle in vehicles:
                at_steps(dataset.read(vehicle, date, COLUMNS), ticks, dataset.site).tofile(scratch)
            for k in range(0, len(ticks), rows):
                # Mapped anew for every block, so that what was read of the file is let go.
                table = np.memmap(scratch, np.float32, "r", shape=(len(vehicles), len(FIELDS), len(ticks)))
                block = np.ascontiguousarray(table[..., k : k + rows].transpose(1, 2, 0))
                values = dict(zip(FIELDS, block, strict=True))
                signals |= _log_block(stream, fleet, ticks[k : k + rows] + fleet.shift, values)
    for signal in signals:
        for curve, (_, tint) in FLEET_CURVES[signal].items():
            title = f"{fleet.name} {'whole fleet' if curve == 'sum' else curve}".strip()
            stream.static(entity(fleet.prefix, signal, curve), curve_style(title, fleet.colour or tint))
    return signals


def at_steps(t: Trajectory, ticks: Ints, site: Site) -> Singles:
    """(fields, T) the latest row at every tick, NaN where it is older than a gap."""
    out = np.full((len(FIELDS), len(ticks)), np.nan, np.float32)
    rows = np.searchsorted(t.time, ticks, side="right") - 1
    known = np.flatnonzero(rows >= 0)
    known = known[ticks[known] - t.time[rows[known]] <= clock.gap_limit(t.time)]
    for k, name in enumerate(FIELDS):
        out[k, known] = (heights(t, site) if name == "z" else t.floats(name))[rows[known]]
    return out


def _log_static(stream: Stream, fleet: Fleet) -> None:
    centre, half, colour = np.array(LOAD_CENTRE), np.array(LOAD_HALF), fleet.colour or PALE
    load = box((centre - half).tolist(), (centre + half).tolist(), (196, 150, 96))
    for names, archetype in {
        ("trucks", "bodies"): mesh3d([*truck_body(colour), *truck_fork()]),
        ("trucks", "loads"): mesh3d([load]),
        ("trucks", "charge"): rr.Points3D.from_fields(radii=ui_points(3.5)),
        ("trail", "fleet"): rr.Points3D.from_fields(radii=ui_points(1.1), colors=[colour]),
        ("geo", "fleet"): rr.GeoPoints.from_fields(radii=ui_points(3.0), colors=[(86, 180, 233)]),
    }.items():
        stream.static(entity(fleet.prefix, *names), archetype)


def _log_block(stream: Stream, fleet: Fleet, time: Ints, v: dict[str, Singles]) -> set[str]:
    """A run of time steps (T,) [us], by field a (T, V) array, NaN where a truck is not known; the signals."""
    prefix, known = fleet.prefix, np.isfinite(v["x"]) & np.isfinite(v["y"])
    xyz = np.column_stack([v[c][known] for c in "xyz"])
    loaded = known & (np.nan_to_num(v["payload"]) > MIN_LOAD)
    lifted = np.column_stack([v[c][loaded] for c in "xyz"])
    lifted[:, 2] += np.nan_to_num(v["fork_height"][loaded])
    for part, here, places in (("bodies", known, xyz), ("loads", loaded, lifted)):
        stream.parts(
            entity(prefix, "trucks", part), time, here.sum(axis=1), rr.InstancePoses3D,
            translations=places, quaternions=quaternions(np.nan_to_num(v["heading"][here])),
        )  # fmt: skip
    stream.parts(
        entity(prefix, "trucks", "charge"), time, known.sum(axis=1), rr.Points3D,
        positions=xyz + np.array([0.0, 0.0, 3.0], np.float32), colors=palette.soc_colours(v["soc"][known]),
    )  # fmt: skip
    moving = (known & ~(v["speed"] <= MOVING))[::TRAIL_EVERY]
    trail = np.column_stack([v[c][::TRAIL_EVERY][moving] for c in "xyz"])
    stream.parts(
        entity(prefix, "trail", "fleet"), time[::TRAIL_EVERY], moving.sum(axis=1), rr.Points3D,
        positions=trail + np.array([0.0, 0.0, 0.1], np.float32),
    )  # fmt: skip
    if (frame := fleet.dataset.site.frame) is not None:
        seen, path = known[::MAP_EVERY], entity(prefix, "geo", "fleet")
        where = np.column_stack(frame.to_geographic(*(v[c][::MAP_EVERY][seen] for c in "xy")))
        stream.parts(path, time[::MAP_EVERY], seen.sum(axis=1), rr.GeoPoints, positions=where)
    found = set()
    for column, (signal, factor) in CURVES.items():
        shown = known & (v["speed"] > MOVING) if column == "speed" else known
        values = np.where(shown, v[column], np.nan).astype(np.float64) * factor
        if np.isfinite(values).any():
            found.add(signal)
            for curve, y in zip(FLEET_CURVES[signal], _fleet_curves(signal, values), strict=True):
                log_curve(stream, entity(prefix, signal, curve), time, y)
    return found


def _fleet_curves(signal: str, values: Floats) -> Floats:
    """(curves, T) of (T, V) values: what the fleet does; NaN at a step at which nothing is known."""
    quantiles = [quantile for quantile, _ in FLEET_CURVES[signal].values()]
    out, known = np.full((len(quantiles), len(values)), np.nan), np.isfinite(values).any(axis=1)
    if signal == "power":
        out[:, known] = np.nansum(values[known], axis=1)
    else:
        out[:, known] = np.nanquantile(values[known], quantiles, axis=1)
    return out

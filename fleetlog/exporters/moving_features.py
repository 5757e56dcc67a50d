"""OGC Moving Features JSON (19-045r3): a feature a vehicle, its temporal geometry and temporal properties.

In longitude and latitude where the site lies somewhere on earth, else in local metres.  Lost are labels, and
rows without a position.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.columns import BY_NAME
from fleetlog.core.trajectory import Trajectory
from fleetlog.exporters.base import Exporter, Selection, iso_times

PROPERTIES = (
    "speed", "payload", "fork_height", "battery_power", "battery_voltage", "battery_current", "soc",
    "ambient_temperature",
)  # fmt: skip


def write(selection: Selection, path: Path) -> dict[str, Any]:
    """A feature a vehicle and day, so that memory is bounded by a day."""
    rows = left_out = 0
    crs = "http://www.opengis.net/def/crs/OGC/1.3/CRS84" if selection.frame else "local metres"
    head = {"type": "FeatureCollection", "crs": {"type": "Name", "properties": {"name": crs}}}
    with path.open("w", encoding="utf-8") as out:
        out.write(json.dumps(head)[:-1] + ', "features": [')
        separator = "\n"
        for t in selection.days(("x", "y", "z", *PROPERTIES)):
            known = np.isfinite(t.floats("x")) & np.isfinite(t.floats("y"))
            left_out += int((~known).sum())
            if known.any():
                out.write(separator + json.dumps(_feature(t[known], selection), allow_nan=False))
                separator = ",\n"
                rows += int(known.sum())
        out.write("\n]}\n")
    return {"rows": rows, "rows_without_position": left_out}


def _feature(t: Trajectory, selection: Selection) -> dict[str, Any]:
    x, y, z = (t.floats(n) for n in ("x", "y", "z"))
    if selection.frame is not None:
        latitude, longitude = selection.frame.to_geographic(x, y)
        x, y = np.round(longitude, 9), np.round(latitude, 9)
    columns = [x, y] + ([z] if np.isfinite(z).all() else [])
    times = iso_times(t.time)
    return {
        "type": "Feature",
        "id": f"{t.vehicle_id} {times[0][:10]}",
        "properties": {"vehicle_id": t.vehicle_id},
        "temporalGeometry": {
            "type": "MovingPoint", "datetimes": times, "coordinates": np.column_stack(columns).tolist(),
            "interpolation": "Linear",
        },
        "temporalProperties": [p for name in PROPERTIES if t.has(name) for p in [_property(t, name, times)]],
    }  # fmt: skip


def _property(t: Trajectory, name: str, times: list[str]) -> dict[str, Any]:
    values = t.floats(name)
    known = np.isfinite(values)
    moments = [time for time, k in zip(times, known.tolist(), strict=True) if k]
    measured = {"values": values[known].tolist(), "interpolation": "Linear", "form": BY_NAME[name].unit}
    return {"datetimes": moments, name: measured}


EXPORTER = Exporter(
    "moving-features", ".mfjson", "OGC Moving Features JSON, a feature a vehicle and day", write
)

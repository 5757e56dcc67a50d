"""OGC Moving Features JSON (19-045r3): a feature a vehicle, its temporal geometry and temporal properties.

In longitude and latitude where the site lies somewhere on earth, else in local metres.  Lost are labels, and
rows without a position.
"""

from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.columns import BY_NAME
from fleetlog.core.site import Frame
from fleetlog.core.trajectory import Trajectory
from fleetlog.exporters.base import Exporter, Selection, iso_times, write_features

PROPERTIES = (
    "speed", "payload", "fork_height", "battery_power", "battery_voltage", "battery_current", "soc",
    "ambient_temperature",
)  # fmt: skip


def write(selection: Selection, path: Path) -> dict[str, Any]:
    """A feature a vehicle and day, so that memory is bounded by a day."""
    crs = "http://www.opengis.net/def/crs/OGC/1.3/CRS84" if selection.frame else "local metres"
    days = map(selection.placed, selection.days(("x", "y", "z", *PROPERTIES)))
    head = {"crs": {"type": "Name", "properties": {"name": crs}}}
    write_features(path, head, (_feature(t, selection.frame) for t in days if len(t)))
    return selection.counts


def _feature(t: Trajectory, frame: Frame | None) -> dict[str, Any]:
    x, y, z = (t.floats(n) for n in ("x", "y", "z"))
    if frame is not None:
        latitude, longitude = frame.to_geographic(x, y)
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

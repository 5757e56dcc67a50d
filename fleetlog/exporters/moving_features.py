"""OGC Moving Features JSON (19-045r3): a feature a vehicle, its temporal geometry and temporal properties.

In longitude and latitude where the site lies somewhere on earth, else in local metres.  Lost are labels, and
rows without a position."""

from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.core.columns import BY_NAME, COLUMNS
from fleetlog.core.trajectory import Trajectory
from fleetlog.exporters.base import Selection, iso_times, write_features

_PLACE = ("x", "y", "z", "heading", "edge_offset", "lateral_offset")
PROPERTIES = tuple(c.name for c in COLUMNS if c.kind == "double" and c.name not in _PLACE)


def write(selection: Selection, path: Path) -> None:
    """A feature a vehicle and day, so that memory is bounded by a day."""
    on_earth = selection.dataset.site.frame is not None
    crs = "http://www.opengis.net/def/crs/OGC/1.3/CRS84" if on_earth else "local metres"
    days = map(selection.placed, selection.days(("x", "y", "z", *PROPERTIES)))
    head = {"crs": {"type": "Name", "properties": {"name": crs}}}
    write_features(path, head, (_feature(t, selection.places(t)) for t in days if len(t)))


def _feature(t: Trajectory, xyz: list[Floats]) -> dict[str, Any]:
    columns = xyz if np.isfinite(xyz[2]).all() else xyz[:2]
    times = iso_times(t.time)
    properties = []
    for name in filter(t.has, PROPERTIES):
        known = np.isfinite(values := t.floats(name))
        measured = {"values": values[known].tolist(), "interpolation": "Linear", "form": BY_NAME[name].unit}
        properties.append({"datetimes": list(compress(times, known.tolist())), name: measured})
    return {
        "type": "Feature", "id": f"{t.vehicle_id} {times[0][:10]}",
        "properties": {"vehicle_id": t.vehicle_id},
        "temporalGeometry": {
            "type": "MovingPoint", "datetimes": times, "coordinates": np.column_stack(columns).tolist(),
            "interpolation": "Linear",
        },
        "temporalProperties": properties,
    }  # fmt: skip

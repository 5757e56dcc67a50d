"""GeoJSON (RFC 7946): a point per row, all columns as properties.

Where the site has no place on earth the points are local metres, which the property ``frame`` says.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.trajectory import Trajectory
from fleetlog.exporters.base import Exporter, Selection, cells, iso_times

_PLACED = ("x", "y", "z")


def write(selection: Selection, path: Path) -> dict[str, Any]:
    """Positions to 1e-9 degrees (0.1 mm)."""
    rows = left_out = 0
    separator = "\n"
    with path.open("w", encoding="utf-8") as out:
        out.write('{"type": "FeatureCollection", "features": [')
        for trajectory in selection.days():
            for feature in _features(trajectory, selection):
                if feature is None:
                    left_out += 1
                    continue
                out.write(separator + json.dumps(feature, allow_nan=False))
                separator = ",\n"
                rows += 1
        out.write("\n]}\n")
    return {"rows": rows, "rows_without_position": left_out}


def _features(t: Trajectory, selection: Selection) -> list[dict[str, Any] | None]:
    frame = selection.frame
    x, y, z = (t.floats(c) for c in _PLACED)
    if frame is not None:
        latitude, longitude = frame.to_geographic(x, y)
        places = np.column_stack([np.round(longitude, 9), np.round(latitude, 9), np.round(z, 4)]).tolist()
    else:
        places = np.column_stack([x, y, z]).tolist()
    names = [n for n in t.columns if n not in _PLACED]
    columns = cells(t, names)
    fixed = {} if frame is not None else {"frame": "local metres"}
    out: list[dict[str, Any] | None] = []
    for i, (place, time) in enumerate(zip(places, iso_times(t.time), strict=True)):
        if place[0] != place[0] or place[1] != place[1]:
            out.append(None)
            continue
        values = {n: c[i] for n, c in zip(names, columns, strict=True) if c[i] is not None}
        out.append({
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": place if place[2] == place[2] else place[:2]},
            "properties": {"vehicle_id": t.vehicle_id, "timestamp": time, **fixed, **values},
        })  # fmt: skip
    return out


EXPORTER = Exporter("geojson", ".geojson", "GeoJSON, a point per row with all columns", write)

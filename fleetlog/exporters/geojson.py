"""GeoJSON (RFC 7946): a point per row, all columns as properties.

Where the site has no place on earth the points are local metres, which the property ``frame`` says.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.site import Frame
from fleetlog.core.trajectory import Trajectory
from fleetlog.exporters.base import Exporter, Selection, cells, iso_times, write_features

_PLACED = ("x", "y", "z")


def write(selection: Selection, path: Path) -> dict[str, Any]:
    """Positions to 1e-9 degrees (0.1 mm)."""
    days = map(selection.placed, selection.days())
    write_features(path, {}, (f for t in days for f in _features(t, selection.frame)))
    return selection.counts


def _features(t: Trajectory, frame: Frame | None) -> Iterator[dict[str, Any]]:
    x, y, z = (t.floats(c) for c in _PLACED)
    if frame is not None:
        latitude, longitude = frame.to_geographic(x, y)
        x, y, z = np.round(longitude, 9), np.round(latitude, 9), np.round(z, 4)
    places = np.column_stack([x, y, z]).tolist()
    columns = [n for n in t.columns if n not in _PLACED]
    fixed = {} if frame is not None else {"frame": "local metres"}
    for place, time, *row in zip(places, iso_times(t.time), *cells(t, columns), strict=True):
        values = {n: v for n, v in zip(columns, row, strict=True) if v is not None}
        yield {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": place if place[2] == place[2] else place[:2]},
            "properties": {"vehicle_id": t.vehicle_id, "timestamp": time, **fixed, **values},
        }


EXPORTER = Exporter("geojson", ".geojson", "GeoJSON, a point per row with all columns", write)

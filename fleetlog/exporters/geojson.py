"""GeoJSON (RFC 7946): a point per row, all columns as properties.

Where the site has no place on earth the points are local metres, which the property ``frame`` says."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.core.trajectory import Trajectory
from fleetlog.exporters.base import Selection, cells, iso_times, write_features


def write(selection: Selection, path: Path) -> None:
    """Positions to 1e-9 degrees (0.1 mm)."""
    local = {"frame": "local metres"} if selection.dataset.site.frame is None else {}
    days = map(selection.placed, selection.days())
    write_features(path, {}, (f for t in days for f in _features(t, selection.places(t), local)))


def _features(t: Trajectory, xyz: list[Floats], fixed: dict[str, Any]) -> Iterator[dict[str, Any]]:
    places = np.column_stack(xyz).tolist()
    columns = [n for n in t.columns if n not in ("x", "y", "z")]
    for place, time, *row in zip(places, iso_times(t.time), *cells(t, columns), strict=True):
        values = {n: v for n, v in zip(columns, row, strict=True) if v is not None}
        yield {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": place if place[2] == place[2] else place[:2]},
            "properties": {"vehicle_id": t.vehicle_id, "timestamp": time, **fixed, **values},
        }

"""Features of GeoJSON; square cells as GeoParquet 1.1 and as GeoJSON."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from fleetlog.core.site import Frame
from fleetlog.store.documents import write_json

if TYPE_CHECKING:
    import pandas as pd

Floats = NDArray[np.float64]
MOST_GEOJSON = 20_000
"""Cells beyond which no GeoJSON is written: Parquet is what larger maps are read from."""
_CORNERS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) / 2.0
_WKB = np.dtype(
    [("order", "u1"), ("kind", "<u4"), ("rings", "<u4"), ("points", "<u4"), ("xy", "<f8", (5, 2))]
)


def outlines(table: pd.DataFrame, size: float, frame: Frame | None) -> Floats:
    """(N, 5, 2) rings about the centres x, y [m]: longitude and latitude, or local metres without a frame."""
    local = table[["x", "y"]].to_numpy(dtype=np.float64)[:, None, :] + size * _CORNERS
    if frame is None:
        return np.asarray(local, dtype=np.float64)
    latitude, longitude = frame.to_geographic(local[..., 0].ravel(), local[..., 1].ravel())
    return np.column_stack([longitude, latitude]).reshape(local.shape)


def write_squares(table: pd.DataFrame, size: float, path: Path, frame: Frame | None) -> None:
    """``path``.parquet with a ``geometry`` column, and ``path``.geojson where the cells are not too many."""
    rings = outlines(table, size, frame)
    wkb = np.zeros(len(rings), _WKB)
    wkb["order"], wkb["kind"], wkb["rings"], wkb["points"], wkb["xy"] = 1, 3, 1, 5, rings
    raw = wkb.tobytes()
    step = _WKB.itemsize
    arrow = pa.Table.from_pandas(table, preserve_index=False).append_column(
        "geometry", pa.array([raw[i : i + step] for i in range(0, len(raw), step)], pa.binary())
    )
    column: dict[str, Any] = {"encoding": "WKB", "geometry_types": ["Polygon"]}
    if frame is None:
        column["crs"] = None
    geo = {"version": "1.1.0", "primary_column": "geometry", "columns": {"geometry": column}}
    metadata = {**(arrow.schema.metadata or {}), b"geo": json.dumps(geo).encode()}
    pq.write_table(arrow.replace_schema_metadata(metadata), path.with_suffix(".parquet"))
    if len(table) <= MOST_GEOJSON:
        where = np.round(rings, 8 if frame else 3)[:, None]
        write_json(path.with_suffix(".geojson"), feature_collection(table, "Polygon", where, frame))


def feature_collection(
    table: pd.DataFrame, kind: str, coordinates: Iterable[Any], frame: Frame | None
) -> dict[str, Any]:
    """The rows of a table as RFC 7946 features that say which frame they are in."""
    named = {"frame": "wgs84" if frame else "local metres"}
    features = [
        {"type": "Feature", "properties": {**row, **named}, "geometry": {"type": kind, "coordinates": where}}
        for row, where in zip(table.to_dict("records"), coordinates, strict=True)
    ]
    return {"type": "FeatureCollection", "features": features}

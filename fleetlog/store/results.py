"""Writing a result: summary as JSON, tables as Parquet, places and cells as GeoJSON too, grids as GeoTIFF."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fleetlog.core.result import Floats, Grid, Result
from fleetlog.core.site import Frame
from fleetlog.store.documents import write_json
from fleetlog.store.geotiff import write_geotiff

if TYPE_CHECKING:
    import pandas as pd

MOST_GEOJSON = 20_000  # Cells beyond which no GeoJSON is written: Parquet is what larger maps are read from
_CORNERS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) / 2.0
_WKB = np.dtype(
    [("order", "u1"), ("kind", "<u4"), ("rings", "<u4"), ("points", "<u4"), ("xy", "<f8", (5, 2))]
)


def write_result(result: Result, folder: Path, frame: Frame | None = None) -> None:
    """``NAME.json``, tables as (Geo)Parquet, places as GeoJSON, grids as GeoTIFF; WGS 84 with a frame."""
    write_json(folder / f"{result.name}.json", {"format_version": 1, **result.summary}, indent=1)
    for name, table in {**result.tables, **result.places}.items():
        if name in result.squares:
            _write_squares(table, result.squares[name], folder / name, frame)
        else:
            table.to_parquet(folder / f"{name}.parquet", index=False)
    for grid in (s for s in result.shapes if isinstance(s, Grid)):
        write_geotiff(grid, folder / f"{file_name(grid.name)}.tif", frame)
    for name, table in result.places.items():
        places = _coordinates(table[["x", "y"]].to_numpy(), frame)
        where = places if frame is None else np.round(places, 8)
        _write_features(folder / f"{name}.geojson", table, "Point", where, frame)


def file_name(text: str) -> str:
    """``text`` as the name of a file on any system; characters that no name holds are percent-encoded."""
    return re.sub(r'[/\\:*?"<>|%\x00-\x1f\x7f]|^\.', lambda c: f"%{ord(c[0]):02X}", text)


def _coordinates(local: Floats, frame: Frame | None) -> Floats:
    """(..., 2) longitude and latitude of local metres; without a frame they stay."""
    if frame is None:
        return local
    latitude, longitude = frame.to_geographic(local[..., 0].ravel(), local[..., 1].ravel())
    return np.column_stack([longitude, latitude]).reshape(local.shape)


def _write_squares(table: pd.DataFrame, size: float, path: Path, frame: Frame | None) -> None:
    """Square cells about x, y [m]: GeoParquet 1.1, and GeoJSON where they are not too many."""
    centres = table[["x", "y"]].to_numpy(dtype=np.float64)
    rings = _coordinates(centres[:, None, :] + size * _CORNERS, frame)
    wkb = np.zeros(len(rings), _WKB)
    wkb["order"], wkb["kind"], wkb["rings"], wkb["points"], wkb["xy"] = 1, 3, 1, 5, rings
    geometry = pa.array([polygon.tobytes() for polygon in wkb], pa.binary())
    arrow = pa.Table.from_pandas(table, preserve_index=False).append_column("geometry", geometry)
    column: dict[str, Any] = {"encoding": "WKB", "geometry_types": ["Polygon"]}
    if frame is None:
        column["crs"] = None
    geo = {"version": "1.1.0", "primary_column": "geometry", "columns": {"geometry": column}}
    metadata = {**(arrow.schema.metadata or {}), b"geo": json.dumps(geo).encode()}
    pq.write_table(arrow.replace_schema_metadata(metadata), path.with_suffix(".parquet"))
    if len(table) <= MOST_GEOJSON:
        where = np.round(rings, 8 if frame else 3)[:, None]
        _write_features(path.with_suffix(".geojson"), table, "Polygon", where, frame)


def _write_features(
    path: Path, table: pd.DataFrame, kind: str, coordinates: Iterable[Any], frame: Frame | None
) -> None:
    """The rows of a table as RFC 7946 features that say which frame they are in."""
    named = {"frame": "wgs84" if frame else "local metres"}
    features = [
        {"type": "Feature", "properties": {**row, **named}, "geometry": {"type": kind, "coordinates": where}}
        for row, where in zip(table.to_dict("records"), coordinates, strict=True)
    ]
    write_json(path, {"type": "FeatureCollection", "features": features})

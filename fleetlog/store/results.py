"""Writing a result: summary as JSON, tables as Parquet, places as GeoJSON, grids as GeoTIFF."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fleetlog.core.result import Grid, Result
from fleetlog.core.site import Frame
from fleetlog.store.documents import write_json
from fleetlog.store.squares import feature_collection, write_squares

if TYPE_CHECKING:
    import pandas as pd


def write_result(result: Result, folder: Path, frame: Frame | None = None) -> None:
    """``NAME.json``, tables as (Geo)Parquet, places as GeoJSON, grids as GeoTIFF; WGS 84 with a frame."""
    from fleetlog.store.geotiff import write_geotiff

    write_json(folder / f"{result.name}.json", {"format_version": 1, **result.summary}, indent=1)
    for name, table in {**result.tables, **result.places}.items():
        if name in result.squares:
            write_squares(table, result.squares[name], folder / name, frame)
        else:
            table.to_parquet(folder / f"{name}.parquet", index=False)
    for grid in (s for s in result.shapes if isinstance(s, Grid)):
        write_geotiff(grid, folder / f"{file_name(grid.name)}.tif", frame)
    for name, table in result.places.items():
        write_json(folder / f"{name}.geojson", points_geojson(table, frame))


def file_name(text: str) -> str:
    """``text`` as the name of a file on any system; characters that no name holds are percent-encoded."""
    return re.sub(r'[/\\:*?"<>|%\x00-\x1f\x7f]|^\.', lambda c: f"%{ord(c[0]):02X}", text)


def points_geojson(table: pd.DataFrame, frame: Frame | None) -> dict[str, Any]:
    """Rows with x, y [m] as RFC 7946 points; in local metres, said so, where there is no frame."""
    where = table[["x", "y"]].to_numpy()
    if frame is not None:
        latitude, longitude = frame.to_geographic(where[:, 0], where[:, 1])
        where = np.column_stack([np.round(longitude, 8), np.round(latitude, 8)])
    return feature_collection(table, "Point", where, frame)

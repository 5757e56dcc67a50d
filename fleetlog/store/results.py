"""Writing a result: summary as JSON, tables as Parquet, places as GeoJSON, grids as GeoTIFF."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fleetlog.core.result import Grid, Result
from fleetlog.core.site import Frame

if TYPE_CHECKING:
    import pandas as pd


def plain(value: Any) -> Any:
    """JSON-ready: numpy scalars and arrays to Python's own, NaN and infinity to null."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value


def write_result(result: Result, folder: Path, frame: Frame | None = None) -> None:
    """``NAME.json``, tables as Parquet, places as GeoJSON, cells as GeoParquet, grids as GeoTIFF into ``folder``.

    Geographic coordinates (WGS 84) where the site has a frame.
    """
    from fleetlog.store.geotiff import write_geotiff
    from fleetlog.store.squares import write_squares

    text = json.dumps(plain({"format_version": 1, **result.summary}), indent=1, allow_nan=False)
    (folder / f"{result.name}.json").write_text(text + "\n", encoding="utf-8")
    for name, table in {**result.tables, **result.places}.items():
        if name in result.squares:
            write_squares(table, result.squares[name], folder / name, frame)
        else:
            table.to_parquet(folder / f"{name}.parquet", index=False)
    for grid in (s for s in result.shapes if isinstance(s, Grid)):
        write_geotiff(grid, folder / f"{grid.name}.tif", frame)
    for name, table in result.places.items():
        (folder / f"{name}.geojson").write_text(
            json.dumps(points_geojson(table, frame)) + "\n", encoding="utf-8"
        )


def points_geojson(table: pd.DataFrame, frame: Frame | None) -> dict[str, Any]:
    """Rows with x, y [m] as RFC 7946 points; in local metres, said so in ``properties``, where there is no frame."""
    if frame is not None:
        latitude, longitude = frame.to_geographic(table["x"].to_numpy(), table["y"].to_numpy())
        where = np.column_stack([np.round(longitude, 8), np.round(latitude, 8)])
    else:
        where = table[["x", "y"]].to_numpy()
    features = [
        {"type": "Feature", "properties": plain({**row, "frame": "wgs84" if frame else "local metres"}),
         "geometry": {"type": "Point", "coordinates": plain(point)}}
        for row, point in zip(table.to_dict("records"), where, strict=True)
    ]  # fmt: skip
    return {"type": "FeatureCollection", "features": features}

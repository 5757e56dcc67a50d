"""Writing a result: summary as JSON, tables as Parquet, places and cells as GeoJSON too, grids as GeoTIFF.

A site is written as ``site.toml`` and ``roads.geojson``, as :func:`fleetlog.roads.load_site` reads them.

The tags are those of OGC GeoTIFF 1.1 (OGC 19-008r4): azimuthal equidistant metres about the site's origin; a
turned site by a full transformation.  Without a frame a raster lies in local metres."""

import json
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import tomli_w

from fleetlog.core.arrays import DataFrame, Floats
from fleetlog.core.network import Network
from fleetlog.core.result import Grid, Result
from fleetlog.core.site import Building, Frame, Place, Site, Zone
from fleetlog.store.documents import plain, write_json

MOST_GEOJSON = 20_000  # Cells beyond which no GeoJSON is written: Parquet is what larger maps are read from
_CORNERS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) / 2.0
_HEAD = [("order", "u1"), ("kind", "<u4"), ("rings", "<u4"), ("points", "<u4")]
_WKB = np.dtype([*_HEAD, ("xy", "<f8", (5, 2))])

PIXEL_SCALE, TIEPOINT, TRANSFORMATION, KEYS, DOUBLES, NODATA = 33550, 33922, 34264, 34735, 34736, 42113


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


def _write_squares(table: DataFrame, size: float, path: Path, frame: Frame | None) -> None:
    """Square cells about x, y [m]: GeoParquet 1.1, and GeoJSON where they are not too many."""
    rings = _coordinates(table[["x", "y"]].to_numpy(dtype=np.float64)[:, None, :] + size * _CORNERS, frame)
    wkb = np.zeros(len(rings), _WKB)
    wkb["order"], wkb["kind"], wkb["rings"], wkb["points"], wkb["xy"] = 1, 3, 1, 5, rings
    geometry = pa.array([polygon.tobytes() for polygon in wkb], pa.binary())
    arrow = pa.Table.from_pandas(table, preserve_index=False).append_column("geometry", geometry)
    column = {"encoding": "WKB", "geometry_types": ["Polygon"], **({} if frame else {"crs": None})}
    geo = {"version": "1.1.0", "primary_column": "geometry", "columns": {"geometry": column}}
    metadata = {**(arrow.schema.metadata or {}), b"geo": json.dumps(geo).encode()}
    pq.write_table(arrow.replace_schema_metadata(metadata), path.with_suffix(".parquet"))
    if len(table) <= MOST_GEOJSON:
        where = np.round(rings, 8 if frame else 3)[:, None]
        _write_features(path.with_suffix(".geojson"), table, "Polygon", where, frame)


def _write_features(
    path: Path, table: DataFrame, kind: str, coordinates: Iterable[Any], frame: Frame | None
) -> None:
    """The rows of a table as RFC 7946 features that say which frame they are in."""
    named = {"frame": "wgs84" if frame else "local metres"}
    features = [
        {"type": "Feature", "properties": {**row, **named}, "geometry": {"type": kind, "coordinates": where}}
        for row, where in zip(table.to_dict("records"), coordinates, strict=True)
    ]
    write_json(path, {"type": "FeatureCollection", "features": features})


def write_geotiff(grid: Grid, path: str | Path, frame: Frame | None = None) -> None:
    """Band 1: the values, 32-bit floats, north up, NaN where empty; band 2: a mask, where there is one."""
    import tifffile

    bands = grid.values if grid.mask is None else np.stack([grid.values, grid.mask], axis=-1)
    rotation = 0.0 if frame is None else frame.rotation
    (a, b, x), (d, e, y) = transformation(grid, rotation).tolist()
    tags: dict[int, Any] = {PIXEL_SCALE: (a, -e, 0.0), TIEPOINT: (0.0, 0.0, 0.0, x, y, 0.0)}
    if rotation:
        tags = {TRANSFORMATION: (a, b, 0.0, x, d, e, 0.0, y, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)}
    tags |= {**_system(frame), NODATA: "nan"}
    kinds = {str: "s", int: "H", float: "d"}
    tifffile.imwrite(
        path, bands[::-1].astype("<f4"), byteorder="<", photometric="minisblack", compression="zlib",
        planarconfig=None if grid.mask is None else "contig", metadata=None, software=False,
        description=f"{grid.name}: {grid.label}".encode(),
        extratags=[(number, kinds[type(v[0])], len(v), v, True) for number, v in tags.items()],
    )  # fmt: skip


def transformation(grid: Grid, rotation: float = 0.0) -> Floats:
    """(2, 3) from (column, row, 1), from the north-west corner, to metres east and north of the origin."""
    c, s = np.cos(rotation), np.sin(rotation)
    top = grid.y0 + len(grid.values) * grid.cell
    turn = np.array([[c, -s], [s, c]])
    return np.asarray(turn @ np.array([[grid.cell, 0.0, grid.x0], [0.0, -grid.cell, top]]), dtype=np.float64)


def _system(frame: Frame | None) -> dict[int, Any]:
    """Azimuthal equidistant (12) metres (9001) on WGS 84 (4326), or a model of the user's own (32767)."""
    if frame is None:
        return {KEYS: (1, 1, 0, 2, 1024, 0, 1, 32767, 1025, 0, 1, 1)}
    keys = [
        (1024, 0, 1, 1), (1025, 0, 1, 1), (2048, 0, 1, 4326), (3072, 0, 1, 32767), (3074, 0, 1, 32767),
        (3075, 0, 1, 12), (3076, 0, 1, 9001), (3082, 34736, 1, 0), (3083, 34736, 1, 0), (3088, 34736, 1, 1),
        (3089, 34736, 1, 2),
    ]  # fmt: skip
    flat = [v for key in [(1, 1, 0, len(keys)), *keys] for v in key]
    return {KEYS: tuple(flat), DOUBLES: (0.0, frame.longitude, frame.latitude)}


NOWHERE = Frame(0.0, 0.0)  # The frame of a site of unknown place: GeoJSON knows degrees only


def write_site(site: Site, folder: Path, more: Mapping[str, Mapping[str, Any]] | None = None) -> None:
    """Write ``site`` into an existing folder; ``more`` holds further properties of its roads by edge id.
    Coordinates are good to 0.1 mm. A site without a frame gets one at latitude and longitude 0."""
    frame = site.frame or NOWHERE
    if site.network is not None:
        write_json(folder / "roads.geojson", roads_geojson(site.network, frame, more or {}))
    own = {k: v for k, v in asdict(frame).items() if v not in (0.0, "UTC") or k in ("latitude", "longitude")}
    out: dict[str, Any] = {"name": site.name, "frame": own}
    if site.network is not None:
        out["network"] = {"file": "roads.geojson", "traffic": site.traffic}
    if math.isfinite(site.power_limit):
        out["power"] = {"limit": site.power_limit}
    tables = {
        "place": [_told(place) for place in site.places],
        "zone": [_told(zone) for zone in site.zones],
        "break": [{"from": _clock(a), "until": _clock(b)} for a, b in site.breaks],
        "building": [_told(building) for building in site.buildings],
    }
    out |= {name: rows for name, rows in tables.items() if rows}
    (folder / "site.toml").write_text(tomli_w.dumps(out), encoding="utf-8")


def _clock(seconds: float) -> str:
    return f"{int(seconds // 3600):02d}:{int(seconds % 3600 // 60):02d}"


def _told(item: Place | Zone | Building) -> dict[str, Any]:
    """What of a part of the site is known and no default, to the millimetre."""
    out: dict[str, Any] = {}
    for f in fields(item):
        value = getattr(item, f.name)
        if isinstance(value, np.ndarray):
            out[f.name] = np.round(value, 3).tolist()
        elif value == value and value != f.default:
            out[f.name] = round(value, 3) if isinstance(value, float) else value
    return out


def roads_geojson(network: Network, frame: Frame, more: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Every road once: both its directions where they share a line."""
    features = []
    for i, edge in enumerate(network.edge_ids):
        back = int(network.reverse[i])
        points, other = network.polyline(i), network.polyline(back)[::-1]
        oneway = back < 0 or bool(len(points) != len(other) or np.abs(points - other).max() > 1e-3)
        if oneway or not edge.startswith("-"):
            features.append(_feature(network, i, oneway, frame, more.get(edge, {})))
    return {"type": "FeatureCollection", "features": features}


def _feature(network: Network, i: int, oneway: bool, frame: Frame, more: Mapping[str, Any]) -> dict[str, Any]:
    points = network.polyline(i)
    latitude, longitude = frame.to_geographic(points[:, 0], points[:, 1])
    columns = [np.round(longitude, 9), np.round(latitude, 9)]
    if network.has_elevation:
        columns.append(np.round(points[:, 2], 3))
    properties: dict[str, Any] = {
        "id": network.edge_ids[i], "from": network.node_ids[network.start[i]],
        "to": network.node_ids[network.end[i]], "oneway": oneway,
    }  # fmt: skip
    for name, value in (("speed_limit", network.speed_limit[i]), ("width", network.width[i])):
        if np.isfinite(value):
            properties[name] = round(float(value), 3)
    properties.update(plain(dict(more)))
    line = {"type": "LineString", "coordinates": np.column_stack(columns).tolist()}
    return {"type": "Feature", "properties": properties, "geometry": line}

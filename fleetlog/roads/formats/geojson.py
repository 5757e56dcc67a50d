"""Roads as GeoJSON (RFC 7946): LineStrings in degrees, a third coordinate being the height.

Properties: ``id``, optionally ``from`` and ``to`` (nodes), ``oneway`` (default false), ``speed_limit`` [m/s],
``width`` [m].  A two-way road ``r`` becomes the edges ``r`` and ``-r``.  Where no road names its nodes, ends
that coincide are one node, and a road is split, as ``r:0``, ``r:1`` ..., at an inner vertex where another
road has a vertex too.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.network import Edge, reversed_edge
from fleetlog.errors import SiteError
from fleetlog.roads.formats._joints import Line, join_lines
from fleetlog.roads.formats._json import read_json
from fleetlog.roads.formats.base import Floats, MapOptions, Reader, RoadMap, Tally, number, without_repeats

KNOWN = ("id", "from", "to", "oneway", "speed_limit", "width")


@dataclass(frozen=True)
class Feature:
    """One LineString; ``points`` (n, 3) longitude, latitude, height; height NaN where the file has none."""

    id: str
    points: Floats
    oneway: bool
    speed_limit: float
    width: float
    start: str | None
    end: str | None


def sniff(head: bytes) -> bool:
    """A JSON object that says Feature."""
    return head.lstrip().startswith(b"{") and b'"Feature' in head


def read(path: Path, options: MapOptions) -> RoadMap:
    """Read a file of roads; see the module."""
    tally = Tally()
    features = list(_features(_document(path), path, tally))
    if not features:
        raise SiteError(_nothing(tally), where=path, do="give roads as LineStrings with an id")
    lines, edges = _with_nodes(features, path, tally), []
    heights = _has_heights(features, tally)
    for line in lines:
        points = line.points if heights else line.points * [1.0, 1.0, 0.0]
        f = features[line.source]
        edge = Edge(line.id, line.start, line.end, points, line.id, f.speed_limit, f.width)
        edges += [edge] if f.oneway else [edge, reversed_edge(edge)]
    tally.kept = len(features)
    return RoadMap(edges, tally.report("GeoJSON"), geographic=True, has_elevation=heights)


def _document(path: Path) -> list[Any]:
    data = read_json(path)
    kind = data.get("type") if isinstance(data, dict) else None
    if kind == "Feature":
        return [data]
    if kind != "FeatureCollection" or not isinstance(data.get("features"), list):
        raise SiteError("is not a FeatureCollection", where=path, do="write the roads as RFC 7946 GeoJSON")
    name = str(((data.get("crs") or {}).get("properties") or {}).get("name", "CRS84"))
    if not any(known in name for known in ("CRS84", "4326")):
        raise SiteError(
            f"coordinates are in {name}", where=path, place="crs", do="export it in degrees (RFC 7946)"
        )
    return list(data["features"])


def _features(raw: list[Any], path: Path, tally: Tally) -> Iterator[Feature]:
    taken: set[str] = set()
    unread: dict[str, int] = {}
    unnamed = 0
    for n, item in enumerate(raw):
        tally.read += 1
        place = f"feature {n}"
        properties, parts = _pieces(item, path, place)
        if not parts:
            tally.drop("not a line")
            continue
        for key in set(properties) - set(KNOWN):
            unread[key] = unread.get(key, 0) + 1
        name = properties.get("id", item.get("id"))
        if name is None:
            unnamed, name = unnamed + 1, f"road{n}"
        for k, part in enumerate(parts):
            road = str(name) if len(parts) == 1 else f"{name}:part{k}"
            points = without_repeats(_points(part, path, place))
            if len(points) < 2:
                tally.drop("without length")
                continue
            if road in taken:
                raise SiteError(
                    f"the id {road!r} occurs twice", where=path, place=place, do="give every road its own"
                )
            taken.add(road)
            yield _feature(road, points, properties, path, place, whole=len(parts) == 1)
    _say_unread(unread, unnamed, tally)


def _pieces(item: Any, path: Path, place: str) -> tuple[dict[str, Any], list[Any]]:
    if not isinstance(item, dict) or not isinstance(item.get("geometry") or {}, dict):
        raise SiteError("is not a feature", where=path, place=place)
    geometry = item.get("geometry") or {}
    coordinates = geometry.get("coordinates") or []
    parts = {"LineString": [coordinates], "MultiLineString": coordinates}.get(str(geometry.get("type")), [])
    properties = item.get("properties") or {}
    if not isinstance(properties, dict):
        raise SiteError("its properties are not an object", where=path, place=place)
    return properties, list(parts)


def _points(raw: Any, path: Path, place: str) -> Floats:
    rows = []
    for vertex in raw if isinstance(raw, list) else [None]:
        if not isinstance(vertex, list) or len(vertex) < 2:
            raise SiteError(f"{vertex!r} is not a position", where=path, place=place, do="write [lon, lat]")
        rows.append([number(v, path, place) for v in vertex[:3]] + [math.nan] * (3 - len(vertex[:3])))
    points = np.array(rows, dtype=np.float64).reshape(-1, 3)
    if len(points) and (np.abs(points[:, 0]).max() > 180.0 or np.abs(points[:, 1]).max() > 90.0):
        raise SiteError(
            "coordinates are not longitude and latitude in degrees", where=path, place=place,
            do="export the roads in degrees (RFC 7946); local metres belong into an OpenDRIVE or LIF file",
        )  # fmt: skip
    return points


def _feature(road: str, points: Floats, p: dict[str, Any], path: Path, place: str, whole: bool) -> Feature:
    nodes = [str(p[k]) if whole and p.get(k) is not None else None for k in ("from", "to")]
    limit, width = (_positive(p.get(k), path, f"{place}, {k}") for k in ("speed_limit", "width"))
    return Feature(road, points, _truth(p.get("oneway"), path, place), limit, width, *nodes)


def _positive(value: Any, path: Path, place: str) -> float:
    if value is None:
        return math.nan
    if isinstance(value, bool) or (result := number(value, path, place)) <= 0.0:
        raise SiteError(
            f"{value!r} is not above zero", where=path, place=place, do="leave it out where unknown"
        )
    return result


def _truth(value: Any, path: Path, place: str) -> bool:
    table = {None: False, False: False, True: True, "no": False, "yes": True, "false": False, "true": True}
    key = value.lower() if isinstance(value, str) else value
    if isinstance(key, list | dict) or key not in table:
        raise SiteError(f"oneway is {value!r}", where=path, place=place, do="write true or false")
    return table[key]


def _has_heights(features: list[Feature], tally: Tally) -> bool:
    known = [bool(np.isfinite(f.points[:, 2]).all()) for f in features]
    missing = len(known) - sum(known)
    if missing and any(known):
        tally.notes.append(f"{missing} of {len(known)} roads have no heights, so no height is used")
    if missing:
        for f in features:
            f.points[:, 2] = 0.0
    return not missing


def _with_nodes(features: list[Feature], path: Path, tally: Tally) -> list[Line]:
    named = sum(f.start is not None and f.end is not None for f in features)
    lines = [Line(f.id, f.points, k, f.start or "", f.end or "") for k, f in enumerate(features)]
    if named == len(features):
        return lines
    if named:
        tally.notes.append(
            f"{len(features) - named} of {len(features)} roads name no nodes; "
            "theirs are found by coinciding ends"
        )
    return join_lines(lines, split=not named, notes=tally.notes)


def _say_unread(unread: dict[str, int], unnamed: int, tally: Tally) -> None:
    if unnamed:
        tally.notes.append(f"{unnamed} roads have no id and are numbered by their place in the file")
    for key, count in sorted(unread.items()):
        close = difflib.get_close_matches(key.lower(), KNOWN, n=1, cutoff=0.75)
        if close:
            tally.notes.append(f"property {key!r} of {count} roads is not read; did you mean {close[0]!r}?")


def _nothing(tally: Tally) -> str:
    why = ", ".join(f"{count} {reason}" for reason, count in tally.dropped.items())
    return f"no road in it: {tally.read} features" + (f" ({why})" if why else "")


READER = Reader("GeoJSON", (".geojson",), sniff, read)

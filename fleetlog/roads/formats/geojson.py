"""Roads as GeoJSON (RFC 7946): LineStrings in degrees, a third coordinate being the height.

Properties: ``id``, optionally ``from`` and ``to`` (nodes), ``oneway`` (default false), ``speed_limit`` [m/s],
``width`` [m].  A two-way road ``r`` becomes the edges ``r`` and ``-r``.  Where no road names its nodes, ends
that coincide are one node, and a road is split, as ``r:0``, ``r:1`` ..., at an inner vertex where another
road has a vertex too.
"""

import difflib
import math
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.network import Edge, reversed_edge
from fleetlog.errors import SiteError
from fleetlog.roads.formats._joints import Line, join_lines
from fleetlog.roads.formats._json import read_json
from fleetlog.roads.formats.base import (
    Floats,
    MapOptions,
    Reader,
    RoadMap,
    Tally,
    at,
    number,
    without_repeats,
)

KNOWN = ("id", "from", "to", "oneway", "speed_limit", "width")
TRUTH = {None: False, False: False, True: True, "no": False, "yes": True, "false": False, "true": True}


def sniff(head: bytes) -> bool:
    """A JSON object that says Feature."""
    return head.lstrip().startswith(b"{") and b'"Feature' in head


def read(path: Path, options: MapOptions) -> RoadMap:
    """Read a file of roads; see the module."""
    tally = Tally()
    roads = _roads(_document(path), tally)
    if not roads:
        why = ", ".join(f"{count} {reason}" for reason, count in tally.dropped.items())
        what = f"no road in it: {tally.read} features" + (f" ({why})" if why else "")
        raise SiteError(what, do="give roads as LineStrings with an id")
    lines, edges = _with_nodes(roads, tally), []
    heights = _has_heights(roads, tally)
    for line in lines:
        points = line.points if heights else np.column_stack([line.points[:, :2], np.zeros(len(line.points))])
        limit, width, oneway = line.traits
        edge = Edge(line.id, line.start, line.end, points, line.id, limit, width)
        edges += [edge] if oneway else [edge, reversed_edge(edge)]
    tally.kept = len(roads)
    return RoadMap(edges, tally.report("GeoJSON"), geographic=True, has_elevation=heights)


def _document(path: Path) -> list[Any]:
    data = read_json(path)
    kind = data.get("type") if isinstance(data, dict) else None
    if kind == "Feature":
        return [data]
    if kind != "FeatureCollection" or not isinstance(data.get("features"), list):
        raise SiteError("is not a FeatureCollection", do="write the roads as RFC 7946 GeoJSON")
    name = str(((data.get("crs") or {}).get("properties") or {}).get("name", "CRS84"))
    if not any(known in name for known in ("CRS84", "4326")):
        raise SiteError(f"coordinates are in {name}", place="crs", do="export it in degrees (RFC 7946)")
    return list(data["features"])


def _roads(raw: list[Any], tally: Tally) -> list[Line]:
    """The roads of all features; nodes "" where not named, heights NaN where the file has none."""
    out: dict[str, Line] = {}
    unread: Counter[str] = Counter()
    unnamed = 0
    for n, item in enumerate(raw):
        tally.read += 1
        with at(f"feature {n}"):
            properties, parts = _pieces(item)
            if not parts:
                tally.drop("not a line")
                continue
            unread.update(set(properties) - set(KNOWN))
            name = properties.get("id", item.get("id"))
            if name is None:
                unnamed, name = unnamed + 1, f"road{n}"
            for k, part in enumerate(parts):
                road = str(name) if len(parts) == 1 else f"{name}:part{k}"
                points = without_repeats(_points(part))
                if len(points) < 2:
                    tally.drop("without length")
                elif road in out:
                    raise SiteError(f"the id {road!r} occurs twice", do="give every road its own")
                else:
                    out[road] = _road(road, points, properties, whole=len(parts) == 1)
    _say_unread(unread, unnamed, tally)
    return list(out.values())


def _pieces(item: Any) -> tuple[dict[str, Any], list[Any]]:
    if not isinstance(item, dict) or not isinstance(item.get("geometry") or {}, dict):
        raise SiteError("is not a feature")
    geometry = item.get("geometry") or {}
    coordinates = geometry.get("coordinates") or []
    parts = {"LineString": [coordinates], "MultiLineString": coordinates}.get(str(geometry.get("type")), [])
    properties = item.get("properties") or {}
    if not isinstance(properties, dict):
        raise SiteError("its properties are not an object")
    return properties, list(parts)


def _points(raw: Any) -> Floats:
    rows = []
    for vertex in raw if isinstance(raw, list) else [None]:
        if not isinstance(vertex, list) or len(vertex) < 2:
            raise SiteError(f"{vertex!r} is not a position", do="write [lon, lat]")
        rows.append([*map(number, vertex[:3]), math.nan][:3])
    points = np.array(rows, dtype=np.float64).reshape(-1, 3)
    if len(points) and (np.abs(points[:, :2]).max(axis=0) > [180.0, 90.0]).any():
        raise SiteError(
            "coordinates are not longitude and latitude in degrees",
            do="export the roads in degrees (RFC 7946); local metres belong into an OpenDRIVE or LIF file",
        )
    return points


def _road(name: str, points: Floats, p: dict[str, Any], whole: bool) -> Line:
    start, end = (str(p[k]) if whole and p.get(k) is not None else "" for k in ("from", "to"))
    limit, width = (_positive(p.get(k), k) for k in ("speed_limit", "width"))
    return Line(name, points, start, end, (limit, width, _truth(p.get("oneway"))))


def _positive(value: Any, key: str) -> float:
    if value is None:
        return math.nan
    if isinstance(value, bool) or (result := number(value, key)) <= 0.0:
        raise SiteError(f"{value!r} is not above zero", place=key, do="leave it out where unknown")
    return result


def _truth(value: Any) -> bool:
    key = value.lower() if isinstance(value, str) else value
    if isinstance(key, list | dict) or key not in TRUTH:
        raise SiteError(f"oneway is {value!r}", do="write true or false")
    return TRUTH[key]


def _has_heights(roads: list[Line], tally: Tally) -> bool:
    known = [bool(np.isfinite(road.points[:, 2]).all()) for road in roads]
    missing = len(known) - sum(known)
    if missing and any(known):
        tally.notes.append(f"{missing} of {len(known)} roads have no heights, so no height is used")
    return not missing


def _with_nodes(roads: list[Line], tally: Tally) -> list[Line]:
    missing = sum(not (road.start and road.end) for road in roads)
    if not missing:
        return roads
    if missing < len(roads):
        tally.notes.append(
            f"{missing} of {len(roads)} roads name no nodes; theirs are found by coinciding ends"
        )
    return join_lines(roads, split=missing == len(roads), notes=tally.notes)


def _say_unread(unread: Counter[str], unnamed: int, tally: Tally) -> None:
    if unnamed:
        tally.notes.append(f"{unnamed} roads have no id and are numbered by their place in the file")
    for key, count in sorted(unread.items()):
        close = difflib.get_close_matches(key.lower(), KNOWN, n=1, cutoff=0.75)
        if close:
            tally.notes.append(f"property {key!r} of {count} roads is not read; did you mean {close[0]!r}?")


READER = Reader("GeoJSON", (".geojson",), sniff, read)

"""Roads as GeoJSON (RFC 7946): LineStrings in degrees, a third coordinate being the height.

Properties: ``id``, optionally ``from`` and ``to`` (nodes), ``oneway`` (default false), ``speed_limit`` [m/s],
``width`` [m].  A two-way road ``r`` becomes the edges ``r`` and ``-r``.  Where no road names its nodes, ends
that coincide are one node, and a road is split, as ``r:0``, ``r:1`` ..., at inner vertices that it shares."""

import difflib
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.arrays import Floats, Indices, Ints
from fleetlog.core.network import Edge, reversed_edge
from fleetlog.errors import SiteError
from fleetlog.roads.formats._documents import read_json
from fleetlog.roads.formats.base import MapOptions, Reader, RoadMap, Tally, at, number

KNOWN = ("id", "from", "to", "oneway", "speed_limit", "width")
TOLERANCE = 0.1  # vertices nearer than this [m] are one place; well under half the width of any road
TRUTH = {None: False, False: False, True: True, "no": False, "yes": True, "false": False, "true": True}


def _read(path: Path, options: MapOptions) -> RoadMap:
    tally, raw = Tally(), _document(path)
    oneway = _add_roads(raw, tally)
    lines, tally.edges = tally.edges, []
    flat = sum(not np.isfinite(road.points[:, 2]).all() for road in lines)
    nameless = sum(not (road.start and road.end) for road in lines)
    if 0 < flat < len(lines):
        tally.notes.append(f"no heights on {flat} of {len(lines)} roads, so no height is used")
    if 0 < nameless < len(lines):
        tally.notes.append(f"no nodes named by {nameless} of {len(lines)} roads: coinciding ends are joined")
    for line in _join_lines(lines, nameless == len(lines), tally) if nameless else lines:
        if flat:
            line.points[:, 2] = 0.0
        edge = replace(line, road=line.id)
        tally.edges += [edge] if line.road in oneway else [edge, reversed_edge(edge)]
    do = "give roads as LineStrings with an id"
    nothing = f"no road in it; features read: {len(raw)}"
    return tally.road_map("GeoJSON", nothing, do, geographic=True, has_elevation=not flat)


def _document(path: Path) -> list[Any]:
    data = read_json(path)
    if (kind := data.get("type") if isinstance(data, dict) else None) == "Feature":
        return [data]
    if kind != "FeatureCollection" or not isinstance(data.get("features"), list):
        raise SiteError("is not a FeatureCollection", do="write the roads as RFC 7946 GeoJSON")
    name = str(((data.get("crs") or {}).get("properties") or {}).get("name", "CRS84"))
    if not any(known in name for known in ("CRS84", "4326")):
        raise SiteError(f"coordinates are in {name}", place="crs", do="export it in degrees (RFC 7946)")
    return list(data["features"])


def _add_roads(raw: list[Any], tally: Tally) -> set[str]:
    """Roads as drawn, nodes "" where not named, heights NaN where none are given; the one-way ones."""
    oneway: set[str] = set()
    unread: Counter[str] = Counter()
    unnamed = 0
    for n, item in enumerate(raw):
        with at(f"feature {n}"):
            if not isinstance(item, dict) or not isinstance(item.get("geometry") or {}, dict):
                raise SiteError("is not a feature")
            geometry, properties = item.get("geometry") or {}, item.get("properties") or {}
            if not isinstance(properties, dict):
                raise SiteError("its properties are not an object")
            lines = geometry.get("coordinates") or []
            parts = list({"LineString": [lines], "MultiLineString": lines}.get(str(geometry.get("type")), []))
            if not parts:
                tally.dropped["not a line"] += 1
                continue
            unread.update(set(properties) - set(KNOWN))
            if (name := properties.get("id", item.get("id"))) is None:
                unnamed, name = unnamed + 1, f"road{n}"
            for k, part in enumerate(parts):
                road = str(name) if len(parts) == 1 else f"{name}:part{k}"
                ends = (properties.get(k) if len(parts) == 1 else None for k in ("from", "to"))
                start, end = ("" if node is None else str(node) for node in ends)
                limit, width = (_positive(properties.get(k), k) for k in ("speed_limit", "width"))
                tally.keep(Edge(road, start, end, _points(part), road, limit, width))
                said = properties.get("oneway")
                key = said.lower() if isinstance(said, str) else said
                if isinstance(key, list | dict) or key not in TRUTH:
                    raise SiteError(f"oneway is {said!r}", do="write true or false")
                oneway |= {road} if TRUTH[key] else set()
    tally.note(unnamed, "road", "without an id, numbered by the place in the file")
    for key, n in sorted(unread.items()):
        if close := difflib.get_close_matches(key.lower(), KNOWN, n=1, cutoff=0.75):
            tally.note(n, "road", f"with an unread property {key!r}; did you mean {close[0]!r}?")
    return oneway


def _points(raw: Any) -> Floats:
    rows = []
    for vertex in raw if isinstance(raw, list) else [None]:
        if not isinstance(vertex, list) or len(vertex) < 2:
            raise SiteError(f"{vertex!r} is not a position", do="write [lon, lat]")
        rows.append([*map(number, vertex[:3]), math.nan][:3])
    points = np.array(rows, dtype=np.float64).reshape(-1, 3)
    if (np.abs(points[:, :2]) > [180.0, 90.0]).any():
        do = "export the roads in degrees (RFC 7946); local metres belong into an OpenDRIVE or LIF file"
        raise SiteError("coordinates are not longitude and latitude in degrees", do=do)
    return points


def _positive(value: Any, key: str) -> float:
    if value is None:
        return math.nan
    if isinstance(value, bool) or (result := number(value, key)) <= 0.0:
        raise SiteError(f"{value!r} is not above zero", place=key, do="leave it out where unknown")
    return result


def _join_lines(lines: list[Edge], split: bool, tally: Tally) -> Iterator[Edge]:
    """Lines in degrees with the nodes "" named; where ``split``, cut at inner vertices shared with others."""
    first = np.concatenate([[0], np.cumsum([len(line.points) for line in lines])])
    owner = np.repeat(np.arange(len(lines)), np.diff(first))
    place = _places(np.concatenate([line.points for line in lines]), owner, first)
    names = {int(place[first[k]]): line.start for k, line in enumerate(lines) if line.start}
    names |= {int(place[first[k + 1] - 1]): line.end for k, line in enumerate(lines) if line.end}
    shared = (np.bincount(np.unique([place, owner], axis=1)[0]) > 1) & split  # by several roads
    divided = 0
    for line, own in zip(lines, np.split(place, first[1:-1]), strict=True):
        cut = shared[own] & (own != own[0]) & (own != own[-1])
        cut[1:] &= own[1:] != own[:-1]
        bounds = [0, *np.flatnonzero(cut).tolist(), len(own) - 1]
        divided += len(bounds) > 2
        nodes = [names.get(p, f"@{p}") for p in own[bounds].tolist()]
        nodes[0], nodes[-1] = line.start or nodes[0], line.end or nodes[-1]
        for n, ((a, b), (start, end)) in enumerate(zip(pairwise(bounds), pairwise(nodes), strict=True)):
            name = f"{line.id}:{n}" if len(bounds) > 2 else line.id
            yield replace(line, id=name, points=line.points[a : b + 1], start=start, end=end)
    tally.note(divided, "road", "split, as ID:0, ID:1 ..., where a vertex of another road lies on a vertex")


def _places(points: Floats, owner: Indices, first: Ints) -> Ints:
    """(P,) place of each vertex: groups within the tolerance, of several roads or of road ends."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    # Rough metres about the first vertex; good to a per mille, enough to see which vertices coincide.
    degree = 111_200.0
    scale = np.array([degree * np.cos(np.radians(points[0, 1])), degree, 1.0])
    metres = np.nan_to_num((points - points[0]) * scale)
    end = np.zeros(len(points), dtype=bool)
    end[first[:-1]] = end[first[1:] - 1] = True
    a, b = cKDTree(metres).query_pairs(TOLERANCE, output_type="ndarray").T
    # A densely drawn road must not shrink into one place: its own vertices join only at its two ends.
    keep = (owner[a] != owner[b]) | (end[a] & end[b])
    graph = coo_matrix((np.ones(keep.sum()), (a[keep], b[keep])), shape=(len(points),) * 2)
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


READER = Reader("GeoJSON", (".geojson",), r'\A\{.*"Feature', _read)

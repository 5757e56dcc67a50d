"""GraphML as OSMnx writes it: a street network of nodes with x, y and edges with an optional LINESTRING.

An edge that has a twin along the same line in the other direction makes one two-way road ``u_v_key`` with the
edges ``u_v_key`` (as OSM digitised it) and ``-u_v_key``.  Speed is ``maxspeed``, else OSMnx's imputed
``speed_kph``; heights come from node ``elevation`` where every node has one.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fleetlog.core.frames import geographic
from fleetlog.core.network import Edge, reverse_id
from fleetlog.errors import SiteError
from fleetlog.roads.formats._xml import looks_like, parse_xml
from fleetlog.roads.formats.base import (
    Floats,
    Inverse,
    MapOptions,
    Reader,
    RoadMap,
    Tally,
    at,
    number,
    osm_speed,
    without_repeats,
)

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

    Attributes = dict[str, str]


def sniff(head: bytes) -> bool:
    """A GraphML root."""
    return looks_like(head, "graphml")


def read(path: Path, options: MapOptions) -> RoadMap:
    """Read a street network; see the module."""
    tally = Tally()
    root = parse_xml(path, "graphml", tally.notes)
    names = {str(k.get("id")): str(k.get("attr.name")) for k in root.iterfind("key")}
    graph = root.find("graph")
    if graph is None:
        raise SiteError("has no graph", do="save it with OSMnx's save_graphml")
    nodes = {str(n.get("id")): _attributes(n, names) for n in graph.iterfind("node")}
    spots = {name: _spot(name, a) for name, a in nodes.items()}
    heights = bool(spots) and all(math.isfinite(p[2]) for p in spots.values())
    if not heights:
        spots = {name: np.array([*p[:2], 0.0]) for name, p in spots.items()}
    edges = _paired(_edges(graph, names, spots, tally))
    if not edges:
        raise SiteError(f"no road in it: {tally.read} edges", do="save a street network with OSMnx")
    tally.kept = len(edges)
    local = _projection(_attributes(graph, names).get("crs", "epsg:4326"))
    report = tally.report("GraphML, directed")
    return RoadMap(edges, report, local is None, geographic_of=local, has_elevation=heights)


def _attributes(element: Element, names: dict[str, str]) -> Attributes:
    return {names.get(str(d.get("key")), ""): d.text or "" for d in element.iterfind("data")}


def _spot(name: str, a: Attributes) -> Floats:
    place = f"node {name}"
    if "x" not in a or "y" not in a:
        raise SiteError("has no x or no y", place=place, do="save the graph with OSMnx")
    height = number(a["elevation"], place) if a.get("elevation") else math.nan
    return np.array([number(a["x"], place), number(a["y"], place), height])


def _edges(
    graph: Element, names: dict[str, str], spots: dict[str, Floats], tally: Tally
) -> list[tuple[Edge, bool]]:
    """Edges named ``u_v_key``, and whether OSM digitised them the other way round."""
    out = []
    for n, element in enumerate(graph.iterfind("edge")):
        tally.read += 1
        u, v = str(element.get("source")), str(element.get("target"))
        with at(f"edge {u} to {v}"):
            for end in (u, v):
                if end not in spots:
                    raise SiteError(f"there is no node {end}", do="save the graph again")
            a = _attributes(element, names)
            points = without_repeats(_line(a.get("geometry", ""), spots[u], spots[v]))
            if len(points) < 2:
                tally.drop("without length")
                continue
            name = f"{u}_{v}_{element.get('id', n)}"
            edge = Edge(name, u, v, points, name, _limit(a), _width(a.get("width", "")))
            out.append((edge, a.get("reversed") == "True"))
    return out


def _limit(a: Attributes) -> float:
    limit = osm_speed(a.get("maxspeed", ""))
    return number(a["speed_kph"]) / 3.6 if math.isnan(limit) and a.get("speed_kph") else limit


def _width(text: str) -> float:
    try:
        width = float(text)
    except ValueError:
        return math.nan
    return width if 0.0 < width < 100.0 else math.nan


def _line(text: str, start: Floats, end: Floats) -> Floats:
    """(n, 3) vertices of a WKT LINESTRING, heights even from node to node; straight without a text."""
    if not text:
        return np.array([start, end])
    kind, _, body = text.partition("(")
    if kind.split()[:1] != ["LINESTRING"] or not body.rstrip().endswith(")"):
        raise SiteError(f"geometry {text[:30]!r} is no LINESTRING", do="save the graph again")
    rows = [[number(v) for v in vertex.split()[:2]] for vertex in body.rstrip()[:-1].split(",")]
    if any(len(row) != 2 for row in rows) or len(rows) < 2:
        raise SiteError("its LINESTRING is broken", do="save the graph again")
    flat = np.array(rows, dtype=np.float64)
    passed = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(flat, axis=0), axis=1))])
    share = passed / max(float(passed[-1]), 1e-12)
    return np.column_stack([flat, start[2] + share * (end[2] - start[2])])


def _paired(edges: list[tuple[Edge, bool]]) -> list[Edge]:
    """Twins along one line become the two directions of one road."""
    by_line: dict[tuple[str, str, bytes], list[int]] = {}
    for k, (edge, _) in enumerate(edges):
        by_line.setdefault((edge.start, edge.end, edge.points.tobytes()), []).append(k)
    out: list[Edge] = [edge for edge, _ in edges]
    taken: set[int] = set()
    for k, (edge, against) in enumerate(edges):
        twins = by_line.get((edge.end, edge.start, edge.points[::-1].tobytes()), [])
        twin = next((t for t in twins if t not in taken and t != k), None)
        if k in taken or twin is None:
            continue
        taken |= {k, twin}
        first, second = (twin, k) if against else (k, twin)
        name = edges[first][0].id
        out[second] = replace(edges[second][0], id=reverse_id(name), road=name)
    return out


def _projection(crs: str) -> Inverse | None:
    """None for degrees; else x, y [m] to latitude, longitude."""
    from pyproj import CRS
    from pyproj.exceptions import ProjError

    try:
        system = CRS.from_user_input(crs)
    except ProjError:
        raise SiteError(f"crs {crs!r} is not known", place="graph", do="save it in epsg:4326") from None
    return None if system.is_geographic else partial(geographic, crs)


READER = Reader("GraphML", (".graphml",), sniff, read)

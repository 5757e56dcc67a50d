"""GraphML as OSMnx writes it: a street network of nodes with x, y and edges with an optional LINESTRING.

An edge that has a twin along the same line in the other direction makes one two-way road ``u_v_key`` with the
edges ``u_v_key`` (as OSM digitised it) and ``-u_v_key``.  Speed is ``maxspeed``, else OSMnx's imputed
``speed_kph``; heights come from node ``elevation`` where every node has one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fleetlog.core.network import Edge, reverse_id
from fleetlog.errors import SiteError
from fleetlog.roads.formats._xml import looks_like, parse_xml
from fleetlog.roads.formats.base import (
    Floats,
    MapOptions,
    Reader,
    RoadMap,
    Tally,
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
        raise SiteError("has no graph", where=path, do="save it with OSMnx's save_graphml")
    nodes = {str(n.get("id")): _attributes(n, names) for n in graph.iterfind("node")}
    spots = {name: _spot(a, path, f"node {name}") for name, a in nodes.items()}
    heights = bool(spots) and all(math.isfinite(p[2]) for p in spots.values())
    if not heights:
        spots = {
            name: p * [1.0, 1.0, 0.0] if math.isfinite(p[2]) else np.array([*p[:2], 0.0])
            for name, p in spots.items()
        }
    edges = _edges(graph, names, spots, path, tally)
    named = _paired(edges)
    if not named:
        raise SiteError(
            f"no road in it: {tally.read} edges", where=path, do="save a street network with OSMnx"
        )
    tally.kept = len(named)
    local = _projection(_attributes(graph, names).get("crs", "epsg:4326"), path)
    return RoadMap(
        named,
        tally.report("GraphML, directed"),
        geographic=local is None,
        geographic_of=local,
        has_elevation=heights,
    )


def _attributes(element: Element, names: dict[str, str]) -> Attributes:
    return {names.get(str(d.get("key")), ""): d.text or "" for d in element.iterfind("data")}


def _spot(a: Attributes, path: Path, place: str) -> Floats:
    if "x" not in a or "y" not in a:
        raise SiteError("has no x or no y", where=path, place=place, do="save the graph with OSMnx")
    height = number(a["elevation"], path, place) if a.get("elevation") else math.nan
    return np.array([number(a["x"], path, place), number(a["y"], path, place), height])


def _edges(
    graph: Element, names: dict[str, str], spots: dict[str, Floats], path: Path, tally: Tally
) -> list[tuple[Edge, bool]]:
    """Edges named ``u_v_key``, and whether OSM digitised them the other way round."""
    out = []
    for n, element in enumerate(graph.iterfind("edge")):
        tally.read += 1
        u, v = str(element.get("source")), str(element.get("target"))
        place = f"edge {u} to {v}"
        for end in (u, v):
            if end not in spots:
                raise SiteError(f"there is no node {end}", where=path, place=place, do="save the graph again")
        a = _attributes(element, names)
        points = without_repeats(_line(a.get("geometry", ""), spots[u], spots[v], path, place))
        if len(points) < 2:
            tally.drop("without length")
            continue
        name = f"{u}_{v}_{element.get('id', n)}"
        limit = osm_speed(a.get("maxspeed", ""))
        if math.isnan(limit) and a.get("speed_kph"):
            limit = number(a["speed_kph"], path, place) / 3.6
        out.append(
            (Edge(name, u, v, points, name, limit, _width(a.get("width", ""))), a.get("reversed") == "True")
        )
    return out


def _width(text: str) -> float:
    try:
        width = float(text)
    except ValueError:
        return math.nan
    return width if 0.0 < width < 100.0 else math.nan


def _line(text: str, start: Floats, end: Floats, path: Path, place: str) -> Floats:
    """(n, 3) vertices of a WKT LINESTRING, heights going evenly from node to node;
    a straight line without a text.
    """
    if not text:
        return np.array([start, end])
    kind, _, body = text.partition("(")
    if kind.split()[:1] != ["LINESTRING"] or not body.rstrip().endswith(")"):
        raise SiteError(
            f"geometry {text[:30]!r} is no LINESTRING", where=path, place=place, do="save the graph again"
        )
    rows = [[number(v, path, place) for v in vertex.split()[:2]] for vertex in body.rstrip()[:-1].split(",")]
    if any(len(row) != 2 for row in rows) or len(rows) < 2:
        raise SiteError("its LINESTRING is broken", where=path, place=place, do="save the graph again")
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
        name, other = edges[first][0].id, edges[second][0]
        out[second] = Edge(
            reverse_id(name), other.start, other.end, other.points, name, other.speed_limit, other.width
        )
    return out


def _projection(crs: str, path: Path) -> Callable[[Floats, Floats], tuple[Floats, Floats]] | None:
    """None for degrees; else x, y [m] to latitude, longitude."""
    from pyproj import CRS, Transformer
    from pyproj.exceptions import ProjError

    try:
        system = CRS.from_user_input(crs)
    except ProjError:
        raise SiteError(
            f"crs {crs!r} is not known", where=path, place="graph", do="save it in epsg:4326"
        ) from None
    if system.is_geographic:
        return None
    transformer = Transformer.from_crs(system, "EPSG:4326", always_xy=True)

    def inverse(x: Floats, y: Floats) -> tuple[Floats, Floats]:
        longitude, latitude = transformer.transform(x, y)
        return np.asarray(latitude, dtype=np.float64), np.asarray(longitude, dtype=np.float64)

    return inverse


READER = Reader("GraphML", (".graphml",), sniff, read)

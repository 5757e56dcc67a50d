"""GraphML as OSMnx writes it: a street network of nodes with x, y and edges with an optional LINESTRING.

An edge that has a twin along the same line in the other direction makes one two-way road ``u_v_key`` with the
edges ``u_v_key`` (as OSM digitised it) and ``-u_v_key``.  Speed is ``maxspeed``, else OSMnx's imputed
``speed_kph``; heights come from node ``elevation`` where every node has one."""

import math
import re
from collections import defaultdict
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.core.network import Edge, reverse_id
from fleetlog.core.site import geographic
from fleetlog.errors import SiteError
from fleetlog.roads.formats._documents import Element, parse_xml
from fleetlog.roads.formats.base import KMH, MapOptions, Nodes, Reader, RoadMap, Tally, at, number, spot
from fleetlog.roads.formats.osm import osm_speed, osm_width

Attributes = dict[str, str]


def _read(path: Path, options: MapOptions) -> RoadMap:
    from pyproj import CRS
    from pyproj.exceptions import ProjError

    tally = Tally()
    root = parse_xml(path, "graphml", tally.notes)
    names = {str(k.get("id")): str(k.get("attr.name")) for k in root.iterfind("key")}
    if (graph := root.find("graph")) is None:
        raise SiteError("has no graph", do="save it with OSMnx's save_graphml")
    said = {str(n.get("id")): _attributes(n, names) for n in graph.iterfind("node")}
    heights = all(a.get("elevation") for a in said.values())
    places = ((n, a.get("x"), a.get("y"), a["elevation"] if heights else 0.0) for n, a in said.items())
    nodes = Nodes((name, spot(x, y, f"node {name}", height)) for name, x, y, height in places)
    against: set[str] = set()
    for n, element in enumerate(graph.iterfind("edge")):
        u, v = str(element.get("source")), str(element.get("target"))
        name, a = f"{u}_{v}_{element.get('id', n)}", _attributes(element, names)
        with at(f"edge {u} to {v}"):
            line = _line(a.get("geometry", ""), nodes[u], nodes[v])
            limit = osm_speed(a.get("maxspeed", ""))
            if math.isnan(limit) and a.get("speed_kph"):
                limit = number(a["speed_kph"]) * KMH
            tally.keep(Edge(name, u, v, line, name, limit, osm_width(a.get("width", ""))))
        against |= {name} if a.get("reversed") == "True" else set()
    # Twins along one line become the two directions of one road, named after that not against OSM's.
    edges, waiting = tally.edges.copy(), defaultdict[tuple[str, str, bytes], list[int]](list)
    for k, edge in enumerate(edges):
        if not (twins := waiting[edge.end, edge.start, edge.points[::-1].tobytes()]):
            waiting[edge.start, edge.end, edge.points.tobytes()].append(k)
            continue
        twin = twins.pop(0)
        first, second = (k, twin) if edges[twin].id in against else (twin, k)
        way = edges[first].id
        tally.edges[second] = replace(edges[second], id=reverse_id(way), road=way)
    crs = _attributes(graph, names).get("crs", "epsg:4326")
    try:
        degrees = CRS.from_user_input(crs).is_geographic
    except ProjError:
        raise SiteError(f"crs {crs!r} is not known", place="graph", do="save it in epsg:4326") from None
    return tally.road_map(
        "GraphML, directed", f"no road in it; edges read: {tally.read}", "save a street network with OSMnx",
        geographic=degrees, geographic_of=None if degrees else partial(geographic, crs),
        has_elevation=heights,
    )  # fmt: skip


def _attributes(element: Element, names: dict[str, str]) -> Attributes:
    return {names.get(str(d.get("key")), ""): d.text or "" for d in element.iterfind("data")}


def _line(text: str, start: Floats, end: Floats) -> Floats:
    """(n, 3) vertices of a WKT LINESTRING, heights even from node to node; straight without a text."""
    if not text:
        return np.array([start, end])
    if not (found := re.fullmatch(r"\s*LINESTRING\b[^(]*\((.*)\)\s*", text)):
        raise SiteError(f"geometry {text[:30]!r} is no LINESTRING", do="save the graph again")
    rows = [[number(v) for v in vertex.split()[:2]] for vertex in found[1].split(",")]
    if any(len(row) != 2 for row in rows) or len(rows) < 2:
        raise SiteError("its LINESTRING is broken", do="save the graph again")
    flat = np.array(rows, dtype=np.float64)
    passed = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(flat, axis=0), axis=1))])
    return np.column_stack([flat, start[2] + passed / max(float(passed[-1]), 1e-12) * (end[2] - start[2])])


READER = Reader("GraphML", (".graphml",), "<graphml", _read)

"""LIF, the VDMA's layout interchange format of driverless vehicles (JSON, versions 1 and 2).

Edges are directed and keep their ids, for VDA 5050 logs name them.  A ``trajectory`` (NURBS) gives an edge
its line, else it is straight.  Stations become places where a node's actions tell their kind.  Several
layouts are kept in one network; a transition between floors is an edge.  Source: VDMA, LIF 1.0.0 (March
2024) and the draft of 2.0.0 (January 2026), section 8.3."""

import math
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.core.network import Edge
from fleetlog.core.site import PlaceKind
from fleetlog.errors import SiteError
from fleetlog.roads.formats._documents import read_json
from fleetlog.roads.formats._odr_geometry import sample
from fleetlog.roads.formats.base import MapOptions, Nodes, Reader, RoadMap, Tally, at, number, spot

Item = dict[str, Any]

KINDS: tuple[tuple[str, PlaceKind], ...] = (
    ("startCharging", "charge"), ("pick", "pick"), ("drop", "drop"), ("park", "park"),
)  # fmt: skip
CHORD = 0.01  # largest distance [m] of a trajectory from its polyline
LEAST, APART = 1e-6, 1e-9  # smallest weight of a control point; distance of two knots, as a share of all


def _read(path: Path, options: MapOptions) -> RoadMap:
    tally, data = Tally(), read_json(path)
    if not isinstance(data, dict) or not isinstance(data.get("layouts"), list):
        raise SiteError("has no layouts", do="give a LIF file")
    keys, layouts = ("nodes", "edges", "stations"), _list(data, "layouts")
    nodes, edges, stations = ([item for layout in layouts for item in _list(layout, k)] for k in keys)
    for raw in nodes:
        if not isinstance(raw.get("nodePosition"), dict):
            place = f"node {raw.get('nodeId')}"
            raise SiteError("has no position", place=place, do="export the layout with positions")
    given = {str(node.get("nodeId")): node["nodePosition"] for node in nodes}
    spots = Nodes((name, spot(p.get("x"), p.get("y"), f"node {name}")) for name, p in given.items())
    for raw in edges:
        with at(f"edge {raw.get('edgeId')}"):
            tally.keep(_edge(raw, spots), shortest=1e-6)
    kinds = {str(node.get("nodeId")): _per_type(node, "Node") for node in nodes}
    for station in stations:
        named = station.get("interactionNodeIds")
        served = [str(n) for n in named if str(n) in spots] if isinstance(named, list) else []
        properties = (p for n in served for p in kinds[n])
        actions = {str(action.get("actionType")) for p in properties for action in _list(p, "actions")}
        kind = next((kind for action, kind in KINDS if action in actions), None)
        tally.stop(str(station.get("stationId")), kind, spots[served[0]] if served else np.zeros(2))
    nothing, do = f"no road in it: {tally.read} edges", "export the layout with its edges"
    forbidden = _about_turns(tally.edges)
    return tally.road_map("LIF, directed", nothing, do, forbidden=forbidden, has_elevation=False)


def _list(item: Item, key: str) -> list[Item]:
    rows = item.get(key) or []
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise SiteError("is not a list, or an entry is not an object", place=key, do="export it again")
    return rows


def _per_type(item: Item, what: str) -> list[Item]:
    """The properties for each vehicle type; version 2 calls vehicles mobile robots."""
    return [p for kind in ("vehicle", "mobileRobot") for p in _list(item, f"{kind}Type{what}Properties")]


def _edge(raw: Item, spots: Nodes) -> Edge:
    name, start, end = (str(raw.get(key)) for key in ("edgeId", "startNodeId", "endNodeId"))
    kinds, points = _per_type(raw, "Edge"), np.array([spots[start], spots[end]])
    if line := next((k["trajectory"] for k in kinds if k.get("trajectory")), None):
        inner = _nurbs(line)[1:-1]
        points = np.insert(points, 1, np.column_stack([inner, np.zeros(len(inner))]), axis=0)
    # Version 2 spells the word out.
    given = (k.get(word) for k in kinds for word in ("maxSpeed", "maximumSpeed"))
    speeds = [number(v) for v in given if v is not None]
    # A log does not tell the type of its vehicle, so the highest of several limits bounds them all.
    limit = max((v for v in speeds if v > 0.0), default=math.nan)
    return Edge(name, start, end, points, "|".join(sorted((start, end))), limit)


def _nurbs(raw: Any) -> Floats:
    """(n, 2) vertices [m] of {degree, knotVector, controlPoints}; chords within ``CHORD``. Without a degree
    it is 1; a control point without a weight weighs 1. Piegl and Tiller, The NURBS Book."""
    from scipy.interpolate import BSpline

    again, given = "export it again", raw if isinstance(raw, dict) else {}
    points, vector = given.get("controlPoints"), given.get("knotVector") or []
    if not isinstance(points, list) or not all(isinstance(p, dict) for p in points):
        raise SiteError("its trajectory has no controlPoints", do=again)
    if not isinstance(vector, list):
        raise SiteError("its knotVector is no list", do=again)
    degree = int(number(given.get("degree", 1), "degree"))
    knots = np.array([number(k, "knotVector") for k in vector])
    named = ({"weight": 1.0, **p} for p in points)
    rows = [[number(p.get(key), "controlPoints") for key in ("x", "y", "weight")] for p in named]
    x, y, weight = np.array(rows).reshape(-1, 3).T
    gaps = np.diff(knots)
    if not 1 <= degree < len(x) or len(knots) != len(x) + degree + 1 or (gaps < 0).any():
        what = f"its trajectory of degree {degree} has {len(knots)} knots for {len(x)} control points"
        raise SiteError(what, do="there must be points + degree + 1 knots in rising order")
    close = ((gaps > 0.0) & (gaps < APART * np.ptp(knots))).any()
    if close or knots[degree] == knots[len(x)] or (weight < LEAST).any():
        what = f"its knots nearly coincide or leave no curve, or a weight is below {LEAST:g}"
        raise SiteError(what, do=again)
    spline = BSpline(knots, np.column_stack([x * weight, y * weight, weight]), degree)

    def at(u: Floats) -> Floats:
        p = spline(u)
        return np.column_stack([p[:, :2] / p[:, 2:], np.zeros(len(u))])

    return at(sample(at, np.unique(knots[degree : len(knots) - degree]), CHORD))[:, :2]


def _about_turns(edges: list[Edge]) -> frozenset[tuple[str, str]]:
    """Turning round on the spot is left out wherever another edge leads on."""
    leaving: dict[str, list[Edge]] = defaultdict(list)
    for edge in edges:
        leaving[edge.start].append(edge)
    leads_on = (e for e in edges if any(f.end != e.start for f in leaving[e.end]))
    return frozenset((e.id, f.id) for e in leads_on for f in leaving[e.end] if f.end == e.start)


READER = Reader("LIF", (".json", ".lif"), r'\A\{.*"(lifVersion|layouts)"', _read)

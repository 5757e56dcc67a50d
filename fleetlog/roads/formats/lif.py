"""LIF, the VDMA's layout interchange format of driverless vehicles (JSON, versions 1 and 2).

Edges are directed and keep their ids, for VDA 5050 logs name them.  A ``trajectory`` (NURBS) gives an edge
its line, else it is straight.  Stations become places where a node's actions tell their kind.  Several
layouts are kept in one network; a transition between floors is an edge.  Version 2 groups layouts by the
origin of their coordinates: a [[map_frame]] of the site called as an origin says where it lies.  Source:
VDMA, LIF 1.0.0 (March 2024) and 2.0.0 (2026) with its examples, section 8.3."""

import math
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.core.network import Edge
from fleetlog.core.site import MapFrame, PlaceKind
from fleetlog.errors import SiteError
from fleetlog.roads.formats._documents import read_json
from fleetlog.roads.formats._odr_geometry import sample
from fleetlog.roads.formats.base import WORDS, MapOptions, Nodes, Reader, RoadMap, Tally, at, number, spot

Item = dict[str, Any]
KINDS: dict[str, PlaceKind] = WORDS["kinds"]["lif"]
CHORD = 0.01  # largest distance [m] of a trajectory from its polyline
LEAST, APART = 1e-6, 1e-9  # smallest weight of a control point; distance of two knots, as a share of all


def _read(path: Path, options: MapOptions) -> RoadMap:
    tally, data = Tally(), read_json(path)
    if not isinstance(data, dict) or not isinstance(data.get("origins", data.get("layouts")), list):
        raise SiteError("has no layouts", do="give a LIF file")
    origins, known = _list(data, "origins") or [data], {f.name: f for f in options.frames}
    names = [str(origin.get("originId", "")) for origin in origins]
    spots, kinds, stations = Nodes(), dict[str, list[Item]](), list[Item]()
    frames = (known.get(name, MapFrame(name)) for name in names)
    parts = [(f, layout) for f, o in zip(frames, origins, strict=True) for layout in _list(o, "layouts")]
    for frame, layout in parts:
        stations += _list(layout, "stations")
        for raw in _list(layout, "nodes"):
            name, p = str(raw.get("nodeId")), raw.get("nodePosition")
            if not isinstance(p, dict):
                raise SiteError("has no position", place=f"node {name}", do="export it with positions")
            if name in kinds:
                raise SiteError("occurs twice", place=f"node {name}", do="name every node of the file apart")
            kinds[name] = _per_type(raw, "Node")
            x, y, z = spot(p.get("x"), p.get("y"), f"node {name}")
            spots[name] = np.array([*frame.to_site(x, y), z])
    for frame, layout in parts:
        for raw in _list(layout, "edges"):
            with at(f"edge {raw.get('edgeId')}"):
                tally.keep(_edge(raw, spots, frame), shortest=1e-6)
    if len(set(names)) > 1 and (loose := sorted(set(names) - known.keys())):
        how = "have no [[map_frame]] of their name in the site and are taken as one"
        tally.notes.append(f"the origins {', '.join(map(repr, loose))} {how}")
    for station in stations:
        named = station.get("interactionNodeIds")
        served = [str(n) for n in named if str(n) in spots] if isinstance(named, list) else []
        # ``actions``, or ``requiredActions`` and ``feasibleActions``
        said = [(p, key) for n in served for p in kinds[n] for key in p if key.lower().endswith("actions")]
        actions = {str(action.get("actionType")) for p, key in said for action in _list(p, key)}
        kind = next((kind for action, kind in KINDS.items() if action in actions), None)
        tally.stop(str(station.get("stationId")), kind, spots[served[0]] if served else np.zeros(2))
    nothing, do = f"no road in it; edges read: {tally.read}", "export the layout with its edges"
    # Turning round on the spot is left out wherever another edge leads on.
    leaving = defaultdict[str, list[Edge]](list)
    for edge in tally.edges:
        leaving[edge.start].append(edge)
    leads_on = (e for e in tally.edges if any(f.end != e.start for f in leaving[e.end]))
    forbidden = frozenset((e.id, f.id) for e in leads_on for f in leaving[e.end] if f.end == e.start)
    return tally.road_map("LIF, directed", nothing, do, forbidden=forbidden, has_elevation=False)


def _list(item: Item, key: str) -> list[Item]:
    rows = item.get(key) or []
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise SiteError("is not a list, or an entry is not an object", place=key, do="export it again")
    return rows


def _per_type(item: Item, what: str) -> list[Item]:
    """The properties for each vehicle type; version 2 calls vehicles mobile robots."""
    return [p for kind in ("vehicle", "mobileRobot") for p in _list(item, f"{kind}Type{what}Properties")]


def _edge(raw: Item, spots: Nodes, frame: MapFrame) -> Edge:
    name, start, end = (str(raw.get(key)) for key in ("edgeId", "startNodeId", "endNodeId"))
    kinds, points = _per_type(raw, "Edge"), np.array([spots[start], spots[end]])
    if line := next((k["trajectory"] for k in kinds if k.get("trajectory")), None):
        inner = _nurbs(line)[1:-1]
        inner = np.column_stack([*frame.to_site(*inner.T), np.zeros(len(inner))])
        points = np.insert(points, 1, inner, axis=0)
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
        raise SiteError(f"knots nearly coincide or leave no curve, or a weight is below {LEAST:g}", do=again)
    spline = BSpline(knots, np.column_stack([x * weight, y * weight, weight]), degree)

    def at(u: Floats) -> Floats:
        p = spline(u)
        return np.column_stack([p[:, :2] / p[:, 2:], np.zeros(len(u))])

    return at(sample(at, np.unique(knots[degree : len(knots) - degree]), CHORD))[:, :2]


READER = Reader("LIF", (".json", ".lif"), r'\A\{.*"(lifVersion|layouts|origins)"', _read)

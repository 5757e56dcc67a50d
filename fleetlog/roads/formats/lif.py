"""LIF, the VDMA's layout interchange format of driverless vehicles (JSON, versions 1 and 2).

Edges are directed and keep their ids, for VDA 5050 logs name them.  A ``trajectory`` (NURBS) gives an edge
its line, else it is straight.  Stations become places where a node's actions tell their kind.  Several
layouts are kept in one network; a transition between floors is an edge.  Source: VDMA, LIF 1.0.0 (March
2024) and the draft of 2.0.0 (January 2026), section 8.3.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.network import Edge
from fleetlog.core.site import Place, PlaceKind
from fleetlog.errors import SiteError
from fleetlog.roads.formats._json import read_json
from fleetlog.roads.formats._nurbs import nurbs
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

KINDS: tuple[tuple[str, PlaceKind], ...] = (
    ("startCharging", "charge"), ("pick", "pick"), ("drop", "drop"), ("park", "park"),
)  # fmt: skip
CHORD = 0.01
"""Largest distance [m] of a trajectory from its polyline."""


def sniff(head: bytes) -> bool:
    """A JSON object with LIF's opening keys."""
    keys = b'"lifVersion"' in head or b'"layouts"' in head
    return keys and head.lstrip(b"\xef\xbb\xbf \r\n\t").startswith(b"{")


def read(path: Path, options: MapOptions) -> RoadMap:
    """Read a layout; see the module."""
    tally = Tally()
    layouts = _layouts(path)
    nodes = {str(n.get("nodeId")): n for layout in layouts for n in _list(layout, "nodes")}
    spots = {name: _spot(node.get("nodePosition"), f"node {name}") for name, node in nodes.items()}
    found = [_edge(raw, spots, tally) for layout in layouts for raw in _list(layout, "edges")]
    edges = [edge for edge in found if edge is not None]
    if not edges:
        raise SiteError(f"no road in it: {tally.read} edges", do="export the layout with its edges")
    tally.kept = len(edges)
    places = _places(layouts, nodes, spots, tally)
    report, forbidden = tally.report("LIF, directed"), _about_turns(edges)
    return RoadMap(edges, report, places=places, forbidden=forbidden, has_elevation=False)


def _layouts(path: Path) -> list[dict[str, Any]]:
    data = read_json(path)
    if not isinstance(data, dict) or not isinstance(data.get("layouts"), list):
        raise SiteError("has no layouts", do="give a LIF file")
    return _list(data, "layouts")


def _list(item: dict[str, Any], key: str) -> list[dict[str, Any]]:
    rows = item.get(key) or []
    if not isinstance(rows, list):
        raise SiteError("is not a list", place=key, do="export it again")
    if not all(isinstance(row, dict) for row in rows):
        raise SiteError("holds something that is not an object", place=key, do="export it again")
    return rows


def _per_type(item: dict[str, Any], what: str) -> list[dict[str, Any]]:
    """The properties for each vehicle type; version 2 calls vehicles mobile robots."""
    return [p for kind in ("vehicle", "mobileRobot") for p in _list(item, f"{kind}Type{what}Properties")]


def _spot(raw: Any, place: str) -> Floats:
    if not isinstance(raw, dict):
        raise SiteError("has no position", place=place, do="export the layout with positions")
    return np.array([number(raw.get("x"), place), number(raw.get("y"), place), 0.0])


def _edge(raw: dict[str, Any], spots: dict[str, Floats], tally: Tally) -> Edge | None:
    tally.read += 1
    name, start, end = (str(raw.get(key)) for key in ("edgeId", "startNodeId", "endNodeId"))
    kinds = _per_type(raw, "Edge")
    with at(f"edge {name}"):
        for node in (start, end):
            if node not in spots:
                raise SiteError(f"there is no node {node!r}", do="correct the layout")
        points = without_repeats(_line(kinds, spots[start], spots[end]), 1e-6)
        if len(points) < 2:
            tally.drop("without length")
            return None
        # Version 2 spells the word out.
        given = (k.get(word) for k in kinds for word in ("maxSpeed", "maximumSpeed"))
        speeds = [number(v) for v in given if v is not None]
    # A log does not tell the type of its vehicle, so the highest of several limits bounds them all.
    limit = max((v for v in speeds if v > 0.0), default=math.nan)
    return Edge(name, start, end, points, "|".join(sorted((start, end))), limit)


def _line(kinds: list[dict[str, Any]], start: Floats, end: Floats) -> Floats:
    line = next((k["trajectory"] for k in kinds if k.get("trajectory")), None)
    if line is None:
        return np.array([start, end])
    inner = nurbs(line, CHORD)[1:-1]
    return np.vstack([start, np.column_stack([inner, np.zeros(len(inner))]), end])


def _about_turns(edges: list[Edge]) -> frozenset[tuple[str, str]]:
    """Turning round on the spot is left out wherever another edge leads on."""
    leaving: dict[str, list[Edge]] = {}
    for edge in edges:
        leaving.setdefault(edge.start, []).append(edge)
    out = set()
    for edge in edges:
        onward = leaving.get(edge.end, ())
        if any(f.end != edge.start for f in onward):
            out |= {(edge.id, f.id) for f in onward if f.end == edge.start}
    return frozenset(out)


def _places(
    layouts: list[dict[str, Any]], nodes: dict[str, dict[str, Any]], spots: dict[str, Floats], tally: Tally
) -> tuple[Place, ...]:
    out, unknown = [], 0
    for station in (s for layout in layouts for s in _list(layout, "stations")):
        named = station.get("interactionNodeIds")
        served = [str(n) for n in named if str(n) in spots] if isinstance(named, list) else []
        kind = _kind([p for n in served for p in _per_type(nodes[n], "Node")])
        if kind is None:
            unknown += 1
        else:
            x, y, _ = spots[served[0]].tolist()
            out.append(Place(str(station.get("stationId")), kind, x, y))
    if unknown:
        why = "no action at their nodes says what is done there"
        tally.notes.append(f"{unknown} stations are left out: {why}")
    return tuple(out)


def _kind(properties: list[dict[str, Any]]) -> PlaceKind | None:
    """Of a station, from the actions at the nodes that serve it."""
    actions = {str(action.get("actionType")) for p in properties for action in _list(p, "actions")}
    return next((kind for action, kind in KINDS if action in actions), None)


READER = Reader("LIF", (".json", ".lif"), sniff, read)

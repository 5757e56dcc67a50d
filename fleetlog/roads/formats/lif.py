"""LIF, the VDMA's layout interchange format of driverless vehicles (JSON, versions 1 and 2): directed edges
between nodes.

Edge ids stay as they are, for VDA 5050 logs name them.  A ``trajectory`` (NURBS) gives an edge its line,
else it is straight.
Stations become places where a node's actions tell their kind.  Several layouts are kept in one network; a
transition between
floors is an edge.  Source: VDMA, LIF 1.0.0 (March 2024) and
the draft of 2.0.0 (January 2026), section 8.3.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.network import Edge
from fleetlog.core.site import Place, PlaceKind
from fleetlog.errors import SiteError
from fleetlog.roads.formats._json import read_json
from fleetlog.roads.formats._nurbs import nurbs
from fleetlog.roads.formats.base import Floats, MapOptions, Reader, RoadMap, Tally, number, without_repeats

KINDS: tuple[tuple[str, PlaceKind], ...] = (
    ("startCharging", "charge"),
    ("pick", "pick"),
    ("drop", "drop"),
    ("park", "park"),
)
CHORD = 0.01
"""Largest distance [m] of a trajectory from its polyline."""


def sniff(head: bytes) -> bool:
    """A JSON object with LIF's opening keys."""
    return head.lstrip(b"\xef\xbb\xbf \r\n\t").startswith(b"{") and (
        b'"lifVersion"' in head or b'"layouts"' in head
    )


def read(path: Path, options: MapOptions) -> RoadMap:
    """Read a layout; see the module."""
    tally = Tally()
    layouts = _layouts(path)
    nodes = {str(n.get("nodeId")): n for layout in layouts for n in _list(layout, "nodes", path)}
    spots = {name: _spot(node.get("nodePosition"), path, f"node {name}") for name, node in nodes.items()}
    edges = [
        edge
        for layout in layouts
        for raw in _list(layout, "edges", path)
        if (edge := _edge(raw, spots, path, tally))
    ]
    if not edges:
        raise SiteError(
            f"no road in it: {tally.read} edges", where=path, do="export the layout with its edges"
        )
    tally.kept = len(edges)
    places = _places(layouts, nodes, spots, path, tally)
    forbidden = _about_turns(edges)
    return RoadMap(
        edges, tally.report("LIF, directed"), places=places, forbidden=forbidden, has_elevation=False
    )


def _layouts(path: Path) -> list[dict[str, Any]]:
    data = read_json(path)
    if not isinstance(data, dict) or not isinstance(data.get("layouts"), list):
        raise SiteError("has no layouts", where=path, do="give a LIF file")
    return _objects(data["layouts"], path, "layouts")


def _objects(rows: list[Any], path: Path, place: str) -> list[dict[str, Any]]:
    if not all(isinstance(row, dict) for row in rows):
        raise SiteError(
            "holds something that is not an object", where=path, place=place, do="export it again"
        )
    return rows


def _list(layout: dict[str, Any], key: str, path: Path) -> list[dict[str, Any]]:
    rows = layout.get(key) or []
    if not isinstance(rows, list):
        raise SiteError("is not a list", where=path, place=key, do="export it again")
    return _objects(rows, path, key)


def _per_type(item: dict[str, Any], what: str, path: Path) -> list[dict[str, Any]]:
    """The properties for each vehicle type; version 2 calls vehicles mobile robots."""
    return [
        p for kind in ("vehicle", "mobileRobot") for p in _list(item, f"{kind}Type{what}Properties", path)
    ]


def _spot(raw: Any, path: Path, place: str) -> Floats:
    if not isinstance(raw, dict):
        raise SiteError("has no position", where=path, place=place, do="export the layout with positions")
    return np.array([number(raw.get("x"), path, place), number(raw.get("y"), path, place), 0.0])


def _edge(raw: dict[str, Any], spots: dict[str, Floats], path: Path, tally: Tally) -> Edge | None:
    tally.read += 1
    name, start, end = (str(raw.get(key)) for key in ("edgeId", "startNodeId", "endNodeId"))
    place = f"edge {name}"
    for node in (start, end):
        if node not in spots:
            raise SiteError(f"there is no node {node!r}", where=path, place=place, do="correct the layout")
    kinds = _per_type(raw, "Edge", path)
    line = next((k["trajectory"] for k in kinds if k.get("trajectory")), None)
    points = np.array([spots[start], spots[end]])
    if line is not None:
        inner = nurbs(line, CHORD, path, place)[1:-1]
        points = np.vstack([points[:1], np.column_stack([inner, np.zeros(len(inner))]), points[1:]])
    points = without_repeats(points, 1e-6)
    if len(points) < 2:
        tally.drop("without length")
        return None
    # Version 2 spells the word out.
    given = (k.get(name) for k in kinds for name in ("maxSpeed", "maximumSpeed"))
    speeds = [number(v, path, place) for v in given if v is not None]
    # Several vehicle types may have several limits; a log does not tell the type, so the highest bounds them
    # all.
    limit = max((v for v in speeds if v > 0.0), default=math.nan)
    return Edge(name, start, end, points, "|".join(sorted((start, end))), limit)


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
    layouts: list[dict[str, Any]],
    nodes: dict[str, dict[str, Any]],
    spots: dict[str, Floats],
    path: Path,
    tally: Tally,
) -> tuple[Place, ...]:
    out, unknown = [], 0
    for station in (s for layout in layouts for s in _list(layout, "stations", path)):
        name = str(station.get("stationId"))
        named = station.get("interactionNodeIds")
        served = [str(n) for n in named if str(n) in spots] if isinstance(named, list) else []
        kind = _kind([p for n in served for p in _per_type(nodes[n], "Node", path)], path)
        if kind is None:
            unknown += 1
            continue
        at = spots[served[0]]
        out.append(Place(name, kind, float(at[0]), float(at[1])))
    if unknown:
        tally.notes.append(
            f"{unknown} stations are left out: no action at their nodes says what is done there"
        )
    return tuple(out)


def _kind(properties: list[dict[str, Any]], path: Path) -> PlaceKind | None:
    """Of a station, from the actions at the nodes that serve it."""
    actions = {str(action.get("actionType")) for p in properties for action in _list(p, "actions", path)}
    return next((kind for action, kind in KINDS if action in actions), None)


READER = Reader("LIF", (".json", ".lif"), sniff, read)

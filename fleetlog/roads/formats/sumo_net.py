"""SUMO networks (``.net.xml``): an edge is its lanes' middle line, in the network's metres.

Edges inside junctions are left out: a connection from edge to edge is a turn.  Where ``location`` names a
projection, the network has its place on earth.  Source: sumo.dlr.de/docs/Networks/SUMO_Road_Networks.html.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fleetlog.core.frames import crs, geographic
from fleetlog.core.network import Edge
from fleetlog.core.schema import Wrong
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
    without_repeats,
)

if TYPE_CHECKING:
    from lxml.etree import _Element as Element


def sniff(head: bytes) -> bool:
    """A network with a location or edges."""
    return looks_like(head, "net ") or looks_like(head, "net>")


def read(path: Path, options: MapOptions) -> RoadMap:
    """Read a network; see the module."""
    tally = Tally()
    net = parse_xml(path, "net", tally.notes)
    edges = [e for element in net.iterfind("edge") if (e := _edge(element, tally)) is not None]
    if not edges:
        raise SiteError(f"no road in it: {tally.read} edges", do="build it with roads for vehicles")
    known = {e.id for e in edges}
    named = ((str(c.get("from")), str(c.get("to"))) for c in net.iterfind("connection"))
    turns = [turn for turn in named if known.issuperset(turn)]
    tally.kept = len(edges)
    heights = any(np.ptp(e.points[:, 2]) > 0.0 for e in edges)
    return RoadMap(
        edges, tally.report("SUMO"), geographic_of=_earth(net.find("location"), tally),
        turns=turns or None, has_elevation=heights,
        traffic="left" if net.get("lefthand") == "true" else "right",
    )  # fmt: skip


def _edge(element: Element, tally: Tally) -> Edge | None:
    name = str(element.get("id"))
    if element.get("function") not in (None, "normal"):
        return None
    tally.read += 1
    lanes = [lane for lane in element.iterfind("lane") if _driven(lane)]
    if not lanes:
        tally.drop("without a lane for vehicles")
        return None
    shape = element.get("shape") if len(lanes) > 1 else lanes[0].get("shape")
    with at(f"edge {name}"):
        points = without_repeats(_line(shape or lanes[len(lanes) // 2].get("shape") or ""))
        if len(points) < 2:
            tally.drop("without length")
            return None
        limit = max(number(lane.get("speed", "0")) for lane in lanes)
        width = sum(number(lane.get("width", "3.2")) for lane in lanes)
    start, end = str(element.get("from")), str(element.get("to"))
    return Edge(name, start, end, points, name.removeprefix("-"), limit if limit > 0.0 else math.nan, width)


def _driven(lane: Element) -> bool:
    """Whether cars or trucks may use a lane; without a word all may."""
    allow, disallow = str(lane.get("allow", "")).split(), str(lane.get("disallow", "")).split()
    motor = {"all", "passenger", "truck", "delivery", "private", "custom1", "custom2"}
    return bool(motor & set(allow)) if allow else not {"all", "passenger"} & set(disallow)


def _line(text: str) -> Floats:
    rows = [[number(v) for v in spot.split(",")] for spot in text.split()]
    if any(len(row) not in (2, 3) for row in rows):
        raise SiteError("its shape is no list of x,y or x,y,z", do="build it again")
    return np.array([[*row, 0.0][:3] for row in rows], dtype=np.float64).reshape(-1, 3)


def _earth(location: Element | None, tally: Tally) -> Inverse | None:
    projection = "!" if location is None else str(location.get("projParameter", "!"))
    if location is None or projection in ("!", "-", "."):
        return None
    east, north, *_ = (number(v, "location") for v in str(location.get("netOffset", "0,0")).split(","))
    try:
        crs(projection)
    except Wrong:
        tally.notes.append("its projection is not one that PROJ knows, so the map has no place on earth")
        return None
    return lambda x, y: geographic(projection, x - east, y - north)


READER = Reader("SUMO", (".xml",), sniff, read)

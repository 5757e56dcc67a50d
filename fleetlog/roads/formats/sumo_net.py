"""SUMO networks (``.net.xml``): an edge is its lanes' middle line, in the network's metres.

Edges inside junctions are left out: a connection from edge to edge is a turn.  Where ``location`` names a
projection, the network has its place on earth.  Source: sumo.dlr.de/docs/Networks/SUMO_Road_Networks.html."""

import math
from pathlib import Path

import numpy as np

from fleetlog.core.network import Edge
from fleetlog.core.schema import Wrong
from fleetlog.core.site import Inverse, crs, geographic
from fleetlog.errors import SiteError
from fleetlog.roads.formats._documents import Element, parse_xml
from fleetlog.roads.formats.base import MapOptions, Reader, RoadMap, Tally, at, number


def _read(path: Path, options: MapOptions) -> RoadMap:
    tally = Tally()
    net = parse_xml(path, "net", tally.notes)
    for element in net.iterfind("edge"):
        if element.get("function") not in (None, "normal"):
            continue
        if not (lanes := [lane for lane in element.iterfind("lane") if _driven(lane)]):
            tally.dropped["without a lane for vehicles"] += 1
            continue
        with at(f"edge {element.get('id')}"):
            name, start, end = (str(element.get(key)) for key in ("id", "from", "to"))
            shape = element.get("shape") if len(lanes) > 1 else None
            text = shape or lanes[len(lanes) // 2].get("shape") or ""
            rows = [[number(v) for v in spot.split(",")] for spot in text.split()]
            if any(len(row) not in (2, 3) for row in rows):
                raise SiteError("its shape is no list of x,y or x,y,z", do="build it again")
            points = np.array([[*row, 0.0][:3] for row in rows], dtype=np.float64).reshape(-1, 3)
            limit = max(number(lane.get("speed", "0")) for lane in lanes)
            width = sum(number(lane.get("width", "3.2")) for lane in lanes)
            road, limit = name.removeprefix("-"), limit if limit > 0.0 else math.nan
            tally.keep(Edge(name, start, end, points, road, limit, width))
    known = {e.id for e in tally.edges}
    named = ((str(c.get("from")), str(c.get("to"))) for c in net.iterfind("connection"))
    return tally.road_map(
        "SUMO", f"no road in it; edges read: {tally.read}", "build it with roads for vehicles",
        geographic_of=_earth(net.find("location"), tally.notes),
        turns=[turn for turn in named if known.issuperset(turn)] or None,
        has_elevation=any(np.ptp(e.points[:, 2]) > 0.0 for e in tally.edges),
        traffic="left" if net.get("lefthand") == "true" else "right",
    )  # fmt: skip


def _driven(lane: Element) -> bool:
    """Whether cars or trucks may use a lane; without a word all may."""
    allow, disallow = str(lane.get("allow", "")).split(), str(lane.get("disallow", "")).split()
    motor = {"all", "passenger", "truck", "delivery", "private", "custom1", "custom2"}
    return bool(motor & set(allow)) if allow else not {"all", "passenger"} & set(disallow)


def _earth(location: Element | None, notes: list[str]) -> Inverse | None:
    projection = "!" if location is None else location.get("projParameter", "!")
    if location is None or projection in ("!", "-", "."):
        return None
    east, north, *_ = (number(v, "location") for v in str(location.get("netOffset", "0,0")).split(","))
    try:
        crs(projection)
    except Wrong:
        notes.append("its projection is not one that PROJ knows, so the map has no place on earth")
        return None
    return lambda x, y: geographic(projection, x - east, y - north)


READER = Reader("SUMO", (".xml",), "<net[ >]", _read)

"""SUMO networks (``.net.xml``): an edge is its lanes' middle line, in the network's metres.

Edges inside junctions are left out: a connection from edge to edge is a turn.  Where ``location`` names a
projection, the network has its place on earth.  Source: sumo.dlr.de/docs/Networks/SUMO_Road_Networks.html.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fleetlog.core.network import Edge
from fleetlog.errors import SiteError
from fleetlog.roads.formats._xml import looks_like, parse_xml
from fleetlog.roads.formats.base import Floats, MapOptions, Reader, RoadMap, Tally, number, without_repeats

if TYPE_CHECKING:
    from lxml.etree import _Element as Element


def sniff(head: bytes) -> bool:
    """A network with a location or edges."""
    return looks_like(head, "net ") or looks_like(head, "net>")


def read(path: Path, options: MapOptions) -> RoadMap:
    """Read a network; see the module."""
    tally = Tally()
    net = parse_xml(path, "net", tally.notes)
    edges = [e for element in net.iterfind("edge") if (e := _edge(element, path, tally)) is not None]
    if not edges:
        raise SiteError(
            f"no road in it: {tally.read} edges", where=path, do="build it with roads for vehicles"
        )
    known = {e.id for e in edges}
    turns = [
        (a, b)
        for c in net.iterfind("connection")
        if (a := str(c.get("from"))) in known and (b := str(c.get("to"))) in known
    ]
    tally.kept = len(edges)
    heights = any(np.ptp(e.points[:, 2]) > 0.0 for e in edges)
    return RoadMap(
        edges, tally.report("SUMO"), geographic_of=_earth(net.find("location"), path, tally),
        turns=turns or None, has_elevation=heights,
        traffic="left" if net.get("lefthand") == "true" else "right",
    )  # fmt: skip


def _edge(element: Element, path: Path, tally: Tally) -> Edge | None:
    name = str(element.get("id"))
    if element.get("function") not in (None, "normal"):
        return None
    tally.read += 1
    lanes = [lane for lane in element.iterfind("lane") if _driven(lane)]
    if not lanes:
        tally.drop("without a lane for vehicles")
        return None
    place = f"edge {name}"
    shape = element.get("shape") if len(lanes) > 1 else lanes[0].get("shape")
    points = without_repeats(_line(shape or lanes[len(lanes) // 2].get("shape") or "", path, place))
    if len(points) < 2:
        tally.drop("without length")
        return None
    limit = max(number(lane.get("speed", "0"), path, place) for lane in lanes)
    widths = [number(lane.get("width", "3.2"), path, place) for lane in lanes]
    return Edge(
        name, str(element.get("from")), str(element.get("to")), points, name.removeprefix("-"),
        limit if limit > 0.0 else math.nan, sum(widths),
    )  # fmt: skip


def _driven(lane: Element) -> bool:
    """Whether cars or trucks may use a lane; without a word all may."""
    allow, disallow = str(lane.get("allow", "")).split(), str(lane.get("disallow", "")).split()
    motor = {"all", "passenger", "truck", "delivery", "private", "custom1", "custom2"}
    return bool(motor & set(allow)) if allow else not {"all", "passenger"} & set(disallow)


def _line(text: str, path: Path, place: str) -> Floats:
    rows = [[number(v, path, place) for v in spot.split(",")] for spot in text.split()]
    if any(len(row) not in (2, 3) for row in rows):
        raise SiteError("its shape is no list of x,y or x,y,z", where=path, place=place, do="build it again")
    return np.array([[*row, 0.0][:3] for row in rows], dtype=np.float64).reshape(-1, 3)


def _earth(
    location: Element | None, path: Path, tally: Tally
) -> Callable[[Floats, Floats], tuple[Floats, Floats]] | None:
    projection = "!" if location is None else str(location.get("projParameter", "!"))
    if projection in ("!", "-", "."):
        return None
    from pyproj import CRS, Transformer

    assert location is not None
    offset = [number(v, path, "location") for v in str(location.get("netOffset", "0,0")).split(",")]
    try:
        back = Transformer.from_crs(CRS.from_user_input(projection), "EPSG:4326", always_xy=True)
    except Exception:  # pyproj raises several kinds
        tally.notes.append("its projection is not one that PROJ knows, so the map has no place on earth")
        return None

    def geographic(x: Floats, y: Floats) -> tuple[Floats, Floats]:
        longitude, latitude = back.transform(x - offset[0], y - offset[1])
        return latitude, longitude

    return geographic


READER = Reader("SUMO", (".xml",), sniff, read)

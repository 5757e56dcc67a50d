"""openTCS plant models (XML, versions 0.0.2 to 7.0.0): points, paths and locations, in millimetres.

A path is an edge, and ``-PATH`` the other way round where it may be driven in reverse; a locked one is left
out.  The drawing of a layout is no measure of the floor, so the line is straight.  Locations become places by
the operations that their type allows.  Source: the schemas of the openTCS project."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.core.network import Edge, reversed_edge
from fleetlog.core.site import PlaceKind
from fleetlog.roads.formats._documents import Element, parse_xml
from fleetlog.roads.formats.base import WORDS, MapOptions, Nodes, Reader, RoadMap, Tally, at, number, spot

MILLI = 1e-3
OPENINGS: dict[str, PlaceKind] = WORDS["kinds"]["opentcs"]
"""Openings of the names of operations; the first that fits counts."""


def _read(path: Path, options: MapOptions) -> RoadMap:
    tally, odd = Tally(), 0
    model = parse_xml(path, "model", tally.notes)
    points = {str(p.get("name")): p for p in model.iterfind("point")}
    spots = Nodes((name, _spot(p)) for name, p in points.items())
    for element in model.iterfind("path"):
        with at(f"path {element.get('name')}"):
            name, start, end = (str(element.get(k)) for k in ("name", "sourcePoint", "destinationPoint"))
            there, back = (number(element.get(k, "0")) * MILLI for k in ("maxVelocity", "maxReverseVelocity"))
            edge = Edge(name, start, end, np.array([spots[start], spots[end]]), name, there or math.nan)
            directions = [edge] if there > 0.0 or back <= 0.0 else []
            directions += [replace(reversed_edge(edge), speed_limit=back)] if back > 0.0 else []
            if element.get("locked") == "true":
                tally.dropped["locked"] += 1
            else:
                tally.keep(*directions, shortest=MILLI)
                straight = float(np.linalg.norm(spots[end] - spots[start]))
                stated = number(element.get("length", "0")) * MILLI or straight
                odd += abs(stated - straight) > 0.1 * straight
    tally.note(odd, "path", "with a length of more than a tenth off the straight line, which is what counts")
    allowed = {str(t.get("name")): _kind([t]) for t in model.iterfind("locationType")}
    for location in model.iterfind("location"):
        links = [link for link in location.iterfind("link") if str(link.get("point")) in spots]
        where = spots[str(links[0].get("point"))] if links else _spot(location)
        tally.stop(str(location.get("name")), _kind(links) or allowed.get(str(location.get("type"))), where)
    for name, point in points.items():
        if point.get("type") == "PARK_POSITION":
            tally.stop(name, "park", spots[name])
    nothing, do = f"no path that may be driven in it ({tally.read} read)", "unlock its paths"
    return tally.road_map("openTCS", nothing, do, has_elevation=False)


def _spot(element: Element) -> Floats:
    """Position [m]; its attributes changed their names with version 0.0.5."""
    x, y = (element.get(f"position{axis.upper()}", element.get(f"{axis}Position")) for axis in "xy")
    return spot(x, y, f"{element.tag} {element.get('name')}") * MILLI


def _kind(elements: list[Element]) -> PlaceKind | None:
    """What is done, by the operations that elements allow."""
    names = [str(o.get("name", "")).lower() for e in elements for o in e.iterfind("allowedOperation")]
    return next((kind for word, kind in OPENINGS.items() if any(n.startswith(word) for n in names)), None)


READER = Reader("openTCS", (".xml",), r"<model\b.*<(point |path |vehicle)", _read)

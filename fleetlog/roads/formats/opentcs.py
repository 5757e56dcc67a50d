"""openTCS plant models (XML, versions 0.0.2 to 7.0.0): points, paths and locations, in millimetres.

A path is an edge from its source to its destination, and ``-PATH`` the other way round where it may be
driven in reverse; a locked path is left out.  ``length`` and control points of a layout may differ from the
straight line: the drawing of a layout is no measure of the floor, so the line is straight.  Locations become
places by the operations that their type allows.  Source: the schemas of the openTCS project.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fleetlog.core.network import Edge, reverse_id
from fleetlog.core.site import Place, PlaceKind
from fleetlog.errors import SiteError
from fleetlog.roads.formats._xml import looks_like, parse_xml
from fleetlog.roads.formats.base import Floats, MapOptions, Reader, RoadMap, Tally, number

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

MILLI = 1e-3
WORDS: tuple[tuple[str, PlaceKind], ...] = (
    ("charg", "charge"), ("unload", "drop"), ("drop", "drop"), ("put", "drop"), ("load", "pick"), ("pick", "pick"),
    ("fetch", "pick"), ("park", "park"),
)  # fmt: skip
"""Openings of the names of operations; the first that fits counts."""


def sniff(head: bytes) -> bool:
    """A model with points."""
    return looks_like(head, "model") and any(looks_like(head, tag) for tag in ("point ", "path ", "vehicle"))


def read(path: Path, options: MapOptions) -> RoadMap:
    """Read a plant model; see the module."""
    tally = Tally()
    model = parse_xml(path, "model", tally.notes)
    spots = {str(p.get("name")): _spot(p, path) for p in model.iterfind("point")}
    edges: list[Edge] = []
    for element in model.iterfind("path"):
        edges += _path(element, spots, path, tally)
    if not edges:
        raise SiteError(
            f"no path that may be driven in it ({tally.read} read)", where=path, do="unlock its paths"
        )
    places = tuple(_places(model, spots, path, tally))
    return RoadMap(edges, tally.report("openTCS"), places=places, has_elevation=False)


def _spot(element: Element, path: Path) -> Floats:
    """Position [m]; its attributes changed their names with version 0.0.5."""
    place = f"{element.tag} {element.get('name')}"
    x, y = (
        number(element.get(f"position{axis.upper()}", element.get(f"{axis}Position")), path, place)
        for axis in "xy"
    )
    return np.array([x * MILLI, y * MILLI, 0.0])


def _path(element: Element, spots: dict[str, Floats], path: Path, tally: Tally) -> list[Edge]:
    tally.read += 1
    name = str(element.get("name"))
    place = f"path {name}"
    start, end = str(element.get("sourcePoint")), str(element.get("destinationPoint"))
    for point in (start, end):
        if point not in spots:
            raise SiteError(f"there is no point {point!r}", where=path, place=place, do="correct the model")
    if element.get("locked") == "true":
        tally.drop("locked")
        return []
    points = np.array([spots[start], spots[end]])
    if np.hypot(*(points[1] - points[0])[:2]) < MILLI:
        tally.drop("without length")
        return []
    there, back = (
        number(element.get(key, "0"), path, place) * MILLI for key in ("maxVelocity", "maxReverseVelocity")
    )
    tally.kept += 1
    edges = [Edge(name, start, end, points, name, there or math.nan)] if there > 0.0 or back <= 0.0 else []
    if back > 0.0:
        edges.append(Edge(reverse_id(name), end, start, points[::-1].copy(), name, back))
    return edges


def _places(model: Element, spots: dict[str, Floats], path: Path, tally: Tally) -> list[Place]:
    allowed = {str(t.get("name")): _operations(t) for t in model.iterfind("locationType")}
    out: list[Place] = []
    unknown = 0
    for location in model.iterfind("location"):
        links = [link for link in location.iterfind("link") if str(link.get("point")) in spots]
        words = [w for link in links for w in _operations(link)] or allowed.get(str(location.get("type")), [])
        kind = _kind(words)
        if kind is None:
            unknown += 1
            continue
        at = spots[str(links[0].get("point"))] if links else _spot(location, path)
        out.append(Place(str(location.get("name")), kind, float(at[0]), float(at[1])))
    if unknown:
        tally.notes.append(f"{unknown} locations are left out: no operation says what is done there")
    known = {p.id for p in out}
    parking = (p for p in model.iterfind("point") if p.get("type") == "PARK_POSITION")
    for point in parking:
        name = str(point.get("name"))
        if name not in known:
            out.append(Place(name, "park", float(spots[name][0]), float(spots[name][1])))
    return out


def _operations(element: Element) -> list[str]:
    return [str(o.get("name", "")).lower() for o in element.iterfind("allowedOperation")]


def _kind(operations: list[str]) -> PlaceKind | None:
    return next((kind for word, kind in WORDS if any(o.startswith(word) for o in operations)), None)


READER = Reader("openTCS", (".xml",), sniff, read)

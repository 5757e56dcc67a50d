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
from fleetlog.roads.formats.base import Floats, MapOptions, Reader, RoadMap, Tally, at, number

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

MILLI = 1e-3
WORDS: tuple[tuple[str, PlaceKind], ...] = (
    ("charg", "charge"), ("unload", "drop"), ("drop", "drop"), ("put", "drop"), ("load", "pick"),
    ("pick", "pick"), ("fetch", "pick"), ("park", "park"),
)  # fmt: skip
"""Openings of the names of operations; the first that fits counts."""


def sniff(head: bytes) -> bool:
    """A model with points."""
    return looks_like(head, "model") and any(looks_like(head, tag) for tag in ("point ", "path ", "vehicle"))


def read(path: Path, options: MapOptions) -> RoadMap:
    """Read a plant model; see the module."""
    tally = Tally()
    model = parse_xml(path, "model", tally.notes)
    spots = {str(p.get("name")): _spot(p) for p in model.iterfind("point")}
    edges = [edge for element in model.iterfind("path") for edge in _path(element, spots, tally)]
    if not edges:
        raise SiteError(f"no path that may be driven in it ({tally.read} read)", do="unlock its paths")
    places = tuple(_places(model, spots, tally))
    return RoadMap(edges, tally.report("openTCS"), places=places, has_elevation=False)


def _spot(element: Element) -> Floats:
    """Position [m]; its attributes changed their names with version 0.0.5."""
    given = (element.get(f"position{axis.upper()}", element.get(f"{axis}Position")) for axis in "xy")
    x, y = (number(v, f"{element.tag} {element.get('name')}") for v in given)
    return np.array([x * MILLI, y * MILLI, 0.0])


def _path(element: Element, spots: dict[str, Floats], tally: Tally) -> list[Edge]:
    tally.read += 1
    name, locked = str(element.get("name")), element.get("locked") == "true"
    start, end = str(element.get("sourcePoint")), str(element.get("destinationPoint"))
    with at(f"path {name}"):
        for point in (start, end):
            if point not in spots:
                raise SiteError(f"there is no point {point!r}", do="correct the model")
        points = np.array([spots[start], spots[end]])
        if locked or np.hypot(*(points[1] - points[0])[:2]) < MILLI:
            tally.drop("locked" if locked else "without length")
            return []
        speeds = (element.get(key, "0") for key in ("maxVelocity", "maxReverseVelocity"))
        there, back = (number(v) * MILLI for v in speeds)
    tally.kept += 1
    edges = [Edge(name, start, end, points, name, there or math.nan)] if there > 0.0 or back <= 0.0 else []
    if back > 0.0:
        edges.append(Edge(reverse_id(name), end, start, points[::-1].copy(), name, back))
    return edges


def _places(model: Element, spots: dict[str, Floats], tally: Tally) -> list[Place]:
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
        x, y, _ = (spots[str(links[0].get("point"))] if links else _spot(location)).tolist()
        out.append(Place(str(location.get("name")), kind, x, y))
    if unknown:
        tally.notes.append(f"{unknown} locations are left out: no operation says what is done there")
    known = {p.id for p in out}
    parking = (str(p.get("name")) for p in model.iterfind("point") if p.get("type") == "PARK_POSITION")
    return out + [Place(n, "park", *spots[n][:2].tolist()) for n in parking if n not in known]


def _operations(element: Element) -> list[str]:
    return [str(o.get("name", "")).lower() for o in element.iterfind("allowedOperation")]


def _kind(operations: list[str]) -> PlaceKind | None:
    return next((kind for word, kind in WORDS if any(o.startswith(word) for o in operations)), None)


READER = Reader("openTCS", (".xml",), sniff, read)

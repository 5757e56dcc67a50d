"""OpenDRIVE elements as checked records.  Source: ASAM OpenDRIVE 1.8, chapters 9 to 12, and 1.4 to 1.7."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from fleetlog.errors import SiteError
from fleetlog.roads.formats import _odr_geometry as geo
from fleetlog.roads.formats.base import SPEED_UNITS, Floats, at, number

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

End = Literal["start", "end"]
LONGEST, TIGHTEST = 1e6, 100.0
"""A road longer than this [m] or a turn of more than this [rad] in one piece is a wrong number."""


@dataclass(frozen=True)
class Lane:
    """One lane of one section; ``predecessors`` and ``successors`` are lane ids in the direction of s."""

    id: int
    type: str
    direction: str
    widths: geo.Cubics
    borders: geo.Cubics
    predecessors: tuple[int, ...]
    successors: tuple[int, ...]
    speeds: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Section:
    """Lanes from s ``start`` to ``end`` [m], by id."""

    start: float
    end: float
    lanes: dict[int, Lane]


@dataclass(frozen=True)
class RoadLink:
    """What a road meets at one end: ``kind`` road or junction."""

    kind: str
    id: str
    contact: End | None


@dataclass(frozen=True)
class Road:
    """One road; ``speeds`` are (s, limit [m/s] or NaN), ``rule`` RHT, LHT or None."""

    id: str
    length: float
    junction: str
    rule: str | None
    plan: geo.Plan
    elevation: geo.Cubics
    superelevation: geo.Cubics
    offset: geo.Cubics
    sections: tuple[Section, ...]
    links: dict[End, RoadLink]
    speeds: tuple[tuple[float, float], ...]


def parse_road(element: Element) -> Road | None:
    """A road, or None where it has no lanes."""
    name = element.get("id")
    if name is None:
        raise SiteError("a road has no id", place=f"line {element.sourceline}", do="correct the map")
    with at(f"road {name}"):
        return _road(name, element)


def _road(name: str, element: Element) -> Road | None:
    plan = geo.Plan(tuple(_piece(g) for g in element.iterfind("planView/geometry")))
    lanes = element.find("lanes")
    if not plan.pieces or lanes is None or lanes.find("laneSection") is None:
        return None
    if bool((np.diff(plan.starts) < 0).any()):
        raise SiteError("the geometry records run backwards in s", do="correct the map")
    length = min(number(element.get("length"), "length"), plan.end)
    if not 0.0 < length <= LONGEST:
        raise SiteError(f"length is {length:g} m", do="correct the map")
    heights = _cubics(element.iterfind("elevationProfile/elevation"))
    return Road(
        name, length, element.get("junction", "-1"), _rule(element), plan, heights,
        _cubics(element.iterfind("lateralProfile/superelevation")), _cubics(lanes.iterfind("laneOffset")),
        _sections(lanes, length), _links(element), _type_speeds(element),
    )  # fmt: skip


def _rule(element: Element) -> str | None:
    rule: str | None = element.get("rule")
    if rule not in (None, "RHT", "LHT"):
        raise SiteError(f"rule is {rule!r}", do="write RHT or LHT")
    return rule


def _floats(element: Element, *names: str) -> list[float]:
    return [number(element.get(n), f"{n} of <{element.tag}>") for n in names]


def _piece(element: Element) -> geo.Piece:
    with at(f"line {element.sourceline}"):
        s, x, y, heading, length = _floats(element, "s", "x", "y", "hdg", "length")
        if not 0.0 <= length <= LONGEST:
            raise SiteError(f"length is {length:g} m", do="correct the map")
        shape = next((child for child in element if child.tag in _SHAPES), None)
        if shape is None:
            raise SiteError("a geometry has no known shape", do=f"known are {', '.join(_SHAPES)}")
        return geo.Piece(s, x, y, heading, length, _SHAPES[str(shape.tag)](shape, max(length, 1e-9)))


def _turn(curvature: float, length: float) -> float:
    if abs(curvature) * length > TIGHTEST:
        raise SiteError(f"curvature {curvature:g} 1/m over {length:g} m", do="correct the map")
    return curvature


def _arc(e: Element, length: float) -> geo.Curve:
    return geo.arc(_turn(_floats(e, "curvature")[0], length))


def _spiral(e: Element, length: float) -> geo.Curve:
    start, end = (_turn(k, length) for k in _floats(e, "curvStart", "curvEnd"))
    return geo.spiral(start, end, length)


def _param_poly3(e: Element, length: float) -> geo.Curve:
    u, v = (np.array(_floats(e, *(f"{c}{axis}" for c in "abcd"))) for axis in "UV")
    kind = e.get("pRange", "normalized")
    if kind not in ("arcLength", "normalized"):
        raise SiteError(f"pRange is {kind!r}", do="write arcLength or normalized")
    if not (np.any(u[1:]) or np.any(v[1:])):
        raise SiteError("a paramPoly3 does not leave its start", do="correct the map")
    return geo.param_poly3(u, v, length, length if kind == "arcLength" else 1.0)


_SHAPES: dict[str, Callable[[Element, float], geo.Curve]] = {
    "line": lambda e, length: geo.line,
    "arc": _arc,
    "spiral": _spiral,
    "poly3": lambda e, length: geo.poly3(np.array(_floats(e, *"abcd")), length),
    "paramPoly3": _param_poly3,
}


def _cubics(elements: Iterable[Element], key: str = "s", add: float = 0.0) -> geo.Cubics:
    rows = sorted(_floats(e, key, *"abcd") for e in elements)
    table = np.array(rows, dtype=np.float64).reshape(-1, 5)
    return geo.Cubics(table[:, 0] + add, table[:, 1:])


def _sections(lanes: Element, length: float) -> tuple[Section, ...]:
    elements = lanes.findall("laneSection")
    starts = [_floats(e, "s")[0] for e in elements]
    if starts != sorted(starts):
        raise SiteError("its lane sections run backwards in s", do="correct the map")
    out = []
    for k, (element, start, end) in enumerate(zip(elements, starts, [*starts[1:], length], strict=True)):
        with at(f"lane section {k}"):
            out.append(Section(start, min(end, length), _lanes(element, start)))
    return tuple(out)


def _lanes(section: Element, start: float) -> dict[int, Lane]:
    out: dict[int, Lane] = {}
    for element in section.iterfind("*/lane"):
        lane = _lane(element, start)
        if lane.id in out:
            raise SiteError(f"two lanes {lane.id}", do="correct the map")
        out[lane.id] = lane
    sides = [sorted((i for i in out if side * i > 0), key=abs) for side in (1, -1)]
    for ids in sides:
        if [abs(i) for i in ids] != list(range(1, len(ids) + 1)):
            raise SiteError(f"lane ids {ids} do not count up from the centre", do="correct the map")
    return out


TRAVEL = {"forward": "+s", "backward": "-s", "bidirectional": "both"}
"""Directions of lanes as a common extension writes them."""


def _lane(e: Element, start: float) -> Lane:
    key = _whole(e.get("id"))
    travel = e.find("userData/vectorLane")
    direction = e.get("direction", "")
    if travel is not None and not direction:
        direction = TRAVEL.get(travel.get("travelDir", ""), "")
    with at(f"lane {key}"):
        before, after = (
            tuple(_whole(x.get("id")) for x in e.iterfind(f"link/{side}"))
            for side in ("predecessor", "successor")
        )
        speeds = tuple((start + _floats(x, "sOffset")[0], speed(x)) for x in e.iterfind("speed"))
        widths, borders = (_cubics(e.iterfind(kind), "sOffset", start) for kind in ("width", "border"))
    return Lane(key, e.get("type", "none"), direction, widths, borders, before, after, speeds)


def _whole(text: Any) -> int:
    value = number(text, "lane id")
    if value != int(value):
        raise SiteError(f"{text!r} is not a lane id", do="correct the map")
    return int(value)


def speed(element: Element) -> float:
    """Limit [m/s] of a <speed>; NaN for "no limit" and "undefined"; without a known unit it is m/s."""
    text = (element.get("max") or "").strip()
    if text in ("no limit", "undefined", ""):
        return math.nan
    unit = (element.get("unit") or "m/s").strip()
    value = number(text, "speed") * SPEED_UNITS.get(unit, 1.0)
    # Exporters write a limit that they do not know as 0 or as a huge number.
    return value if 0.0 < value < 200.0 else math.nan


def _type_speeds(element: Element) -> tuple[tuple[float, float], ...]:
    limits = ((kind, kind.find("speed")) for kind in element.iterfind("type"))
    return tuple((_floats(k, "s")[0], math.nan if limit is None else speed(limit)) for k, limit in limits)


def _links(element: Element) -> dict[End, RoadLink]:
    out: dict[End, RoadLink] = {}
    sides: tuple[tuple[End, str], ...] = (("start", "link/predecessor"), ("end", "link/successor"))
    for end, tag in sides:
        link = element.find(tag)
        other = None if link is None else link.get("elementId")
        if link is not None and other is not None:
            out[end] = RoadLink(link.get("elementType", "road"), other, contact(link))
    return out


def contact(element: Element) -> End | None:
    """The contact point of a link, None where it has none."""
    text = element.get("contactPoint")
    if text not in (None, "start", "end"):
        raise SiteError(f"contactPoint is {text!r}", do="write start or end")
    return None if text is None else "start" if text == "start" else "end"


def stations(road: Road, section: Section, lanes: Iterable[Lane]) -> Floats:
    """s [m] of a section's ends, of every record that starts inside it, and at most 25 m apart."""
    tables = [road.plan.starts, road.elevation.starts, road.superelevation.starts, road.offset.starts]
    tables += [t for lane in lanes for t in (lane.widths.starts, lane.borders.starts)]
    marks = np.concatenate(tables)
    inner = marks[(marks > section.start + 1e-6) & (marks < section.end - 1e-6)]
    pieces = max(1, math.ceil((section.end - section.start) / 25.0))
    s = np.unique(np.concatenate([inner, np.linspace(section.start, section.end, 1 + pieces)]))
    keep = np.concatenate([[True], np.diff(s) > 1e-6])
    keep[-1] = True
    return np.asarray(s[keep], dtype=np.float64)

"""OpenDRIVE elements as checked records.  Source: ASAM OpenDRIVE 1.8, chapters 9 to 12, and 1.4 to 1.7."""

import math
from collections.abc import Callable, Iterable, Iterator
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np

from fleetlog.errors import SiteError
from fleetlog.roads.formats import _odr_geometry as geo
from fleetlog.roads.formats._documents import Element
from fleetlog.roads.formats.base import SPEED_UNITS, at, number

End = Literal["start", "end"]
ENDS: tuple[End, End] = ("start", "end")
SIDES = tuple(zip(ENDS, ("link/predecessor", "link/successor"), strict=True))
LONGEST, TIGHTEST = 2e5, 100.0  # a longer road [m], or more of a turn in one piece [rad], is wrong
MOST_LANES = 200  # the widest roads on earth have some thirty; the work grows with the square of the lanes
AGAIN = "correct the map"
MICRO = 1e-3  # a lane section shorter than this [m] is no edge; its links are carried through
TRAVEL = {"forward": "+s", "backward": "-s", "bidirectional": "both"}
"""Directions of lanes as a common extension writes them."""


class Lane(NamedTuple):
    """One lane of one section; ``links`` are the lane ids at its start and end in the direction of s."""

    id: int
    type: str
    direction: str
    widths: geo.Cubics
    borders: geo.Cubics
    links: dict[End, tuple[int, ...]]
    speeds: tuple[tuple[float, float], ...]


class Section(NamedTuple):
    """Lanes from s ``start`` to ``end`` [m], by id."""

    start: float
    end: float
    lanes: dict[int, Lane]


class RoadLink(NamedTuple):
    """What a road meets at one end: ``kind`` road or junction."""

    kind: str
    id: str
    contact: End | None


class LaneEnd(NamedTuple):
    """One end of a lane of a section."""

    road: str
    section: int
    lane: int
    end: End

    def __str__(self) -> str:
        return f"{self.road}:{self.section}:{self.lane}:{self.end}"


class Road(NamedTuple):
    """One road; ``speeds`` are (s, limit [m/s] or NaN), ``rule`` RHT, LHT or None."""

    id: str
    rule: str | None
    plan: geo.Plan
    length: float
    elevation: geo.Cubics
    superelevation: geo.Cubics
    offset: geo.Cubics
    sections: tuple[Section, ...]
    links: dict[End, RoadLink]
    speeds: tuple[tuple[float, float], ...]


def parse_road(element: Element) -> Road | None:
    """A road, or None where it has no lanes; the caller says which one it is."""
    plan = geo.Plan(tuple(_piece(g) for g in element.iterfind("planView/geometry")))
    lanes = element.find("lanes")
    if not plan.pieces or lanes is None or lanes.find("laneSection") is None:
        return None
    if bool((np.diff(plan.starts) < 0).any()):
        raise SiteError("the geometry records run backwards in s", do=AGAIN)
    length = min(number(element.get("length"), "length"), plan.pieces[-1].s + plan.pieces[-1].length)
    if not 0.0 < length <= LONGEST:
        raise SiteError(f"length is {length:g} m", do=AGAIN)
    if (rule := element.get("rule")) not in (None, "RHT", "LHT"):
        raise SiteError(f"rule is {rule!r}", do="write RHT or LHT")
    profiles = ("elevationProfile/elevation", "lateralProfile/superelevation", "lanes/laneOffset")
    heights, rolls, offset = (_cubics(element.iterfind(profile)) for profile in profiles)
    speeds = tuple((_floats(k, "s")[0], _speed(k.find("speed"))) for k in element.iterfind("type"))
    linked = ((end, link) for end, tag in SIDES for link in element.findall(f"{tag}[@elementId]")[:1])
    kind = "elementType", "road"  # A road where it is not said
    links = {end: RoadLink(e.get(*kind), str(e.get("elementId")), contact(e)) for end, e in linked}
    sections = tuple(_sections(lanes, length))
    return Road(str(element.get("id")), rule, plan, length, heights, rolls, offset, sections, links, speeds)


def _floats(element: Element, *names: str) -> list[float]:
    return [number(element.get(n), f"{n} of <{element.tag}>") for n in names]


def _piece(element: Element) -> geo.Piece:
    with at(f"line {element.sourceline}"):
        s, x, y, heading, length = _floats(element, "s", "x", "y", "hdg", "length")
        if not 0.0 <= length <= LONGEST:
            raise SiteError(f"length is {length:g} m", do=AGAIN)
        if (shape := next((child for child in element if child.tag in _SHAPES), None)) is None:
            raise SiteError("a geometry has no known shape", do=f"known are {', '.join(_SHAPES)}")
        return geo.Piece(s, x, y, heading, length, _SHAPES[str(shape.tag)](shape, max(length, 1e-9)))


def _bend(element: Element, length: float, *names: str) -> geo.Curve:
    start, end = _floats(element, *names)
    if abs(most := max(start, end, key=abs)) * length > TIGHTEST:
        raise SiteError(f"curvature {most:g} 1/m over {length:g} m", do=AGAIN)
    return geo.spiral(start, end, length)


def _param_poly3(e: Element, length: float) -> geo.Curve:
    u, v = (np.array(_floats(e, *(f"{c}{axis}" for c in "abcd"))) for axis in "UV")
    if (kind := e.get("pRange", "normalized")) not in ("arcLength", "normalized"):
        raise SiteError(f"pRange is {kind!r}", do="write arcLength or normalized")
    if not (np.any(u[1:]) or np.any(v[1:])):
        raise SiteError("a paramPoly3 does not leave its start", do=AGAIN)
    return geo.param_poly3(u, v, length, length if kind == "arcLength" else 1.0)


_SHAPES: dict[str, Callable[[Element, float], geo.Curve]] = {
    "line": lambda e, length: geo.spiral(0.0, 0.0, length),
    "arc": lambda e, length: _bend(e, length, "curvature", "curvature"),
    "spiral": lambda e, length: _bend(e, length, "curvStart", "curvEnd"),
    "poly3": lambda e, length: geo.poly3(np.array(_floats(e, *"abcd")), length),
    "paramPoly3": _param_poly3,
}


def _cubics(elements: Iterable[Element], key: str = "s", add: float = 0.0) -> geo.Cubics:
    table = np.array(sorted(_floats(e, key, *"abcd") for e in elements), dtype=np.float64).reshape(-1, 5)
    return geo.Cubics(table[:, 0] + add, table[:, 1:])


def _sections(lanes: Element, length: float) -> Iterator[Section]:
    elements = lanes.findall("laneSection")
    if (starts := [_floats(e, "s")[0] for e in elements]) != sorted(starts):
        raise SiteError("its lane sections run backwards in s", do=AGAIN)
    for k, (element, (start, end)) in enumerate(zip(elements, pairwise([*starts, length]), strict=True)):
        with at(f"lane section {k}"):
            yield Section(start, min(end, length), _lanes(element, start))


def _lanes(section: Element, start: float) -> dict[int, Lane]:
    lanes = [_lane(element, start) for element in section.iterfind("*/lane")]
    if len(out := {lane.id: lane for lane in lanes}) < len(lanes):
        raise SiteError("two lanes have one id", do=AGAIN)
    if len(out) > MOST_LANES:
        raise SiteError(f"it has {len(out):,} lanes", do=AGAIN)
    counted = {0, *out}
    if max(counted) - min(counted) >= len(counted):
        raise SiteError(f"lane ids {sorted(out)} do not count up from the centre", do=AGAIN)
    return out


def _lane(e: Element, start: float) -> Lane:
    key, travel = _whole(e.get("id")), str(e.xpath("string(userData/vectorLane/@travelDir)"))
    direction = e.get("direction") or TRAVEL.get(travel, "")
    with at(f"lane {key}"):
        links = {end: tuple(_whole(x.get("id")) for x in e.iterfind(tag)) for end, tag in SIDES}
        speeds = tuple((start + _floats(x, "sOffset")[0], _speed(x)) for x in e.iterfind("speed"))
        widths, borders = (_cubics(e.iterfind(kind), "sOffset", start) for kind in ("width", "border"))
    return Lane(key, e.get("type", "none"), direction, widths, borders, links, speeds)


def _whole(text: Any) -> int:
    if (value := number(text, "lane id")) != int(value):
        raise SiteError(f"{text!r} is not a lane id", do=AGAIN)
    return int(value)


def _speed(element: Element | None) -> float:
    """Limit [m/s] of a <speed>; NaN for "no limit" and "undefined"; without a known unit it is m/s."""
    text = "" if element is None else (element.get("max") or "").strip()
    if element is None or text in ("no limit", "undefined", ""):
        return math.nan
    value = number(text, "speed") * SPEED_UNITS.get((element.get("unit") or "m/s").strip(), 1.0)
    # Exporters write a limit that they do not know as 0 or as a huge number.
    return value if 0.0 < value < 200.0 else math.nan


def contact(element: Element) -> End | None:
    """The contact point of a link, None where it has none."""
    if (text := element.get("contactPoint")) not in (None, *ENDS):
        raise SiteError(f"contactPoint is {text!r}", do="write start or end")
    return next((end for end in ENDS if end == text), None)

"""OpenDRIVE elements as checked records.  Source: ASAM OpenDRIVE 1.8, chapters 9 to 12;
1.4 to 1.7 where they differ.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from fleetlog.errors import SiteError
from fleetlog.roads.formats import _odr_geometry as geo
from fleetlog.roads.formats.base import SPEED_UNITS, Floats, number

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

End = Literal["start", "end"]
LONGEST, TIGHTEST = 1e6, 100.0
"""A road longer than this [m] or a turn of more than this [rad] in one piece is a wrong number,
not a road.
"""


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
    """One road; ``speeds`` are (s, limit [m/s] or NaN); ``left`` whether traffic keeps left."""

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
    has_elevation: bool


def parse_road(element: Element, path: Path) -> Road | None:
    """A road, or None where it has no lanes."""
    name = element.get("id")
    if name is None:
        raise SiteError(
            "a road has no id", where=path, place=f"line {element.sourceline}", do="correct the map"
        )
    place = f"road {name}"
    plan = geo.Plan(
        tuple(_piece(g, path, f"{place}, line {g.sourceline}") for g in element.iterfind("planView/geometry"))
    )
    lanes = element.find("lanes")
    if not plan.pieces or lanes is None or lanes.find("laneSection") is None:
        return None
    if bool((np.diff(plan.starts) < 0).any()):
        raise SiteError(
            "the geometry records run backwards in s", where=path, place=place, do="correct the map"
        )
    length = min(number(element.get("length"), path, f"{place}, length"), plan.end)
    if not 0.0 < length <= LONGEST:
        raise SiteError(f"length is {length:g} m", where=path, place=place, do="correct the map")
    heights = _cubics(element.iterfind("elevationProfile/elevation"), "s", path, place)
    return Road(
        name, length, element.get("junction", "-1"), _rule(element, path, place), plan, heights,
        _cubics(element.iterfind("lateralProfile/superelevation"), "s", path, place),
        _cubics(lanes.iterfind("laneOffset"), "s", path, place), _sections(lanes, length, path, place),
        _links(element, path, place), _type_speeds(element, path, place), bool(len(heights.starts)),
    )  # fmt: skip


def _rule(element: Element, path: Path, place: str) -> str | None:
    rule: str | None = element.get("rule")
    if rule not in (None, "RHT", "LHT"):
        raise SiteError(f"rule is {rule!r}", where=path, place=place, do="write RHT or LHT")
    return rule


def _floats(element: Element, names: Iterable[str], path: Path, place: str) -> list[float]:
    return [number(element.get(n), path, f"{place}, {n} of <{element.tag}>") for n in names]


def _piece(element: Element, path: Path, place: str) -> geo.Piece:
    s, x, y, heading, length = _floats(element, ("s", "x", "y", "hdg", "length"), path, place)
    if not 0.0 <= length <= LONGEST:
        raise SiteError(f"length is {length:g} m", where=path, place=place, do="correct the map")
    shape = next((child for child in element if child.tag in _SHAPES), None)
    if shape is None:
        known = ", ".join(_SHAPES)
        raise SiteError("a geometry has no known shape", where=path, place=place, do=f"known are {known}")
    return geo.Piece(s, x, y, heading, length, _SHAPES[str(shape.tag)](shape, max(length, 1e-9), path, place))


def _turn(curvature: float, length: float, path: Path, place: str) -> float:
    if abs(curvature) * length > TIGHTEST:
        raise SiteError(
            f"curvature {curvature:g} 1/m over {length:g} m", where=path, place=place, do="correct the map"
        )
    return curvature


def _line(e: Element, length: float, path: Path, place: str) -> geo.Curve:
    return geo.line


def _arc(e: Element, length: float, path: Path, place: str) -> geo.Curve:
    return geo.arc(_turn(_floats(e, ("curvature",), path, place)[0], length, path, place))


def _spiral(e: Element, length: float, path: Path, place: str) -> geo.Curve:
    start, end = (_turn(k, length, path, place) for k in _floats(e, ("curvStart", "curvEnd"), path, place))
    return geo.spiral(start, end, length)


def _poly3(e: Element, length: float, path: Path, place: str) -> geo.Curve:
    return geo.poly3(np.array(_floats(e, "abcd", path, place)), length)


def _param_poly3(e: Element, length: float, path: Path, place: str) -> geo.Curve:
    u = np.array(_floats(e, ("aU", "bU", "cU", "dU"), path, place))
    v = np.array(_floats(e, ("aV", "bV", "cV", "dV"), path, place))
    kind = e.get("pRange", "normalized")
    if kind not in ("arcLength", "normalized"):
        raise SiteError(f"pRange is {kind!r}", where=path, place=place, do="write arcLength or normalized")
    if not (np.any(u[1:]) or np.any(v[1:])):
        raise SiteError(
            "a paramPoly3 does not leave its start", where=path, place=place, do="correct the map"
        )
    return geo.param_poly3(u, v, length, length if kind == "arcLength" else 1.0)


_SHAPES: dict[str, Any] = {
    "line": _line, "arc": _arc, "spiral": _spiral, "poly3": _poly3, "paramPoly3": _param_poly3,
}  # fmt: skip


def _cubics(elements: Iterable[Element], key: str, path: Path, place: str, add: float = 0.0) -> geo.Cubics:
    rows = sorted(_floats(e, (key, *"abcd"), path, place) for e in elements)
    table = np.array(rows, dtype=np.float64).reshape(-1, 5)
    return geo.Cubics(table[:, 0] + add, table[:, 1:])


def _sections(lanes: Element, length: float, path: Path, place: str) -> tuple[Section, ...]:
    elements = lanes.findall("laneSection")
    starts = [_floats(e, ("s",), path, place)[0] for e in elements]
    if starts != sorted(starts):
        raise SiteError("its lane sections run backwards in s", where=path, place=place, do="correct the map")
    ends = [*starts[1:], length]
    return tuple(
        Section(a, min(b, length), _lanes(e, a, path, f"{place}, lane section {k}"))
        for k, (e, a, b) in enumerate(zip(elements, starts, ends, strict=True))
    )


def _lanes(section: Element, start: float, path: Path, place: str) -> dict[int, Lane]:
    out: dict[int, Lane] = {}
    for element in section.iterfind("*/lane"):
        lane = _lane(element, start, path, place)
        if lane.id in out:
            raise SiteError(f"two lanes {lane.id}", where=path, place=place, do="correct the map")
        out[lane.id] = lane
    sides = [sorted((i for i in out if side * i > 0), key=abs) for side in (1, -1)]
    for ids in sides:
        if [abs(i) for i in ids] != list(range(1, len(ids) + 1)):
            raise SiteError(
                f"lane ids {ids} do not count up from the centre",
                where=path,
                place=place,
                do="correct the map",
            )
    return out


def _lane(e: Element, start: float, path: Path, place: str) -> Lane:
    key = _whole(e.get("id"), path, place)
    spot = f"{place}, lane {key}"
    travel = e.find("userData/vectorLane")
    direction = e.get("direction", "")
    if travel is not None and not direction:
        direction = {"forward": "+s", "backward": "-s", "bidirectional": "both"}.get(
            travel.get("travelDir", ""), ""
        )
    link = {
        side: tuple(_whole(x.get("id"), path, spot) for x in e.iterfind(f"link/{side}"))
        for side in ("predecessor", "successor")
    }
    speeds = tuple(
        (start + _floats(x, ("sOffset",), path, spot)[0], speed(x, path, spot)) for x in e.iterfind("speed")
    )
    return Lane(
        key, e.get("type", "none"), direction, _cubics(e.iterfind("width"), "sOffset", path, spot, start),
        _cubics(e.iterfind("border"), "sOffset", path, spot, start), link["predecessor"], link["successor"],
        speeds,
    )  # fmt: skip


def _whole(text: Any, path: Path, place: str) -> int:
    value = number(text, path, f"{place}, lane id")
    if value != int(value):
        raise SiteError(f"{text!r} is not a lane id", where=path, place=place, do="correct the map")
    return int(value)


def speed(element: Element, path: Path, place: str) -> float:
    """Limit [m/s] of a <speed>; NaN for "no limit" and "undefined"; without a known unit it is m/s."""
    text = (element.get("max") or "").strip()
    if text in ("no limit", "undefined", ""):
        return math.nan
    value = number(text, path, f"{place}, speed") * SPEED_UNITS.get(
        (element.get("unit") or "m/s").strip(), 1.0
    )
    # Exporters write a limit that they do not know as 0 or as a huge number.
    return value if 0.0 < value < 200.0 else math.nan


def _type_speeds(element: Element, path: Path, place: str) -> tuple[tuple[float, float], ...]:
    out = []
    for kind in element.iterfind("type"):
        limit = kind.find("speed")
        out.append(
            (_floats(kind, ("s",), path, place)[0], math.nan if limit is None else speed(limit, path, place))
        )
    return tuple(out)


def _links(element: Element, path: Path, place: str) -> dict[End, RoadLink]:
    out: dict[End, RoadLink] = {}
    sides: tuple[tuple[End, str], ...] = (("start", "link/predecessor"), ("end", "link/successor"))
    for end, tag in sides:
        link = element.find(tag)
        other = None if link is None else link.get("elementId")
        if link is not None and other is not None:
            out[end] = RoadLink(link.get("elementType", "road"), other, contact(link, path, place))
    return out


def contact(element: Element, path: Path, place: str) -> End | None:
    """The contact point of a link, None where it has none."""
    text = element.get("contactPoint")
    if text is None:
        return None
    if text not in ("start", "end"):
        raise SiteError(f"contactPoint is {text!r}", where=path, place=place, do="write start or end")
    return "start" if text == "start" else "end"


def stations(road: Road, section: Section, lanes: Iterable[Lane]) -> Floats:
    """s [m] of a section's ends, of every record that starts inside it, and at most 25 m apart."""
    tables = [road.plan.starts, road.elevation.starts, road.superelevation.starts, road.offset.starts]
    tables += [t for lane in lanes for t in (lane.widths.starts, lane.borders.starts)]
    marks = np.concatenate(tables)
    inner = marks[(marks > section.start + 1e-6) & (marks < section.end - 1e-6)]
    steps = np.linspace(
        section.start, section.end, 1 + max(1, math.ceil((section.end - section.start) / 25.0))
    )
    s = np.unique(np.concatenate([inner, steps]))
    keep = np.concatenate([[True], np.diff(s) > 1e-6])
    keep[-1] = True
    return np.asarray(s[keep], dtype=np.float64)

"""OpenDRIVE elements as checked records, and which lane ends touch.

Source: ASAM OpenDRIVE 1.8, chapters 9 to 12, and 1.4 to 1.7.

Links name neighbours in the direction of s, not of travel.  Written as a graph of *lane ends* they need no
case for left lanes, left-hand traffic or reference lines that meet head to head: an edge leaves at one lane
end, and may be followed by every edge that enters at a lane end which touches it."""

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import chain, pairwise, product
from typing import Any, Literal, NamedTuple

import numpy as np

from fleetlog.errors import SiteError
from fleetlog.roads.formats import _odr_geometry as geo
from fleetlog.roads.formats._documents import Element
from fleetlog.roads.formats.base import SPEED_UNITS, Tally, at, number

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


Pair = tuple[LaneEnd, LaneEnd] | None  # Two lane ends that a link joins; None where one has no road


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
            found = [_lane(e, start) for e in element.iterfind("*/lane")]
            if len(named := {lane.id: lane for lane in found}) < len(found):
                raise SiteError("two lanes have one id", do=AGAIN)
            if len(named) > MOST_LANES:
                raise SiteError(f"it has {len(named):,} lanes", do=AGAIN)
            counted = {0, *named}
            if max(counted) - min(counted) >= len(counted):
                raise SiteError(f"lane ids {sorted(named)} do not count up from the centre", do=AGAIN)
            yield Section(start, min(end, length), named)


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
    unit = (element.get("unit") or "m/s").strip()
    value = number(text, "speed") * SPEED_UNITS.get(unit, 1.0)
    # Exporters write a limit that they do not know as 0 or as a huge number.
    return value if 0.0 < value < 200.0 else math.nan


def contact(element: Element) -> End | None:
    """The contact point of a link, None where it has none."""
    if (text := element.get("contactPoint")) not in (None, *ENDS):
        raise SiteError(f"contactPoint is {text!r}", do="write start or end")
    return next((end for end in ENDS if end == text), None)


def connect(roads: dict[str, Road], junctions: list[Element], tally: Tally) -> list[tuple[str, str]]:
    """The allowed turns, (edge id, next edge id), of the tally's lanes; ends that touch become one node."""
    import networkx as nx

    lanes, touching = tally.edges, _touching(roads, junctions, tally)
    entering: dict[str, list[str]] = defaultdict(list)
    nodes: dict[str, str] = {}
    for lane in lanes:
        entering[lane.start].append(lane.id)
        for spot in (lane.start, lane.end):
            touching.add_node(spot)
            if spot not in nodes:
                nodes |= dict.fromkeys(nx.node_connected_component(touching, spot), spot)
    tally.edges = [replace(lane, start=nodes[lane.start], end=nodes[lane.end]) for lane in lanes]
    turns = [(lane.id, f) for lane in lanes for end in touching[lane.end] for f in entering[end]]
    tally.note(len(lanes) - len({a for a, _ in turns}), "lane", "with no lane to follow at the end")
    return turns


def _touching(roads: dict[str, Road], junctions: list[Element], tally: Tally) -> Any:
    """The graph of all lane ends that touch, whichever of them says so."""
    import networkx as nx

    said: nx.DiGraph[LaneEnd] = nx.DiGraph()
    odd = 0
    in_roads = (_links_of(road, roads) for road in roads.values())
    in_junctions = (_links_in(junction, roads, tally.notes) for junction in junctions)
    for pair in chain.from_iterable(chain(in_roads, in_junctions)):
        if pair is None or not all(s.lane in roads[s.road].sections[s.section].lanes for s in pair):
            odd += 1
        elif pair[0] != pair[1]:
            said.add_edge(*pair)
    # a junction lists the links of the roads that it meets in their stead
    unanswered = [b for a, b in said.edges if not said.has_edge(b, a)]
    outer = [b for b in unanswered if b == _outer(roads[b.road], b.lane, b.end)]
    met = (roads[b.road].links.get(b.end) for b in outer)
    listed = sum(link is not None and link.kind == "junction" for link in met)
    tally.note(len(unanswered) - listed, "lane link", "given in one direction only, taken to hold in both")
    tally.note(odd, "link", "left out, to roads or lanes that do not exist")
    touching: nx.Graph[Any] = said.to_undirected()
    # Sections too short to be edges are passed through.
    short = ((r, k, s) for r in roads.values() for k, s in enumerate(r.sections) if s.end - s.start < MICRO)
    for road, k, section in short:
        for lane in section.lanes:
            sides = (list(touching.adj.get(LaneEnd(road.id, k, lane, end), ())) for end in ENDS)
            touching.add_edges_from((a, b) for a, b in product(*sides) if a != b)
    return nx.relabel_nodes(touching, str)


def _outer(road: Road, lane: int, end: End) -> LaneEnd:
    """The end of a lane at an end of its road."""
    return LaneEnd(road.id, 0 if end == "start" else len(road.sections) - 1, lane, end)


def _links_of(road: Road, roads: dict[str, Road]) -> Iterator[Pair]:
    """What the lanes of a road say, from section to section and to the roads at its ends."""
    for k, (before, after) in enumerate(pairwise(road.sections)):
        for lane in before.lanes.values():
            high = LaneEnd(road.id, k, lane.id, "end")
            yield from ((high, LaneEnd(road.id, k + 1, i, "start")) for i in lane.links["end"])
        for lane in after.lanes.values():
            low = LaneEnd(road.id, k + 1, lane.id, "start")
            yield from ((low, LaneEnd(road.id, k, i, "end")) for i in lane.links["start"])
    for end, link in road.links.items():
        other = roads.get(link.id)
        if link.kind == "road" and other is None:
            yield None
        elif link.kind == "road" and other is not None:
            there = link.contact or _nearest_end(other, road, end)
            for lane in road.sections[0 if end == "start" else -1].lanes.values():
                yield from ((_outer(road, lane.id, end), _outer(other, i, there)) for i in lane.links[end])


def _links_in(junction: Element, roads: dict[str, Road], notes: list[str]) -> Iterator[Pair]:
    name = junction.get("id", "?")
    if junction.get("type") in ("virtual", "crossing"):
        notes.append(f"junction {name} is {junction.get('type')} and is not routed over")
        return
    for c in junction.iterfind("connection"):
        incoming = roads.get(c.get("incomingRoad", ""))
        onward = roads.get(c.get("connectingRoad") or c.get("linkedRoad") or "")
        if incoming is None or onward is None:
            yield None
            continue
        with at(f"junction {name}, connection {c.get('id')}"):
            there, links = contact(c) or "start", c.iterfind("laneLink")
            lanes = [[int(number(e.get(k), "laneLink")) for k in ("from", "to")] for e in links]
        # By the links of the incoming road, by nearness where they do not decide.
        meets = [end for end, link in incoming.links.items() if link.kind == "junction" and link.id == name]
        here = meets[0] if len(meets) == 1 else _nearest_end(incoming, onward, there)
        yield from ((_outer(incoming, a, here), _outer(onward, b, there)) for a, b in lanes)


def _nearest_end(road: Road, other: Road, there: End) -> End:
    """The end of a road that is nearer to the end ``there`` of another."""
    ends = ((other, there), (road, "start"), (road, "end"))
    spots = (r.plan.at(np.array([0.0 if end == "start" else r.length]))[:2, 0] for r, end in ends)
    spot, start, end = spots
    return "start" if np.linalg.norm(start - spot) < np.linalg.norm(end - spot) else "end"

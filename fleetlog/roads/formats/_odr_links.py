"""OpenDRIVE connectivity: which lane ends touch, from lane links, road links and junctions.

Links name neighbours in the direction of s, not of travel.  Written as a relation between *lane ends* they
need no case for left lanes, left-hand traffic or reference lines that meet head to head: an edge leaves at
one lane end, and may be followed by every edge that enters at a lane end which touches it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from fleetlog.roads.formats._odr_lanes import MICRO, LaneEdge, LaneEnd
from fleetlog.roads.formats._odr_parse import End, Road, contact
from fleetlog.roads.formats.base import Floats, Tally, at, number

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

Pair = tuple[LaneEnd, LaneEnd]
ENDS: tuple[End, End] = ("start", "end")
GAP, BEND = 0.5, np.radians(20.0)
"""Edges that follow one another but lie farther apart [m] or turn more sharply [rad] are told of."""


@dataclass
class Touching:
    """The symmetric relation; ``said`` keeps from which side each pair was named, for the notes."""

    roads: dict[str, Road]
    neighbours: dict[LaneEnd, set[LaneEnd]] = field(default_factory=dict)
    said: set[Pair] = field(default_factory=set)
    odd: int = 0

    def add(self, a: LaneEnd, b: LaneEnd) -> None:
        """a names b."""
        if not self._is_there(b):
            self.odd += 1
        elif a != b:
            self.said.add((a, b))
            self.neighbours.setdefault(a, set()).add(b)
            self.neighbours.setdefault(b, set()).add(a)

    def _is_there(self, spot: LaneEnd) -> bool:
        road = self.roads.get(spot[0])
        return road is not None and spot[2] in road.sections[spot[1]].lanes

    def one_sided(self) -> int:
        """How many pairs are named from one side only, though the other could name them."""
        return sum((b, a) not in self.said and not _at_junction(self.roads, b) for a, b in self.said)


def touching(roads: dict[str, Road], junctions: list[Element], tally: Tally) -> Touching:
    """All lane ends that touch."""
    relation = Touching(roads)
    for road in roads.values():
        for a, b in _inside(road):
            relation.add(a, b)
        _between(road, relation)
    for junction in junctions:
        _junction(junction, roads, relation, tally)
    if one := relation.one_sided():
        what = "given in one direction only; they are taken to hold in both"
        tally.notes.append(f"{one} lane links are {what}")
    if relation.odd:
        tally.notes.append(f"{relation.odd} links name roads or lanes that do not exist and are left out")
    _bridge(roads, relation)
    return relation


def _at_junction(roads: dict[str, Road], spot: LaneEnd) -> bool:
    """Whether the road meets a junction at this end, which then lists the links in its stead."""
    road = roads.get(spot[0])
    link = road.links.get(spot[3]) if road else None
    outermost = road is not None and spot[1] == _outermost(road, spot[3])
    return outermost and link is not None and link.kind == "junction"


def _inside(road: Road) -> Iterator[Pair]:
    for k, section in enumerate(road.sections):
        for lane in section.lanes.values():
            if k + 1 < len(road.sections):
                for i in lane.successors:
                    yield (road.id, k, lane.id, "end"), (road.id, k + 1, i, "start")
            if k:
                for i in lane.predecessors:
                    yield (road.id, k, lane.id, "start"), (road.id, k - 1, i, "end")


def _between(road: Road, relation: Touching) -> None:
    for end, link in road.links.items():
        other = relation.roads.get(link.id)
        if link.kind != "road":
            continue
        if other is None:
            relation.odd += 1
            continue
        there = link.contact or _nearest_end(other, _end_point(road, end))
        for lane in road.sections[_outermost(road, end)].lanes.values():
            for i in lane.predecessors if end == "start" else lane.successors:
                relation.add(_outer(road, lane.id, end), _outer(other, i, there))


def _outermost(road: Road, end: End) -> int:
    """The section at an end of a road."""
    return 0 if end == "start" else len(road.sections) - 1


def _outer(road: Road, lane: int, end: End) -> LaneEnd:
    return road.id, _outermost(road, end), lane, end


def _junction(e: Element, roads: dict[str, Road], relation: Touching, tally: Tally) -> None:
    name = e.get("id", "?")
    if e.get("type") in ("virtual", "crossing"):
        tally.notes.append(f"junction {name} is {e.get('type')} and is not routed over")
        return
    for c in e.iterfind("connection"):
        incoming = roads.get(c.get("incomingRoad", ""))
        onward = roads.get(c.get("connectingRoad") or c.get("linkedRoad") or "")
        if incoming is None or onward is None:
            relation.odd += 1
            continue
        with at(f"junction {name}, connection {c.get('id')}"):
            there = contact(c) or "start"
        end = _incoming_end(incoming, name, onward, there)
        for link in c.iterfind("laneLink"):
            a, b = (int(number(link.get(k), f"junction {name}, laneLink")) for k in ("from", "to"))
            here = _outer(incoming, a, end)
            if a in incoming.sections[here[1]].lanes:
                relation.add(here, _outer(onward, b, there))
            else:
                relation.odd += 1


def _incoming_end(road: Road, junction: str, onward: Road, there: End) -> End:
    """The end of the incoming road at the junction: by its links, by nearness where they do not decide."""
    meets = [end for end, link in road.links.items() if link.kind == "junction" and link.id == junction]
    return meets[0] if len(meets) == 1 else _nearest_end(road, _end_point(onward, there))


def _nearest_end(road: Road, spot: Floats) -> End:
    start, end = (float(np.linalg.norm(_end_point(road, e) - spot)) for e in ENDS)
    return "start" if start < end else "end"


def _end_point(road: Road, end: End) -> Floats:
    x, y, _ = road.plan.at(np.array([0.0 if end == "start" else road.length]))
    return np.array([x[0], y[0]])


def _bridge(roads: dict[str, Road], relation: Touching) -> None:
    """Carry the links through sections too short to be edges."""
    for road in roads.values():
        for k, section in enumerate(road.sections):
            if section.end - section.start >= MICRO:
                continue
            for lane in section.lanes:
                low: LaneEnd = (road.id, k, lane, "start")
                high: LaneEnd = (road.id, k, lane, "end")
                for a in sorted(relation.neighbours.get(low, ())):
                    for b in sorted(relation.neighbours.get(high, ())):
                        relation.add(a, b)


def turns(edges: list[LaneEdge], relation: Touching, tally: Tally) -> list[tuple[str, str]]:
    """(edge id, next edge id) of every allowed turn; gaps and kinks between them are noted."""
    entering: dict[LaneEnd, list[LaneEdge]] = {}
    for edge in edges:
        entering.setdefault(edge.enters, []).append(edge)
    out, broken, dead = [], [], 0
    for edge in edges:
        after = [f for end in sorted(relation.neighbours.get(edge.leaves, ())) for f in entering.get(end, ())]
        dead += not after
        out += [(edge.id, f.id) for f in after]
        broken += [(edge.id, f.id) for f in after if not _joins(edge, f)]
    if broken:
        a, b = broken[0]
        tally.notes.append(
            f"{len(broken)} turns have a gap over {GAP:g} m or a kink over 20 degrees, the first {a} to {b}"
        )
    if dead:
        tally.notes.append(f"{dead} lanes end with no lane to follow")
    return out


def _joins(a: LaneEdge, b: LaneEdge) -> bool:
    p, q = a.points[-1] - a.points[-2], b.points[1] - b.points[0]
    turn = np.arctan2(p[0] * q[1] - p[1] * q[0], p[0] * q[0] + p[1] * q[1])
    return bool(np.linalg.norm(a.points[-1] - b.points[0]) <= GAP and abs(turn) <= BEND)


def node_names(edges: list[LaneEdge], relation: Touching) -> dict[LaneEnd, str]:
    """A node for every group of touching lane ends."""
    names: dict[LaneEnd, str] = {}
    for edge in edges:
        for end in (edge.enters, edge.leaves):
            if end in names:
                continue
            name, todo = f"{end[0]}:{end[1]}:{end[2]}:{end[3]}", [end]
            while todo:
                spot = todo.pop()
                if spot not in names:
                    names[spot] = name
                    todo += relation.neighbours.get(spot, ())
    return names

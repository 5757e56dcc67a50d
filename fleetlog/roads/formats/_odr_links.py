"""OpenDRIVE connectivity: which lane ends touch, from lane links, road links and junctions.

Links name neighbours in the direction of s, not of travel.  Written as a graph of *lane ends* they need no
case for left lanes, left-hand traffic or reference lines that meet head to head: an edge leaves at one lane
end, and may be followed by every edge that enters at a lane end which touches it."""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from itertools import chain, pairwise, product
from typing import Any

import numpy as np

from fleetlog.roads.formats._documents import Element
from fleetlog.roads.formats._odr_parse import ENDS, MICRO, End, LaneEnd, Road, contact
from fleetlog.roads.formats.base import Tally, at, number

Pair = tuple[LaneEnd, LaneEnd] | None  # Two lane ends that a link joins; None where one has no road


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

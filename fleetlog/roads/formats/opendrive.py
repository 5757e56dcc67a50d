"""OpenDRIVE 1.4 to 1.8 (.xodr): every driven lane of every lane section is an edge ``road:section:lane``.

Read: plan view (line, arc, spiral, poly3, paramPoly3), elevation, superelevation, lane offset, widths and
borders, lane links, junctions (direct ones too), rule (RHT, LHT), lane directions, speeds, geoReference with
the offset of the header.  Left out: virtual junctions, road shape and surface, objects, signals, railroads,
included files.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from fleetlog.core.network import Edge
from fleetlog.errors import SiteError
from fleetlog.roads.formats._odr_lanes import DRIVEN, LaneEdge, lane_edges
from fleetlog.roads.formats._odr_links import node_names, touching, turns
from fleetlog.roads.formats._odr_parse import Road, parse_road
from fleetlog.roads.formats._odr_place import earth
from fleetlog.roads.formats._xml import looks_like, parse_xml
from fleetlog.roads.formats.base import HUGE, MapOptions, Reader, RoadMap, Tally, number

if TYPE_CHECKING:
    from lxml.etree import _Element as Element


def sniff(head: bytes) -> bool:
    """An OpenDRIVE root."""
    return looks_like(head, "OpenDRIVE")


def read(path: Path, options: MapOptions) -> RoadMap:
    """Read an OpenDRIVE file; see the module."""
    tally = Tally()
    root = parse_xml(path, "OpenDRIVE", tally.notes)
    version = _version(root)
    roads = _roads(root, tally)
    lanes = _lanes(roads, options, tally)
    if not lanes:
        kinds = ", ".join(f"{n} {why}" for why, n in tally.dropped.items())
        raise SiteError(
            f"no driven lane in {tally.read} lanes" + (f" ({kinds})" if kinds else ""),
            do="name the driven types as lane_types under [network] in a site.toml",
        )
    for found in lanes:
        if float(np.abs(found.points).max()) > HUGE:
            place = f"road {found.key[0]}"
            raise SiteError("its lanes lie beyond the earth", place=place, do="correct the map")
    relation = touching(roads, root.findall("junction"), tally)
    nodes = node_names(lanes, relation)
    edges = [_edge(lane, nodes[lane.enters], nodes[lane.leaves]) for lane in lanes]
    allowed = turns(lanes, relation, tally)
    inverse = earth(root, tally.notes)
    return RoadMap(
        edges, tally.report(f"OpenDRIVE {version} ({len(roads)} roads, counted lane by lane)"),
        geographic_of=inverse, turns=allowed, traffic=_traffic(roads),
        has_elevation=any(len(road.elevation.starts) for road in roads.values()),
    )  # fmt: skip


def _version(root: Element) -> str:
    header = root.find("header")
    if header is None:
        return "without header"
    major, minor = (int(number(header.get(k, "0"), f"header, {k}")) for k in ("revMajor", "revMinor"))
    return f"{major}.{minor}"


def _roads(root: Element, tally: Tally) -> dict[str, Road]:
    roads: dict[str, Road] = {}
    bare = 0
    for element in root.iterfind("road"):
        road = parse_road(element)
        if road is None:
            bare += 1
        elif road.id in roads:
            raise SiteError(f"two roads have the id {road.id!r}", place=f"line {element.sourceline}")
        else:
            roads[road.id] = road
    if bare:
        tally.notes.append(f"{bare} roads have no geometry or no lanes and are left out")
    if root.find(".//include") is not None:
        tally.notes.append("included files are not read")
    return roads


def _lanes(roads: dict[str, Road], options: MapOptions, tally: Tally) -> list[LaneEdge]:
    skipped: dict[str, float] = {}
    default = "LHT" if options.traffic == "left" else "RHT"
    driven = options.lane_types or DRIVEN
    lanes: list[LaneEdge] = []
    for road in roads.values():
        lanes += lane_edges(road, driven, (road.rule or default) == "LHT", tally, skipped)
    if skipped:
        parts = ", ".join(f"{kind} {length:.0f} m" for kind, length in sorted(skipped.items()))
        tally.notes.append(f"length of the lanes that are left out, by type: {parts}")
    against = sum(road.rule not in (None, default) for road in roads.values())
    if options.traffic and against:
        what = f"a rule of their own that differs from traffic = {options.traffic!r}; it holds there"
        tally.notes.append(f"{against} roads have {what}")
    return lanes


def _traffic(roads: dict[str, Road]) -> Literal["right", "left"] | None:
    rules = [road.rule for road in roads.values() if road.rule]
    if not rules:
        return None
    return "left" if 2 * rules.count("LHT") > len(rules) else "right"


def _edge(lane: LaneEdge, start: str, end: str) -> Edge:
    road = ":".join(str(part) for part in lane.key)
    return Edge(lane.id, start, end, lane.points, road, lane.speed_limit, lane.width)


READER = Reader("OpenDRIVE", (".xodr",), sniff, read)

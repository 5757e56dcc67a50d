"""OSM XML: ways with a ``highway`` tag of a driven class, split where they meet; turn restrictions at nodes.

A way ``123`` that meets no other in its middle is the road ``123``, else its parts are ``123:0``, ``123:1``
...  Source of the tags: wiki.openstreetmap.org, Key:highway, Key:oneway, Relation:restriction.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from itertools import groupby, pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fleetlog.core.network import Edge, reversed_edge
from fleetlog.errors import SiteError
from fleetlog.roads.formats import _lanelets
from fleetlog.roads.formats._osm_restrictions import forbidden_turns, tags
from fleetlog.roads.formats._xml import looks_like, parse_xml
from fleetlog.roads.formats.base import MapOptions, Reader, RoadMap, Tally, number, osm_speed

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

DRIVEN = frozenset({
    "motorway", "motorway_link", "trunk", "trunk_link", "primary", "primary_link", "secondary",
    "secondary_link", "tertiary", "tertiary_link", "unclassified", "residential", "living_street", "service",
    "road",
})  # fmt: skip
"""Classes that are driven unless the user says otherwise."""


@dataclass(frozen=True)
class Way:
    """A driven way; ``direction`` 1 one-way as drawn, -1 against it, 0 both."""

    id: str
    nodes: tuple[str, ...]
    direction: int
    speed_limit: float
    width: float


def sniff(head: bytes) -> bool:
    """An OSM root."""
    return looks_like(head, "osm")


def read(path: Path, options: MapOptions) -> RoadMap:
    """Read an OSM extract; see the module."""
    tally = Tally()
    root = parse_xml(path, "osm", tally.notes)
    if _lanelets.holds_lanelets(root):
        return _lanelets.read(path)
    spots = {str(n.get("id")): _spot(n) for n in root.iterfind("node") if _alive(n)}
    ways = _ways(root, options.road_classes or DRIVEN, spots, tally)
    if not ways:
        raise SiteError(
            f"no driven road in {tally.read} ways with a highway tag",
            do="name the driven classes as road_classes under [network] in a site.toml",
        )
    tally.kept = len(ways)
    uses = Counter(node for way in ways for node in way.nodes)
    found = [(way.id, _edges(way, uses, spots)) for way in ways]
    edges = [edge for _, parts in found for edge in parts]
    forbidden = forbidden_turns(root, dict(found), edges, tally)
    return RoadMap(edges, tally.report("OSM XML"), geographic=True, forbidden=forbidden, has_elevation=False)


def _alive(element: Element) -> bool:
    return bool(element.get("visible") != "false" and element.get("action") != "delete")


def _spot(node: Element) -> tuple[float, float]:
    place = f"node {node.get('id')}"
    return number(node.get("lon"), place), number(node.get("lat"), place)


def _ways(
    root: Element, driven: frozenset[str], spots: dict[str, tuple[float, float]], tally: Tally
) -> list[Way]:
    out, cut = [], 0
    for element in root.iterfind("way"):
        tag = tags(element)
        if "highway" not in tag or not _alive(element):
            continue
        tally.read += 1
        nodes = [str(nd.get("ref")) for nd in element.iterfind("nd")]
        known = [n for n in nodes if n in spots]
        cut += len(known) < len(nodes)
        if reason := _reason(tag, driven):
            tally.drop(reason)
        elif len(set(known)) < 2:
            tally.drop("without nodes in the file")
        else:
            chain, limit = tuple(n for n, _ in groupby(known)), osm_speed(tag.get("maxspeed", ""))
            out.append(Way(str(element.get("id")), chain, _direction(tag), limit, _width(tag)))
    if cut:
        what = "ways name nodes that are not in the file; they are drawn through those that are"
        tally.notes.append(f"{cut} {what}")
    return out


def _width(tag: dict[str, str]) -> float:
    width = tag.get("width", "").removesuffix("m").strip()
    return float(width) if width.replace(".", "", 1).isdigit() and float(width) > 0.0 else math.nan


def _reason(tag: dict[str, str], driven: frozenset[str]) -> str:
    """Why a way is left out; empty where it is kept."""
    if tag["highway"] not in driven:
        return f"class {tag['highway']}"
    if tag.get("area") == "yes":
        return "area"
    closed = "no" in (tag.get("access"), tag.get("vehicle"), tag.get("motor_vehicle"))
    return "closed to traffic" if closed else ""


def _direction(tag: dict[str, str]) -> int:
    implied = "yes" if tag.get("junction") == "roundabout" or tag["highway"] == "motorway" else "no"
    return {"yes": 1, "true": 1, "1": 1, "-1": -1, "reverse": -1}.get(tag.get("oneway", implied), 0)


def _edges(way: Way, uses: Counter[str], spots: dict[str, tuple[float, float]]) -> list[Edge]:
    inner = [k for k in range(1, len(way.nodes) - 1) if uses[way.nodes[k]] > 1]
    bounds = [0, *inner, len(way.nodes) - 1]
    out = []
    for k, (a, b) in enumerate(pairwise(bounds)):
        chain = way.nodes[a : b + 1]
        points = np.array([(*spots[n], 0.0) for n in chain])
        name = f"{way.id}:{k}" if inner else way.id
        edge = Edge(name, chain[0], chain[-1], points, name, way.speed_limit, way.width)
        both = [edge, reversed_edge(edge)]
        out += both if way.direction == 0 else both[:1] if way.direction > 0 else both[1:]
    return out


READER = Reader("OSM XML", (".osm",), sniff, read)

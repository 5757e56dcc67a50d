"""OSM XML: ways with a ``highway`` tag of a driven class, split where they meet; turn restrictions at nodes.

A way ``123`` that meets no other in its middle is the road ``123``, else its parts are ``123:0``, ``123:1``
...  Source of the tags: wiki.openstreetmap.org, Key:highway, Key:maxspeed, Key:oneway, Relation:restriction.

Lanelet2 maps are OSM XML whose relations are lanelets, read by that library (the extra ``lanelet2``).  A
lanelet that vehicles may use is an edge along its centre line, one that goes both ways two; lanelets follow
one another where they share the end points of both bounds.  Positions are the latitudes and longitudes of the
file.  Limits are those that the map states; changes between lanes are left out."""

import math
import re
from collections import Counter, defaultdict
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.core.network import Edge, reversed_edge
from fleetlog.errors import SiteError
from fleetlog.registry import extra
from fleetlog.roads.formats._documents import Element, parse_xml
from fleetlog.roads.formats.base import KMH, SPEED_UNITS, WORDS, MapOptions, Reader, RoadMap, Tally, spot

Tags = dict[str, str]
Spots = dict[str, Floats]
Way = tuple[str, list[str], Tags]  # Id, nodes and tags
DRIVEN = frozenset(WORDS["driven"]["osm"].split())  # Classes that are driven unless the user says otherwise
ALIVE = "[not(@visible = 'false' or @action = 'delete')]"  # What an editor has not deleted


def _read(path: Path, options: MapOptions) -> RoadMap:
    tally = Tally()
    root = parse_xml(path, "osm", tally.notes)
    if root.find("relation/tag[@k='type'][@v='lanelet']") is not None:
        return _lanelet_map(path)
    nodes = {str(n.get("id")): n for n in root.xpath(f"node{ALIVE}")}
    spots = {name: spot(n.get("lon"), n.get("lat"), f"node {name}") for name, n in nodes.items()}
    ways = _ways(root, options.road_classes or DRIVEN, spots, tally)
    tally.kept, uses = len(ways), Counter(node for _, chain, _ in ways for node in chain)
    parts = {name: _edges(name, chain, tags, uses, spots) for name, chain, tags in ways}
    tally.edges += [edge for name, _, _ in ways for edge in parts[name]]
    forbidden = _forbidden(root, parts, tally)
    nothing = f"no driven road in it; ways with a highway tag: {tally.read}"
    do = "name the driven classes as road_classes under [network] in a site.toml"
    return tally.road_map("OSM XML", nothing, do, geographic=True, forbidden=forbidden, has_elevation=False)


def _tags(element: Element) -> Tags:
    return {str(t.get("k")): t.get("v") or "" for t in element.iterfind("tag")}


def _ways(root: Element, driven: frozenset[str], spots: Spots, tally: Tally) -> list[Way]:
    """The driven ways."""
    out, cut = [], 0
    for element in root.xpath(f"way{ALIVE}"):
        if "highway" not in (tags := _tags(element)):
            continue
        nodes = [str(nd.get("ref")) for nd in element.iterfind("nd")]
        chain = [n for n, _ in groupby(n for n in nodes if n in spots)]
        cut += not spots.keys() >= set(nodes)
        if reason := _reason(tags, driven) or ("" if len(set(chain)) > 1 else "without nodes in the file"):
            tally.dropped[reason] += 1
        else:
            out.append((str(element.get("id")), chain, tags))
    tally.note(cut, "way", "over nodes that are not in the file, drawn through those that are")
    return out


def _reason(tags: Tags, driven: frozenset[str]) -> str:
    """Why a way is left out; empty where it is kept."""
    if tags["highway"] not in driven:
        return f"class {tags['highway']}"
    if tags.get("area") == "yes":
        return "area"
    return "closed to traffic" if "no" in map(tags.get, ("access", "vehicle", "motor_vehicle")) else ""


def _edges(way: str, chain: list[str], tags: Tags, uses: Counter[str], spots: Spots) -> list[Edge]:
    """The parts of a way between the nodes that it shares, in the directions in which they are driven."""
    implied = "yes" if tags.get("junction") == "roundabout" or tags["highway"] == "motorway" else "no"
    oneway = tags.get("oneway", implied)
    limit, width = osm_speed(tags.get("maxspeed", "")), osm_width(tags.get("width", ""))
    inner, out = [k for k in range(1, len(chain) - 1) if uses[chain[k]] > 1], []
    for k, (a, b) in enumerate(pairwise([0, *inner, len(chain) - 1])):
        points = np.array([spots[n] for n in chain[a : b + 1]])
        name = f"{way}:{k}" if inner else way
        edge = Edge(name, chain[a], chain[b], points, name, limit, width)
        out += [] if oneway in ("-1", "reverse") else [edge]
        out += [] if oneway in ("yes", "true", "1") else [reversed_edge(edge)]
    return out


def _forbidden(root: Element, parts: dict[str, list[Edge]], tally: Tally) -> frozenset[tuple[str, str]]:
    """(edge id, next edge id) that ``no_*`` relations at nodes forbid or ``only_*`` ones do not allow."""
    leaving: dict[str, set[str]] = defaultdict(set)
    for edge in tally.edges:
        leaving[edge.start].add(edge.id)
    out: set[tuple[str, str]] = set()
    unread = 0
    for relation in root.iterfind("relation"):
        rule = _tags(relation).get("restriction", "")
        if _tags(relation).get("type") != "restriction" or not rule.startswith(("no_", "only_")):
            continue
        refs = {(m.get("role"), m.get("type")): m.get("ref") for m in relation.iterfind("member")}
        node = refs.get(("via", "node"))
        unread += node is None
        incoming = [e.id for e in parts.get(refs.get(("from", "way"), ""), ()) if e.end == node]
        onward = {e.id for e in parts.get(refs.get(("to", "way"), ""), ()) if e.start == node}
        if rule.startswith("only_"):
            # Without the way that it leads to (beyond the extract) the rule would close the road.
            onward = leaving[str(node)] - onward if onward else set()
        out |= {(a, b) for a in incoming for b in onward}
    tally.note(unread, "turn restriction", "over ways not read")
    return frozenset(out)


def osm_width(text: str) -> float:
    """Width [m] of an OSM ``width`` text, NaN where unknown or no road's."""
    found = re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*m?\s*", text)
    return float(found[1]) if found and 0.0 < float(found[1]) < 100.0 else math.nan


def osm_speed(text: str) -> float:
    """Lowest limit [m/s] of an OSM ``maxspeed`` text, NaN where unknown; plain numbers are km/h."""
    form = r"\s*(\d+(?:\.\d+)?)\s*(km/h|kmh|kph|mph|knots)?\s*"
    values = [re.fullmatch(form, part.strip(" '\"[]")) for part in re.split(r"[;,|]", text)]
    speeds = [float(m[1]) * SPEED_UNITS[m[2] or "km/h"] for m in values if m]
    return min((s for s in speeds if s > 0.0), default=math.nan)


def _lanelet_map(path: Path) -> RoadMap:
    """The lanelets of a map."""
    extra("lanelet2", "lanelet2", "reading Lanelet2 maps needs lanelet2", error=SiteError)
    from lanelet2 import io, projection, traffic_rules

    # Any origin does: what is projected here is taken back to degrees.
    projector = projection.MercatorProjector(io.Origin(0.0, 0.0))
    try:
        found, errors = io.loadRobust(str(path), projector)
    except (RuntimeError, ValueError) as error:
        why = " ".join(str(error).split())[:120]
        raise SiteError(f"cannot be read as a Lanelet2 map ({why})", do="correct the file") from None
    tally = Tally(notes=[" ".join(str(e).split())[:160] for e in list(errors)[:5]])
    rules = traffic_rules.create(traffic_rules.Locations.Germany, traffic_rules.Participants.Vehicle)
    for lanelet in sorted(found.laneletLayer, key=lambda lanelet: lanelet.id):
        if len(lanelet.centerline) < 2 or not rules.canPass(lanelet):
            tally.dropped["not for vehicles" if len(lanelet.centerline) > 1 else "without length"] += 1
            continue
        edge = _lanelet(lanelet, projector, rules)
        tally.keep(edge, *([] if rules.isOneWay(lanelet) else [reversed_edge(edge)]))
    nothing, do = f"no lanelet that vehicles may use ({tally.read} read)", "tag them for vehicles"
    return tally.road_map("Lanelet2", nothing, do, geographic=True)


def _lanelet(lanelet: Any, projector: Any, rules: Any) -> Edge:
    """A lanelet along its centre line; its nodes are the points at which both bounds begin and end."""
    from lanelet2.core import BasicPoint3d, SpeedLimit

    back = [projector.reverse(BasicPoint3d(p.x, p.y, p.z)) for p in lanelet.centerline]
    line = np.array([(g.lon, g.lat, g.alt) for g in back]).reshape(-1, 3)
    if not np.isfinite(line).all():
        raise SiteError("a position is not a number", place=f"lanelet {lanelet.id}", do="correct the map")
    stated = "speed_limit" in lanelet.attributes  # The defaults of a country are not the plant's.
    stated = stated or any(isinstance(r, SpeedLimit) for r in lanelet.regulatoryElements)
    limit = float(rules.speedLimit(lanelet).speedLimit) * KMH if stated else math.nan
    left, right, name = lanelet.leftBound, lanelet.rightBound, str(lanelet.id)
    start, end = (f"{left[k].id}-{right[m].id}" for k, m in ((0, 0), (len(left) - 1, len(right) - 1)))
    return Edge(name, start, end, line, name, limit)


READER = Reader("OSM XML", (".osm",), "<osm", _read)

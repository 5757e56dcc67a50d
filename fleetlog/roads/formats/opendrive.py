"""OpenDRIVE 1.4 to 1.8 (.xodr): every driven lane of every lane section is an edge ``road:section:lane``.

Read: plan view (line, arc, spiral, poly3, paramPoly3), elevation, superelevation, lane offset, widths and
borders, lane links, junctions (direct ones too), rule (RHT, LHT), lane directions, speeds, geoReference with
its header's offset.  Left out: virtual junctions, road shape, surface, objects, signals, rails, includes."""

import math
import re
from collections import defaultdict
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.core.network import Edge, reverse_id
from fleetlog.core.site import Inverse, MapFrame, geographic
from fleetlog.core.words import count
from fleetlog.errors import SiteError
from fleetlog.roads.formats._documents import Element, parse_xml
from fleetlog.roads.formats._odr_geometry import sample
from fleetlog.roads.formats._odr_parse import ENDS, MICRO, Lane, LaneEnd, Road, Section, connect, parse_road
from fleetlog.roads.formats.base import HUGE, WORDS, MapOptions, Reader, RoadMap, Tally, at, number

DRIVEN = frozenset(WORDS["driven"]["opendrive"].split())  # Lane types driven unless the user says otherwise
CHORD = 0.005  # largest distance [m] of a lane's centre line from its polyline
THIN = 0.05  # a lane that is nowhere wider than this [m] is not there
BEFORE_END = 1e-7  # a section is read this far before its end, where records of the next one start [m]


def _read(path: Path, options: MapOptions) -> RoadMap:
    tally = Tally()
    root = parse_xml(path, "OpenDRIVE", tally.notes)
    header = root.find("header")
    parts = [] if header is None else [header.get(k, "0") for k in ("revMajor", "revMinor")]
    version = ".".join(f"{number(part, 'header'):.0f}" for part in parts) or "without header"
    roads, elements = dict[str, Road](), root.findall("road")
    for element in elements:
        with at(f"road {element.get('id')}"):
            road = parse_road(element)
        if road and roads.setdefault(road.id, road) is not road:
            raise SiteError(f"two roads have the id {road.id!r}", place=f"line {element.sourceline}")
    tally.note(len(elements) - len(roads), "road", "left out, without geometry or lanes")
    if root.find(".//include") is not None:
        tally.notes.append("included files are not read")
    _add_lanes(roads, options, tally)
    rules = [road.rule for road in roads.values() if road.rule]
    nothing = f"no driven lane in it; lanes read: {tally.read}"
    do = "name the driven types as lane_types under [network] in a site.toml"
    return tally.road_map(
        f"OpenDRIVE {version} ({count(len(roads), 'road')}, counted lane by lane)", nothing, do,
        traffic=("left" if 2 * rules.count("LHT") > len(rules) else "right") if rules else None,
        turns=connect(roads, root.findall("junction"), tally), geographic_of=_earth(root, tally.notes),
        has_elevation=any(len(road.elevation.starts) for road in roads.values()),
    )  # fmt: skip


def _add_lanes(roads: dict[str, Road], options: MapOptions, tally: Tally) -> None:
    skipped: dict[str, float] = defaultdict(float)
    default = "LHT" if options.traffic == "left" else "RHT"
    driven = options.lane_types or DRIVEN
    for road in roads.values():
        left = (road.rule or default) == "LHT"
        for k, section in enumerate(road.sections):
            length = section.end - section.start
            some = np.linspace(section.start, section.end - BEFORE_END, 9)
            for lane in (section.lanes[i] for i in section.lanes if i != 0):
                widths = np.abs(np.diff(_sides(road, section, lane, some), axis=0))
                if lane.type not in driven:
                    tally.dropped[f"lane type {lane.type}"] += 1
                    skipped[lane.type] += length
                elif length < MICRO:
                    tally.dropped["shorter than 1 mm"] += 1
                elif widths.max() < THIN:
                    tally.dropped["without width"] += 1
                else:
                    tally.kept += 1
                    for edge in _directed(road, k, lane, left, float(widths.mean())):
                        tally.add(edge)
    if skipped:
        parts = ", ".join(f"{kind} {length:.0f} m" for kind, length in sorted(skipped.items()))
        tally.notes.append(f"length of the lanes that are left out, by type: {parts}")
    if options.traffic:
        against = sum(road.rule not in (None, default) for road in roads.values())
        tally.note(against, "road", f"of another rule than traffic = {options.traffic!r}, which holds there")


def _directed(road: Road, k: int, lane: Lane, left: bool, width: float) -> Iterator[Edge]:
    section = road.sections[k]
    points, name = _centre_line(road, section, lane), f"{road.id}:{k}:{lane.id}"
    if not (np.abs(points) <= HUGE).all():
        raise SiteError("its lanes lie beyond the earth", place=f"road {road.id}", do="correct the map")
    # The limit on the greatest part of the section, the lane's or else the road's.
    limit, longest = math.nan, 0.0
    for (s, speed), (until, _) in pairwise([*sorted(lane.speeds or road.speeds), (math.inf, math.nan)]):
        if (part := min(until, section.end) - max(s, section.start)) > longest + 1e-9:
            limit, longest = speed, part
    low, high = (str(LaneEnd(road.id, k, lane.id, end)) for end in ENDS)
    for edge_id, forward in zip((name, reverse_id(name)), _directions(lane, left), strict=False):
        start, end, line = (low, high, points) if forward else (high, low, points[::-1].copy())
        yield Edge(edge_id, start, end, line, name, limit, width)


def _directions(lane: Lane, left: bool) -> tuple[bool, ...]:
    """Whether the lane is driven along s (True) or against it; two-way lanes both, the usual way first."""
    usual = (lane.id < 0) != left
    if lane.direction in ("+s", "-s"):
        return (lane.direction == "+s",)
    if lane.direction == "both" or lane.type == "bidirectional":
        return (usual, not usual)
    return (not usual,) if lane.direction == "reversed" else (usual,)


def _inward(section: Section, lane: Lane) -> list[Lane]:
    """The lanes from the centre to this one, itself included."""
    side = 1 if lane.id > 0 else -1
    return [section.lanes[i] for i in range(side, lane.id + side, side)]


def _centre_line(road: Road, section: Section, lane: Lane) -> Floats:
    """(n, 3) centre of a lane [m] along s; chords within 5 mm of it."""

    def at(s: Floats) -> Floats:
        s = np.minimum(s, section.end - BEFORE_END)
        x, y, heading = road.plan.at(s)
        t = np.mean(_sides(road, section, lane, s), axis=0)
        roll = road.superelevation.at(s)
        flat, z = t * np.cos(roll), road.elevation.at(s) + t * np.sin(roll)
        return np.column_stack([x - flat * np.sin(heading), y + flat * np.cos(heading), z])

    # Stations at the ends of the section, at every record that starts inside it, and at most 25 m apart.
    cubics = [road.elevation, road.superelevation, road.offset]
    cubics += [table for inward in _inward(section, lane) for table in (inward.widths, inward.borders)]
    marks = np.concatenate([road.plan.starts, *(table.starts for table in cubics)])
    inner = marks[(marks > section.start + 1e-6) & (marks < section.end - 1e-6)]
    pieces = max(1, math.ceil((section.end - section.start) / 25.0))
    s = np.unique([*inner, *np.linspace(section.start, section.end, 1 + pieces)])
    # the last one is the end of the section, and stays
    return at(sample(at, s[np.append(np.diff(s[:-1], prepend=-np.inf) > 1e-6, True)], CHORD))


def _sides(road: Road, section: Section, lane: Lane, s: Floats) -> tuple[Floats, Floats]:
    """(N,) lateral places t [m] of the inner and outer border of a lane, left positive."""
    inner = outer = offset = road.offset.at(s)
    for inward in _inward(section, lane):
        inner = outer
        if len(inward.widths.starts) or not len(inward.borders.starts):
            outer = inner + np.sign(lane.id) * np.maximum(inward.widths.at(s), 0.0)
        else:
            outer = offset + inward.borders.at(s)
    return inner, outer


def _earth(root: Element, notes: list[str]) -> Inverse | None:
    """Where on earth a map lies; None, and why among the notes, where the file does not say."""
    text = " ".join((root.findtext("header/geoReference") or "").split())
    if "+proj" not in text and "+lat_0" in text and "+lon_0" in text:
        how = "read as transverse Mercator about its lat_0 and lon_0"
        notes.append(f"the geoReference names no projection; it is {how}")
        text = f"+proj=tmerc {text}"
    # Vertical grids are not part of an installation and do not move anything in the plane.
    plain = re.sub(r"\+(geoidgrids|vunits)=\S+", "", text) if text.startswith("+") else text
    offset = [(k, root.xpath(f"string(header/offset/@{k})") or 0.0) for k in ("x", "y", "hdg")]
    east, north, heading = (number(value, f"header offset, {k}") for k, value in offset)
    shifted = MapFrame("header", (east, north), heading)  # Map coordinates as the projection takes them

    def inverse(x: Floats, y: Floats) -> tuple[Floats, Floats]:
        return geographic(plain, *shifted.to_site(x, y))

    if not (why := _no_place(plain)) and not np.isfinite(inverse(np.zeros(1), np.zeros(1))).all():
        why = "the geoReference does not reach the map's coordinates"
    if why:
        notes.append(f"{why}, so the map has no place on earth; state [frame] in a site.toml to give it one")
    return None if why else inverse


def _no_place(text: str) -> str:
    """Why PROJ makes no projection to metres of a geoReference; empty where it does."""
    from pyproj import CRS
    from pyproj.exceptions import ProjError

    if not text:
        return "there is no geoReference"
    zone, longitude = re.search(r"\+zone=(\d+)", text), re.search(r"\+lon_0=(-?[\d.]+)", text)
    if "+proj=utm" in text and zone and longitude and abs(6 * int(zone[1]) - 183 - float(longitude[1])) > 6.0:
        return f"the geoReference contradicts itself (UTM zone {zone[1]} and lon_0 {longitude[1]})"
    try:
        crs = CRS.from_user_input(text)
        geographic(text, [], [])
    except ProjError as error:
        return f"the geoReference is not understood ({str(error).splitlines()[0]})"
    return "" if crs.is_projected else "the geoReference is no projection to metres"


READER = Reader("OpenDRIVE", (".xodr",), "<OpenDRIVE", _read)

"""OpenDRIVE 1.4 to 1.8 (.xodr): every driven lane of every lane section is an edge ``road:section:lane``.

Read: plan view (line, arc, spiral, poly3, paramPoly3), elevation, superelevation, lane offset, widths and
borders, lane links, junctions (direct ones too), rule (RHT, LHT), lane directions, speeds, geoReference with
the offset of the header.  Left out: virtual junctions, road shape and surface, objects, signals, railroads,
included files.
"""

import math
import re
from collections import defaultdict
from pathlib import Path

import numpy as np

from fleetlog.core.frames import geographic
from fleetlog.core.network import Floats
from fleetlog.errors import SiteError
from fleetlog.roads.formats._documents import Element, parse_xml
from fleetlog.roads.formats._odr_lanes import DRIVEN, lane_edges
from fleetlog.roads.formats._odr_links import connect
from fleetlog.roads.formats._odr_parse import Road, parse_road
from fleetlog.roads.formats.base import HUGE, Inverse, MapOptions, Reader, RoadMap, Tally, at, number


def read(path: Path, options: MapOptions) -> RoadMap:
    """Read an OpenDRIVE file; see the module."""
    tally = Tally()
    root = parse_xml(path, "OpenDRIVE", tally.notes)
    header = root.find("header")
    parts = [] if header is None else [header.get(k, "0") for k in ("revMajor", "revMinor")]
    version = ".".join(f"{number(part, 'header'):.0f}" for part in parts) or "without header"
    roads = _roads(root, tally.notes)
    _add_lanes(roads, options, tally)
    allowed = connect(roads, root.findall("junction"), tally)
    rules = [road.rule for road in roads.values() if road.rule]
    kinds = ", ".join(f"{n} {why}" for why, n in tally.dropped.items())
    nothing = f"no driven lane in {tally.read} lanes" + (f" ({kinds})" if kinds else "")
    do = "name the driven types as lane_types under [network] in a site.toml"
    return tally.road_map(
        f"OpenDRIVE {version} ({len(roads)} roads, counted lane by lane)", nothing, do, turns=allowed,
        traffic=("left" if 2 * rules.count("LHT") > len(rules) else "right") if rules else None,
        geographic_of=_earth(root, tally.notes),
        has_elevation=any(len(road.elevation.starts) for road in roads.values()),
    )  # fmt: skip


def _roads(root: Element, notes: list[str]) -> dict[str, Road]:
    roads: dict[str, Road] = {}
    bare = 0
    for element in root.iterfind("road"):
        with at(f"road {element.get('id')}"):
            road = parse_road(element)
        if road is None:
            bare += 1
        elif road.id in roads:
            raise SiteError(f"two roads have the id {road.id!r}", place=f"line {element.sourceline}")
        else:
            roads[road.id] = road
    if bare:
        notes.append(f"{bare} roads have no geometry or no lanes and are left out")
    if root.find(".//include") is not None:
        notes.append("included files are not read")
    return roads


def _add_lanes(roads: dict[str, Road], options: MapOptions, tally: Tally) -> None:
    skipped: dict[str, float] = defaultdict(float)
    default = "LHT" if options.traffic == "left" else "RHT"
    driven = options.lane_types or DRIVEN
    for road in roads.values():
        edges = [*lane_edges(road, driven, (road.rule or default) == "LHT", tally, skipped)]
        if not all((np.abs(edge.points) <= HUGE).all() for edge in edges):
            place = f"road {road.id}"
            raise SiteError("its lanes lie beyond the earth", place=place, do="correct the map")
        tally.edges += edges
    if skipped:
        parts = ", ".join(f"{kind} {length:.0f} m" for kind, length in sorted(skipped.items()))
        tally.notes.append(f"length of the lanes that are left out, by type: {parts}")
    against = sum(road.rule not in (None, default) for road in roads.values())
    if options.traffic and against:
        what = f"a rule of their own that differs from traffic = {options.traffic!r}; it holds there"
        tally.notes.append(f"{against} roads have {what}")


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
    by = [number(value, f"header offset, {k}") for k, value in offset]

    def inverse(x: Floats, y: Floats) -> tuple[Floats, Floats]:
        return geographic(plain, *moved(x, y, *by))

    why = _no_place(plain)
    if not why and not np.isfinite(inverse(np.zeros(1), np.zeros(1))).all():
        why = "the geoReference does not reach the map's coordinates"
    if why:
        notes.append(f"{why}, so the map has no place on earth; state [frame] in a site.toml to give it one")
    return None if why else inverse


def moved(x: Floats, y: Floats, east: float, north: float, heading: float) -> tuple[Floats, Floats]:
    """Map coordinates [m] with the header's offset [m], [rad], as the projection takes them:
    X = x cos h - y sin h + x_off, Y = x sin h + y cos h + y_off."""
    c, s = math.cos(heading), math.sin(heading)
    return x * c - y * s + east, x * s + y * c + north


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


READER = Reader("OpenDRIVE", (".xodr",), "<OpenDRIVE", read)

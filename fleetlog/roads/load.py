"""Sites: a site file with its map, or a map alone, brought into the frame of the site."""

import math
import re
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core import schema
from fleetlog.core.arrays import Floats
from fleetlog.core.files import read_head
from fleetlog.core.network import LoadReport, Network, build_network, distance_to_segment
from fleetlog.core.site import Building, Frame, Place, Site, Zone, crs, frame_at, geographic, map_frames
from fleetlog.errors import REPORT, SiteError, fault
from fleetlog.registry import parts
from fleetlog.roads.formats.base import MOST_VERTICES, MapOptions, Reader, RoadMap, at
from fleetlog.store.documents import digest as sha256

HEAD = 4096  # bytes that a format is recognised by
MOST_EDGES, LONGEST = 2_000_000, 200_000.0  # a site has no more edges, and none that is longer [m]
OFF_ROADS = 10.0  # a place farther than this [m] from every road gets a warning
SAME = 0.01  # local metres of a map stay untouched where its frame reproduces them within this [m]
FAR = 50_000.0  # roads farther than this [m] from the frame's origin are in another frame than the site says
metres = schema.real(-schema.FARTHEST, schema.FARTHEST)


def _polygon(value: Any) -> Floats:
    """At least three corners [x, y] in metres; a repeated last corner is left out."""
    if not isinstance(value, list) or not all(isinstance(p, list) and len(p) == 2 for p in value):
        raise schema.Wrong("is not a list of corners [x, y]")
    points = np.array([[metres(v) for v in p] for p in value], dtype=np.float64).reshape(-1, 2)
    if len(points) > 1 and bool((points[0] == points[-1]).all()):
        points = points[:-1]
    if len(points) < 3:
        raise schema.Wrong("has fewer than three corners")
    return points


def _clock(value: Any) -> float:
    """A time of day such as "09:30" [s]."""
    if not (found := re.fullmatch(r"([01]?\d|2[0-3]):([0-5]\d)", schema.text(value))):
        raise schema.Wrong('is no time of day such as "09:30"')
    return 3600.0 * int(found[1]) + 60.0 * int(found[2])


TABLES = ("frame", "network", "place", "zone", "building", "map_frame", "break", "power")
TOP: schema.Keys = {"name": schema.text, **dict.fromkeys(TABLES, schema.anything)}
ORIGIN: schema.Keys = {"latitude": schema.real(-90, 90), "longitude": schema.real(-180, 180)}
PROJECTED: schema.Keys = {"crs": crs, "easting": metres, "northing": metres}
AXES: schema.Keys = {"rotation": schema.real(-2 * math.pi, 2 * math.pi), "timezone": schema.time_zone}
NETWORK: schema.Keys = {
    "file": schema.text, "traffic": schema.one_of("right", "left"),
    "lane_types": schema.list_of(schema.text, 1), "road_classes": schema.list_of(schema.text, 1),
}  # fmt: skip
POWER: schema.Keys = {"limit": schema.real(1.0, 1e9, "W")}
PLACE: schema.Keys = {
    "id": schema.text, "kind": schema.one_of("pick", "drop", "park", "charge"), "x": metres, "y": metres,
    "plugs": schema.whole(), "power": schema.real(0.0, 1e9), "swap": schema.real(30.0, 86400.0, "s"),
}  # fmt: skip
ZONE: schema.Keys = {
    "id": schema.text, "polygon": _polygon, "speed_limit": schema.real(1e-3, 100.0), "covered": schema.flag,
    "closed_every": schema.real(1.0, 1e6, "s"), "closed_for": schema.real(1.0, 1e4, "s"),
}  # fmt: skip
BUILDING: schema.Keys = {"id": schema.text, "polygon": _polygon, "height": schema.real(0.0, 1000.0)}
BREAK: schema.Keys = {"id": schema.text, "from": _clock, "until": _clock}
LISTS: dict[str, tuple[schema.Keys, tuple[str, ...]]] = {
    "place": (PLACE, ("id", "kind", "x", "y")), "zone": (ZONE, ("polygon",)),
    "building": (BUILDING, ("polygon",)), "break": (BREAK, ("from", "until")),
}  # fmt: skip
"""Keys of the tables of the lists [[name]], and those that must be there."""


def load_site(path: str | Path) -> tuple[Site, list[LoadReport]]:
    """The site of a file (TOML, or its folder) with the map that it names, or of a map of any format.

    With it comes a report for every map that was read.  A map in degrees without a site file gets a frame
    about its centre, rotation 0.  Local metres stay as they are, with the frame of the map's geoReference;
    without one the site has no frame.  :class:`SiteError` says where, what is wrong and what to do."""
    path = Path(path)
    if path.is_dir():
        path = path / "site.toml"
    if not path.exists():
        raise SiteError("no such file", where=path, do="give a site file (.toml) or a map")
    try:
        with at(where=path):
            if path.suffix.lower() != ".toml":
                return _with_map(Site(path.stem), path, MapOptions())
            return _load_toml(path)
    except OSError as error:
        raise SiteError(f"not readable: {error.strerror}", where=path) from None
    except SiteError:
        raise
    except Exception as error:
        raise SiteError(fault("the reader of maps", error), where=path, do=REPORT) from error


def readers() -> dict[str, Reader]:
    """Every map format by name."""
    return parts("fleetlog.roads.formats", "READER")


def read_map(path: Path, options: MapOptions | None = None) -> RoadMap:
    """The roads of a map file, gzipped or not, in its coordinates; content, else suffix, tells the format."""
    if not (head := read_head(path, HEAD, SiteError)).strip():
        raise SiteError("the file is empty", where=path, do="give a map")
    suffix, known = Path(path.name.lower().removesuffix(".gz")).suffix, readers().values()
    if not (found := [r for r in known if r.knows(head)] or [r for r in known if suffix in r.suffixes]):
        suffixes = ", ".join(sorted({s for r in known for s in r.suffixes}))
        raise SiteError("not a map of a known format", where=path, do=f"known are {suffixes}")
    with at(where=path):
        # Two formats can share an opening; the suffix then decides.
        return next((r for r in found if suffix in r.suffixes), found[0]).read(path, options or MapOptions())


def _load_toml(path: Path) -> tuple[Site, list[LoadReport]]:
    data = schema.table(schema.load_toml(path, SiteError), TOP, path, "", error=SiteError)
    power = schema.table(data.get("power", {}), POWER, path, "power", error=SiteError)
    site = Site(
        data.get("name", path.parent.resolve().name), _frame(data, path),
        places=tuple(Place(**row) for row in _rows(data, "place", path)),
        zones=tuple(Zone(**row) for row in _rows(data, "zone", path)),
        buildings=tuple(Building(**row) for row in _rows(data, "building", path)),
        breaks=tuple((row["from"], row["until"]) for row in _rows(data, "break", path)),
        power_limit=power.get("limit", math.inf), map_frames=map_frames(data, path, SiteError),
        source={"site": {"file": path.name, "sha256": sha256(path)}},
    )  # fmt: skip
    if "network" not in data:
        return site, []
    given = schema.table(data["network"], NETWORK, path, "network", ("file",), SiteError)
    # A map is named by an absolute name, or one that stays in the site's folder.
    name, file, place = given["file"], path.parent / given["file"], "network.file"
    if not Path(name).is_absolute() and not file.resolve().is_relative_to(path.parent.resolve()):
        what, do = f"{name!r} leads out of the site's folder", "put the map there or write its absolute path"
        raise SiteError(what, where=path, place=place, do=do)
    if not file.is_file():
        raise SiteError(f"no such file {name!r}", where=path, place=place, do="correct the name")
    lanes, classes = (frozenset(given[k]) if k in given else None for k in ("lane_types", "road_classes"))
    return _with_map(site, file, MapOptions(given.get("traffic"), lanes, classes, site.map_frames))


def _with_map(site: Site, file: Path, options: MapOptions) -> tuple[Site, list[LoadReport]]:
    road_map, frame, notes = place_map(read_map(file, options), site.frame)
    with at(where=file):
        edges, vertices = road_map.edges, sum(len(e.points) for e in road_map.edges)
        if len(edges) > MOST_EDGES or vertices > MOST_VERTICES:
            what = f"holds {len(edges):,} edges of {vertices:,} vertices"
            raise SiteError(what, do="cut the map to the site")
        network = build_network(edges, road_map.turns, road_map.forbidden, road_map.has_elevation)
        longest = int(np.argmax(network.length))
        if not network.length[longest] <= LONGEST:
            what = f"edge {network.edge_ids[longest]!r} is {network.length[longest] / 1000.0:,.0f} km long"
            raise SiteError(what, do="cut the map to the site or correct its coordinates")
    known = {p.id for p in site.places}
    places = site.places + tuple(p for p in road_map.places if p.id not in known)
    traffic = options.traffic or road_map.traffic or "right"
    about = {"file": file.name, "path": str(file.resolve()), "sha256": sha256(file)}
    source = {**site.source, "network": about}
    site = replace(site, frame=frame, network=network, traffic=traffic, places=places, source=source)
    gaps = distance_to_roads(network, np.array([[p.x, p.y] for p in places]).reshape(-1, 2))
    far = ((p.id, gap) for p, gap in zip(places, gaps, strict=True) if gap > OFF_ROADS)
    strays = [f"place {name!r} is {gap:.0f} m from the nearest road" for name, gap in far]
    return site, [replace(road_map.report, notes=(*road_map.report.notes, *notes, *strays))]


def _rows(data: dict[str, Any], name: str, where: Path) -> list[dict[str, Any]]:
    """The checked tables of a list [[name]]; ids are made where none are given and may not occur twice."""
    keys, required = LISTS[name]
    out: dict[str, dict[str, Any]] = {}
    for n, given in enumerate(schema.rows(data, name, keys, where, required, SiteError)):
        row = {"id": f"{name}-{n + 1}", **given}
        if row["id"] in out:
            what = f"the id {row['id']!r} occurs twice"
            raise SiteError(what, where=where, place=f"{name}[{n}]", do="rename one")
        idle = {
            "swap": row.get("kind") != "charge", "power": row.get("kind") != "charge" or "swap" in row,
            "closed_for": "closed_every" not in row, "until": row.get("until") == row.get("from"),
        }  # fmt: skip
        if key := next((k for k in idle if k in row and idle[k]), None):
            do = "leave it out, or see docs/maps.md for what it goes with"
            raise SiteError("has no effect here", where=where, place=f"{name}[{n}].{key}", do=do)
        out[row["id"]] = row
    return list(out.values())


def _frame(data: dict[str, Any], where: Path) -> Frame | None:
    """The [frame] table, if there is one."""
    if "frame" not in data:
        return None
    given = data["frame"]
    if not isinstance(given, dict) or "crs" not in given:
        return Frame(**schema.table(given, {**ORIGIN, **AXES}, where, "frame", tuple(ORIGIN), SiteError))
    values = schema.table(given, {**PROJECTED, **AXES}, where, "frame", tuple(PROJECTED), SiteError)
    found = frame_at(partial(geographic, values["crs"]), values["easting"], values["northing"])
    if not math.isfinite(found.latitude + found.longitude):
        raise SiteError("the origin lies outside the reference system", where=where, place="frame",
                        do="correct easting and northing")  # fmt: skip
    return replace(found, **{k: values[k] for k in AXES if k in values})


def place_map(road_map: RoadMap, frame: Frame | None) -> tuple[RoadMap, Frame | None, list[str]]:
    """The map in the site frame (None: the map's, or one about its centre), that frame, and notes."""
    earth, stops = road_map.geographic_of, np.array([[p.x, p.y] for p in road_map.places]).reshape(-1, 2)
    points = np.concatenate([*(e.points[:, :2] for e in road_map.edges), stops])
    if road_map.geographic:
        (west, south), (east, north) = points.min(axis=0), points.max(axis=0)
        if frame is None and (north - south > 5.0 or east - west > 10.0):
            do = "cut the map to the site or correct its coordinates"
            raise SiteError("the roads span more than a region", do=do)
        frame = frame or Frame(round(float(south + north) / 2.0, 9), round(float(west + east) / 2.0, 9))
        return _moved(road_map, *frame.to_local(points[:, 1], points[:, 0])), frame, []
    if earth is None:
        note = ["the map's coordinates are taken as the local metres of the site's frame"] if frame else []
        return road_map, frame, note
    latitude, longitude = earth(*points.T)
    if not (np.isfinite(latitude).all() and np.isfinite(longitude).all()):
        do = "correct the geoReference or the header's offset"
        raise SiteError("its projection does not reach its coordinates", do=do)
    if frame is None:
        # The map's axes, about its (0, 0) where that is near the roads, else about their centre.
        low, high = points.min(axis=0), points.max(axis=0)
        near = bool((np.maximum(np.abs(low), np.abs(high)) < FAR / 5).all())
        east, north = np.zeros(2) if near else (low + high) / 2.0
        frame = frame_at(earth, float(east), float(north), max(1.0, float((high - low).max()) / 2.0))
        frame = frame if abs(frame.rotation) > 1e-9 else replace(frame, rotation=0.0)
    x, y = frame.to_local(latitude, longitude)
    if (moved := float(np.hypot(x - points[:, 0], y - points[:, 1]).max())) <= SAME:
        return road_map, frame, []
    how = "coordinates are brought from the map's projection into the site frame"
    return _moved(road_map, x, y), frame, [f"{how}; the largest change is {moved:.2f} m"]


def _moved(road_map: RoadMap, x: Floats, y: Floats) -> RoadMap:
    """The map with the coordinates of its vertices, edge after edge, and of its places exchanged."""
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        what = "its coordinates cannot be brought into the site frame"
        raise SiteError(what, do="check the frame and the map")
    if (away := float(np.hypot(x, y).min())) > FAR:
        what = f"the roads are {away / 1000.0:.0f} km from the site's frame"
        raise SiteError(what, do="correct [frame] or give another map")
    *lines, stops = np.split(np.column_stack([x, y]), np.cumsum([len(e.points) for e in road_map.edges]))
    moved = zip(road_map.edges, lines, strict=True)
    edges = [replace(e, points=np.column_stack([line, e.points[:, 2]])) for e, line in moved]
    spots = zip(road_map.places, stops.tolist(), strict=True)
    return replace(road_map, edges=edges, places=tuple(replace(p, x=a, y=b) for p, (a, b) in spots))


def distance_to_roads(network: Network, spots: Floats) -> Floats:
    """(N,) horizontal distance [m] of spots (N, 2) from the nearest road."""
    inner = np.ones(len(network.points), dtype=bool)
    inner[network.first[1:] - 1] = False
    a, b = network.points[inner, :2], network.points[np.flatnonzero(inner) + 1, :2]
    return np.array([distance_to_segment(spot, a, b).min() for spot in spots])

"""A site: its frame on the earth, roads, places, zones and buildings; and the frames that files state."""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Literal
from zoneinfo import ZoneInfo

import numpy as np
from numpy.typing import ArrayLike

from fleetlog.core.arrays import Floats, Mask
from fleetlog.core.network import Edge, Network, build_network
from fleetlog.core.schema import FARTHEST, Errors, Keys, Wrong, list_of, real, rows, text
from fleetlog.errors import InputError, SiteError

PlaceKind = Literal["pick", "drop", "park", "charge"]
Inverse = Callable[[Floats, Floats], tuple[Floats, Floats]]  # x, y [m] of a map to latitude, longitude [deg]


@dataclass(frozen=True)
class Frame:
    """Right-handed local metres, x east, y north, z up, about an origin on the WGS 84 ellipsoid. Azimuthal
    equidistant about (``latitude``, ``longitude``) [degrees]; ``rotation`` [rad] turns the local x axis
    counter-clockwise from east. ``timezone`` (IANA name) is of the hours in reports; data stay UTC."""

    latitude: float
    longitude: float
    rotation: float = 0.0
    timezone: str = "UTC"

    @cached_property
    def _projection(self) -> Any:
        from pyproj import Transformer

        origin = f"+lat_0={self.latitude!r} +lon_0={self.longitude!r}"
        local = f"+proj=aeqd {origin} +ellps=WGS84 +units=m +no_defs"
        return Transformer.from_crs("EPSG:4326", local, always_xy=True)

    def to_local(self, latitude: ArrayLike, longitude: ArrayLike) -> tuple[Floats, Floats]:
        """x, y [m] of geographic coordinates [degrees]."""
        east, north = self._projection.transform(np.asarray(longitude, float), np.asarray(latitude, float))
        c, s = np.cos(self.rotation), np.sin(self.rotation)
        return c * east + s * north, -s * east + c * north

    def to_geographic(self, x: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats]:
        """Latitude, longitude [degrees] of local coordinates [m]."""
        x, y = np.asarray(x, float), np.asarray(y, float)
        c, s = np.cos(self.rotation), np.sin(self.rotation)
        longitude, latitude = self._projection.transform(c * x - s * y, s * x + c * y, direction="INVERSE")
        return latitude, longitude


@dataclass(frozen=True)
class Place:
    """A spot where trucks stay: pick, drop, park or charge; metres in the site frame."""

    id: str
    kind: PlaceKind
    x: float
    y: float
    plugs: int = 1  # Trucks that there is room for at once; chargers have as many plugs
    power: float = float("nan")  # Charging power [W] of one plug, for kind ``charge``
    swap: float = float("nan")  # There batteries are not charged, but swapped for full ones in this time [s]


@dataclass(frozen=True)
class Zone:
    """A polygon ((n, 2) metres) with a speed limit [m/s] (NaN: none), or under a roof. Simulated people close
    its roads for ``closed_for`` [s], then it is open ``closed_every`` [s] on average (0: always)."""

    id: str
    polygon: Floats
    speed_limit: float = float("nan")
    covered: bool = False
    closed_every: float = 0.0
    closed_for: float = 10.0

    def contains(self, x: Floats, y: Floats) -> Mask:
        """(N,) whether points lie inside: an odd number of the polygon's sides is to their right."""
        inside = np.zeros(len(x), dtype=bool)
        corners = self.polygon[:, :2]
        for (ax, ay), (bx, by) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            if ay != by:
                inside ^= ((ay > y) != (by > y)) & (x < ax + (y - ay) / (by - ay) * (bx - ax))
        return inside


@dataclass(frozen=True)
class Building:
    """A polygon ((n, 2) metres) of a height [m]; drawn in the 3-D replay."""

    id: str
    polygon: Floats
    height: float = 6.0


@dataclass(frozen=True)
class MapFrame:
    """How a log's own frame lies in the site's: turned by ``rotation`` [rad], then moved by ``shift`` [m].
    ``level`` names the floor, where a site has several."""

    name: str
    shift: tuple[float, float] = (0.0, 0.0)
    rotation: float = 0.0
    level: str = ""

    def to_site(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """x, y [m] in the site frame."""
        c, s = np.cos(self.rotation), np.sin(self.rotation)
        return c * x - s * y + self.shift[0], s * x + c * y + self.shift[1]


@dataclass(frozen=True)
class Site:
    """The plant; ``frame`` is None where its place on earth is unknown, ``network`` without a map."""

    name: str = "site"
    frame: Frame | None = None
    network: Network | None = None
    traffic: Literal["right", "left"] = "right"
    places: tuple[Place, ...] = ()
    zones: tuple[Zone, ...] = ()
    buildings: tuple[Building, ...] = ()
    map_frames: tuple[MapFrame, ...] = ()
    breaks: tuple[tuple[float, float], ...] = ()
    """From when until when simulated trucks rest [s of the local day], or past midnight until then."""
    power_limit: float = float("inf")  # Of all chargers together [W]
    source: dict[str, Any] = field(default_factory=dict)  # Of the files it was read from: names and sha256

    @property
    def timezone(self) -> str:
        """IANA name of the zone of the hours in reports."""
        return "UTC" if self.frame is None else self.frame.timezone

    def on_break(self, time: float) -> bool:
        """Whether trucks rest at a time [s since 1970]."""
        local = datetime.fromtimestamp(time, ZoneInfo(self.timezone))
        now = 3600.0 * local.hour + 60.0 * local.minute + local.second
        return any(a <= now < b if a <= b else not b <= now < a for a, b in self.breaks)

    def zone_limit(self, x: Floats, y: Floats) -> Floats:
        """(N,) lowest speed limit of the zones at points [m/s], inf where there is none."""
        limits = [np.where(zone.contains(x, y), zone.speed_limit, np.nan) for zone in self.zones]
        return np.asarray(np.fmin.reduce([np.full(len(x), np.inf), *limits]))

    def roads(self) -> Network:
        """The network, or :class:`SiteError` where the site has none."""
        if self.network is None:
            raise SiteError(f"site {self.name!r} has no road network", do="give one with --site")
        return self.network


def site_to_dict(site: Site) -> dict[str, Any]:
    """The whole site JSON-ready, network included; :func:`site_from_dict` reads it back exactly."""
    out: dict[str, Any] = {"name": site.name, "traffic": site.traffic, "source": site.source}
    if site.breaks:
        out["break"] = [list(b) for b in site.breaks]
    if np.isfinite(site.power_limit):
        out["power"] = {"limit": site.power_limit}
    if site.frame:
        out["frame"] = asdict(site.frame)
    for name in ("place", "zone", "building", "map_frame"):
        out[name] = [{k: _json(v) for k, v in vars(item).items()} for item in getattr(site, f"{name}s")]
    if (n := site.network) is not None:
        edges = [
            {
                "id": e.id, "road": e.road, "from": e.start, "to": e.end, "speed_limit": _json(e.speed_limit),
                "width": _json(e.width), "next": [n.edge_ids[j] for j in n.successors(i)],
                "points": e.points.tolist(),
            }
            for i, e in enumerate(n.edges())
        ]  # fmt: skip
        out["network"] = {"has_elevation": n.has_elevation, "edges": edges}
    return out


def _json(value: Any) -> Any:
    if isinstance(value, np.ndarray | tuple):
        return np.asarray(value).tolist()
    return None if isinstance(value, float) and np.isnan(value) else value


def site_from_dict(data: dict[str, Any]) -> Site:
    """The site of a dictionary made by :func:`site_to_dict`."""
    network = None
    if drawn := data.get("network"):
        edges, turns = [], []
        for item in map(_known, drawn["edges"]):
            turns += [(item["id"], follow) for follow in item.pop("next")]
            edges.append(Edge(start=item.pop("from"), end=item.pop("to"), **item))
        network = build_network(edges, turns=turns, has_elevation=drawn["has_elevation"])
    kinds = {"place": Place, "zone": Zone, "building": Building, "map_frame": MapFrame}
    more: dict[str, Any] = {"source": data.get("source", {}), "traffic": data.get("traffic", "right")}
    for name, kind in kinds.items():
        more[f"{name}s"] = tuple(kind(**_known(row)) for row in data.get(name, ()))
    more["breaks"] = tuple((a, b) for a, b in data.get("break", ()))
    more["power_limit"] = data.get("power", {}).get("limit", float("inf"))
    return Site(data["name"], Frame(**data["frame"]) if data.get("frame") else None, network, **more)


def _known(item: dict[str, Any]) -> dict[str, Any]:
    """The known values of a place, zone, building or edge; points as an array."""
    known = {k: tuple(v) if k == "shift" else v for k, v in item.items() if v is not None}
    return known | {k: np.asarray(known[k], float) for k in ("polygon", "points") if k in known}


def crs(value: Any) -> str:
    """A reference system that PROJ knows, as ``"EPSG:25832"``."""
    try:
        _to_geographic(text(value))
    except Exception as error:  # pyproj raises several kinds
        raise Wrong("is no reference system that PROJ knows; write it as EPSG:25832") from error
    return str(value)


@lru_cache
def _to_geographic(name: str) -> Any:
    from pyproj import Transformer

    return Transformer.from_crs(name, "EPSG:4326", always_xy=True)


def geographic(name: str, x: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats]:
    """Latitude, longitude [degrees] of coordinates of a reference system; NaN where it does not reach."""
    longitude, latitude = _to_geographic(name).transform(np.asarray(x, float), np.asarray(y, float))
    known = np.isfinite(longitude) & np.isfinite(latitude)
    return np.where(known, latitude, np.nan), np.where(known, longitude, np.nan)


def frame_at(earth: Inverse, x: float, y: float, step: float = 100.0) -> Frame:
    """The site frame about a point x, y [m] of a projected system, its x axis that of the system, as a
    ``step`` [m] along it shows. Distances are those on the ground: they differ from those of the projection
    by its scale (0.4 m a kilometre in the middle of a UTM zone)."""
    latitude, longitude = earth(np.array([x, x + step]), np.array([y, y]))
    origin = Frame(float(latitude[0]), float(longitude[0]))
    east, north = (float(v[1] - v[0]) for v in origin.to_local(latitude, longitude))
    return replace(origin, rotation=math.atan2(north, east))


MAP_FRAME: Keys = {
    "name": text, "shift": list_of(real(-FARTHEST, FARTHEST), 2, 2), "level": text,
    "rotation": real(-2 * math.pi, 2 * math.pi),
}  # fmt: skip


def map_frames(data: dict[str, Any], where: Path | str, error: Errors = InputError) -> tuple[MapFrame, ...]:
    """All [[map_frame]] tables."""
    return tuple(MapFrame(**row) for row in rows(data, "map_frame", MAP_FRAME, where, ("name",), error))

"""Bring the roads of a map into the frame of a site."""

import math
from dataclasses import replace

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.core.network import Edge, Network
from fleetlog.core.site import Frame
from fleetlog.errors import SiteError
from fleetlog.roads.formats.base import Inverse, RoadMap
from fleetlog.roads.segments import distance_to_segment

SAME = 0.01  # local metres of a map stay untouched where its frame reproduces them within this [m]
FAR = 50_000.0  # roads farther than this [m] from the frame's origin are in another frame than the site says


def place_map(road_map: RoadMap, frame: Frame | None) -> tuple[list[Edge], Frame | None, list[str]]:
    """Edges in the site frame (None: the map's, or one about its centre), that frame, and notes."""
    edges, earth = road_map.edges, road_map.geographic_of
    points = np.concatenate([e.points for e in edges])
    if road_map.geographic:
        frame = frame or _centre_frame(points[:, 1], points[:, 0])
        return _moved(edges, *frame.to_local(points[:, 1], points[:, 0])), frame, []
    if earth is None:
        note = ["the map's coordinates are taken as the local metres of the site's frame"] if frame else []
        return edges, frame, note
    latitude, longitude = earth(points[:, 0], points[:, 1])
    if not (np.isfinite(latitude).all() and np.isfinite(longitude).all()):
        do = "correct the geoReference or the header's offset"
        raise SiteError("its projection does not reach its coordinates", do=do)
    frame = frame or _own_frame(earth, points)
    x, y = frame.to_local(latitude, longitude)
    moved = float(np.hypot(x - points[:, 0], y - points[:, 1]).max())
    if moved <= SAME:
        return edges, frame, []
    how = "coordinates are brought from the map's projection into the site frame"
    return _moved(edges, x, y), frame, [f"{how}; the largest change is {moved:.2f} m"]


def _own_frame(earth: Inverse, points: Floats) -> Frame:
    """A frame with the map's axes, about its (0, 0) where that is near the roads, else about their centre."""
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    near = bool((np.maximum(np.abs(low), np.abs(high)) < FAR / 5).all())
    origin = np.zeros(2) if near else (low + high) / 2.0
    step = max(1.0, float((high - low).max()) / 2.0)
    axis = np.array([origin, [origin[0] + step, origin[1]]])
    latitude, longitude = earth(axis[:, 0], axis[:, 1])
    plain = Frame(float(latitude[0]), float(longitude[0]))
    east, north = plain.to_local(latitude, longitude)
    rotation = math.atan2(float(north[1] - north[0]), float(east[1] - east[0]))
    return replace(plain, rotation=rotation if abs(rotation) > 1e-9 else 0.0)


def _centre_frame(latitude: Floats, longitude: Floats) -> Frame:
    """A frame about the middle of the extent, rotation 0; :class:`SiteError` beyond the size of a region."""
    if np.ptp(latitude) > 5.0 or np.ptp(longitude) > 10.0:
        do = "cut the map to the site or correct its coordinates"
        raise SiteError("the roads span more than a region", do=do)
    middle = [float((v.min() + v.max()) / 2.0) for v in (latitude, longitude)]
    return Frame(round(middle[0], 9), round(middle[1], 9))


def _moved(edges: list[Edge], x: Floats, y: Floats) -> list[Edge]:
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        what = "its coordinates cannot be brought into the site frame"
        raise SiteError(what, do="check the frame and the map")
    if (away := float(np.hypot(x, y).min())) > FAR:
        what = f"the roads are {away / 1000.0:.0f} km from the site's frame"
        raise SiteError(what, do="correct [frame] or give another map")
    bounds = np.cumsum([len(e.points) for e in edges])[:-1]
    pieces = zip(np.split(x, bounds), np.split(y, bounds), edges, strict=True)
    return [replace(e, points=np.column_stack([px, py, e.points[:, 2]])) for px, py, e in pieces]


def distance_to_roads(network: Network, spots: Floats) -> Floats:
    """(N,) horizontal distance [m] of spots (N, 2) from the nearest road."""
    inner = np.ones(len(network.points), dtype=bool)
    inner[network.first[1:] - 1] = False
    a, b = network.points[inner, :2], network.points[np.flatnonzero(inner) + 1, :2]
    return np.array([distance_to_segment(spot, a, b).min() for spot in spots])

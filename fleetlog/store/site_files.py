"""Writing a site: ``site.toml`` and ``roads.geojson``, as :func:`fleetlog.roads.load_site` reads them."""

import math
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.network import Network
from fleetlog.core.site import Building, Frame, Place, Site, Zone
from fleetlog.store.documents import plain, write_json

NOWHERE = Frame(0.0, 0.0)  # The frame of a site of unknown place: GeoJSON knows degrees only


def write_site(site: Site, folder: Path, more: Mapping[str, Mapping[str, Any]] | None = None) -> None:
    """Write ``site`` into an existing folder; ``more`` holds further properties of its roads by edge id.

    Coordinates are good to 0.1 mm.  A site without a frame gets one at latitude and longitude 0.
    """
    import tomli_w

    frame = site.frame or NOWHERE
    if site.network is not None:
        write_json(folder / "roads.geojson", roads_geojson(site.network, frame, more or {}))
    (folder / "site.toml").write_text(tomli_w.dumps(_tables(site, frame)), encoding="utf-8")


def _tables(site: Site, frame: Frame) -> dict[str, Any]:
    own = {k: v for k, v in asdict(frame).items() if v not in (0.0, "UTC") or k in ("latitude", "longitude")}
    out: dict[str, Any] = {"name": site.name, "frame": own}
    if site.network is not None:
        out["network"] = {"file": "roads.geojson", "traffic": site.traffic}
    if math.isfinite(site.power_limit):
        out["power"] = {"limit": site.power_limit}
    tables = {
        "place": [_told(place) for place in site.places],
        "zone": [_told(zone) for zone in site.zones],
        "break": [{"from": _clock(a), "until": _clock(b)} for a, b in site.breaks],
        "building": [_told(building) for building in site.buildings],
    }
    return out | {name: rows for name, rows in tables.items() if rows}


def _clock(seconds: float) -> str:
    return f"{int(seconds // 3600):02d}:{int(seconds % 3600 // 60):02d}"


def _told(item: Place | Zone | Building) -> dict[str, Any]:
    """What of a part of the site is known and no default, to the millimetre."""
    out: dict[str, Any] = {}
    for f in fields(item):
        value = getattr(item, f.name)
        if isinstance(value, np.ndarray):
            out[f.name] = np.round(value, 3).tolist()
        elif value == value and value != f.default:
            out[f.name] = round(value, 3) if isinstance(value, float) else value
    return out


def roads_geojson(network: Network, frame: Frame, more: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Every road once: both its directions where they share a line."""
    features = []
    for i, edge in enumerate(network.edge_ids):
        back = int(network.reverse[i])
        oneway = back < 0 or _differ(network, i, back)
        if oneway or not edge.startswith("-"):
            features.append(_feature(network, i, oneway, frame, more))
    return {"type": "FeatureCollection", "features": features}


def _differ(network: Network, i: int, back: int) -> bool:
    """Whether two directions are drawn apart."""
    a, b = network.polyline(i), network.polyline(back)[::-1]
    return len(a) != len(b) or bool(np.abs(a - b).max() > 1e-3)


def _feature(
    network: Network, i: int, oneway: bool, frame: Frame, more: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    points = network.polyline(i)
    latitude, longitude = frame.to_geographic(points[:, 0], points[:, 1])
    columns = [np.round(longitude, 9), np.round(latitude, 9)]
    if network.has_elevation:
        columns.append(np.round(points[:, 2], 3))
    properties: dict[str, Any] = {
        "id": network.edge_ids[i], "from": network.node_ids[network.start[i]],
        "to": network.node_ids[network.end[i]], "oneway": oneway,
    }  # fmt: skip
    for name, value in (("speed_limit", network.speed_limit[i]), ("width", network.width[i])):
        if np.isfinite(value):
            properties[name] = round(float(value), 3)
    properties.update(plain(dict(more.get(network.edge_ids[i], {}))))
    line = {"type": "LineString", "coordinates": np.column_stack(columns).tolist()}
    return {"type": "Feature", "properties": properties, "geometry": line}

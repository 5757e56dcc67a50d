"""Writing a site: ``site.toml`` and ``roads.geojson``, as :func:`fleetlog.roads.load_site` reads them."""

import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.network import Network
from fleetlog.core.site import Frame, Place, Site, Zone
from fleetlog.store.documents import plain, write_json

NOWHERE = Frame(0.0, 0.0)
"""The frame of a site of unknown place: GeoJSON knows degrees only."""


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
    tables = {
        "place": [_place(p) for p in site.places],
        "zone": [_zone(z) for z in site.zones],
        "break": [{"from": _clock(a), "until": _clock(b)} for a, b in site.breaks],
        "building": [{"id": b.id, "polygon": b.polygon.tolist(), "height": b.height} for b in site.buildings],
    }
    if math.isfinite(site.power_limit):
        out["power"] = {"limit": site.power_limit}
    return {**out, **{name: rows for name, rows in tables.items() if rows}}


def _clock(seconds: float) -> str:
    return f"{int(seconds // 3600):02d}:{int(seconds % 3600 // 60):02d}"


def _place(p: Place) -> dict[str, Any]:
    out = {"id": p.id, "kind": p.kind, "x": round(p.x, 3), "y": round(p.y, 3)}
    if p.plugs != 1:
        out["plugs"] = p.plugs
    return out if math.isnan(p.power) else {**out, "power": p.power}


def _zone(z: Zone) -> dict[str, Any]:
    out: dict[str, Any] = {"id": z.id, "polygon": np.round(z.polygon, 3).tolist()}
    if not math.isnan(z.speed_limit):
        out["speed_limit"] = z.speed_limit
    if z.closed_every:
        out |= {"closed_every": z.closed_every, "closed_for": z.closed_for}
    return {**out, "covered": True} if z.covered else out


def roads_geojson(network: Network, frame: Frame, more: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Every road once: both its directions where they share a line."""
    features = []
    for i, edge in enumerate(network.edge_ids):
        back = int(network.reverse[i])
        if back >= 0 and (edge.startswith("-") or _differ(network, i, back)):
            if _differ(network, i, back):
                features.append(_feature(network, i, True, frame, more))
            continue
        features.append(_feature(network, i, back < 0, frame, more))
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

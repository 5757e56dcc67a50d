"""The tables of a site file: their schemas, and the parts of a site that they become."""

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.frames import crs, frame_of_crs
from fleetlog.core.schema import Keys, Wrong, flag, list_of, one_of, real, table, text, time_zone, whole
from fleetlog.core.site import Building, Frame, Place, PlaceKind, Zone
from fleetlog.errors import SiteError

KINDS: dict[str, PlaceKind] = {"pick": "pick", "drop": "drop", "park": "park", "charge": "charge"}
FARTHEST = 1e7
"""No corner or place lies farther from the origin [m]."""


metres = real(-FARTHEST, FARTHEST)


def polygon(value: Any) -> NDArray[np.float64]:
    """At least three corners [x, y] in metres; a repeated last corner is left out."""
    if not isinstance(value, list) or not all(isinstance(p, list) and len(p) == 2 for p in value):
        raise Wrong("is not a list of corners [x, y]")
    points = np.array([[metres(v) for v in p] for p in value], dtype=np.float64).reshape(-1, 2)
    if len(points) > 1 and bool((points[0] == points[-1]).all()):
        points = points[:-1]
    if len(points) < 3:
        raise Wrong("has fewer than three corners")
    return points


def clock(value: Any) -> float:
    """A time of day such as "09:30" [s]."""
    found = re.fullmatch(r"([01]?\d|2[0-3]):([0-5]\d)", text(value))
    if not found:
        raise Wrong('is no time of day such as "09:30"')
    return 3600.0 * int(found[1]) + 60.0 * int(found[2])


FRAME: Keys = {
    "latitude": real(-90, 90),
    "longitude": real(-180, 180),
    "rotation": real(-2 * math.pi, 2 * math.pi),
    "crs": crs,
    "easting": metres,
    "northing": metres,
    "timezone": time_zone,
}
NETWORK: Keys = {
    "file": text,
    "traffic": one_of("right", "left"),
    "lane_types": list_of(text, 1),
    "road_classes": list_of(text, 1),
}
PLACE: Keys = {
    "id": text, "kind": one_of(*KINDS), "x": metres, "y": metres, "plugs": whole(), "power": real(0.0, 1e9),
}  # fmt: skip
ZONE: Keys = {
    "id": text, "polygon": polygon, "speed_limit": real(1e-3, 100.0), "covered": flag,
    "closed_every": real(1.0, 1e6, "s"), "closed_for": real(1.0, 1e4, "s"),
}  # fmt: skip
BREAK: Keys = {"id": text, "from": clock, "until": clock}
BUILDING: Keys = {"id": text, "polygon": polygon, "height": real(0.0, 1000.0)}


def rows(
    data: dict[str, Any], name: str, keys: Keys, where: Path, required: tuple[str, ...]
) -> list[dict[str, Any]]:
    """The checked tables of a list [[name]]; ids are made where none are given and may not occur twice."""
    raw = data.get(name, [])
    if not isinstance(raw, list):
        raise SiteError("is not a list of tables", where=where, place=name, do=f"write [[{name}]]")
    out = [table(row, keys, where, f"{name}[{n}]", required, SiteError) for n, row in enumerate(raw)]
    seen: set[str] = set()
    for n, row in enumerate(out):
        row.setdefault("id", f"{name}-{n + 1}")
        if row["id"] in seen:
            raise SiteError(
                f"the id {row['id']!r} occurs twice", where=where, place=f"{name}[{n}]", do="rename one"
            )
        seen.add(row["id"])
    return out


def places(data: dict[str, Any], where: Path) -> tuple[Place, ...]:
    """All [[place]] tables."""
    found = rows(data, "place", PLACE, where, ("id", "kind", "x", "y"))
    return tuple(Place(**{**row, "kind": KINDS[row["kind"]]}) for row in found)


def zones(data: dict[str, Any], where: Path) -> tuple[Zone, ...]:
    """All [[zone]] tables."""
    return tuple(Zone(**row) for row in rows(data, "zone", ZONE, where, ("polygon",)))


def buildings(data: dict[str, Any], where: Path) -> tuple[Building, ...]:
    """All [[building]] tables."""
    return tuple(Building(**row) for row in rows(data, "building", BUILDING, where, ("polygon",)))


def breaks(data: dict[str, Any], where: Path) -> tuple[tuple[float, float], ...]:
    """All [[break]] tables."""
    found = rows(data, "break", BREAK, where, ("from", "until"))
    return tuple((row["from"], row["until"]) for row in found)


def power_limit(data: dict[str, Any], where: Path) -> float:
    """What the [power] table allows all chargers together [W]."""
    given = table(data.get("power", {}), {"limit": real(1.0, 1e9, "W")}, where, "power", error=SiteError)
    return float(given.get("limit", math.inf))


def frame(data: dict[str, Any], where: Path) -> Frame | None:
    """The [frame] table, if there is one."""
    if "frame" not in data:
        return None
    given = data["frame"]
    if not isinstance(given, dict) or "crs" not in given:
        keys = {k: FRAME[k] for k in ("latitude", "longitude", "rotation", "timezone")}
        return Frame(**table(given, keys, where, "frame", ("latitude", "longitude"), SiteError))
    keys = {k: FRAME[k] for k in ("crs", "easting", "northing", "rotation", "timezone")}
    values = table(given, keys, where, "frame", ("easting", "northing"), SiteError)
    found = frame_of_crs(values["crs"], values["easting"], values["northing"], values.get("rotation"))
    if not math.isfinite(found.latitude + found.longitude):
        raise SiteError("the origin lies outside the reference system", where=where, place="frame",
                        do="correct easting and northing")  # fmt: skip
    return replace(found, timezone=values["timezone"]) if "timezone" in values else found


def network(data: dict[str, Any], where: Path) -> dict[str, Any]:
    """The [network] table: file, traffic, lane types and road classes."""
    return table(data["network"], NETWORK, where, "network", ("file",), SiteError)

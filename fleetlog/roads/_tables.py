"""The tables of a site file: their schemas, and what is read of them."""

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.frames import crs, frame_of_crs
from fleetlog.core.schema import Keys, Wrong, flag, list_of, one_of, real, table, text, time_zone, whole
from fleetlog.core.site import Frame
from fleetlog.errors import SiteError

FARTHEST = 1e7  # no corner or place lies farther from the origin [m]
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


ORIGIN: Keys = {"latitude": real(-90, 90), "longitude": real(-180, 180)}
PROJECTED: Keys = {"crs": crs, "easting": metres, "northing": metres}
AXES: Keys = {"rotation": real(-2 * math.pi, 2 * math.pi), "timezone": time_zone}
NETWORK: Keys = {
    "file": text, "traffic": one_of("right", "left"), "lane_types": list_of(text, 1),
    "road_classes": list_of(text, 1),
}  # fmt: skip
POWER: Keys = {"limit": real(1.0, 1e9, "W")}
PLACE: Keys = {
    "id": text, "kind": one_of("pick", "drop", "park", "charge"), "x": metres, "y": metres, "plugs": whole(),
    "power": real(0.0, 1e9),
}  # fmt: skip
ZONE: Keys = {
    "id": text, "polygon": polygon, "speed_limit": real(1e-3, 100.0), "covered": flag,
    "closed_every": real(1.0, 1e6, "s"), "closed_for": real(1.0, 1e4, "s"),
}  # fmt: skip
BUILDING: Keys = {"id": text, "polygon": polygon, "height": real(0.0, 1000.0)}
BREAK: Keys = {"id": text, "from": clock, "until": clock}
LISTS: dict[str, tuple[Keys, tuple[str, ...]]] = {
    "place": (PLACE, ("id", "kind", "x", "y")), "zone": (ZONE, ("polygon",)),
    "building": (BUILDING, ("polygon",)), "break": (BREAK, ("from", "until")),
}  # fmt: skip
"""Keys of the tables of the lists [[name]], and those that must be there."""


def rows(data: dict[str, Any], name: str, where: Path) -> list[dict[str, Any]]:
    """The checked tables of a list [[name]]; ids are made where none are given and may not occur twice."""
    raw = data.get(name, [])
    if not isinstance(raw, list):
        raise SiteError("is not a list of tables", where=where, place=name, do=f"write [[{name}]]")
    keys, required = LISTS[name]
    out: dict[str, dict[str, Any]] = {}
    for n, given in enumerate(raw):
        place = f"{name}[{n}]"
        row = {"id": f"{name}-{n + 1}", **table(given, keys, where, place, required, SiteError)}
        if row["id"] in out:
            raise SiteError(f"the id {row['id']!r} occurs twice", where=where, place=place, do="rename one")
        out[row["id"]] = row
    return list(out.values())


def frame(data: dict[str, Any], where: Path) -> Frame | None:
    """The [frame] table, if there is one."""
    if "frame" not in data:
        return None
    given = data["frame"]
    if not isinstance(given, dict) or "crs" not in given:
        return Frame(**table(given, {**ORIGIN, **AXES}, where, "frame", tuple(ORIGIN), SiteError))
    values = table(given, {**PROJECTED, **AXES}, where, "frame", tuple(PROJECTED), SiteError)
    found = frame_of_crs(values["crs"], values["easting"], values["northing"], values.get("rotation"))
    if not math.isfinite(found.latitude + found.longitude):
        raise SiteError("the origin lies outside the reference system", where=where, place="frame",
                        do="correct easting and northing")  # fmt: skip
    return replace(found, timezone=values["timezone"]) if "timezone" in values else found

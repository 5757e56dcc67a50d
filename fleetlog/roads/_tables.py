"""Tables of a site file, checked: every key is known and every value is of its kind."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.site import Building, Frame, Place, PlaceKind, Zone
from fleetlog.errors import SiteError, nearest

Check = Callable[[Any], Any]
KINDS: dict[str, PlaceKind] = {"pick": "pick", "drop": "drop", "park": "park", "charge": "charge"}


class Wrong(Exception):
    """A value is not of its kind; the text says what is expected."""


def real(low: float = -math.inf, high: float = math.inf) -> Check:
    """A finite number in a range."""

    def check(value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise Wrong("is not a number")
        if not low <= value <= high:
            raise Wrong(f"is outside {low:g} to {high:g}")
        return float(value)

    return check


def whole(value: Any) -> int:
    """A whole number above zero."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise Wrong("is not a whole number above zero")
    return value


def text(value: Any) -> str:
    """A text, not empty."""
    if not isinstance(value, str) or not value:
        raise Wrong("is not a text")
    return value


def flag(value: Any) -> bool:
    """True or false."""
    if not isinstance(value, bool):
        raise Wrong("is neither true nor false")
    return value


def texts(value: Any) -> frozenset[str]:
    """A list of texts."""
    if not isinstance(value, list) or not value:
        raise Wrong("is not a list of texts")
    return frozenset(text(v) for v in value)


def one_of(*known: str) -> Check:
    """One of a few words."""

    def check(value: Any) -> str:
        if value not in known:
            raise Wrong(f"is none of {', '.join(known)}")
        return str(value)

    return check


def polygon(value: Any) -> NDArray[np.float64]:
    """At least three corners [x, y] in metres; a repeated last corner is left out."""
    corner = real()
    if not isinstance(value, list) or not all(isinstance(p, list) and len(p) == 2 for p in value):
        raise Wrong("is not a list of corners [x, y]")
    points = np.array([[corner(v) for v in p] for p in value], dtype=np.float64).reshape(-1, 2)
    if len(points) > 1 and bool((points[0] == points[-1]).all()):
        points = points[:-1]
    if len(points) < 3:
        raise Wrong("has fewer than three corners")
    return points


Keys = dict[str, Check]
SITE: Keys = {"name": text}
FRAME: Keys = {
    "latitude": real(-90, 90),
    "longitude": real(-180, 180),
    "rotation": real(-2 * math.pi, 2 * math.pi),
}
NETWORK: Keys = {
    "file": text, "traffic": one_of("right", "left"), "lane_types": texts, "road_classes": texts,
}  # fmt: skip
PLACE: Keys = {
    "id": text, "kind": one_of(*KINDS), "x": real(), "y": real(), "plugs": whole, "power": real(0.0),
}  # fmt: skip
ZONE: Keys = {"id": text, "polygon": polygon, "speed_limit": real(1e-3, 100.0), "covered": flag}
BUILDING: Keys = {"id": text, "polygon": polygon, "height": real(0.0, 1000.0)}


def table(data: Any, keys: Keys, where: Path, place: str, required: tuple[str, ...] = ()) -> dict[str, Any]:
    """The checked values of one table; :class:`SiteError` names the key at fault."""
    if not isinstance(data, dict):
        raise SiteError("is not a table", where=where, place=place, do=f"write [{place}] and its keys below")
    out = {}
    for key, value in data.items():
        spot = f"{place}.{key}" if place else key
        if key not in keys:
            raise SiteError("unknown key", where=where, place=spot, do=nearest(key, keys))
        try:
            out[key] = keys[key](value)
        except Wrong as wrong:
            raise SiteError(f"{value!r} {wrong}", where=where, place=spot, do="correct it") from None
    for key in required:
        if key not in out:
            raise SiteError(f"{key} is missing", where=where, place=place, do=f"add {key} = ...")
    return out


def rows(
    data: dict[str, Any], name: str, keys: Keys, where: Path, required: tuple[str, ...]
) -> list[dict[str, Any]]:
    """The checked tables of a list [[name]]; ids are made where none are given and may not occur twice."""
    raw = data.get(name, [])
    if not isinstance(raw, list):
        raise SiteError("is not a list of tables", where=where, place=name, do=f"write [[{name}]]")
    out = [table(row, keys, where, f"{name}[{n}]", required) for n, row in enumerate(raw)]
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


def frame(data: dict[str, Any], where: Path) -> Frame | None:
    """The [frame] table, if there is one."""
    if "frame" not in data:
        return None
    return Frame(**table(data["frame"], FRAME, where, "frame", ("latitude", "longitude")))

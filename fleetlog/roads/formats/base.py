"""What a map format gives: the type of a reader and of what it reads."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.network import Edge, LoadReport
from fleetlog.core.schema import shown
from fleetlog.core.site import Place
from fleetlog.errors import SiteError

Floats = NDArray[np.float64]
MPH, KNOT, KMH = 0.44704, 1852.0 / 3600.0, 1.0 / 3.6
SPEED_UNITS: dict[str, float] = {"m/s": 1.0, "km/h": KMH, "kmh": KMH, "kph": KMH, "mph": MPH, "knots": KNOT}


@dataclass(frozen=True)
class MapOptions:
    """What the user chose about reading a map; None takes the format's documented default.

    ``lane_types`` are the OpenDRIVE lane types that are driven, ``road_classes`` the values of OSM's
    ``highway`` tag.
    """

    traffic: Literal["right", "left"] | None = None
    lane_types: frozenset[str] | None = None
    road_classes: frozenset[str] | None = None


@dataclass(frozen=True)
class RoadMap:
    """The roads of one file, before they are placed in a site's frame.

    Attributes
    ----------
    edges : directed edges.  ``points`` are (n, 3): longitude, latitude [degrees] and height [m] where
        ``geographic``,
        local metres otherwise.
    report : what came in and what is kept.
    geographic : see ``edges``.
    geographic_of : for local metres of a known place on earth: (x, y) to (latitude, longitude) [degrees].
    turns : the allowed (edge id, next edge id), None for every turn that the nodes allow except
        ``forbidden``.
    has_elevation : whether the heights mean anything; None: where they differ.
    places : places that the map itself names, local metres.
    traffic : the side of the road, where the map says it.
    """

    edges: list[Edge]
    report: LoadReport
    geographic: bool = False
    geographic_of: Callable[[Floats, Floats], tuple[Floats, Floats]] | None = None
    turns: list[tuple[str, str]] | None = None
    forbidden: frozenset[tuple[str, str]] = frozenset()
    has_elevation: bool | None = None
    places: tuple[Place, ...] = ()
    traffic: Literal["right", "left"] | None = None


@dataclass(frozen=True)
class Reader:
    """A map format.

    Attributes
    ----------
    name : as it stands in reports.
    suffixes : lower case, with the dot.
    sniff : whether the first bytes of a file are of this format.
    read : the file as a :class:`RoadMap`; raises :class:`SiteError`.
    """

    name: str
    suffixes: tuple[str, ...]
    sniff: Callable[[bytes], bool]
    read: Callable[[Path, MapOptions], RoadMap]


@dataclass
class Tally:
    """Counts for a load report while a map is read."""

    read: int = 0
    kept: int = 0
    dropped: dict[str, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def drop(self, reason: str, count: int = 1) -> None:
        """Count roads that are left out."""
        self.dropped[reason] = self.dropped.get(reason, 0) + count

    def report(self, name: str) -> LoadReport:
        """The finished report."""
        return LoadReport(name, self.read, self.kept, dict(sorted(self.dropped.items())), tuple(self.notes))


HUGE = 1e9
"""No coordinate, coefficient or count of a map is larger."""


def number(text: Any, where: Path, place: str) -> float:
    """A finite number of a map's text; :class:`SiteError` with the place otherwise."""
    try:
        value = float(text)
    except OverflowError:
        value = math.inf
    except (TypeError, ValueError):
        raise SiteError(
            f"{shown(text)} is not a number", where=where, place=place, do="correct the map"
        ) from None
    if not math.isfinite(value):
        raise SiteError(
            f"{shown(text)} is not a finite number", where=where, place=place, do="correct the map"
        )
    if abs(value) > HUGE:
        raise SiteError(
            f"{shown(text)} is larger than any number of a map",
            where=where,
            place=place,
            do="correct the map",
        )
    return value


def without_repeats(points: Floats, tolerance: float = 1e-9) -> Floats:
    """Vertices without those that repeat the one before them ((n, 3), the unit of ``points``)."""
    keep = np.ones(len(points), dtype=bool)
    # Heights may be unknown (NaN); they then tell no two vertices apart.
    keep[1:] = np.abs(np.nan_to_num(np.diff(points, axis=0))).max(axis=1) > tolerance
    return points[keep]


_SPEED = re.compile(r"^\s*(\d+(?:\.\d+)?)\s*(km/h|kmh|kph|mph|knots)?\s*$")


def osm_speed(text: str) -> float:
    """Speed limit [m/s] of an OSM ``maxspeed`` text; plain numbers are km/h, lists take the lowest, NaN
    where unknown.

    Source: wiki.openstreetmap.org/wiki/Key:maxspeed.
    """
    values = [_SPEED.match(part.strip(" '\"[]")) for part in re.split(r"[;,|]", text)]
    speeds = [float(m[1]) * SPEED_UNITS[m[2] or "km/h"] for m in values if m]
    return min((s for s in speeds if s > 0.0), default=math.nan)

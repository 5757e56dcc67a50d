"""What a map format gives: the type of a reader and of what it reads."""

import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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
Inverse = Callable[[Floats, Floats], tuple[Floats, Floats]]
"""x, y [m] of a map to latitude, longitude [degrees]."""
MPH, KNOT, KMH = 0.44704, 1852.0 / 3600.0, 1.0 / 3.6
SPEED_UNITS: dict[str, float] = {"m/s": 1.0, "km/h": KMH, "kmh": KMH, "kph": KMH, "mph": MPH, "knots": KNOT}


@dataclass(frozen=True)
class MapOptions:
    """What the user chose about reading a map; None takes the format's documented default.

    Driven are the ``lane_types`` of OpenDRIVE and the ``road_classes`` (tag ``highway``) of OSM.
    """

    traffic: Literal["right", "left"] | None = None
    lane_types: frozenset[str] | None = None
    road_classes: frozenset[str] | None = None


@dataclass(frozen=True)
class RoadMap:
    """The roads of one file, before they are placed in a site's frame.

    Attributes
    ----------
    edges : directed; points are longitude, latitude [degrees], height [m] where ``geographic``, else [m].
    report : what came in and what is kept.
    geographic_of : for local metres of a known place on earth.
    turns : the allowed (edge id, next edge id); None: all that the nodes allow except ``forbidden``.
    has_elevation : whether the heights mean anything; None: where they differ.
    places : places that the map itself names, local metres.
    traffic : the side of the road, where the map says it.
    """

    edges: list[Edge]
    report: LoadReport
    geographic: bool = False
    geographic_of: Inverse | None = None
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
    read : the file as a :class:`RoadMap`; :class:`SiteError` says the place in it, the caller adds the file.
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


def number(text: Any, place: str | None = None) -> float:
    """A finite number of a map's text; :class:`SiteError` with the place otherwise."""
    try:
        value = float(text)
    except OverflowError:
        value = math.inf
    except (TypeError, ValueError):
        raise SiteError(f"{shown(text)} is not a number", place=place, do="correct the map") from None
    if abs(value) <= HUGE:
        return value
    what = "larger than any number of a map" if math.isfinite(value) else "not a finite number"
    raise SiteError(f"{shown(text)} is {what}", place=place, do="correct the map")


@contextmanager
def at(place: str) -> Iterator[None]:
    """Say in every :class:`SiteError` of this block which place it is about, outer places first."""
    try:
        yield
    except SiteError as error:
        inner = place if error.place is None else f"{place}, {error.place}"
        raise SiteError(error.what, where=error.where, place=inner, do=error.do) from None


def without_repeats(points: Floats, tolerance: float = 1e-9) -> Floats:
    """Vertices without those that repeat the one before them ((n, 3), the unit of ``points``)."""
    keep = np.ones(len(points), dtype=bool)
    # Heights may be unknown (NaN); they then tell no two vertices apart.
    keep[1:] = np.abs(np.nan_to_num(np.diff(points, axis=0))).max(axis=1) > tolerance
    return points[keep]


_SPEED = re.compile(r"^\s*(\d+(?:\.\d+)?)\s*(km/h|kmh|kph|mph|knots)?\s*$")


def osm_speed(text: str) -> float:
    """Lowest limit [m/s] of an OSM ``maxspeed`` text, NaN where unknown; plain numbers are km/h.

    Source: wiki.openstreetmap.org/wiki/Key:maxspeed.
    """
    values = [_SPEED.match(part.strip(" '\"[]")) for part in re.split(r"[;,|]", text)]
    speeds = [float(m[1]) * SPEED_UNITS[m[2] or "km/h"] for m in values if m]
    return min((s for s in speeds if s > 0.0), default=math.nan)

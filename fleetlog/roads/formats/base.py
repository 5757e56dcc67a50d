"""What a map format gives: the type of a reader and of what it reads."""

import re
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.core.network import Edge, LoadReport
from fleetlog.core.schema import shown
from fleetlog.core.site import Inverse, MapFrame, Place, PlaceKind
from fleetlog.core.words import count
from fleetlog.errors import SiteError

MPH, KNOT, KMH = 0.44704, 1852.0 / 3600.0, 1.0 / 3.6
SPEED_UNITS: dict[str, float] = {"m/s": 1.0, "km/h": KMH, "kmh": KMH, "kph": KMH, "mph": MPH, "knots": KNOT}
WORDS = tomllib.loads(Path(__file__).with_name("words.toml").read_text(encoding="utf-8"))
HUGE = 1e9  # no coordinate, coefficient or count of a map is larger
MOST_VERTICES = 20_000_000  # vertices of all roads of a map


@dataclass(frozen=True)
class MapOptions:
    """What the user chose about reading a map; None takes the format's documented default."""

    traffic: Literal["right", "left"] | None = None
    lane_types: frozenset[str] | None = None  # driven ones of OpenDRIVE
    road_classes: frozenset[str] | None = None  # driven ones (tag highway) of OSM
    frames: tuple[MapFrame, ...] = ()  # how the map's own frames lie in the site's


@dataclass(frozen=True)
class RoadMap:
    """The roads of one file, before they are placed in a site's frame."""

    edges: list[Edge]  # points are longitude, latitude [degrees], height [m] where geographic, else [m]
    report: LoadReport
    geographic: bool = False
    geographic_of: Inverse | None = None  # for local metres of a known place on earth
    turns: list[tuple[str, str]] | None = None  # (edge id, next edge id); None: all but the forbidden ones
    forbidden: frozenset[tuple[str, str]] = frozenset()
    has_elevation: bool | None = None  # whether the heights mean anything; None: where they differ
    places: tuple[Place, ...] = ()  # that the map itself names, local metres
    traffic: Literal["right", "left"] | None = None  # the side of the road, where the map says it


@dataclass(frozen=True)
class Reader:
    """A map format. ``read`` gives a :class:`RoadMap`; its :class:`SiteError` says the place in the file."""

    name: str
    suffixes: tuple[str, ...]  # lower case, with the dot
    opening: str  # regular expression that is found in the first kilobytes of a file of this format
    read: Callable[[Path, MapOptions], RoadMap]

    def knows(self, head: bytes) -> bool:
        """Whether the first bytes of a file, in UTF-8 or UTF-16, are of this format."""
        text = head.replace(b"\0", b"").decode("latin-1").lstrip("\xff\xfe\xef\xbb\xbf \r\n\t")
        return re.search(self.opening, text, re.DOTALL | re.MULTILINE) is not None


@dataclass
class Tally:
    """The edges and places of a map while it is read, how many roads are kept, and why others are not."""

    edges: list[Edge] = field(default_factory=list)
    places: dict[str, Place] = field(default_factory=dict)
    kept: int = 0
    dropped: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)
    idle: int = 0  # stations where nothing is done
    vertices: int = 0

    def note(self, number: int, noun: str, what: str) -> None:
        """Say of how many things called ``noun`` ``what`` is so, if of any."""
        if number:
            self.notes.append(f"{count(number, noun)} {what}")

    @property
    def read(self) -> int:
        """Roads that were read."""
        return self.kept + self.dropped.total()

    def keep(self, *directions: Edge, shortest: float = 1e-9) -> None:
        """Take in a road by the directions in which it is driven, or count it as dropped without length.
        Vertices no farther than ``shortest`` from the one before them, in the unit of the points, go."""
        edges = [replace(e, points=distinct(e.points, shortest)) for e in directions]
        if any(len(e.points) < 2 for e in edges):
            self.dropped["without length"] += 1
            return
        self.kept += 1
        for edge in edges:
            self.add(edge)

    def add(self, edge: Edge) -> None:
        """Take in an edge; :class:`SiteError` beyond the vertices of any site's map."""
        self.edges.append(edge)
        self.vertices += len(edge.points)
        if self.vertices > MOST_VERTICES:
            raise SiteError(f"needs more than {MOST_VERTICES:,} vertices", do="cut the map to the site")

    def stop(self, name: str, kind: PlaceKind | None, spot: Floats) -> None:
        """Take in a station; the first of a name stays, and those where nothing is done are noted."""
        if kind is None:
            self.idle += 1
        else:
            self.places.setdefault(name, Place(name, kind, *spot[:2].tolist()))

    def road_map(self, name: str, nothing: str, do: str, **more: Any) -> RoadMap:
        """What was read; :class:`SiteError` that says so and what to ``do`` where that is no edge."""
        if not self.edges:
            why = ", ".join(f"{n} {reason}" for reason, n in self.dropped.items())
            raise SiteError(nothing + (f" ({why})" if why else ""), do=do)
        self.note(self.idle, "station", "left out: no action says what is done there")
        report = LoadReport(name, self.read, self.kept, dict(sorted(self.dropped.items())), tuple(self.notes))
        return RoadMap(self.edges, report, places=tuple(self.places.values()), **more)


class Nodes(dict[str, Floats]):
    """(3,) positions of a map's nodes by name; :class:`SiteError` for one that is not there."""

    def __missing__(self, name: str) -> Floats:
        raise SiteError(f"there is no node {name!r}", do="correct the map")


def spot(x: Any, y: Any, place: str, z: Any = 0.0) -> Floats:
    """(3,) position of a map's text."""
    return np.array([number(v, place) for v in (x, y, z)])


def number(text: Any, place: str | None = None) -> float:
    """A finite number of a map's text; :class:`SiteError` with the place otherwise."""
    try:
        value = float(text)
    except (TypeError, ValueError, OverflowError):
        raise SiteError(f"{shown(text)} is not a number", place=place, do="correct the map") from None
    if not abs(value) <= HUGE:
        what = f"{shown(text)} is not a finite number of a map, at most {HUGE:g}"
        raise SiteError(what, place=place, do="correct the map")
    return value


@contextmanager
def at(place: str | None = None, where: Path | None = None) -> Iterator[None]:
    """Say in a :class:`SiteError` of this block which place it is about, outer places first, and the file."""
    try:
        yield
    except SiteError as error:
        places = ", ".join(p for p in (place, error.place) if p)
        raise SiteError(error.what, where=error.where or where, place=places or None, do=error.do) from None


def distinct(points: Floats, tolerance: float = 1e-9) -> Floats:
    """Vertices without those that repeat the one before them ((n, 3), the unit of ``points``)."""
    keep = np.ones(len(points), dtype=bool)
    # Heights may be unknown (NaN); they then tell no two vertices apart.
    keep[1:] = np.abs(np.nan_to_num(np.diff(points, axis=0))).max(axis=1) > tolerance
    return points[keep]

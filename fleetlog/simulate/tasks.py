"""What trucks are asked to do, fetch a load at one place and set it down at another; what became of it."""

import bisect
import csv
import difflib
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.files import SETTINGS, read_whole
from fleetlog.core.site import Site
from fleetlog.core.trajectory import Labels
from fleetlog.core.truck import Truck
from fleetlog.errors import InputError, nearest
from fleetlog.simulate.arrays import Floats, Ints
from fleetlog.simulate.doors import Stand
from fleetlog.store.events import Columns

COLUMNS = ("vehicle", "from", "to", "payload", "earliest")
HEIGHTS = (0.3, 1.2, 2.4, 3.6)  # Of shelves that loads are taken from and set down on [m]
ENGAGE = 6.0  # To drive the forks under a load or out of it [s]
NONE = -1.0  # A time that has not come [s after the start]
LATER, LEFT_OUT = "later", "left out"


@dataclass(frozen=True)
class Task:
    """One load.

    ``vehicle`` None: any; ``source``, ``target`` places; ``payload`` kg; ``earliest`` s after the start;
    ``dwell`` (pick, drop) s, at least what the lift needs, ``on_road`` with the way into and out of the bay;
    ``height`` (pick, drop) m.
    """

    vehicle: str | None
    source: str
    target: str
    payload: float
    earliest: float
    dwell: tuple[float, float] = (20.0, 20.0)
    height: tuple[float, float] = (1.2, 1.2)
    on_road: bool = False


@dataclass(frozen=True)
class Visit:
    """A recorded truck stood at a place.

    ``begin`` time of day [s], ``dwell`` [s], ``height`` of the forks [m]; ``taken`` is the load that it took
    up there [kg], negative where it set one down; ``next`` is the number of the visit that the same truck
    made after it, -1: none.
    """

    place: str
    begin: float
    dwell: float
    height: float
    taken: float
    next: int = -1

    @property
    def loads(self) -> bool:
        """Whether the truck leaves with a load."""
        return self.taken > 0.0


@dataclass
class Demand:
    """Tasks to do: ``given`` ones in order of time, and with ``endless`` new ones for whoever is idle."""

    given: list[Task] = field(default_factory=list)
    endless: bool = True
    pause: float = 20.0  # Mean time between two endless tasks of a truck [s]
    visits: tuple[Visit, ...] = ()
    """Of a recorded fleet: each truck goes on as recorded ones did, and nothing else is asked of it."""
    stands: Mapping[str, Stand] = field(default_factory=dict)
    """Places where the recorded trucks stood along the road."""
    left_out: list[Task] = field(default_factory=list)
    """Given ones that cannot be done: there is no room at one of their places."""


def random_load(rng: np.random.Generator, truck: Truck) -> float:
    """A payload between a tenth and all of the rated load [kg], most often half."""
    return round(float(rng.triangular(0.1, 0.5, 1.0)) * truck.chassis.rated_load, 1)


def random_visits(rng: np.random.Generator) -> tuple[tuple[float, float], tuple[float, float]]:
    """Dwell [s], log-normal, and height of the shelf [m], where a load is picked and where it is dropped."""
    stay, leave = (float(np.clip(rng.lognormal(np.log(22.0), 0.35), 12.0, 90.0)) for _ in range(2))
    pick, drop = (HEIGHTS[int(rng.integers(len(HEIGHTS)))] for _ in range(2))
    return (stay, leave), (pick, drop)


@dataclass(frozen=True)
class Drawn:
    """An endless task; ``ranks`` (P,): of the free places the lowest is taken; ``pause`` after it [s]."""

    task: Task
    ranks: Floats
    pause: float


class TaskStream:
    """Endless tasks: number k of a seed is the same task, whoever does it and whatever else is varied."""

    def __init__(self, seed: int, truck: Truck, places: int, pause: float) -> None:
        self.seed, self.truck, self.places, self.pause = seed, truck, places, pause
        self.drawn = 0

    def draw(self, now: float) -> Drawn:
        """The next task, its places still open."""
        rng = np.random.Generator(np.random.PCG64([self.seed, self.drawn]))
        self.drawn += 1
        load, pause = random_load(rng, self.truck), float(rng.exponential(self.pause))
        task = Task(None, "", "", load, now, *random_visits(rng))
        return Drawn(task, rng.random(self.places), pause)


def read_tasks(path: str | Path, site: Site, truck: Truck, seed: int = 0) -> list[Task]:
    """Tasks of a CSV whose columns are ``COLUMNS``; :class:`InputError` names the line at fault."""
    path = Path(path)
    rng = np.random.default_rng(seed)
    tasks = [_task(row, path, line, site, truck, rng) for line, row in _rows(path)]
    return sorted(tasks, key=lambda t: t.earliest)


def _rows(path: Path) -> Iterator[tuple[str, dict[str, str]]]:
    """The rows of a tasks file, each with its line."""
    try:
        text = read_whole(path, SETTINGS).decode("utf-8-sig")
        reader = csv.DictReader(io.StringIO(text, newline=""), restval="")
        _check_header(list(reader.fieldnames or ()), path)
        for row in reader:
            place = f"line {reader.line_num}"
            if None in row:
                raise InputError("has more fields than the header", where=path, place=place)
            yield place, row
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"not readable as CSV: {error}", where=path, do="write UTF-8 text") from None


def _check_header(names: list[str], path: Path) -> None:
    known = f"the columns are {', '.join(COLUMNS)}"
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"has the column {name!r} more than once", where=path, place="line 1", do=known)
        if name not in COLUMNS and difflib.get_close_matches(name, COLUMNS):
            do = nearest(name, COLUMNS)
            raise InputError(f"has an unknown column {name!r}", where=path, place="line 1", do=do)
    for name in ("from", "to"):
        if name not in names:
            raise InputError(f"has no column {name!r}", where=path, place="line 1", do=known)


def _task(
    row: dict[str, str], path: Path, place: str, site: Site, truck: Truck, rng: np.random.Generator
) -> Task:
    known = [p.id for p in site.places]
    for column in ("from", "to"):
        if row[column] not in known:
            do = nearest(row[column], known) if known else "add it to the site"
            raise InputError(f"no place {row[column]!r} on this site", where=path, place=place, do=do)
    payload = _number(row.get("payload"), 0.5 * truck.chassis.rated_load, "payload", path, place)
    if payload > truck.chassis.rated_load:
        raise InputError(
            f"{payload:g} kg is more than the truck's rated load of {truck.chassis.rated_load:g} kg",
            where=path, place=place, do="split the load or take a stronger truck",
        )  # fmt: skip
    earliest = _number(row.get("earliest"), 0.0, "earliest", path, place)
    given = (row.get("vehicle") or "").strip()
    vehicle = given if given not in ("", "any") else None
    return Task(vehicle, row["from"], row["to"], payload, earliest, *random_visits(rng))


def _number(text: str | None, default: float, name: str, path: Path, place: str) -> float:
    if text is None or not text.strip():
        return default
    try:
        value = float(text)
    except ValueError:
        raise InputError(f"{name} {text!r} is not a number", where=path, place=place) from None
    if not 0.0 <= value < np.inf:
        raise InputError(f"{name} {text!r} is negative or not finite", where=path, place=place)
    return value


def check_vehicles(tasks: Sequence[Task], names: Sequence[str]) -> None:
    """Raise where a task is for a truck that is not simulated."""
    for task in tasks:
        if task.vehicle is not None and task.vehicle not in names:
            raise InputError(
                f"a task is for vehicle {task.vehicle!r}, which is not simulated",
                do=nearest(task.vehicle, names),
            )


class TaskBook:
    """One line a task, numbered as given; ``of`` (V,) is the number that each truck has, -1: none."""

    def __init__(self, vehicles: Sequence[str]) -> None:
        self.vehicles, self.of = tuple(vehicles), np.full(len(vehicles), -1, np.int64)
        self.lines: list[dict[str, Any]] = []
        self._open: dict[Task, list[int]] = {}

    def give(self, task: Task, status: str = "waiting") -> None:
        """A task can be done from now on."""
        self._open.setdefault(task, []).append(len(self.lines))
        places = {"from_place": task.source, "to_place": task.target}
        self.lines.append({**places, "payload": task.payload, "earliest": task.earliest, "status": status})

    def assign(self, v: int, task: Task, now: float) -> None:
        """Truck ``v`` takes it."""
        self.of[v] = n = self._open[task].pop(0)
        self.lines[n] |= {"vehicle_id": self.vehicles[v], "status": "assigned", "assigned": now}

    def give_back(self, v: int, task: Task) -> None:
        """Truck ``v`` leaves it, not begun, to others."""
        bisect.insort(self._open[task], int(self.of[v]))
        self.lines[self.of[v]] |= {"vehicle_id": "", "status": "waiting", "assigned": NONE}
        self.of[v] = -1

    def heads_for(self, v: int, place: str) -> None:
        """Truck ``v`` brings its load to a place."""
        self.lines[self.of[v]]["to_place"] = place

    def picked(self, v: int, now: float) -> None:
        """Truck ``v`` has its load."""
        self.lines[self.of[v]] |= {"status": "loaded", "picked": now}

    def dropped(self, v: int, now: float) -> None:
        """Truck ``v`` has set its load down."""
        self.lines[self.of[v]] |= {"status": "done", "dropped": now}
        self.of[v] = -1

    def numbers(self, name: str) -> Floats:
        """A column; times [s] are negative where they have not come."""
        return np.array([line.get(name, NONE) for line in self.lines], dtype=np.float64)

    def columns(self, start: int) -> Columns:
        """The table of tasks; ``start`` of the simulation [us]."""

        def text(name: str) -> Labels:
            return Labels.of([line.get(name) or None for line in self.lines])

        def time(name: str) -> Ints:
            seconds = self.numbers(name)
            return np.where(seconds < 0.0, -1, start + np.rint(seconds * 1e6).astype(np.int64))

        return {
            "task": np.arange(len(self.lines)), "payload": self.numbers("payload"),
            **{name: text(name) for name in ("vehicle_id", "from_place", "to_place", "status")},
            **{name: time(name) for name in ("earliest", "assigned", "picked", "dropped")},
        }  # fmt: skip

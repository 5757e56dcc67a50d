"""What trucks are asked to do, fetch a load at one place and set it down at another; what became of it."""

import bisect
import csv
import difflib
import io
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.arguments import Between, moment
from fleetlog.core.arrays import Floats
from fleetlog.core.files import SETTINGS, read_whole
from fleetlog.core.site import Site
from fleetlog.core.trajectory import Labels
from fleetlog.core.truck import Truck
from fleetlog.core.words import count
from fleetlog.errors import InputError, nearest
from fleetlog.simulate.doors import Stand
from fleetlog.store.events import Columns

COLUMNS = ("vehicle", "from", "to", "payload", "earliest")
EXPORTED = {"vehicle_id": "vehicle", "from_place": "from", "to_place": "to"}  # As tasks.parquet has them
HEIGHTS = (0.3, 1.2, 2.4, 3.6)  # Of shelves that loads are taken from and set down on [m]
ENGAGE = 6.0  # To drive the forks under a load or out of it [s]
NONE = -1.0  # A time that has not come [s after the start]
LATER, LEFT_OUT = "later", "left out"


@dataclass(frozen=True)
class Task:
    """One load.

    ``vehicle`` None: any; ``source``, ``target`` places; ``payload`` kg; ``earliest`` s after the start;
    ``dwell`` (pick, drop) s, at least what the lift needs, ``on_road`` with the way into and out of the bay;
    ``height`` (pick, drop) m.  Of the free places an endless task takes the one of the lowest ``ranks``
    (P,); a truck takes no other for ``pause`` s after it."""

    vehicle: str | None
    source: str
    target: str
    payload: float
    earliest: float
    dwell: tuple[float, float] = (20.0, 20.0)
    height: tuple[float, float] = (1.2, 1.2)
    on_road: bool = False
    ranks: Floats = field(default_factory=lambda: np.zeros(0), compare=False)
    pause: float = field(default=0.0, compare=False)


@dataclass(frozen=True)
class Visit:
    """A recorded truck stood at a place. ``begin`` time of day [s], ``dwell`` [s], ``height`` of the forks
    [m]; ``taken`` is the load that it took up there [kg], negative where it set one down; ``next`` is the
    number of the visit that the same truck made after it, -1: none; ``way``: edges over which it came."""

    place: str
    begin: float
    dwell: float
    height: float
    taken: float
    next: int = -1
    way: tuple[str, ...] = ()


@dataclass
class Demand:
    """Tasks to do: ``given`` ones in order of time, and with ``endless`` new ones for whoever is idle."""

    given: list[Task] = field(default_factory=list)
    endless: bool = True
    pause: float = 20.0  # Mean time between two endless tasks of a truck [s]
    visits: tuple[Visit, ...] = ()
    """Of a recorded fleet: each truck goes on as recorded ones did, and nothing else is asked of it."""
    stands: Mapping[str, Stand] = field(default_factory=dict)  # By place: trucks stood along the road
    notes: list[str] = field(default_factory=list)  # How it came about
    left_out: list[Task] = field(default_factory=list)
    """Given ones that cannot be done: there is no room at one of their places."""


def random_visits(rng: np.random.Generator) -> tuple[tuple[float, float], tuple[float, float]]:
    """Dwell [s], log-normal, and height of the shelf [m], where a load is picked and where it is dropped."""
    stay, leave = (float(np.clip(rng.lognormal(np.log(22.0), 0.35), 12.0, 90.0)) for _ in range(2))
    pick, drop = (HEIGHTS[int(rng.integers(len(HEIGHTS)))] for _ in range(2))
    return (stay, leave), (pick, drop)


def endless_tasks(seed: int, truck: Truck, places: int, pause: float) -> Iterator[Task]:
    """Tasks whose places are open: number k of a seed is the same, whoever does it, whatever is varied."""
    for number in itertools.count():
        rng = np.random.Generator(np.random.PCG64([seed, number]))
        load = round(float(rng.triangular(0.1, 0.5, 1.0)) * truck.chassis.rated_load, 1)
        rest, (dwell, height) = float(rng.exponential(pause)), random_visits(rng)
        yield Task(None, "", "", load, 0.0, dwell, height, ranks=rng.random(places), pause=rest)


def read_tasks(path: str | Path, site: Site, truck: Truck, seed: int = 0, start: int = 0) -> Demand:
    """Tasks of a CSV whose columns are ``COLUMNS``, or of an export but those whose place to go to is open;
    ``start`` of the simulation [us]. :class:`InputError` names the line at fault."""
    path, data, place = Path(path), read_whole(Path(path), SETTINGS), "line 1"
    tasks, rng, known = [], np.random.default_rng(seed), f"the columns are {', '.join(COLUMNS)}"
    try:
        reader = csv.DictReader(io.StringIO(data.decode("utf-8-sig"), newline=""), restval="")
        names = reader.fieldnames = [EXPORTED.get(name, name) for name in reader.fieldnames or ()]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"has the column {name!r} more than once", do=known)
            if name not in COLUMNS and difflib.get_close_matches(name, COLUMNS):
                raise InputError(f"has an unknown column {name!r}", do=nearest(name, COLUMNS))
        if missing := {"from", "to"} - {*names}:
            raise InputError(f"has no column {min(missing)!r}", do=known)
        for row in reader:
            place = f"line {reader.line_num}"
            tasks += [_task(row, site, truck, rng, start) if row["to"] or "status" not in row else None]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"not readable as CSV: {error}", where=path, do="write UTF-8 text") from None
    except InputError as error:
        raise InputError(error.what, where=path, place=place, do=error.do) from None
    note = f"{count(tasks.count(None), 'task')} left out: no place to go to was chosen yet"
    given = sorted(filter(None, tasks), key=lambda t: t.earliest)
    return Demand(given, endless=False, notes=[note] if None in tasks else [])


def _task(row: dict[str, str], site: Site, truck: Truck, rng: np.random.Generator, start: int) -> Task:
    if None in row:
        raise InputError("has more fields than the header")
    known = [p.id for p in site.places]
    for name in (row["from"], row["to"]):
        if name not in known:
            do = nearest(name, known) if known else "add it to the site"
            raise InputError(f"no place {name!r} on this site", do=do)
    if row["from"] == row["to"]:
        raise InputError(f"from and to are both {row['to']!r}", do="name two places")
    payload = _number(row, "payload", 0.5 * truck.chassis.rated_load)
    earliest = _number(row, "earliest", 0.0, start)
    given = (row.get("vehicle") or "").strip()
    vehicle = given if given not in ("", "any") else None
    return Task(vehicle, row["from"], row["to"], payload, earliest, *random_visits(rng))


def _number(row: dict[str, str], name: str, default: float, start: int = 0) -> float:
    text = (row.get(name) or "").strip()
    try:
        return Between(0.0)((moment(text) - start) / 1e6 if ":" in text else text or default)
    except ValueError as error:
        do = f"write {'kilograms' if name == 'payload' else 'seconds, or a time in UTC'}"
        raise InputError(f"{name} {error}", do=do) from None


def check_doable(tasks: Sequence[Task], loads: Mapping[str, float]) -> None:
    """Raise where a task is for a truck that is not simulated, or too heavy for the ``loads`` [kg] of all."""
    strongest = max(loads.values())
    for task in tasks:
        if task.vehicle is not None and task.vehicle not in loads:
            what = f"a task is for vehicle {task.vehicle!r}, which is not simulated"
            raise InputError(what, do=nearest(task.vehicle, loads))
        most, who = strongest if task.vehicle is None else loads[task.vehicle], task.vehicle or "a truck"
        if task.payload > most:
            what = f"a load of {task.payload:g} kg is more than the {most:g} kg that {who} carries"
            raise InputError(what, do="split the load or take a stronger truck")


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

    def note(self, v: int, **what: float | str) -> None:
        """What became of the task of truck ``v``; it is rid of it when that is done."""
        self.lines[self.of[v]] |= what
        if what.get("status") == "done":
            self.of[v] = -1

    def numbers(self, name: str) -> Floats:
        """A column; times [s] are negative where they have not come."""
        return np.array([line.get(name, NONE) for line in self.lines], dtype=np.float64)

    def columns(self, start: int) -> Columns:
        """The table of tasks; ``start`` of the simulation [us]."""
        columns: dict[str, Any] = {"task": np.arange(len(self.lines)), "payload": self.numbers("payload")}
        for name in ("vehicle_id", "from_place", "to_place", "status"):
            columns[name] = Labels.of([line.get(name) or None for line in self.lines])
        for name in ("earliest", "assigned", "picked", "dropped"):
            seconds = self.numbers(name)
            columns[name] = np.where(seconds < 0.0, -1, start + np.rint(seconds * 1e6).astype(np.int64))
        return columns

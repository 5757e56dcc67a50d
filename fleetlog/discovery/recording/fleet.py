"""The recording in memory: one trajectory per vehicle and day, and what it lacks."""

import itertools
import math
import tomllib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from statistics import median
from typing import TypeVar

import numpy as np

from fleetlog import engines
from fleetlog.core.arrays import Floats, Ints
from fleetlog.core.network import Network
from fleetlog.core.site import Site
from fleetlog.core.trajectory import Trajectory
from fleetlog.core.truck import Truck
from fleetlog.discovery.recording.blocks import TRIP, Block, block, merged
from fleetlog.discovery.recording.day import Day, renewed
from fleetlog.discovery.recording.splits import trips_apart
from fleetlog.errors import DataError
from fleetlog.physics.motion import measured_channels
from fleetlog.store import Dataset

COLUMNS = (
    "x", "y", "z", "heading", "speed", "edge_id", "edge_offset", "trip_id", "payload", "fork_height",
    "battery_power", "soc", "ambient_temperature", "lateral_offset",
)  # fmt: skip

FEWEST_ROWS = 8  # A shorter vehicle-day says nothing
GOLDEN = 0.5 * (5.0**0.5 - 1.0)  # Multiples of it lie far apart in one, however many there are
EVENLY = 100_000  # Rows in all that stand for the others, at least
ROW_COST = 1e-5  # What a look at all rows takes, at least [s each]
R = TypeVar("R")


@dataclass(frozen=True)
class Fleet:
    """Vehicle-days of a recording on a site, with the truck that the model takes for all of them. ``lag`` and
    ``scale`` (by vehicle) put the clock of the power channel and the scale of the speed channel right;
    ``interval`` (by vehicle) is that over which the logger took the mean of power [s]."""

    days: list[Day]
    vehicles: tuple[str, ...]
    network: Network | None
    truck: Truck
    lag: dict[int, float]
    scale: dict[int, float]
    load_with_power: bool = False
    interval: dict[int, float] = field(default_factory=dict)
    held: dict[int, float] = field(default_factory=dict)
    """For how long each value of power is repeated, by vehicle [s]."""
    speed_late: dict[int, float] = field(default_factory=dict)
    """By how much the speed channel runs behind the positions, by vehicle [s]."""
    left_out: tuple[str, ...] = ()
    """Vehicles whose log lacks the payload that others have: their loads would pass for missing physics."""
    speed_from_positions: frozenset[int] = frozenset()
    """Vehicles whose speed was derived on import: it can say nothing of a faulty speed channel."""
    rarely_placed: frozenset[int] = frozenset()
    """Vehicles whose position is updated on few rows only: their speed cannot be held against it."""

    def has(self, column: str) -> bool:
        """Whether any vehicle-day knows the column."""
        return any(column in d.known for d in self.days)

    def of(self, vehicle: int | None) -> list[Day]:
        """Return the days of a vehicle; of one without any, or of none, those of all."""
        return [d for d in self.days if d.vehicle == vehicle] or self.days

    def each(self, work: Callable[[int], R]) -> Iterator[R]:
        """Yield what a function makes of every date, in their order, on the engine in use."""
        cost, run = ROW_COST * self.rows, engines.current().run
        yield from run(work, self.dates, lambda date: f"date={np.datetime64(date, 'D')}", cost=cost)

    def on(self, date: int) -> Iterator[tuple[int, Day]]:
        """Yield the vehicle-days of a date with their numbers."""
        return ((k, d) for k, d in enumerate(self.days) if d.date == date)

    def some(self, most: int) -> frozenset[int]:
        """Return the numbers of so many days of every vehicle at most, far apart."""
        own = [[k for k, d in enumerate(self.days) if d.vehicle == v] for v in range(len(self.vehicles))]
        return frozenset(k for days in own for k in np.array(days)[far_apart(len(days))[:most]].tolist())

    def each_block(self, date: int) -> Iterator[tuple[int, Block]]:
        """Yield the vehicle-days of a date as finely stepped motion, with their numbers."""
        return ((k, self.block(d.vehicle, d.load())) for k, d in self.on(date))

    def block(self, vehicle: int, trajectory: Trajectory) -> Block:
        """Return one vehicle-day."""
        lag, scale = self.lag.get(vehicle, 0.0), self.scale.get(vehicle, 1.0)
        load_lags = self.load_with_power
        if late := self.speed_late.get(vehicle):
            time = trajectory.seconds()
            speed = np.interp(time + late, time, trajectory.floats("speed"))
            trajectory = trajectory.with_columns(speed=speed)
        return block(trajectory, vehicle, self.network, self.truck, lag=lag, scale=scale, load_lags=load_lags)

    def merged(self, block: Block) -> Block:
        """Return one whose rows say something new of power each."""
        return merged(block, self.interval.get(block.vehicle, 0.0), self.held.get(block.vehicle, 0.0))

    def thinned(self, vehicle: int, rows: Trajectory) -> Block:
        """Return every second row of a vehicle-day, or every second value of its power."""
        if vehicle not in self.held:
            return self.merged(self.block(vehicle, rows[::2]))
        power = rows.floats("battery_power")
        begin = np.flatnonzero(renewed(power))[::2]
        size = np.diff(np.append(begin, len(power)))
        held = self.held[vehicle]
        rarer = replace(self, held={vehicle: 2.0 * held}, lag={vehicle: self.lag[vehicle] + 0.5 * held})
        rows = rows.with_columns(battery_power=np.repeat(power[begin], size))
        return rarer.merged(rarer.block(vehicle, rows))

    @cached_property
    def dates(self) -> tuple[int, ...]:
        """Days since 1970 that have rows."""
        return tuple(sorted({d.date for d in self.days}))

    @cached_property
    def begins(self) -> dict[tuple[int, int], float]:
        """Time of the first row of each vehicle and day [s since 1970]."""
        return {(d.vehicle, d.date): d.begin for d in reversed(self.days)}

    @cached_property
    def own_trips(self) -> tuple[int, ...]:
        """Codes of trips that may have something of their own; none where places or many trips say more."""
        return tuple(v * TRIP + k for v, k in trips_apart(self.days))

    @property
    def trip_names(self) -> tuple[str, ...]:
        """Names of these trips: the number, after the vehicle where there are several."""
        front = [f"{v}:" if len(self.vehicles) > 1 else "" for v in self.vehicles]
        return tuple(f"{front[c // TRIP]}{c % TRIP}" for c in self.own_trips)

    def moments(self, count: int) -> Floats:
        """Return the (count + 1,) ends of as many slots of equal recorded time [s since 1970]."""
        return np.quantile(self._times, np.linspace(0.0, 1.0, count + 1))

    @cached_property
    def span(self) -> float:
        """Time from the first row to the last of all [s]."""
        return float(np.ptp(self._times))

    @cached_property
    def _times(self) -> Floats:
        """Times of the rows that stand for all [s since 1970]."""
        return np.concatenate([d.few.time for d in self.days]) * 1e-6

    @cached_property
    def trips(self) -> int:
        """Number of trips."""
        return sum(len(d.trips) for d in self.days)

    @cached_property
    def seconds(self) -> float:
        """Recorded time in all [s]."""
        return sum(d.end - d.begin for d in self.days)

    @cached_property
    def rows(self) -> int:
        """Rows in all."""
        return sum(d.rows for d in self.days)

    @cached_property
    def step(self) -> float:
        """Median time between rows [s]."""
        return float(np.median([d.step for d in self.days]))

    @cached_property
    def steps(self) -> Floats:
        """Median time between rows of each vehicle [s]: every truck has its own logger."""
        return np.array([np.median([d.step for d in self.of(v)]) for v in range(len(self.vehicles))])

    @cached_property
    def updates(self) -> Floats:
        """Median time between two values of power of each vehicle [s]."""
        return np.maximum(self.steps, [self.held.get(v, 0.0) for v in range(len(self.vehicles))])

    @cached_property
    def loggers(self) -> list[list[int]]:
        """Vehicles by kind of logger; rows of one kind lie about as far apart, and tell the same."""
        kinds: dict[tuple[float, bool, bool], list[int]] = {}
        for v in sorted({d.vehicle for d in self.days}):
            apart = round(2.0 * math.log2(max(self.updates[v], 1e-3)))  # To a fifth either way
            kinds.setdefault((apart, v in self.interval, v in self.speed_from_positions), []).append(v)
        return list(kinds.values())

    def sparse(self, window: float) -> frozenset[int]:
        """Return the vehicles whose rows are so far apart [s]: between them they set off and stop unseen."""
        return frozenset(v for kind in self.loggers for v in kind if self.steps[v] >= window)

    @property
    def update(self) -> float:
        """Median time between two values of power [s]."""
        return max([self.step, *self.held.values()])


def read_fleet(data: Dataset, truck: Truck, site: Site | None = None, without: Sequence[str] = ()) -> Fleet:
    """Return the vehicle-days of a dataset, of which the columns that matter here are read, but for some."""
    columns = [c for c in COLUMNS if c not in without]
    network = (site or data.site).network
    vehicles, every = tuple(data.vehicles), 1 << max(0, (data.rows // EVENLY).bit_length() - 1)
    asked = list(itertools.product(range(len(vehicles)), data.dates))
    work = partial(_day, data, columns, vehicles, every)
    name, cost = (lambda day: str(data.folder_of(vehicles[day[0]], day[1]))), ROW_COST * data.rows
    days = [d for d in engines.current().run(work, asked, name, cost=cost) if d is not None]
    if not days:
        raise DataError("no vehicle has rows with a speed", do="import logs that carry speed or positions")
    weighed = {d.vehicle for d in days if "payload" in d.known}
    left_out = tuple(vehicles[v] for v in sorted({d.vehicle for d in days} - weighed)) if weighed else ()
    days = [d for d in days if not weighed or d.vehicle in weighed]
    rarely = frozenset(d.vehicle for d in days if network is None and d.seldom)
    no_channel = frozenset(d.vehicle for d in days if "speed" not in d.known)
    repeats = {d.vehicle: d.held for d in days if d.held}
    return Fleet(
        days, vehicles, network, truck, {}, {}, left_out=left_out, speed_from_positions=no_channel,
        rarely_placed=rarely, held=repeats,
    )  # fmt: skip


def far_apart(count: int) -> Ints:
    """Return the numbers up to a count in an order in which the first few lie far apart."""
    return np.argsort(np.arange(count) * GOLDEN % 1.0)


def _rows(data: Dataset, vehicle: str, date: str, columns: Sequence[str]) -> Trajectory:
    return measured_channels(data.here().read(vehicle, date, columns), data.meta)


def _day(
    data: Dataset, columns: Sequence[str], vehicles: tuple[str, ...], every: int, which: tuple[int, str]
) -> Day | None:
    """What is kept of a vehicle-day; None of one that says nothing."""
    load = partial(_rows, data, vehicles[which[0]], which[1], columns)
    rows = load()
    told = len(rows) >= FEWEST_ROWS and (rows.has("speed") or rows.has("x"))
    return Day(which[0], rows, load, every) if told else None


NOTES = tomllib.loads(Path(__file__).with_name("notes.toml").read_text(encoding="utf-8"))
"""What a recording lacks, and what that costs, by the columns that it lacks; and what else it hides."""


def absences(fleet: Fleet, once: bool = False) -> list[str]:
    """What the recording lacks, and what that costs; ``once`` where each place is passed once."""
    lacks = [column for column in NOTES["lacks"] if not any(fleet.has(c) for c in column.split(" and "))]
    out = [NOTES["lacks"][column] for column in lacks if column != "edge_id" or "x" not in lacks]
    if once:
        out.append(NOTES["apart" if fleet.own_trips else "once"])
    if fleet.left_out:
        out.append(f"trucks left out, as no payload is logged: {', '.join(fleet.left_out)}")
    powered, charged = ({d.vehicle for d in fleet.days if c in d.known} for c in ("battery_power", "soc"))
    if powered and (mute := sorted(charged - powered)):
        names = ", ".join(fleet.vehicles[v] for v in mute)
        out.append(f"state of charge not judged, as no battery power is logged: {names}")
    if fleet.speed_late:
        late = median(fleet.speed_late.values())
        names = ", ".join(fleet.vehicles[v] for v in fleet.speed_late)
        way = f"{abs(late):.1f} s {'behind' if late > 0.0 else 'ahead of'} the positions"
        out.append(f"the speed channel runs {way}, which is corrected: {names}")
    if fleet.held:
        names = ", ".join(fleet.vehicles[v] for v in fleet.held)
        out.append(f"power changes every {fleet.update:.1f} s only, and is repeated in between: {names}")
    if fleet.rarely_placed:
        out.append(NOTES["rarely"])
    if len({d.vehicle for d in fleet.days}) == 1:
        out.append(NOTES["alone"])
    return out

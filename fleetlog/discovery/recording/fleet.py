"""The recording in memory: one trajectory per vehicle and day, and what it lacks."""

import itertools
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.core.network import Network
from fleetlog.core.site import Site
from fleetlog.core.trajectory import Trajectory
from fleetlog.core.truck import Truck
from fleetlog.discovery.recording.blocks import DAY, TRIP, Block, block
from fleetlog.discovery.recording.shelf import Shelf
from fleetlog.discovery.recording.splits import trips_apart
from fleetlog.errors import DataError
from fleetlog.physics.motion import measured_channels
from fleetlog.physics.motion.rows import updates
from fleetlog.store import Dataset

COLUMNS = (
    "x", "y", "z", "heading", "speed", "edge_id", "edge_offset", "trip_id", "payload", "fork_height",
    "battery_power", "soc", "ambient_temperature", "lateral_offset",
)  # fmt: skip

SELDOM, SEVERAL = 5.0, 2.5
"""Seconds and rows between updates of positions from which on these are too few to hold a speed against."""
LARGE = 500_000  # Rows whose motion is kept in memory, 600 bytes each, and given to other processes
FEWEST_ROWS = 8  # A shorter vehicle-day says nothing


@dataclass(frozen=True)
class Fleet:
    """Vehicle-days of a recording on a site, with the truck that the model takes for all of them. ``lag`` and
    ``scale`` (by vehicle) put the clock of the power channel and the scale of the speed channel right;
    ``interval`` (by vehicle) is that over which the logger took the mean of power [s]."""

    days: list[tuple[int, Trajectory]]
    vehicles: tuple[str, ...]
    network: Network | None
    truck: Truck
    lag: dict[int, float]
    scale: dict[int, float]
    load_with_power: bool = False
    interval: dict[int, float] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()
    """Vehicles whose log lacks the payload that others have: their loads would pass for missing physics."""
    speed_from_positions: frozenset[int] = frozenset()
    """Vehicles whose speed was derived on import: it can say nothing of a faulty speed channel."""
    rarely_placed: frozenset[int] = frozenset()
    """Vehicles whose position is updated on few rows only: their speed cannot be held against it."""

    def has(self, column: str) -> bool:
        """Whether any vehicle-day knows the column."""
        return any(t.has(column) for _, t in self.days)

    _kept: dict[int, int] = field(default_factory=dict, init=False, repr=False)
    """Where the motion of a vehicle-day is on the shelf, by its number."""

    @property
    def large(self) -> bool:
        """Whether what is made of its rows has no room in memory."""
        return self.rows > LARGE

    def each_block(self, date: int | None = None) -> Iterator[Block]:
        """Yield all vehicle-days, or those of a ``date`` (days since 1970), as finely stepped motion."""
        for k, (vehicle, trajectory) in enumerate(self.days):
            if date is not None and trajectory.time[0] // DAY != date:
                continue
            if k in self._kept:
                yield self._shelf[self._kept[k]]
                continue
            found = self.block(vehicle, trajectory)
            self._kept[k] = len(self._shelf)
            self._shelf.add(replace(found, fresh=None))  # It can be made anew.
            yield found

    @cached_property
    def _shelf(self) -> Shelf[Block]:
        return Shelf(self.large)

    def block(self, vehicle: int, trajectory: Trajectory) -> Block:
        """Return one vehicle-day."""
        lag, scale = self.lag.get(vehicle, 0.0), self.scale.get(vehicle, 1.0)
        return block(
            trajectory, vehicle, self.network, self.truck, lag=lag, scale=scale,
            load_lags=self.load_with_power, mean_of=self.interval.get(vehicle, 0.0),
        )  # fmt: skip

    @cached_property
    def dates(self) -> tuple[int, ...]:
        """Days since 1970 that have rows."""
        return tuple(sorted({int(t.time[0] // DAY) for _, t in self.days}))

    @cached_property
    def begins(self) -> dict[tuple[int, int], float]:
        """Time of the first row of each vehicle and day [s since 1970]."""
        out: dict[tuple[int, int], float] = {}
        for vehicle, t in self.days:
            key = (vehicle, int(t.time[0] // DAY))
            out[key] = min(out.get(key, np.inf), float(t.time[0]) * 1e-6)
        return out

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
        """Times of some 5,000 rows a vehicle-day [s since 1970]."""
        return np.concatenate([t.time[:: max(1, len(t) // 5000)] for _, t in self.days]) * 1e-6

    @cached_property
    def trips(self) -> int:
        """Number of trips."""
        return sum(len(np.unique(t.trip_ids())) for _, t in self.days)

    @cached_property
    def seconds(self) -> float:
        """Recorded time in all [s]."""
        return sum(float(t.time[-1] - t.time[0]) * 1e-6 for _, t in self.days)

    @cached_property
    def rows(self) -> int:
        """Rows in all."""
        return sum(len(t) for _, t in self.days)

    @cached_property
    def step(self) -> float:
        """Median time between rows [s]."""
        return float(np.median([np.median(np.diff(t.time)) for _, t in self.days if len(t) > 2])) * 1e-6


def read_fleet(data: Dataset, truck: Truck, site: Site | None = None, without: Sequence[str] = ()) -> Fleet:
    """Return the columns that matter here, but for some, vehicle-day by vehicle-day."""
    columns = [c for c in COLUMNS if c not in without]
    network = (site or data.site).network
    days, vehicles = [], tuple(data.vehicles)
    for (v, vehicle), date in itertools.product(enumerate(vehicles), data.dates):
        trajectory = data.read(vehicle, date, columns)
        if len(trajectory) >= FEWEST_ROWS and (trajectory.has("speed") or trajectory.has("x")):
            days.append((v, measured_channels(trajectory, data.meta)))
    if not days:
        raise DataError("no vehicle has rows with a speed", do="import logs that carry speed or positions")
    weighed = {v for v, t in days if t.has("payload")}
    left_out = tuple(vehicles[v] for v in sorted({v for v, _ in days} - weighed)) if weighed else ()
    days = [(v, t) for v, t in days if not weighed or v in weighed]
    rarely: frozenset[int] = frozenset()
    if network is None:
        rarely = frozenset(v for v, t in days if t.has("x") and t.has("speed") and seldom(t))
    no_channel = frozenset(v for v, t in days if not t.has("speed"))
    return Fleet(
        days, vehicles, network, truck, {}, {}, left_out=left_out, speed_from_positions=no_channel,
        rarely_placed=rarely,
    )  # fmt: skip


def seldom(t: Trajectory) -> bool:
    """Return whether positions come far more rarely than rows, and rarely."""
    speed, time = t.floats("speed"), t.seconds()
    rows = np.flatnonzero(updates(time, t.floats("x"), t.floats("y"), speed) & (np.nan_to_num(speed) > 0.0))
    few = len(rows) < 2 or float(np.median(np.diff(time[rows]))) <= SELDOM
    return not few and float(np.median(np.diff(rows))) > SEVERAL


NOTES = tomllib.loads(Path(__file__).with_name("notes.toml").read_text(encoding="utf-8"))
"""What a recording lacks, and what that costs, by the columns that it lacks; and what else it hides."""


def absences(fleet: Fleet, once: bool = False) -> list[str]:
    """What the recording lacks, and what that costs; ``once`` where each place is passed once."""
    lacks = [column for column in NOTES["lacks"] if not any(fleet.has(c) for c in column.split(" and "))]
    out = [NOTES["lacks"][column] for column in lacks if column != "edge_id" or "x" not in lacks]
    if once:
        out.append(NOTES["apart" if fleet.own_trips else "once"])
    if fleet.left_out:
        out.append(f"left out, since their logs carry no payload: {', '.join(fleet.left_out)}")
    powered, charged = ({v for v, t in fleet.days if t.has(c)} for c in ("battery_power", "soc"))
    if powered and (mute := sorted(charged - powered)):
        names = ", ".join(fleet.vehicles[v] for v in mute)
        out.append(f"state of charge not judged, since their logs carry no battery power: {names}")
    if fleet.rarely_placed:
        out.append(NOTES["rarely"])
    if len({v for v, _ in fleet.days}) == 1:
        out.append(NOTES["alone"])
    return out

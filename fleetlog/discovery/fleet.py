"""The recording in memory: one trajectory per vehicle and day, and what it lacks."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fleetlog.core.network import Network
from fleetlog.core.site import Site
from fleetlog.core.trajectory import Trajectory
from fleetlog.core.truck import Truck
from fleetlog.discovery.positions import placed, seldom
from fleetlog.discovery.replay import Block, blocks
from fleetlog.errors import DataError
from fleetlog.store import Dataset

COLUMNS = (
    "x", "y", "heading", "speed", "edge_id", "edge_offset", "trip_id", "payload", "fork_height", "battery_power",
    "soc", "ambient_temperature",
)  # fmt: skip

SPARSE = 2.5
"""Time between rows from which on a truck may set off or stop between two of them, unseen [s]."""
ABRUPT = 0.3
"""Change of speed from row to row, as a share of speed, from which on it does (root mean squares)."""
MOST_ROWS = 1_200_000
"""Rows that are looked at: some 1.8 GB of memory."""


@dataclass(frozen=True)
class Fleet:
    """Vehicle-days of a recording on a site, with the truck that the model takes for all of them.

    ``lag`` and ``scale`` (by vehicle) put the clock of the power channel and the scale of the speed channel right.
    """

    days: list[tuple[int, Trajectory]]
    vehicles: tuple[str, ...]
    network: Network | None
    truck: Truck
    lag: dict[int, float]
    scale: dict[int, float]
    load_with_power: bool = False
    left_out: tuple[str, ...] = ()
    """Vehicles whose log lacks the payload that others have: their loads would pass for missing physics."""
    speed_from_positions: frozenset[int] = frozenset()
    """Vehicles whose speed was derived on import: it can say nothing of a faulty speed channel."""
    rarely_placed: frozenset[int] = frozenset()
    """Vehicles whose position is updated on few rows only: their speed cannot be held against it."""
    every: int = 1
    """Of so many vehicle-days one is looked at."""

    def has(self, column: str) -> bool:
        """Whether any vehicle-day knows the column."""
        return any(t.has(column) for _, t in self.days)

    @cached_property
    def sparse(self) -> bool:
        """Whether so much happens between rows that power and travel times cannot be added up from them.

        A truck that sets off and stops every minute moves unseen between rows five seconds apart, a car on a motorway does not.
        """
        speeds = [np.nan_to_num(t.floats("speed")) for _, t in self.days]
        change = sum(float((np.diff(v) ** 2).sum()) for v in speeds)
        return self.step > SPARSE and change > ABRUPT**2 * sum(float((v**2).sum()) for v in speeds)

    @cached_property
    def blocks(self) -> list[Block]:
        """Uninterrupted pieces as finely stepped motion; the largest thing in memory, so all channels share it."""
        return list(self.each_block())

    def each_block(self) -> Iterator[Block]:
        """The same one after the other, for a single look."""
        for vehicle, trajectory in self.days:
            lag, scale = self.lag.get(vehicle, 0.0), self.scale.get(vehicle, 1.0)
            yield from blocks(
                trajectory, vehicle, self.network, self.truck.chassis.turn_radius,
                lag=lag, scale=scale, load_with_power=self.load_with_power,
            )  # fmt: skip

    @cached_property
    def rows(self) -> int:
        """Rows in all."""
        return sum(len(t) for _, t in self.days)

    @cached_property
    def step(self) -> float:
        """Median time between rows [s]."""
        return float(np.median([np.median(np.diff(t.time)) for _, t in self.days if len(t) > 2])) * 1e-6


def read_fleet(dataset: Dataset, truck: Truck, site: Site | None = None, most: int = MOST_ROWS) -> Fleet:
    """The columns that matter here, vehicle-day by vehicle-day; of more than ``most`` rows a sample of whole vehicle-days."""
    network = (site or dataset.site).network
    days, vehicles = [], tuple(dataset.vehicles)
    every = max(1, math.ceil(dataset.rows / most))
    for (v, vehicle), (d, date) in itertools.product(enumerate(vehicles), enumerate(dataset.dates)):
        # On a diagonal, so that every vehicle and every day of the week stays in.
        if (v + d) % every == 0:
            trajectory = dataset.read(vehicle, date, COLUMNS)
            if len(trajectory) >= 8 and trajectory.has("speed"):
                days.append((v, trajectory))
    if not days:
        raise DataError("no vehicle has rows with a speed", do="import logs that carry speed or positions")
    weighed = {v for v, t in days if t.has("payload")}
    left_out = tuple(vehicles[v] for v in sorted({v for v, _ in days} - weighed)) if weighed else ()
    days = [(v, t) for v, t in days if not weighed or v in weighed]
    rarely: frozenset[int] = frozenset()
    if network is None:
        rarely = frozenset(v for v, t in days if t.has("x") and seldom(t))
        days = [(v, placed(t) if t.has("x") else t) for v, t in days]
    derived = dataset.meta.get("summary", {}).get("derived_by_vehicle", {})
    no_channel = frozenset(i for i, v in enumerate(vehicles) if "speed" in derived.get(v, ()))
    return Fleet(
        days,
        vehicles,
        network,
        truck,
        {},
        {},
        left_out=left_out,
        speed_from_positions=no_channel,
        rarely_placed=rarely,
        every=every,
    )


ABSENCES = {
    "edge_id": "no road network: places are squares of the floor, and nothing is said of speed limits, turns or waiting",
    "payload": "no payload: where masts work, each trip may have had any load, so that nothing is said of what looks like mass",
    "fork_height": "no fork height: lifting is not replayed; where power jumps at standstill, standstills are left out",
    "payload and fork_height": "no payload and no fork height: a wait on the way cannot be told from work",
    "ambient_temperature": "no ambient temperature: heating and cooling cannot be told from a load that follows the hour",
    "soc": "no state of charge: losses inside the battery stay unseen",
    "battery_power": "no battery power: energy is read from the state of charge, whose coarse steps hide what is short",
}  # fmt: skip


def absences(fleet: Fleet) -> list[str]:
    """What the recording lacks, and what that costs."""
    out = [text for column, text in ABSENCES.items() if not any(fleet.has(c) for c in column.split(" and "))]
    if fleet.left_out:
        out.append(f"left out, since their logs carry no payload: {', '.join(fleet.left_out)}")
    if fleet.rarely_placed:
        out.append(
            "positions come on few rows: between them places are known in outline, and speed is not held against them"
        )
    if fleet.sparse:
        out.append(
            f"a row every {fleet.step:.0f} s: setting off, turning and braking fall between rows, so nothing is said of travel "
            "times, and what differs by less than some ten per cent stays unseen"
        )
    elif fleet.step > SPARSE:
        out.append(
            f"a row every {fleet.step:.0f} s: braking and setting off fall between rows and are known in outline only"
        )
    if fleet.sparse and fleet.has("soc") and fleet.has("battery_power"):
        out.append("power between the rows is not known: energy is read from the state of charge instead")
    if len({v for v, _ in fleet.days}) == 1:
        out.append("one vehicle: what is wrong with it cannot be told from what is wrong with its kind")
    if fleet.every > 1:
        out.append(
            f"one of every {fleet.every} vehicle-days was looked at: more rows than memory should hold"
        )
    return out

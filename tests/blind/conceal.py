"""Effects written into a recording that was not made here: what a foreign clean log says of them.

    python conceal.py FOLDER [EFFECT ...]

FOLDER holds recorded.csv.gz of a clean recording, site.toml and truck.toml; what is diagnosed is printed. The state of
charge falls by what the power adds. A force acts through the drive as the truck file has it; whether the wheels drive
or brake is told by speed and acceleration, as the noise of the power would turn small values about.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from degrade import diagnosed_as, main

from fleetlog.core.truck import Truck, load_truck

GRAVITY, DEGREE = 9.81, 111_200.0  # [m/s2], metres of a degree

Floats = np.ndarray[Any, np.dtype[np.float64]]
Mask = np.ndarray[Any, np.dtype[np.bool_]]


@dataclass(frozen=True)
class Log:
    """Columns (n,) of a recording: time [s] and the share of it, vehicle, speed [m/s], way to the north and the east [m],
    weight with the load [N], height of the forks [m], temperature [degC], power [W] and state of charge; ``own`` are the
    rows of each vehicle."""

    truck: Truck
    time: Floats
    share: Floats
    vehicle: np.ndarray[Any, Any]
    own: list[np.ndarray[Any, np.dtype[np.intp]]]
    speed: Floats
    north: Floats
    east: Floats
    weight: Floats
    forks: Floats
    temperature: Floats
    power: Floats
    soc: Floats

    @property
    def first(self) -> Mask:
        """Whether a row is of the first truck."""
        return np.asarray(self.vehicle == min(self.vehicle))

    @property
    def half(self) -> Mask:
        """Whether a row is of every other truck."""
        return np.isin(self.vehicle, np.unique(self.vehicle)[::2])

    @property
    def there(self) -> Mask:
        """Whether a row is in the northern part of the site, where three rows of ten are."""
        return self.north > np.nanpercentile(self.north, 70.0)

    @property
    def force(self) -> Floats:
        """That of the wheels on a level floor [N]."""
        return self.weight * (self.truck.resistance.rolling + self.rate(self.speed) / GRAVITY)

    @property
    def northward(self) -> Floats:
        """The cosine of the heading from north."""
        ways = self.rate(self.north), self.rate(self.east)
        return np.where(self.speed > 0.3, ways[0] / np.maximum(np.hypot(*ways), 1e-9), 0.0)

    def along(self, change: Callable[[Floats, Floats], Floats], column: Floats) -> Floats:
        """A column changed by a function of time and values, vehicle by vehicle."""
        out = np.array(column)
        for rows in self.own:
            out[rows] = change(self.time[rows], column[rows])
        return out

    def rate(self, column: Floats) -> Floats:
        """How fast a column changes [1/s]."""
        return self.along(lambda time, values: np.gradient(values, time), column)

    def pushed(self, force: Floats | float) -> Floats:
        """The power with a force [N] more against the motion."""
        drive, own = self.truck.drive, self.force

        def drawn(wheels: Floats) -> Floats:
            work = wheels * self.speed
            return np.where(work > 0.0, work / drive.efficiency, work * drive.regeneration)

        more = drawn(own + force) - drawn(own)
        return self.power + np.where(self.speed > 0.05, more, 0.0)

    def less_efficient(self, efficiency: float) -> Floats:
        """The power with all that the battery gives beyond the auxiliary load divided by a factor."""
        own = self.truck.auxiliary.power
        return np.where(self.power > own, own + (self.power - own) / efficiency, self.power)

    def enabled(self) -> Floats:
        """Whether the drive is: in motion and eight seconds after."""

        def on(time: Floats, speed: Floats) -> Floats:
            moving = np.where(speed > 0.05, time, -np.inf)
            return (time - np.maximum.accumulate(moving) < 8.0).astype(float)

        return self.along(on, self.speed)

    def lifting(self) -> Mask:
        """Whether the forks go up while the truck stands."""
        return (self.rate(self.forks) > 0.05) & (self.speed < 0.05)

    def late(self, seconds: float) -> Floats:
        """The power as it was some seconds before."""
        return self.along(lambda t, p: np.interp(t - seconds, t, p), self.power)

    def averaged(self, seconds: float) -> Floats:
        """The mean of the power over the last seconds."""

        def mean(time: Floats, power: Floats) -> Floats:
            work = np.concatenate([[0.0], np.cumsum(power[1:] * np.diff(time))])
            return (work - np.interp(time - seconds, time, work)) / np.minimum(seconds, time - time[0] + 0.01)

        return self.along(mean, self.power)


EFFECTS: dict[str, Callable[[Log], Floats]] = {
    "nothing": lambda log: log.power,
    "load of one truck": lambda log: log.power + 300.0 * log.first,
    "load since": lambda log: log.power + 400.0 * (log.share > 0.45),
    "load for a time": lambda log: log.power + 500.0 * ((log.share > 0.4) & (log.share < 0.7)),
    "load that grows": lambda log: log.power + 600.0 * log.share,
    "load of one truck since": lambda log: log.power + 600.0 * (log.first & (log.share > 0.5)),
    "enabled load": lambda log: log.power + 400.0 * log.enabled(),
    "heating": lambda log: (
        log.power + 80.0 * np.maximum(np.nanmedian(log.temperature) - log.temperature, 0.0)
    ),
    "efficiency": lambda log: log.less_efficient(0.85),
    "efficiency of one truck": lambda log: np.where(log.first, log.less_efficient(0.8), log.power),
    "no regeneration": lambda log: np.maximum(log.power, log.truck.auxiliary.power),
    "lift": lambda log: np.where(log.lifting(), log.less_efficient(0.7), log.power),
    "copper loss": lambda log: log.power + 4e-4 * log.force**2 * (log.speed > 0.05),
    "mass": lambda log: log.pushed(0.2 * log.truck.chassis.mass / log.weight * GRAVITY * log.force),
    "mass of half the trucks": lambda log: log.pushed(
        0.2 * log.half * log.truck.chassis.mass / log.weight * GRAVITY * log.force
    ),
    "drag": lambda log: log.pushed(500.0),
    "drag of one truck": lambda log: log.pushed(400.0 * log.first),
    "rolling since": lambda log: log.pushed(0.008 * log.weight * (log.share > 0.6)),
    "rolling of half the trucks": lambda log: log.pushed(0.006 * log.weight * log.half),
    "air drag": lambda log: log.pushed(7.2 * log.speed**2),
    "viscous drag": lambda log: log.pushed(150.0 * log.speed),
    "rough floor": lambda log: log.pushed(0.015 * log.weight * log.there),
    "rough floor since": lambda log: log.pushed(0.022 * log.weight * (log.there & (log.share > 0.5))),
    "tilted site": lambda log: log.pushed(0.01 * log.weight * log.northward),
    "tilted part": lambda log: log.pushed(0.03 * log.weight * log.northward * log.there),
    "stiff when cold": lambda log: log.pushed(
        0.0012 * log.weight * (np.nanmax(log.temperature) - log.temperature)
    ),
    "load that comes and goes": lambda log: log.power + 600.0 * (log.time % 900.0 < 300.0),
    "pump with a load": lambda log: log.power + 500.0 * (log.weight > log.weight.min() + 2000.0),
    "late power": lambda log: log.late(2.0),
    "averaged power": lambda log: log.averaged(5.0),
    "efficiency and load of one truck": lambda log: log.less_efficient(0.85) + 400.0 * log.first,
    "viscous drag and load since": lambda log: log.pushed(100.0 * log.speed) + 400.0 * (log.share > 0.6),
    "rough floor and tilted site": lambda log: log.pushed(
        log.weight * (0.015 * log.there + 0.01 * log.northward)
    ),
}


def conceal(recorded: Path, truck: Truck, effect: str, out: Path) -> None:
    """Write ``recorded`` (csv.gz) with an effect to ``out`` (csv)."""
    table = pl.read_csv(recorded, infer_schema_length=20_000)

    def known(name: str) -> Floats:
        return table[name].cast(pl.Float64, strict=False).to_numpy().copy()

    stamp = table["timestamp"] if "timestamp" in table.columns else table["time"]
    stamp = stamp.str.to_datetime(time_zone="UTC") if stamp.dtype == pl.String else stamp
    time = stamp.to_numpy().astype("datetime64[us]").astype(np.int64) * 1e-6
    vehicle = table["vehicle_id"].to_numpy()
    own = [np.flatnonzero(vehicle == one) for one in np.unique(vehicle)]
    speed, latitude = np.nan_to_num(known("speed")), known("latitude")
    east = np.cos(np.radians(np.nanmean(latitude))) * known("longitude")
    weight = GRAVITY * (truck.chassis.mass + np.nan_to_num(known("payload")))
    log = Log(
        truck, time, (time - time.min()) / np.ptp(time), vehicle, own, speed, DEGREE * latitude,
        DEGREE * east, weight, known("fork_height"), known("ambient_temperature"), known("battery_power"), known("soc"),
    )  # fmt: skip
    power, soc = EFFECTS[effect](log), log.soc
    for rows in own:
        step = np.clip(np.diff(time[rows], prepend=time[rows[0]]), 0.0, 30.0)
        added = np.cumsum(np.nan_to_num(power - log.power)[rows] * step) / 3600.0
        soc[rows] -= added / truck.battery.capacity_wh
    table.with_columns(battery_power=pl.Series(power), soc=pl.Series(soc)).write_csv(out)


def diagnosed(folder: Path, effect: str) -> dict[str, Any]:
    """The diagnosis of a recording in which an effect is concealed."""
    truck = load_truck(str(folder / "truck.toml"))
    return diagnosed_as(folder, lambda log: conceal(folder / "recorded.csv.gz", truck, effect, log))


if __name__ == "__main__":
    main(EFFECTS, diagnosed)

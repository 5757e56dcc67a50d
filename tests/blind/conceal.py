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

GRAVITY = 9.81

Floats = np.ndarray[Any, np.dtype[np.float64]]


@dataclass(frozen=True)
class Log:
    """Columns (n,) of a recording: share of its time, vehicle, speed [m/s] and acceleration [m/s2], weight with the load
    [N], latitude [deg], power [W]."""

    truck: Truck
    share: Floats
    first: np.ndarray[Any, np.dtype[np.bool_]]
    """Whether a row is of the first truck."""
    speed: Floats
    acceleration: Floats
    weight: Floats
    latitude: Floats
    power: Floats

    def pushed(self, force: Floats | float) -> Floats:
        """The power with a force [N] more against the motion."""
        drive = self.truck.drive
        own = self.weight * (self.truck.resistance.rolling + self.acceleration / GRAVITY)

        def drawn(force: Floats) -> Floats:
            work = force * self.speed
            return np.where(work > 0.0, work / drive.efficiency, work * drive.regeneration)

        return self.power + np.where(self.speed > 0.05, drawn(own + force) - drawn(own), 0.0)

    def less_efficient(self, efficiency: float) -> Floats:
        """The power with all that the battery gives beyond the auxiliary load divided by a factor."""
        own = self.truck.auxiliary.power
        return np.where(self.power > own, own + (self.power - own) / efficiency, self.power)

    @property
    def north(self) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Whether a row is in the northern part of the site, where three rows of ten are."""
        return self.latitude > np.nanpercentile(self.latitude, 70.0)


EFFECTS: dict[str, Callable[[Log], Floats]] = {
    "nothing": lambda log: log.power,
    "load of one truck": lambda log: log.power + 300.0 * log.first,
    "load since": lambda log: log.power + 400.0 * (log.share > 0.45),
    "load for a time": lambda log: log.power + 500.0 * ((log.share > 0.4) & (log.share < 0.7)),
    "load that grows": lambda log: log.power + 600.0 * log.share,
    "load of one truck since": lambda log: log.power + 600.0 * (log.first & (log.share > 0.5)),
    "efficiency": lambda log: log.less_efficient(0.85),
    "efficiency of one truck": lambda log: np.where(log.first, log.less_efficient(0.8), log.power),
    "no regeneration": lambda log: np.maximum(log.power, log.truck.auxiliary.power),
    "drag": lambda log: log.pushed(500.0),
    "drag of one truck": lambda log: log.pushed(400.0 * log.first),
    "air drag": lambda log: log.pushed(7.2 * log.speed**2),
    "viscous drag": lambda log: log.pushed(150.0 * log.speed),
    "rough floor": lambda log: log.pushed(0.015 * log.weight * log.north),
    "rough floor since": lambda log: log.pushed(0.022 * log.weight * (log.north & (log.share > 0.5))),
    "efficiency and load of one truck": lambda log: log.less_efficient(0.85) + 400.0 * log.first,
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
    share = (time - time.min()) / np.ptp(time)
    first = vehicle == min(vehicle)
    speed, acceleration = np.nan_to_num(known("speed")), np.zeros(len(time))
    own = [np.flatnonzero(vehicle == one) for one in np.unique(vehicle)]
    for rows in own:
        acceleration[rows] = np.gradient(speed[rows], time[rows])
    weight = GRAVITY * (truck.chassis.mass + np.nan_to_num(known("payload")))
    log = Log(truck, share, first, speed, acceleration, weight, known("latitude"), known("battery_power"))
    power = EFFECTS[effect](log)
    columns = {"battery_power": power}
    if "soc" in table.columns:
        columns["soc"] = known("soc")
        for rows in own:
            step = np.clip(np.diff(time[rows], prepend=time[rows[0]]), 0.0, 30.0)
            added = np.cumsum(np.nan_to_num(power - log.power)[rows] * step) / 3600.0
            columns["soc"][rows] -= added / truck.battery.capacity_wh
    table.with_columns(**{n: pl.Series(v) for n, v in columns.items()}).write_csv(out)


def diagnosed(folder: Path, effect: str) -> dict[str, Any]:
    """The diagnosis of a recording in which an effect is concealed."""
    truck = load_truck(str(folder / "truck.toml"))
    return diagnosed_as(folder, lambda log: conceal(folder / "recorded.csv.gz", truck, effect, log))


if __name__ == "__main__":
    main(EFFECTS, diagnosed)

"""Measured against modelled energy on real drives, with and without altitude; prints the tables of docs/proof_energy.md.

    python tests/proofs/energy_reality.py FOLDER        the folder with twizy/ and tripviewer/

Twizy: 11 trips of a Renault Twizy around Rabat, energy from the state of charge (steps of 0.02 %); NaitMalekYoussef/RSK_Twizy_EV_Dataset,
CC-BY-4.0.  Leaf: one motorway run of a Nissan Leaf, pack voltage times current; ericthobbs/TripViewer, MIT.

No number below has seen the trip (or the block) that it is judged on: the vehicle is calibrated on the others.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fleetlog.calibrate.fit import fit
from fleetlog.calibrate.observe import Observations
from fleetlog.core.motion import Motion
from fleetlog.core.site import Frame
from fleetlog.core.trajectory import Trajectory
from fleetlog.core.truck import Auxiliary, Battery, Chassis, Drive, Resistance, Truck
from fleetlog.physics.motion import reconstruct
from fleetlog.physics.power import Physics, battery_power

Floats = NDArray[np.float64]
WINDOW = 1000.0
"""Length of the pieces of a Twizy trip that are compared [m]."""

# Masses and drag areas are the makers' and the press's round figures; the rest are priors that calibration moves.
TWIZY = Truck(
    Chassis(550.0), "twizy", Drive(efficiency=0.75, regeneration=0.5), Resistance(0.012, 0.7),
    auxiliary=Auxiliary(150.0), battery=Battery(58.0, 6100.0),
)  # fmt: skip
LEAF = Truck(
    Chassis(1750.0), "leaf", Drive(efficiency=0.88, regeneration=0.7), Resistance(0.010, 0.65),
    auxiliary=Auxiliary(700.0), battery=Battery(360.0, 50000.0),
)  # fmt: skip


@dataclass(frozen=True)
class Trip:
    """A motion with the real slope, the number of the window of every sample, and the measured Wh of every window."""

    name: str
    motion: Motion
    window: NDArray[np.int64]
    measured: Floats
    """NaN where the gauge jumped."""

    def predicted(self, physics: Physics, altitude: bool) -> Floats:
        motion = self.motion if altitude else self.motion.replaced(slope=np.zeros(len(self.motion)))
        joules = battery_power(motion, physics) * motion.dt
        return np.bincount(self.window, joules, len(self.measured)) / 3600.0


def twizy_trip(path: Path) -> Trip:
    """One CSV of the Twizy: speed in km/h at 1 Hz; altitude counts where the position was refreshed and it is no sentinel."""
    log = pd.read_csv(path)
    # A few rows carry an impossible date, or one earlier than the row before.
    log["stamp"] = pd.to_datetime(
        log["Date"] + " " + log["Time"], format="%m/%d/%Y %H:%M:%S", errors="coerce"
    )
    log = log[log["stamp"].notna()]
    log = log[log["stamp"] > log["stamp"].cummax().shift(fill_value=pd.Timestamp(0))]
    time = log["stamp"].to_numpy().astype("datetime64[us]").astype(np.int64)
    fresh = (log["LAT"].diff() != 0).to_numpy() & (log["ALT"] > -50).to_numpy() & (log["ALT"] != 0).to_numpy()
    speed, soc = log["Speed"].to_numpy(float) / 3.6, log["Soc"].to_numpy(float) / 100.0
    z = np.where(fresh, log["ALT"].to_numpy(float), np.nan)
    found = reconstruct(Trajectory(path.stem, time, {"speed": speed, "z": z, "soc": soc}))
    fine = found.motion
    number = (np.cumsum(found.rows(fine.speed * fine.dt)) / WINDOW).astype(np.int64)
    ends = np.append(np.flatnonzero(np.diff(number)), len(number) - 1)
    begins = np.concatenate([[0], ends[:-1]])
    used = (soc[begins] - soc[ends]) * TWIZY.battery.capacity_wh
    jumps = np.maximum.reduceat(np.abs(np.diff(soc, prepend=soc[0])), np.unique(number, return_index=True)[1])
    return Trip(path.stem, fine, number[found.row], np.where(jumps > 0.002, np.nan, used))


def leaf_trips(path: Path, rows: int = 10, blocks: int = 8) -> list[Trip]:
    """The motorway run in blocks, each of windows of ``rows`` samples (some 50 s)."""
    log = pd.read_csv(path)
    frame = Frame(float(log["lat"].iloc[0]), float(log["lon"].iloc[0]))
    x, y = frame.to_local(log["lat"].to_numpy(), log["lon"].to_numpy())
    whole = Trajectory("leaf", (log["epoch"].to_numpy() * 1e6).astype(np.int64), {
        "x": x, "y": y, "speed": log["speed_mph"].to_numpy() * 0.44704, "z": log["elev_ft"].to_numpy() * 0.3048,
        "battery_power": (log["volts"] * log["amps"]).to_numpy(),
    })  # fmt: skip
    found = reconstruct(whole)
    fine, of_sample = found.motion, found.row // rows
    measured = np.bincount(of_sample, fine.power * fine.dt) / 3600.0
    cuts = np.array_split(np.arange(len(measured)), blocks)
    return [
        Trip(
            f"block {i + 1}",
            fine[(inside := np.isin(of_sample, cut))],
            of_sample[inside] - cut[0],
            measured[cut],
        )
        for i, cut in enumerate(cuts)
    ]


def calibrated(trips: list[Trip], truck: Truck, altitude: bool) -> Physics:
    """The vehicle fitted to the windows of some trips."""

    def joined(of: Callable[[Trip], Floats]) -> Floats:
        return np.concatenate([of(t)[np.isfinite(t.measured)] for t in trips])

    measured = joined(lambda t: t.measured)
    nominal = joined(lambda t: t.predicted(Physics(truck), altitude))
    sigma = np.full(len(measured), float(np.std(measured - nominal)))
    seen = Observations(
        measured, sigma, tuple(map(str, range(len(measured)))),
        lambda physics: joined(lambda t: t.predicted(physics, altitude)), np.zeros((len(measured), 0)),
    )  # fmt: skip
    return Physics(fit(seen, Physics(truck)).truck)


def r_squared(measured: Floats, predicted: Floats) -> float:
    known = np.isfinite(measured)
    m, p = measured[known], predicted[known]
    return float(1.0 - np.sum((m - p) ** 2) / np.sum((m - m.mean()) ** 2))


def judge(trips: list[Trip], truck: Truck) -> tuple[pd.DataFrame, dict[str, float]]:
    """Each trip by a vehicle calibrated on the others."""
    rows, held_out = [], {True: [], False: []}
    for i, trip in enumerate(trips):
        others = [t for k, t in enumerate(trips) if k != i]
        known = np.isfinite(trip.measured)
        row: dict[str, object] = {
            "trip": trip.name, "km": float(trip.motion.speed @ trip.motion.dt) / 1000.0,
            "measured Wh": trip.measured[known].sum(),
        }  # fmt: skip
        for altitude in (False, True):
            predicted = trip.predicted(calibrated(others, truck, altitude), altitude)
            held_out[altitude].append(predicted)
            word = "with" if altitude else "without"
            row[f"{word} altitude"] = predicted[known].sum()
            row[f"error {word}"] = predicted[known].sum() / trip.measured[known].sum() - 1.0
            row[f"window error {word} [Wh]"] = float(
                np.sqrt(np.mean((predicted - trip.measured)[known] ** 2))
            )
        rows.append(row)
    measured = np.concatenate([t.measured for t in trips])
    r2 = {"with" if a else "without": r_squared(measured, np.concatenate(p)) for a, p in held_out.items()}
    return pd.DataFrame(rows), r2


def markdown(table: pd.DataFrame) -> str:
    def cell(column: str, value: object) -> str:
        if isinstance(value, str):
            return value
        return f"{value:+.1%}" if column.startswith("error") else f"{value:.1f}"

    lines = ["| " + " | ".join(table.columns) + " |", "|" + " --- |" * len(table.columns)]
    lines += [
        "| " + " | ".join(cell(c, r[c]) for c in table.columns) + " |" for r in table.to_dict("records")
    ]
    return "\n".join(lines)


def main(folder: Path) -> None:
    twizy = [twizy_trip(p) for p in sorted((folder / "twizy").glob("*/*.csv"))]
    leaf = leaf_trips(folder / "tripviewer" / "tripviewer_hesperia_la.csv")
    for name, trips, truck in (("twizy", twizy, TWIZY), ("leaf", leaf, LEAF)):
        table, r2 = judge(trips, truck)
        whole = {
            w: table[f"{w} altitude"].sum() / table["measured Wh"].sum() - 1 for w in ("without", "with")
        }
        print(f"\n{name}: R2 of the windows {r2}; whole energy {whole}\n\n{markdown(table)}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))

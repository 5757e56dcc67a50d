"""A vehicle-day of a recording: what is kept of it, while its rows are read anew when their turn comes."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from fleetlog.core.arrays import Floats, Ints
from fleetlog.core.trajectory import Trajectory
from fleetlog.physics.motion.rows import updates

SELDOM, SEVERAL = 5.0, 2.5
"""Seconds and rows between updates of positions from which on these are too few to hold a speed against."""
DAY = 86_400_000_000  # Microseconds
FEW = ("x", "y", "speed", "battery_power")  # Columns of the rows that stand for all


@dataclass(frozen=True)
class Day:
    """What is known of the rows of one vehicle on one day.

    ``date`` counts from 1970; ``begin`` and ``end`` [s since 1970]; ``step`` [s] between two rows, the
    median; ``known`` columns; ``trips`` numbers; ``driven`` [s] within trips; ``charge_step`` that the state
    of charge is logged in, ``charge_used`` all that it fell by; ``seldom`` whether positions come far more
    rarely than rows, and rarely; ``few`` rows, evenly drawn, that stand for all; ``load`` reads all."""

    vehicle: int
    date: int
    rows: int
    begin: float
    end: float
    step: float
    known: frozenset[str]
    trips: Ints
    driven: float
    charge_step: float
    charge_used: float
    seldom: bool
    few: Trajectory
    load: Callable[[], Trajectory]


def day_of(vehicle: int, t: Trajectory, load: Callable[[], Trajectory] | None = None, every: int = 1) -> Day:
    """Return a vehicle-day; ``load`` reads its rows again, and one in ``every`` stands for the others."""
    steps, trip, charge = np.diff(t.time) * 1e-6, t.trip_ids(), np.diff(t.floats("soc"))
    fell, changed = -charge[charge < 0.0], np.abs(charge[np.isfinite(charge) & (charge != 0.0)])
    few = Trajectory(t.vehicle_id, t.time, {c: t.columns[c] for c in FEW if c in t.columns})
    return Day(
        vehicle, int(t.time[0] // DAY), len(t), float(t.time[0]) * 1e-6, float(t.time[-1]) * 1e-6,
        float(np.median(steps)), frozenset(c for c in t.columns if t.has(c)), np.unique(trip),
        float(steps[np.diff(trip) == 0].sum()), float(np.quantile(changed, 0.05)) if len(changed) else 0.0,
        float(fell.sum()), t.has("x") and t.has("speed") and seldom(t), few[::every],
        load or partial(_same, t),
    )  # fmt: skip


def _same(t: Trajectory) -> Trajectory:
    return t


def seldom(t: Trajectory) -> bool:
    """Return whether positions come far more rarely than rows, and rarely."""
    speed, time = t.floats("speed"), t.seconds()
    rows = np.flatnonzero(updates(time, t.floats("x"), t.floats("y"), speed) & (np.nan_to_num(speed) > 0.0))
    few = len(rows) < 2 or float(np.median(np.diff(time[rows]))) <= SELDOM
    return not few and float(np.median(np.diff(rows))) > SEVERAL


def pooled(days: list[Day], column: str) -> Floats:
    """Return a column of the rows that stand for all."""
    return np.concatenate([d.few.floats(column) for d in days])

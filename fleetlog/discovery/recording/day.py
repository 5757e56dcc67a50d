"""A vehicle-day of a recording: what is kept of it, while its rows are read anew when their turn comes."""

from collections.abc import Callable
from copy import copy
from functools import partial

import numpy as np

from fleetlog.core.arrays import Floats, Mask
from fleetlog.core.trajectory import Trajectory
from fleetlog.physics.motion.rows import updates

SELDOM, SEVERAL = 5.0, 2.5  # Seconds, and rows, between updates of positions that are too few
SHARED = 0.05  # Levels of values in steps, by row: twenty rows have one in common on average
FEWEST, REGULAR = 50, 0.8  # Runs of equal power that say how long values are held; share alike of them
DAY = 86_400_000_000  # Microseconds
FEW = ("x", "y", "speed", "battery_power")  # Columns of the rows that stand for all


class Day:
    """What is known of the rows of one vehicle on one day.

    ``date`` counts from 1970; ``begin`` and ``end`` [s since 1970]; ``step`` [s] between two rows, the
    median; ``known`` columns; ``trips`` numbers; ``driven`` [s] within trips; ``charge_step`` that the state
    of charge is logged in, ``charge_used`` all that it fell by; ``seldom`` whether positions come far more
    rarely than rows, and rarely; ``held`` for how long each value of power is repeated, 0 where it is
    not [s]; ``few`` rows, one in ``every``, that stand for all; ``load`` reads all."""

    def __init__(
        self, vehicle: int, t: Trajectory, load: Callable[[], Trajectory] | None = None, every: int = 1
    ) -> None:
        steps, trip, charge = np.diff(t.time) * 1e-6, t.trip_ids(), np.diff(t.floats("soc"))
        changed = np.abs(charge[np.isfinite(charge) & (charge != 0.0)])
        self.vehicle, self.date, self.rows = vehicle, int(t.time[0] // DAY), len(t)
        self.begin, self.end = float(t.time[0]) * 1e-6, float(t.time[-1]) * 1e-6
        self.step, self.known = float(np.median(steps)), frozenset(c for c in t.columns if t.has(c))
        self.trips, self.driven = np.unique(trip), float(steps[np.diff(trip) == 0].sum())
        self.charge_step = float(np.quantile(changed, 0.05)) if len(changed) else 0.0
        self.charge_used = float(np.sum(-charge[charge < 0.0]))
        self.seldom = t.has("x") and t.has("speed") and seldom(t)
        self.held = held(t) * self.step
        few = Trajectory(t.vehicle_id, t.time, {c: t.columns[c] for c in FEW if c in t.columns})
        self.few, self.load = few[::every], load or partial(copy, t)


def seldom(t: Trajectory) -> bool:
    """Return whether positions come far more rarely than rows, and rarely."""
    speed, time = t.floats("speed"), t.seconds()
    rows = np.flatnonzero(updates(time, t.floats("x"), t.floats("y"), speed) & (np.nan_to_num(speed) > 0.0))
    few = len(rows) < 2 or float(np.median(np.diff(time[rows]))) <= SELDOM
    return not few and float(np.median(np.diff(rows))) > SEVERAL


def held(t: Trajectory) -> float:
    """Return in how many rows each value of power stands on the way, 0 where it is not repeated: hardly any
    run of equal values is shorter than the others, as they are where power comes in coarse steps."""
    power, moves = t.floats("battery_power"), np.nan_to_num(t.floats("speed"), nan=1.0) > 0.0
    begin = np.flatnonzero(renewed(power) & np.isfinite(power))
    runs = np.diff(begin)[np.logical_and.reduceat(moves, begin)[:-1]] if len(begin) else begin
    if len(runs) < FEWEST or (usual := float(np.median(runs))) < 2.0:
        return 0.0
    return usual if np.mean(np.abs(runs - usual) <= max(0.5, 0.1 * usual)) > REGULAR else 0.0


def renewed(values: Floats) -> Mask:
    """(N,) whether a row has another value than the one before it."""
    return np.asarray(np.diff(values, prepend=np.nan) != 0.0)


def pooled(days: list[Day], column: str) -> Floats:
    """Return a column of the rows that stand for all."""
    return np.concatenate([d.few.floats(column) for d in days])


def step_of(days: list[Day], column: str) -> float:
    """Return the step in which a column is logged; 0 where hardly any two rows have a value in common."""
    values = np.round(pooled(days, column), 3)
    levels = np.unique(values[np.isfinite(values)])
    return float(np.diff(levels).min()) if 1 < len(levels) < SHARED * len(values) else 0.0

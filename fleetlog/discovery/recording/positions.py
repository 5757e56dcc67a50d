"""Positions that a log repeats or leaves out between updates, put where the vehicle was.

Many loggers write the last known position on every row until the receiver gives another.  Taken as they
stand such rows put
minutes of driving on one spot.  Between two updates a vehicle moved along the line between them as far as
its speed says.
"""

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.trajectory import Trajectory

Floats = NDArray[np.float64]

MOVED = 0.5
"""Metres that a vehicle has driven by its speed while its position stayed the same: then that was not an
update."""
SELDOM = 5.0
"""Updates further apart than this are too few to hold a speed against [s]."""
SEVERAL = 2.5
"""... where rows are this many times as many."""
REACH = 10.0
"""Half the length of track whose direction is the heading [m]."""


def travelled(trajectory: Trajectory) -> Floats:
    """(N,) metres driven since the first row, from the speed channel."""
    t, v = trajectory.seconds(), np.nan_to_num(trajectory.floats("speed"))
    return np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(t))])


def updates(trajectory: Trajectory) -> NDArray[np.bool_]:
    """(N,) rows whose position is known and new; a standing vehicle's stays the same rightly."""
    x, y = trajectory.floats("x"), trajectory.floats("y")
    known = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    fresh = np.zeros(len(x), bool)
    if len(known):
        new = np.concatenate([[True], (np.diff(x[known]) != 0.0) | (np.diff(y[known]) != 0.0)])
        last = known[new][np.cumsum(new) - 1]
        s = travelled(trajectory)
        fresh[known] = new | (s[known] - s[last] < MOVED)
    return fresh


def seldom(trajectory: Trajectory) -> bool:
    """Whether positions come far more rarely than rows, and rarely."""
    rows = np.flatnonzero(updates(trajectory) & (np.nan_to_num(trajectory.floats("speed")) > 0.0))
    if len(rows) < 2:
        return False
    apart = float(np.median(np.diff(trajectory.seconds()[rows])))
    return apart > SELDOM and float(np.median(np.diff(rows))) > SEVERAL


def placed(trajectory: Trajectory) -> Trajectory:
    """The trajectory with positions and headings of rows without an update interpolated along the
    distance driven."""
    fresh = updates(trajectory)
    if fresh.all() or fresh.sum() < 2:
        return trajectory
    s = travelled(trajectory) + 1e-6 * np.arange(len(fresh))
    x, y = (np.interp(s, s[fresh], trajectory.floats(c)[fresh]) for c in ("x", "y"))

    def at(values: Floats, where: Floats) -> Floats:
        return np.interp(where, s, values)

    heading = np.arctan2(at(y, s + REACH) - at(y, s - REACH), at(x, s + REACH) - at(x, s - REACH))
    return trajectory.with_columns(x=x, y=y, heading=heading)

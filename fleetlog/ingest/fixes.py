"""Positions that come more seldom than the rows: a fix repeated until the next one is no measurement.

Loggers write the last fix into every row.  Where the speed says that the truck has moved, it is unknown;
short stretches between two fixes are then filled along the line between them, by the distance driven.
"""

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.trajectory import Floats, Trajectory
from fleetlog.ingest.rows import HELD, set_unknown

MOVED = 0.3
"""A step that the speed claims and the position denies [m]."""
HELD_SHARE = 0.2
"""Fewer repeats among the moving rows are chance, not a slow receiver."""
FILL_DRIVEN, FILL_BLIND = 60.0, 5.0
"""Longest stretch between two fixes that is filled [s]: with a known speed, and without."""


def release_held(rows: Trajectory) -> Trajectory:
    """Repeated positions are unknown where the log's speed says that the truck moved; rows are marked."""
    x, y = rows.floats("x"), rows.floats("y")
    driven = np.nan_to_num(rows.floats("speed")) * np.diff(rows.seconds(), prepend=rows.seconds()[:1])
    moved = driven > MOVED
    same = np.zeros(len(rows), bool)
    same[1:] = (np.diff(x) == 0) & (np.diff(y) == 0)
    held = same & moved
    if not held.any() or held.sum() < HELD_SHARE * moved.sum():
        return rows
    for name in ("x", "y", "z"):
        if name in rows:
            rows = set_unknown(rows, name, held)
    marked = np.nan_to_num(rows.floats(HELD)) + held
    return rows.with_columns(**{HELD: marked})


def fill_positions(rows: Trajectory) -> Trajectory:
    """x, y and z of rows between two fixes not too far apart; beyond that they stay unknown."""
    x = rows.floats("x")
    known = np.isfinite(x) & np.isfinite(rows.floats("y"))
    if known.all() or known.sum() < 2:
        return rows
    fraction, before, after = _between(rows, np.flatnonzero(known))
    out = rows
    for name in ("x", "y", "z"):
        values = rows.floats(name)
        if np.isfinite(values).any():
            line = values[before] + fraction * (values[after] - values[before])
            out = out.with_columns(**{name: np.where(~known & np.isnan(values), line, values)})
    return out


def _between(rows: Trajectory, known: NDArray[np.intp]) -> tuple[Floats, NDArray[np.intp], NDArray[np.intp]]:
    """Share of the way from the fix before to the fix after (NaN where unknown), and those fixes."""
    t, speed = rows.seconds(), rows.floats("speed")
    at = np.arange(len(rows))
    k = np.clip(np.searchsorted(known, at, side="right") - 1, 0, len(known) - 2)
    before, after = known[k], known[k + 1]
    step = np.diff(t, prepend=t[:1])
    way = np.cumsum(np.nan_to_num(speed) * step)
    blind = np.cumsum(np.isnan(speed).astype(np.int64))
    length, time = way[after] - way[before], t[after] - t[before]
    guided = (blind[after] == blind[before]) & (length > 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        fraction = np.where(guided, (way - way[before]) / length, (t - t[before]) / time)
    inside = (at > before) & (at < after) & (time <= np.where(guided, FILL_DRIVEN, FILL_BLIND))
    return np.where(inside, fraction, np.nan), before, after

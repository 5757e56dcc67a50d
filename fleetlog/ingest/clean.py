"""Cleaning: what cannot be a measurement is refused or unknown, what can is left alone.

Every step takes a vehicle's sorted rows, gives fewer or some with unknown values, and tells ``rejects``."""

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.arrays import Floats, Mask
from fleetlog.core.columns import COLUMNS
from fleetlog.core.trajectory import Labels, Trajectory
from fleetlog.ingest.rows import FILE, RECORD, STUCK, Rejects, set_unknown

MAX_SPEED = 60.0  # A position that implies more is impossible [m/s]; the bound of the speed column
FARTHEST, HIGHEST = 1e8, 1e6  # No vehicle is farther or higher [m]; grids of whole countries count up to 1e7
JUMP = "impossible jump of the position"
JUMP_MARGIN = 20.0  # Error of two positions that no jump is made of [m]
SHORT_JUMP = 10  # Rows; a place that is left sooner by another impossible jump was never visited
STUCK_TIME, STUCK_ROWS = 60.0, 30  # Speed the same to the last digit so long [s, rows] while standing: stuck


def sort_rows(rows: Trajectory) -> Trajectory:
    """In order of time; at equal times in order of file and line."""
    if len(rows) < 2 or (np.diff(rows.time) > 0).all():
        return rows
    return rows[np.lexsort((rows.floats(RECORD), rows.floats(FILE), rows.time))]


def drop_duplicates(rows: Trajectory, rejects: Rejects) -> Trajectory:
    """One row at a time, the first in the files; identical and contradicting ones told apart."""
    again = np.zeros(len(rows), bool)
    again[1:] = np.diff(rows.time) == 0
    if not again.any():
        return rows
    first = np.maximum.accumulate(np.where(again, 0, np.arange(len(rows))))
    same = again.copy()
    for name, values in rows.columns.items():
        if name not in (FILE, RECORD):
            array: NDArray[Any] = values.codes if isinstance(values, Labels) else values
            other = array[first]
            same &= (array == other) | ((array != array) & (other != other))
    rejects.refuse(rows, same, "duplicate of another row")
    rejects.refuse(rows, again & ~same, "another row of the vehicle has the same time")
    return rows[~again]


def drop_impossible(rows: Trajectory, rejects: Rejects) -> Trajectory:
    """Positions off the globe are refused; such heights, and 0, 0 degrees (no fix), are unknown."""
    rows = _drop_beyond(rows, {"x": FARTHEST, "y": FARTHEST}, rejects)
    high = np.abs(rows.floats("z")) > HIGHEST
    if high.any():
        rejects.refuse(rows, high, "the height is off the globe", whole=False)
        rows = set_unknown(rows, high, "z")
    if "latitude" not in rows:
        return rows
    rows = _drop_beyond(rows, {"latitude": 90.0, "longitude": 180.0}, rejects)
    latitude, longitude = rows.floats("latitude"), rows.floats("longitude")
    unknown = ((latitude == 0.0) & (longitude == 0.0)) | (np.isnan(latitude) != np.isnan(longitude))
    return set_unknown(rows, unknown, "latitude", "longitude") if unknown.any() else rows


def _drop_beyond(rows: Trajectory, bounds: dict[str, float], rejects: Rejects) -> Trajectory:
    off = np.logical_or.reduce([np.abs(rows.floats(name)) > most for name, most in bounds.items()])
    rejects.refuse(rows, off, "the position is off the globe")
    return rows[~off] if off.any() else rows


def bound_values(rows: Trajectory, rejects: Rejects) -> Trajectory:
    """Values beyond what their column can be become unknown; each is kept in ``rejected.parquet``."""
    for column in COLUMNS:
        if column.name not in rows or column.kind != "double" or (column.low, column.high) == (None, None):
            continue
        values = rows.floats(column.name)
        low, high = (np.inf * s if b is None else b for b, s in ((column.low, -1), (column.high, 1)))
        # Rounding may put a measured bound a hair beyond itself.
        slack = 1e-6 * (1.0 + abs(high - low)) if column.name in ("soc", "heading") else 0.0
        beyond = (values < low - slack) | (values > high + slack)
        if beyond.any():
            unit = "" if column.unit == "1" else f" {column.unit}"
            reason = f"{column.name} is beyond {low:g} to {high:g}{unit}".rstrip()
            rejects.refuse(rows, beyond, reason, whole=False)
            rows = set_unknown(rows, beyond, column.name)
        if slack:
            rows = rows.with_columns(**{column.name: np.clip(rows.floats(column.name), low, high)})
    return rows


def drop_jumps(rows: Trajectory, rejects: Rejects) -> Trajectory:
    """Refuse rows whose place cannot be reached and is left again at once, and no others.

    Positions fall into stays between impossible jumps.  One of fewer than ``SHORT_JUMP`` rows between two, or
    beside a longer one, was never visited; a longer one is where the truck is (the log resumes elsewhere)."""
    x, y = rows.floats("x"), rows.floats("y")
    known, gone = np.isfinite(x) & np.isfinite(y), np.zeros(len(rows), bool)
    gone[known] = jump_outliers(x[known], y[known], rows.seconds()[known])
    rejects.refuse(rows, gone, JUMP)
    return rows[~gone] if gone.any() else rows


def jump_outliers(x: Floats, y: Floats, t: Floats) -> Mask:
    """(N,) which positions lie on stays that were never visited."""
    gone, index = np.zeros(len(x), bool), np.arange(len(x))
    for _ in range(20):  # each pass takes the shortest stays; real logs are done after two or three
        step = np.hypot(np.diff(x[index]), np.diff(y[index]))
        if not len(breaks := np.flatnonzero(step > MAX_SPEED * np.diff(t[index]) + JUMP_MARGIN) + 1):
            break
        size = np.diff(breaks, prepend=0, append=len(index))
        short = (size < SHORT_JUMP) & (size < np.maximum(np.append(size[1:], 0), np.append(0, size[:-1])))
        if not short.any():
            break
        drop = np.repeat(short & (size == size[short].min()), size)
        gone[index[drop]] = True
        index = index[~drop]
    return gone


def unstick(rows: Trajectory) -> Trajectory:
    """Values that stay the same to the last digit while the truck shows that they cannot: unknown, marked. A
    speed, for a minute, while the position stands; a battery power or current, for two minutes, while the
    truck speeds up and slows down. A sensor that is merely coarse is left alone."""
    t, speed = rows.seconds(), rows.floats("speed")
    stuck = np.zeros(len(rows))
    for name in ("speed", "battery_power", "battery_current"):
        values, held = rows.floats(name), np.zeros(len(rows), bool)
        for start, stop in _same_runs(values, t, STUCK_TIME if name == "speed" else 2 * STUCK_TIME):
            if name != "speed":
                driven = speed[start:stop]
                held[start:stop] = (driven < 0.2).sum() >= 5 and (driven > 1.0).sum() >= 5
                continue
            for part in _minutes(t, start, stop):  # rounds at a governed speed come back to where they were
                held[part] = _stands(rows[part], values[start])
        if held.any():
            rows = set_unknown(rows, held, name)
            stuck += held
    return rows.with_columns(**{STUCK: stuck}) if stuck.any() else rows


def _same_runs(values: Floats, t: Floats, length: float) -> list[tuple[int, int]]:
    """Half-open row ranges of one value other than zero, at least ``length`` [s] and ``STUCK_ROWS`` long."""
    cut = np.flatnonzero(np.diff(values, prepend=np.nan) != 0)
    stop = np.append(cut, len(values))[1:]
    long = (stop - cut >= STUCK_ROWS) & (t[stop - 1] - t[cut] >= length) & (np.abs(values[cut]) > 0.5)
    return list(zip(cut[long].tolist(), stop[long].tolist(), strict=True))


def _minutes(t: Floats, start: int, stop: int) -> list[slice]:
    """A run in pieces of ``STUCK_TIME`` or a little more, of ``STUCK_ROWS`` on average at least."""
    count = int(max(1, min((t[stop - 1] - t[start]) // STUCK_TIME, (stop - start) // STUCK_ROWS)))
    cuts = np.linspace(t[start], t[stop - 1], count + 1)[1:-1]
    edges = [start, *(start + np.searchsorted(t[start:stop], cuts)).tolist(), stop]
    return [slice(a, b) for a, b in itertools.pairwise(edges) if a < b]


def _stands(rows: Trajectory, speed: float) -> bool:
    """Whether the position stays within a tenth of the way that the speed claims."""
    x, y = rows.floats("x"), rows.floats("y")
    known = np.isfinite(x) & np.isfinite(y)
    if known.sum() < 5:
        return False
    t = rows.seconds()
    return bool(max(np.ptp(x[known]), np.ptp(y[known])) < 0.1 * speed * (t[-1] - t[0]))

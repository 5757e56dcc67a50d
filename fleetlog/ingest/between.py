"""Values between samples: messages at times of their own, and positions that come more seldom than the rows.

Values of messages without a position (a battery's) go onto the rows that have one.  Loggers write the last
fix of a slow receiver into every row: where the speed says that the truck has moved, a repeated fix is no
measurement; short stretches between two fixes are then filled by the distance driven.
"""

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.trajectory import Floats, Labels, Trajectory
from fleetlog.ingest.rows import CHANNEL, FILE, HELD, RECORD, set_unknown, without

REACH = 3.0  # A value reaches this many of its usual steps, and no farther than ``MAX_REACH`` [s]
MAX_REACH = 30.0
MOVED = 0.3  # A step that the speed claims and the position denies [m]
HELD_SHARE = 0.2  # Fewer repeats among the moving rows are chance, not a slow receiver
FILL_DRIVEN, FILL_BLIND = 60.0, 5.0
"""Longest stretch between two fixes that is filled [s]: with a known speed, and without."""


def join_channels(rows: Trajectory) -> Trajectory:
    """Sorted rows without the channel rows, whose values are interpolated onto the others."""
    if CHANNEL not in rows:
        return rows
    flag = rows.floats(CHANNEL) > 0.5
    base, channel = rows[~flag], rows[flag]
    origin = int(base.time[0]) if len(base) else 0
    at, t = base.seconds(origin), channel.seconds(origin)
    for name, given in channel.columns.items():
        if name in (CHANNEL, FILE, RECORD):
            continue
        if isinstance(given, Labels):
            base = base.with_columns(**{name: _held(base.labels(name), given, at, t)})
            continue
        own, values = base.floats(name), channel.floats(name)
        known = np.isfinite(values)
        if known.any() and len(base):
            own = np.where(np.isfinite(own), own, interpolated(at, t[known], values[known]))
        base = base.with_columns(**{name: own})
    return without(base, CHANNEL)


def interpolated(at: Floats, t: Floats, values: Floats) -> Floats:
    """Linear between samples that are not too far apart, held a little beyond the ends; NaN elsewhere."""
    reach = min(REACH * (float(np.median(np.diff(t))) if len(t) > 1 else 1.0), MAX_REACH)
    after = np.clip(np.searchsorted(t, at), 0, len(t) - 1)
    before = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 1)
    gap_before, gap_after = np.abs(at - t[before]), np.abs(t[after] - at)
    inside = (at >= t[0]) & (at <= t[-1])
    near = np.where(inside, t[after] - t[before] <= reach, np.minimum(gap_before, gap_after) <= reach)
    nearest = np.where(gap_before <= gap_after, values[before], values[after])
    close = np.minimum(gap_before, gap_after) <= reach / 2
    with np.errstate(over="ignore", invalid="ignore"):  # a column of the log's own may hold anything
        line = np.interp(at, t, values)
    return np.where(near, line, np.where(close, nearest, np.nan))


def _held(own: Labels, given: Labels, at: Floats, t: Floats) -> Labels:
    """Texts hold until the next one."""
    order = {name: i for i, name in enumerate(dict.fromkeys((*own.names, *given.names)))}
    # Before the first one there is none: -1, the last.
    held = np.append(given.recode(order), np.int32(-1))[np.searchsorted(t, at, side="right") - 1]
    mine = own.recode(order)
    return Labels(np.where(mine >= 0, mine, held), tuple(order))


def release_held(rows: Trajectory) -> Trajectory:
    """Repeated positions are unknown where the log's speed says that the truck moved; rows are marked."""
    x, y = rows.floats("x"), rows.floats("y")
    t = rows.seconds()
    moved = np.nan_to_num(rows.floats("speed")) * np.diff(t, prepend=t[:1]) > MOVED
    held = moved & (np.diff(x, prepend=np.nan) == 0) & (np.diff(y, prepend=np.nan) == 0)
    if not held.any() or held.sum() < HELD_SHARE * moved.sum():
        return rows
    rows = set_unknown(rows, held, *(name for name in ("x", "y", "z") if name in rows))
    return rows.with_columns(**{HELD: np.nan_to_num(rows.floats(HELD)) + held})


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

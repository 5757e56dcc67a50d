"""Values that come at their own times (a battery message) onto the rows that have positions."""

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.trajectory import Floats, Labels, Trajectory
from fleetlog.ingest.rows import CHANNEL, FILE, RECORD, without

REACH = 3.0
"""A value reaches this many of its usual steps, and no farther than ``MAX_REACH`` [s]."""
MAX_REACH = 30.0


def join_channels(rows: Trajectory) -> Trajectory:
    """Sorted rows without the channel rows, whose values are interpolated onto the others."""
    if CHANNEL not in rows:
        return rows
    flag = rows.floats(CHANNEL) > 0.5
    base, channel = rows[~flag], rows[flag]
    new = {n: _joined(base, channel, n) for n in channel.columns if n not in (CHANNEL, FILE, RECORD)}
    return without(base.with_columns(**new), CHANNEL)


def _joined(base: Trajectory, channel: Trajectory, name: str) -> Floats | Labels:
    origin = int(base.time[0]) if len(base) else 0
    at, t = base.seconds(origin), channel.seconds(origin)
    if isinstance(channel.columns[name], Labels):
        return _held(base.labels(name), channel.labels(name), at, t)
    values, own = channel.floats(name), base.floats(name)
    known = np.isfinite(values)
    if not known.any() or not len(base):
        return own
    return np.where(np.isfinite(own), own, interpolated(at, t[known], values[known]))


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
    names = tuple(dict.fromkeys((*own.names, *given.names)))
    order = {n: i for i, n in enumerate(names)}
    before: NDArray[np.intp] = np.searchsorted(t, at, side="right") - 1
    code = given.recode(order)
    held = np.where(before >= 0, code[np.maximum(before, 0)], -1)
    mine = own.recode(order)
    return Labels(np.where(mine >= 0, mine, held).astype(np.int32), names)

"""Which rows of a trajectory a replay keeps: pure array work, no drawing."""

import itertools

import numpy as np

from fleetlog.core.arrays import Floats, Ints
from fleetlog.core.trajectory import Trajectory

GAP = 10_000_000  # A silence longer than this [us], and than five sampling intervals, is shown as a gap


def rows_at_rate(time: Ints, rate_hz: float) -> Ints:
    """Indices of the first row in every interval of 1/rate, and of the last row."""
    if not len(time):
        return np.zeros(0, np.int64)
    bins = time // max(round(1e6 / rate_hz), 1)
    keep = np.flatnonzero(np.diff(bins, prepend=bins[0] - 1))
    return keep if keep[-1] == len(time) - 1 else np.append(keep, len(time) - 1)


def gap_limit(time: Ints) -> int:
    """Longest step between rows [us] that does not count as a gap."""
    return max(GAP, 5 * int(np.median(np.diff(time)))) if len(time) > 1 else GAP


def thinned(trajectory: Trajectory, rate_hz: float) -> Trajectory:
    """The trajectory at no more than ``rate_hz``; rows beside a gap are always kept."""
    time = trajectory.time
    before = np.flatnonzero(np.diff(time) > gap_limit(time))
    return trajectory[np.union1d(rows_at_rate(time, rate_hz), np.concatenate([before, before + 1]))]


def runs_collapsed(*values: Floats) -> Ints:
    """Indices left when every run of equal rows is cut to its two ends; NaN equals NaN."""
    n = len(values[0])
    changes = np.zeros(n + 1, dtype=bool)
    changes[[0, n]] = True
    for v in values:
        same = (v[1:] == v[:-1]) | (np.isnan(v[1:]) & np.isnan(v[:-1]))
        changes[1:n] |= ~same
    return np.flatnonzero(changes[:-1] | changes[1:])


def changed(values: Floats, step: float) -> Ints:
    """Indices at which a value has moved by ``step`` or more, or turns to or from NaN."""
    level = np.where(np.isnan(values), -(10**9), np.floor(np.nan_to_num(values) / step + 0.5))
    return np.flatnonzero(np.diff(level, prepend=np.inf) != 0)


def moved(step: float, *values: Floats) -> Ints:
    """Indices at which any value has moved by ``step`` or more, the rows before these, and both ends.

    The row before a move keeps a truck standing until it sets off, however long it stood.
    """
    n = len(values[0])
    keep = np.zeros(n, dtype=bool)
    keep[[0, n - 1]] = True
    for v in values:
        at = changed(v, step)
        keep[at] = True
        keep[np.maximum(at - 1, 0)] = True
    return np.flatnonzero(keep)


def pieces(time: Ints, limit: int) -> list[slice]:
    """The stretches of rows without a gap."""
    cuts = [0, *(np.flatnonzero(np.diff(time) > limit) + 1).tolist(), len(time)]
    return [slice(a, b) for a, b in itertools.pairwise(cuts) if b > a]

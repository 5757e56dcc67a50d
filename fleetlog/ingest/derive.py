"""Values that a log does not have, from those that it has: between its samples, speed, heading, power.

Values of messages without a position (a battery's) go onto the rows that have one.  Loggers write the last
fix of a slow receiver into every row: where the speed says that the truck has moved, a repeated fix is no
measurement; short stretches between two fixes are then filled by the distance driven.  Speed and heading come
from straight lines fitted to the positions over a short while."""

import numpy as np
import pandas as pd

from fleetlog.core.arrays import Floats, Ints, Mask
from fleetlog.core.trajectory import Labels, Trajectory
from fleetlog.ingest.rows import CHANNEL, FILE, HELD, RECORD, set_unknown
from fleetlog.store.trips import MIN_STOP

REACH = 3.0  # A value reaches this many of its usual steps, and no farther than ``MAX_REACH`` [s]
MAX_REACH = 30.0
MOVED = 0.3  # A step that the speed claims and the position denies [m]
HELD_SHARE = 0.2  # Fewer repeats among the moving rows are chance, not a slow receiver
FILL_DRIVEN, FILL_BLIND = 60.0, 5.0  # Longest stretch that is filled [s]: with a known speed, without
DETOUR, MOST_BESIDE = 1.5, 5.0  # Nor is a way that is so many times its chord and metres longer
HALF_WINDOW = 1.0
"""A line is fitted over this time before and after a row [s], or over two neighbours on each side within
``WIDEST`` if that is more; over the nearest neighbours at least."""
WIDEST = 2.5
MAX_GAP = 30.0  # No line reaches across a longer silence [s]
STANDING = 0.15  # Slower than this, or than twice the error of the fit, is standing still [m/s]
MAX_SPEED = 60.0
SCATTER = 3.0  # Positions of a truck that stands are this many times as far apart as usual, at most
FEWEST = 6  # Rows that tell how far apart they are
EDGE = 3.0  # In which a truck that sets off leaves its place [s]
READINGS = ("clockwise from north", "in degrees", "in degrees, clockwise from north")
BLOCK = 4096  # Rows that are summed up at once


def derive_motion(rows: Trajectory) -> Trajectory:
    """Speed [m/s] and heading [rad] of the rows that have none; what the log says stays."""
    speed, heading = rows.floats("speed"), rows.floats("heading")
    if not (np.isnan(speed).any() or np.isnan(heading).any()):
        return rows
    fitted = fitted_motion(rows.seconds(), rows.floats("x"), rows.floats("y"), speed)
    return _completed(_completed(rows, "speed", fitted[0]), "heading", fitted[1])


def derive_power(rows: Trajectory) -> Trajectory:
    """Battery power [W] as voltage times current, where the log has both and no power."""
    if not (rows.has("battery_voltage") and rows.has("battery_current")):
        return rows
    return _completed(rows, "battery_power", rows.floats("battery_voltage") * rows.floats("battery_current"))


def _completed(rows: Trajectory, name: str, values: Floats) -> Trajectory:
    own = rows.floats(name)
    if not (np.isnan(own).any() and np.isfinite(values).any()):
        return rows
    return rows.with_columns(**{name: np.where(np.isnan(own), values, own)})


def pace_ratio(rows: Trajectory) -> float | None:
    """The log's speed over that of its positions: median over half minutes in motion, or None."""
    table = np.stack([rows.seconds(), *(rows.floats(name) for name in ("x", "y", "speed"))])
    t, x, y, speed = table[:, np.isfinite(table).all(axis=0)]
    if len(t) < 100:
        return None
    cut = np.flatnonzero(np.diff((t - t[0]) // 30.0, prepend=-1.0))
    claimed = np.add.reduceat(speed * np.minimum(np.diff(t, prepend=t[0]), 5.0), cut)
    # The way is measured between rows some seconds apart, so that noise does not add up.
    far, gone = np.flatnonzero(np.diff(t // 3.0, prepend=-1.0)), np.zeros(len(t))
    gone[far[1:]] = np.hypot(np.diff(x[far]), np.diff(y[far]))
    way = np.add.reduceat(gone, cut)
    moving = (way > 15.0) & (claimed > 5.0)
    return float(np.median(claimed[moving] / way[moving])) if moving.sum() >= 5 else None


def suspect_unit(ratios: list[float]) -> tuple[str, float] | None:
    """The unit that a speed seems to be in, and the usual ratio; None where it fits metres a second."""
    if not ratios:
        return None
    ratio = float(np.median(ratios))
    units = {"km/h": 3.6, "mph": 1 / 0.44704, "kn": 3600 / 1852, "m/s, they in mm": 1e-3}
    near = [name for name, factor in units.items() if abs(ratio / factor - 1.0) < 0.1]
    return (near[0], ratio) if near else None


def other_reading(rows: Trajectory) -> str | None:
    """How the log's headings would lie ten times nearer to the way; None where they do not lie far off it."""
    table = np.stack([rows.seconds(), *(rows.floats(name) for name in ("x", "y", "heading"))])
    table = table[:, np.isfinite(table).all(axis=0)]
    table = table[:, np.flatnonzero(np.diff(table[0] // 3.0, prepend=-1.0))]
    _, east, north, turned = np.diff(table)
    straight = np.flatnonzero((np.hypot(east, north) > 2.0) & (np.cos(turned) > 0.98))
    if len(straight) < 10:
        return None
    heading, along = table[3][straight], np.arctan2(north, east)[straight]
    degrees = np.radians(np.mod(heading, 2.0 * np.pi))  # below 6.28 they may pass for radians
    angles = (heading, np.pi / 2.0 - heading, degrees, np.pi / 2.0 - degrees)
    for turns in (1.0, 2.0):  # in the second, forwards and backwards are one
        off = [1.0 - np.cos(turns * (angle - along)).mean() for angle in angles]
        if off[0] > 0.05 and min(off) < 0.1 * off[0]:
            return READINGS[int(np.argmin(off)) - 1]
    return None


def fitted_motion(t: Floats, x: Floats, y: Floats, logged: Floats | None = None) -> tuple[Floats, Floats]:
    """Speed and heading at (N,) times [s] from positions [m]; NaN where there are too few positions.

    Least-squares slopes over time in a window about each row (Savitzky and Golay's first derivative for
    uneven steps).  Slower than the error of the fit is standing still: speed 0, the heading as it was; so is
    what goes nowhere within the noise of the positions."""
    speed, heading = np.full(len(t), np.nan), np.full(len(t), np.nan)
    have = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    if len(have) < 2:
        return speed, heading
    first, last = _windows(t[have])
    vx, ex = _slopes(t[have], x[have], first, last)
    vy, ey = _slopes(t[have], y[have], first, last)
    fast = np.hypot(vx, vy)
    moving = fast > np.maximum(STANDING, 2.0 * np.minimum(np.hypot(ex, ey), 1.0))
    own = np.full(len(have), np.nan) if logged is None else logged[have]
    if (untold := np.isnan(own)).any():
        _without_drift(t[have], np.stack([x, y])[:, have], moving)
    # A log's own speed knows better whether the truck stands.
    moving = np.where(untold, moving, (own > STANDING) & (fast > STANDING))
    speed[have] = np.minimum(np.where(moving, fast, 0.0), MAX_SPEED)
    speed[have[first == last]] = np.nan
    heading[have] = np.where(moving, np.arctan2(vy, vx), np.nan)
    return speed, pd.Series(heading).ffill().bfill().to_numpy()


def _without_drift(t: Floats, at: Floats, moving: Mask) -> None:
    """Take out of ``moving`` (N,) what stays in one place for the time of a stop: positions ``at`` (2, N)
    that scatter, or drift, no farther than ``SCATTER`` times as usual then, nor than the slowest motion."""
    stop = max(MIN_STOP, FEWEST * float(np.median(np.diff(t))))
    place = pd.DataFrame(at.T, pd.to_timedelta(t - t[0], unit="s"))
    near = place.rolling(pd.Timedelta(stop / 3.0, "s"), center=True).mean().rolling(pd.Timedelta(stop, "s"))
    apart = np.hypot(*(near.max() - near.min()).to_numpy().T)
    first = np.searchsorted(t, t - stop, side="right")
    lasts = t - t[first]
    stays = (lasts > 0.5 * stop) & (apart <= 2.0 * STANDING * lasts)
    last = np.flatnonzero(stays & (apart <= SCATTER * np.median(apart[stays]))) if stays.any() else first[:0]
    begins = np.searchsorted(t, t[first[last]] + EDGE * (first[last] > 0))
    ends = np.searchsorted(t, t[last] - EDGE * (last < len(t) - 1))
    rows = np.arange(len(t))  # Stretches of one length: as many have begun as ended where there is none.
    moving &= np.searchsorted(begins, rows, side="right") == np.searchsorted(ends, rows)


def _windows(t: Floats) -> tuple[Ints, Ints]:
    """First and last row of the window of each row; never across a gap."""
    rows = np.arange(len(t))
    two_back = np.maximum(np.searchsorted(t, t - WIDEST), rows - 2)
    two_on = np.minimum(np.searchsorted(t, t + WIDEST, side="right") - 1, rows + 2)
    first = np.minimum.reduce([np.searchsorted(t, t - HALF_WINDOW), two_back, rows - 1])
    last = np.maximum.reduce([np.searchsorted(t, t + HALF_WINDOW, side="right") - 1, two_on, rows + 1])
    cuts = np.concatenate([[0], np.flatnonzero(np.diff(t) > MAX_GAP) + 1, [len(t)]])
    stretch = np.searchsorted(cuts, rows, side="right")
    return np.maximum(first, cuts[stretch - 1]), np.minimum(last, cuts[stretch] - 1)


def _slopes(t: Floats, v: Floats, first: Ints, last: Ints) -> tuple[Floats, Floats]:
    """Slope of v over t in each window, and its standard error."""
    out, error = np.zeros(len(t)), np.zeros(len(t))
    # Sums over blocks of rows, so that large coordinates and times lose no digits.
    for start in range(0, len(t), BLOCK):
        block = slice(start, start + BLOCK)
        a, b = int(first[block].min()), int(last[block].max()) + 1
        tt, vv = t[a:b] - t[start], v[a:b] - v[start]
        sums = [np.concatenate([[0.0], np.cumsum(s)]) for s in (tt, vv, tt * tt, tt * vv, vv * vv)]
        f, g = first[block] - a, last[block] + 1 - a
        m = (g - f).astype(np.float64)
        st, sv, stt, stv, svv = (s[g] - s[f] for s in sums)
        ctt, ctv, cvv = stt - st * st / m, stv - st * sv / m, svv - sv * sv / m
        good = ctt > 1e-9
        slope = np.where(good, ctv / np.where(good, ctt, 1.0), 0.0)
        rest = np.maximum(cvv - slope * ctv, 0.0) / np.maximum(m - 2.0, 1.0)
        out[block] = slope
        error[block] = np.where(good & (m > 2), np.sqrt(rest / np.where(good, ctt, 1.0)), 0.0)
    return out, error


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
    return base.without(CHANNEL)


def interpolated(at: Floats, t: Floats, values: Floats) -> Floats:
    """Linear between samples that are not too far apart, held a little beyond the ends; NaN elsewhere."""
    reach = min(REACH * (float(np.median(np.diff(t))) if len(t) > 1 else 1.0), MAX_REACH)
    after = np.clip(np.searchsorted(t, at), 0, len(t) - 1)
    before = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 1)
    gap_before, gap_after = np.abs(at - t[before]), np.abs(t[after] - at)
    inside = (at >= t[0]) & (at <= t[-1])
    near = np.where(inside, t[after] - t[before] <= reach, np.minimum(gap_before, gap_after) <= reach)
    nearest = np.where(gap_before <= gap_after, values[before], values[after])
    with np.errstate(over="ignore", invalid="ignore"):  # a column of the log's own may hold anything
        line = np.interp(at, t, values)
    return np.where(near, line, np.where(np.minimum(gap_before, gap_after) <= reach / 2, nearest, np.nan))


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
    same, row = (np.diff(x, prepend=np.nan) == 0) & (np.diff(y, prepend=np.nan) == 0), np.arange(len(t))
    frozen = moved & same
    if not frozen.any() or frozen.sum() < HELD_SHARE * moved.sum():
        return rows
    # Once it has moved, where it stands is not known either.
    last, begin = (np.maximum.accumulate(np.where(which, row, 0)) for which in (frozen, ~same))
    held = same & (last > begin)
    rows = set_unknown(rows, held, *(name for name in ("x", "y", "z") if name in rows))
    return rows.with_columns(**{HELD: np.nan_to_num(rows.floats(HELD)) + held})


def fill_positions(rows: Trajectory) -> Trajectory:
    """x, y and z of rows between two fixes not too far apart; beyond that they stay unknown."""
    known = np.isfinite(rows.floats("x")) & np.isfinite(rows.floats("y"))
    if known.all() or known.sum() < 2:
        return rows
    t, speed, at = rows.seconds(), rows.floats("speed"), np.flatnonzero(known)
    # The fixes before and after each row, and its share of the way from one to the other.
    row = np.arange(len(rows))
    k = np.clip(np.searchsorted(at, row, side="right") - 1, 0, len(at) - 2)
    before, after = at[k], at[k + 1]
    way = np.cumsum(np.nan_to_num(speed) * np.diff(t, prepend=t[:1]))
    blind = np.cumsum(np.isnan(speed).astype(np.int64))
    length, time = way[after] - way[before], t[after] - t[before]
    guided = (blind[after] == blind[before]) & (length > 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        fraction = np.where(guided, (way - way[before]) / length, (t - t[before]) / time)
    chord = np.hypot(*(v[after] - v[before] for v in (rows.floats("x"), rows.floats("y"))))
    straight = ~guided | (length <= DETOUR * chord + MOST_BESIDE)
    inside = (row > before) & (row < after) & (time <= np.where(guided, FILL_DRIVEN, FILL_BLIND)) & straight
    fraction[~inside] = np.nan
    for name in ("x", "y", "z"):
        values = rows.floats(name)
        if np.isfinite(values).any():
            line = values[before] + fraction * (values[after] - values[before])
            rows = rows.with_columns(**{name: np.where(~known & np.isnan(values), line, values)})
    return rows

"""Speed and heading from positions, where the log has none: straight lines fitted over a short while."""

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.trajectory import Floats, Ints, Trajectory

HALF_WINDOW = 1.0
"""A line is fitted over this time before and after a row [s], or over two neighbours on each side within
``WIDEST`` if that is more; over the nearest neighbours at least.
"""
WIDEST = 2.5
MAX_GAP = 30.0
"""No line reaches across a longer silence [s]."""
STANDING = 0.15
"""Slower than this, or than twice the error of the fit, is standing still [m/s]."""
MAX_SPEED = 60.0


def derive_motion(rows: Trajectory) -> Trajectory:
    """Speed [m/s] and heading [rad] of the rows that have none; what the log says stays."""
    own = {name: rows.floats(name) for name in ("speed", "heading")}
    if not any(np.isnan(values).any() for values in own.values()):
        return rows
    fitted = fitted_motion(rows.seconds(), rows.floats("x"), rows.floats("y"), own["speed"])
    for (name, values), fit in zip(own.items(), fitted, strict=True):
        if np.isnan(values).any() and np.isfinite(fit).any():
            rows = rows.with_columns(**{name: np.where(np.isnan(values), fit, values)})
    return rows


def derive_power(rows: Trajectory) -> Trajectory:
    """Battery power [W] as voltage times current, where the log has both and no power."""
    if not (rows.has("battery_voltage") and rows.has("battery_current")):
        return rows
    own, made = rows.floats("battery_power"), rows.floats("battery_voltage") * rows.floats("battery_current")
    if not np.isnan(own).any():
        return rows
    return rows.with_columns(battery_power=np.where(np.isnan(own), made, own))


def pace_ratio(rows: Trajectory) -> float | None:
    """The log's speed over that of its positions: median over half minutes in motion, or None."""
    t, x, y, speed = rows.seconds(), rows.floats("x"), rows.floats("y"), rows.floats("speed")
    good = np.isfinite(x) & np.isfinite(y) & np.isfinite(speed)
    if good.sum() < 100:
        return None
    t, x, y, speed = (v[good] for v in (t, x, y, speed))
    step = np.diff(t, prepend=t[:1])
    slot = ((t - t[0]) // 30.0).astype(np.int64)
    cut = np.flatnonzero(np.diff(slot, prepend=-1))
    claimed = np.add.reduceat(speed * np.minimum(step, 5.0), cut)
    # The way is measured between rows some seconds apart, so that noise does not add up.
    far = np.flatnonzero(np.diff((t // 3.0).astype(np.int64), prepend=-1))
    gone = np.zeros(len(t))
    gone[far[1:]] = np.hypot(np.diff(x[far]), np.diff(y[far]))
    way = np.add.reduceat(gone, cut)
    moving = (way > 15.0) & (claimed > 5.0)
    return float(np.median(claimed[moving] / way[moving])) if moving.sum() >= 5 else None


def suspect_unit(ratios: list[float]) -> tuple[str, float] | None:
    """The unit that a speed seems to be in, and the usual ratio; None where it fits metres a second."""
    if not ratios:
        return None
    ratio = float(np.median(ratios))
    units = {"km/h": 3.6, "mph": 1 / 0.44704, "kn": 3600 / 1852}
    near = [name for name, factor in units.items() if abs(ratio / factor - 1.0) < 0.1]
    return (near[0], ratio) if near else None


def fitted_motion(
    t: Floats, x: Floats, y: Floats, known_speed: Floats | None = None
) -> tuple[Floats, Floats]:
    """Speed and heading at (N,) times [s] from positions [m]; NaN where there are too few positions.

    Least-squares slopes of x and y over time in a window about each row (Savitzky and Golay's first
    derivative for uneven steps).  Slower than the error of the fit is standing still: speed 0, and the
    heading stays as it was.
    """
    speed, heading = np.full(len(t), np.nan), np.full(len(t), np.nan)
    have = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    if len(have) < 2:
        return speed, heading
    first, last = _windows(t[have])
    vx, ex = _slopes(t[have], x[have], first, last)
    vy, ey = _slopes(t[have], y[have], first, last)
    fast = np.hypot(vx, vy)
    moving = fast > np.maximum(STANDING, 2.0 * np.minimum(np.hypot(ex, ey), 1.0))
    if known_speed is not None:
        # A log's own speed knows better whether the truck stands.
        own = known_speed[have]
        moving = np.where(np.isnan(own), moving, (own > STANDING) & (fast > STANDING))
    speed[have] = np.minimum(np.where(moving, fast, 0.0), MAX_SPEED)
    speed[have[first == last]] = np.nan
    heading[have] = np.where(moving, np.arctan2(vy, vx), np.nan)
    return speed, _held(heading)


def _windows(t: Floats) -> tuple[Ints, Ints]:
    """First and last row of the window of each row; never across a gap."""
    n = len(t)
    rows = np.arange(n)
    two_back = np.maximum(np.searchsorted(t, t - WIDEST), rows - 2)
    two_on = np.minimum(np.searchsorted(t, t + WIDEST, side="right") - 1, rows + 2)
    first = np.minimum(np.minimum(np.searchsorted(t, t - HALF_WINDOW), two_back), np.maximum(rows - 1, 0))
    last = np.maximum(np.searchsorted(t, t + HALF_WINDOW, side="right") - 1, two_on)
    last = np.maximum(last, np.minimum(rows + 1, n - 1))
    cut = np.flatnonzero(np.diff(t) > MAX_GAP) + 1
    starts = np.concatenate([[0], cut])
    stretch = np.searchsorted(starts, rows, side="right") - 1
    ends = np.append(cut, n) - 1
    return np.maximum(first, starts[stretch]), np.minimum(last, ends[stretch])


def _slopes(t: Floats, v: Floats, first: Ints, last: Ints) -> tuple[Floats, Floats]:
    """Slope of v over t in each window, and its standard error."""
    n = len(t)
    # Sums from the middle of blocks of rows, so that large coordinates and times lose no digits.
    block = np.arange(n) // 4096 * 4096
    t0, v0 = t[block], v[block]
    out, error = np.zeros(n), np.full(n, 0.0)
    for start in range(0, n, 4096):
        a, b = max(int(first[start : start + 4096].min()), 0), int(last[start : start + 4096].max()) + 1
        tt, vv = t[a:b] - t0[start], v[a:b] - v0[start]
        sums = [np.concatenate([[0.0], np.cumsum(s)]) for s in (tt, vv, tt * tt, tt * vv, vv * vv)]
        f, g = first[start : start + 4096] - a, last[start : start + 4096] + 1 - a
        m = (g - f).astype(np.float64)
        st, sv, stt, stv, svv = (s[g] - s[f] for s in sums)
        ctt, ctv, cvv = stt - st * st / m, stv - st * sv / m, svv - sv * sv / m
        good = ctt > 1e-9
        slope = np.where(good, ctv / np.where(good, ctt, 1.0), 0.0)
        rest = np.maximum(cvv - slope * ctv, 0.0) / np.maximum(m - 2.0, 1.0)
        out[start : start + 4096] = slope
        error[start : start + 4096] = np.where(good & (m > 2), np.sqrt(rest / np.where(good, ctt, 1.0)), 0.0)
    return out, error


def _held(heading: Floats) -> Floats:
    """Unknown headings take the last known one; before the first, the first."""
    known: NDArray[np.intp] = np.flatnonzero(np.isfinite(heading))
    if not len(known):
        return heading
    at = np.searchsorted(known, np.arange(len(heading)), side="right") - 1
    return np.asarray(heading[known[np.maximum(at, 0)]], dtype=np.float64)

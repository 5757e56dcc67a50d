"""Speed and heading from positions, where the log has none: straight lines fitted over a short while."""

import numpy as np
import pandas as pd

from fleetlog.core.trajectory import Floats, Ints, Trajectory

HALF_WINDOW = 1.0
"""A line is fitted over this time before and after a row [s], or over two neighbours on each side within
``WIDEST`` if that is more; over the nearest neighbours at least."""
WIDEST = 2.5
MAX_GAP = 30.0  # No line reaches across a longer silence [s]
STANDING = 0.15  # Slower than this, or than twice the error of the fit, is standing still [m/s]
MAX_SPEED = 60.0
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
    power = rows.floats("battery_voltage") * rows.floats("battery_current")
    return _completed(rows, "battery_power", power)


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
    far = np.flatnonzero(np.diff(t // 3.0, prepend=-1.0))
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
    return speed, pd.Series(heading).ffill().bfill().to_numpy()


def _windows(t: Floats) -> tuple[Ints, Ints]:
    """First and last row of the window of each row; never across a gap."""
    rows = np.arange(len(t))
    two_back = np.maximum(np.searchsorted(t, t - WIDEST), rows - 2)
    two_on = np.minimum(np.searchsorted(t, t + WIDEST, side="right") - 1, rows + 2)
    first = np.minimum.reduce([np.searchsorted(t, t - HALF_WINDOW), two_back, rows - 1])
    last = np.maximum.reduce([np.searchsorted(t, t + HALF_WINDOW, side="right") - 1, two_on, rows + 1])
    cut = np.flatnonzero(np.diff(t) > MAX_GAP) + 1
    stretch = np.searchsorted(cut, rows, side="right")
    return np.maximum(first, np.append(0, cut)[stretch]), np.minimum(
        last, np.append(cut, len(t))[stretch] - 1
    )


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

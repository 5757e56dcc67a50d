"""Load, forks, power and slope of a log as a motion needs them."""

from typing import NamedTuple

import numpy as np

from fleetlog.core.arrays import Floats, Mask
from fleetlog.core.trajectory import Trajectory

LONGEST_HOLD = 60.0  # A load is held through a silence of its channel up to this [s]


def payload(t: Floats, trajectory: Trajectory) -> Floats:
    """(N,) kg; held through short silences, 0 where nothing is known."""
    value = trajectory.floats("payload")
    last = np.maximum.accumulate(np.where(np.isnan(value), 0, np.arange(len(t))))
    held = np.where(t - t[last] <= LONGEST_HOLD, value[last], 0.0)
    return np.asarray(np.maximum(np.nan_to_num(held), 0.0))


class Forks(NamedTuple):
    """Height [m] of the forks at knots in time [s], linear between them."""

    time: Floats
    height: Floats
    doubt: Floats  # (N - 1,) of what is lifted between rows, share that may lie in either half; a deviation

    def at(self, moment: Floats) -> Floats:
        """(n,) height [m] at (n,) moments."""
        return np.asarray(np.interp(moment, self.time, self.height))

    def speed(self, low: Floats, dt: Floats) -> Floats:
        """(n,) mean lifting speed [m/s] over ``dt`` from ``low`` on; ``sum(speed dt)`` is the rise."""
        return np.where(dt > 0.0, self.at(low + dt) - self.at(low), 0.0) / np.maximum(dt, 1e-9)


def forks(t: Floats, trajectory: Trajectory) -> Forks:
    """The forks of a log: jitter and quantisation are taken out by a dead band. Between two rows they move at
    their usual speed. A lift that begins or ends between two rows takes its share of the time: it joins the
    lift in the interval before or after it, or else lies in the middle."""
    from fleetlog.physics.motion.kernels.way import dead_band

    height = trajectory.floats("fork_height")
    if (known := np.isfinite(height)).sum() < 2:
        return Forks(np.zeros(1), np.zeros(1), np.zeros(max(len(t) - 1, 0)))
    if not known.all():
        height = np.interp(t, t[known], height[known])
    height = height.copy()
    dead_band(height, _jitter(height))
    doubt, moved = np.zeros(len(t) - 1), np.flatnonzero(np.diff(height))
    step, rise = np.diff(t)[moved], np.diff(height)[moved]
    usual = np.where(rise > 0.0, _usual(rise / step), _usual(-rise / step))
    lasts = np.minimum(np.abs(rise) / np.maximum(usual, 1e-9), step)
    goes_on = (np.diff(moved) == 1) & (np.sign(rise[1:]) == np.sign(rise[:-1]))
    before, after = np.append(False, goes_on), np.append(goes_on, False)
    # Alone in its interval a lift may be anywhere, but one that fills it is spread evenly over both halves.
    doubt[moved] = np.where(before == after, 0.5 * (1.0 - lasts / step), 0.0)
    share = np.where(before == after, 0.5, np.where(before, 0.0, 1.0))
    begin = t[moved] + share * (step - lasts)
    ends = np.column_stack([begin, begin + lasts])
    heights = np.column_stack([height[moved], height[moved + 1]])
    return Forks(np.append(t[0], ends), np.append(height[0], heights), doubt)


def _usual(rate: Floats) -> float:
    """Of the rates above half of the highest [m/s], nine tenths are no higher; 0 where none is positive."""
    highest = float(rate.max(initial=0.0))
    return float(np.quantile(rate[rate > 0.5 * highest], 0.9)) if highest > 0.0 else 0.0


def _jitter(height: Floats) -> float:
    """Half-width of the band that noise and quantisation fill [m]: most successive differences are less."""
    steps = np.abs(np.diff(height))
    steps = steps[steps > 1e-9]
    if len(steps) < 10 or len(steps) < 0.3 * len(height):
        return 0.0
    # forks move in a small share of all rows, so when most rows differ from the next, that is noise
    return float(min(3.0 * np.median(steps) / 0.954, 0.05))


def measured_power(trajectory: Trajectory) -> Floats:
    """(N,) battery power [W]: measured, else voltage times current, else NaN."""
    power = trajectory.floats("battery_power")
    product = trajectory.floats("battery_voltage") * trajectory.floats("battery_current")
    return np.where(np.isfinite(power), power, product)


def slope_from_height(coordinate: Floats, z: Floats, breaks: Mask) -> Floats:
    """(N,) slope angle [rad] from measured heights over the path coordinate; 0 where there are none. A
    straight line fitted to the heights within half a window before and after each row; the window is so long
    that the noise of the heights leaves the slope good to about half a per cent, at least 10 m."""
    known, chain, out = np.isfinite(z), np.cumsum(breaks), np.zeros(len(z))
    for c in np.unique(chain[known]):
        there = chain == c
        s, heights = coordinate[there & known], z[there & known]
        if len(s) >= 5:
            # A receiver often repeats a height for many rows of a faster log: there the slope goes over.
            out[there] = np.interp(coordinate[there], s, _running_slope(s, heights))
    return out


def _running_slope(s: Floats, z: Floats) -> Floats:
    s = np.maximum.accumulate(s)
    noise = 1.4826 * float(np.median(np.abs(np.diff(z, 2)))) / np.sqrt(6.0)
    spacing = max(float(s[-1] - s[0]) / len(s), 1e-3)
    half = max(5.0, (12.0 * noise**2 * spacing / 0.005**2) ** (1.0 / 3.0) / 2.0)
    lo, hi = np.searchsorted(s, s - half, "left"), np.searchsorted(s, s + half, "right")
    # Both neighbours at least, however far apart the heights are.
    row = np.arange(len(s))
    lo, hi = np.maximum(np.minimum(lo, row - 1), 0), np.minimum(np.maximum(hi, row + 2), len(s))
    s0 = s - s[0]
    sums = (np.append(0.0, np.cumsum(v)) for v in (s0, z, s0 * s0, s0 * z))
    ms, mz, s2, sz = ((v[hi] - v[lo]) / (hi - lo) for v in sums)
    spread, shared = s2 - ms**2, sz - ms * mz
    return np.asarray(np.arctan(np.where(spread > 0.1, shared / np.maximum(spread, 0.1), 0.0)))

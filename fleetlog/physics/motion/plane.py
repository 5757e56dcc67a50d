"""The track off the map: both axes smoothed alike, and the way along the smooth curve."""

from dataclasses import dataclass

import numpy as np

from fleetlog.core.motion import Floats
from fleetlog.physics.motion.noise import Noise, Observed, estimate_noise, smooth
from fleetlog.physics.motion.rows import Rows

TRACK = 2.5
"""Half the length of track whose turning is taken together [m]: noise of the positions is divided by it."""
HELD = 0.2  # Below this speed noisy positions have no direction: the last one holds [m/s]


@dataclass(frozen=True)
class Plane:
    """The track at the rows, (rows,) each.

    Way along the curve [m], how far the position lies ahead of it [m], heading [rad, unwrapped]. ``turned``
    is the angle that was driven [rad]: without what is turned at a standstill.
    """

    way: Floats
    ahead: Floats
    heading: Floats
    turned: Floats

    def curvature(self, way: Floats, half: Floats) -> Floats:
        """Mean curvature from ``half`` m before, or ``TRACK``, to as much after [1/m], left positive."""
        half = np.maximum(half, TRACK)
        return mean_curvature(way, half, self.way + 1e-6 * np.arange(len(self.way)), self.turned)


def mean_curvature(way: Floats, half: Floats, driven: Floats, turned: Floats) -> Floats:
    """Angle turned from ``half`` m before to ``half`` m after a way, over that length [1/m]."""
    low, high = (np.interp(way + side * half, driven, turned) for side in (-1.0, 1.0))
    return np.asarray((high - low) / (2.0 * half))


def plane_track(rows: Rows) -> Plane:
    """Smooth the positions in the plane; the noise is measured on both axes together.

    So turning the frame changes nothing.
    """
    t, rest, link, nan = rows.t, rows.rest, rows.link, np.full(len(rows.t), np.nan)
    x, y = (np.where(rows.fresh, v, np.nan) for v in (rows.x, rows.y))
    east, north = Observed(t, x, nan, rest, link), Observed(t, y, nan, rest, link)
    again = link.copy()
    again[:1] = 2
    both = Observed(np.tile(t, 2), np.append(x, y), np.tile(nan, 2), np.tile(rest, 2), np.append(link, again))
    noise = estimate_noise(both, Noise(jerk=0.3, position=0.5))
    mx, my = smooth(east, noise).mean, smooth(north, noise).mean
    heading = _held_heading(mx[:, 1], my[:, 1])
    step = _length(t, mx, my)
    step[link == 2] = 0.0
    ahead = (x - mx[:, 0]) * np.cos(heading) + (y - my[:, 0]) * np.sin(heading)
    slow = rest | (np.hypot(mx[:, 1], my[:, 1]) < HELD)
    turn = np.where(slow[1:] | slow[:-1] | (link[1:] == 2), 0.0, np.diff(heading))
    return Plane(np.cumsum(step), ahead, heading, np.append(0.0, np.cumsum(turn)))


def _length(t: Floats, mx: Floats, my: Floats) -> Floats:
    """(rows,) length of the cubic from the row before [m], by Simpson's rule over its speed."""
    h = np.diff(t)
    ends = np.hypot(mx[:, 1], my[:, 1])
    middle = [1.5 * np.diff(m[:, 0]) - 0.25 * h * (m[1:, 1] + m[:-1, 1]) for m in (mx, my)]
    return np.append(0.0, (h * (ends[1:] + ends[:-1]) + 4.0 * np.hypot(*middle)) / 6.0)


def _held_heading(vx: Floats, vy: Floats) -> Floats:
    """Direction of motion, unwrapped; at a standstill that of the last motion, at first that of the next."""
    moving = np.flatnonzero(np.hypot(vx, vy) > HELD)
    if not len(moving):
        return np.zeros(len(vx))
    last = np.maximum(np.searchsorted(moving, np.arange(len(vx)), side="right") - 1, 0)
    return np.asarray(np.unwrap(np.arctan2(vy, vx)[moving])[last])

"""Smooth curves through samples, without the seconds that a large library takes to load."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

FLAT = 1e-9
"""Share of the largest change of slope below which two slopes are taken as equal."""


class Akima:
    """Akima's piecewise cubic through ``y`` (n,) at increasing ``x`` (n,), n >= 3; it does not overshoot as a spline does.

    H. Akima, A new method of interpolation and smooth curve fitting based on local procedures, J. ACM 17 (1970) 589.
    """

    def __init__(self, x: Floats, y: Floats) -> None:
        rise = np.diff(y) / np.diff(x)
        before = 2.0 * rise[0] - rise[1]
        after = 2.0 * rise[-1] - rise[-2]
        m = np.concatenate([[2.0 * before - rise[0], before], rise, [after, 2.0 * after - rise[-1]]])
        change = np.abs(np.diff(m))
        left, right = change[2:], change[:-2]
        total = left + right
        bent = total > FLAT * total.max()
        mixed = (left * m[1:-2] + right * m[2:-1]) / np.where(bent, total, 1.0)
        self.x, self.y, self.rise = x, y, rise
        self.slope = np.where(bent, mixed, 0.5 * (m[3:] + m[:-3]))

    def __call__(self, at: Floats) -> Floats:
        """(m,) values at ``at`` (m,)."""
        return self.with_slope(at)[0]

    def with_slope(self, at: Floats) -> tuple[Floats, Floats]:
        """(m,) values and (m,) derivatives at ``at`` (m,)."""
        j = np.clip(np.searchsorted(self.x, at, side="right") - 1, 0, len(self.x) - 2)
        width, s = (self.x[1:] - self.x[:-1])[j], at - self.x[j]
        first, rise = self.slope[j], self.rise[j]
        cubic = (first + self.slope[j + 1] - 2.0 * rise) / width**2
        square = (rise - first) / width - cubic * width
        value = self.y[j] + s * (first + s * (square + s * cubic))
        return value, first + s * (2.0 * square + 3.0 * s * cubic)


def gaussian(values: Floats, deviation: float) -> Floats:
    """(n,) values smoothed by a Gaussian of ``deviation`` samples, mirrored at the ends, cut at four deviations."""
    reach = int(4.0 * deviation + 0.5)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / deviation) ** 2)
    padded = np.pad(values, reach, mode="symmetric")
    return np.convolve(padded, kernel / kernel.sum(), mode="valid")

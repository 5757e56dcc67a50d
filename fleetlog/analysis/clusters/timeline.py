"""Which episode belongs to which critical area, and when they were."""

from __future__ import annotations

import numpy as np
import pandas as pd

from fleetlog.analysis.clusters.areas import Watched
from fleetlog.analysis.clusters.crowds import Crowds
from fleetlog.analysis.clusters.tracking import Episode
from fleetlog.core.result import Series
from fleetlog.core.trajectory import Floats, Ints

MARGIN = 10.0
"""An episode this far outside an area's radius belongs to none [m]."""
SHOWN = 5
MOST_POINTS = 200_000


def area_of(table: pd.DataFrame, areas: pd.DataFrame) -> Ints:
    """(N,) number of the area that an episode's middle lies in or beside, 0 for none."""
    if not len(table) or not len(areas):
        return np.zeros(len(table), np.int64)
    at, middle = (t[["x", "y"]].to_numpy(float) for t in (table, areas))
    outside = np.hypot(*(at[:, None] - middle).T).T - areas.radius.to_numpy()
    best = outside.argmin(axis=1)
    near = outside[np.arange(len(table)), best] <= MARGIN
    return np.where(near, areas.area.to_numpy()[best], 0)


def timeline(c: Crowds, watched: Watched, found: list[Episode], area: Ints) -> Series:
    """Trucks in open episodes over time, a curve for each of the first areas and one for elsewhere.

    Of long recordings the most in each of ``MOST_POINTS`` intervals.
    """
    steps = -(-(watched.stop - watched.start) // watched.step)
    width = watched.step * max(1, -(-steps // MOST_POINTS))
    time = np.arange(watched.start, watched.stop, width, dtype=np.int64)
    shown = np.where((area > 0) & (area <= SHOWN), area, 0)
    curves: dict[str, Floats] = {}
    for number in [*sorted({*shown.tolist()} - {0}), 0]:
        of = [k for e, a in zip(found, shown.tolist(), strict=True) if a == number for k in e.clusters]
        at, inverse = np.unique(c.time[of], return_inverse=True)
        curve = np.zeros(len(time))
        np.maximum.at(curve, (at - watched.start) // width, np.bincount(inverse, c.size[of], len(at)))
        if number or of or not curves:
            curves[f"area {number}" if number else "elsewhere"] = curve
    return Series("episodes", time, curves, "time", "trucks", over_time=True)

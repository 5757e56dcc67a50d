"""Which episode belongs to which critical area, and when they were."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fleetlog.analysis.clusters.steps import Fleet
from fleetlog.analysis.clusters.tracking import Episode
from fleetlog.core.result import Series

MARGIN = 10.0
"""An episode this far outside an area's radius belongs to none [m]."""
SHOWN = 5


def area_of(table: pd.DataFrame, areas: pd.DataFrame) -> NDArray[np.int64]:
    """(N,) number of the area that an episode's middle lies in or beside, 0 for none."""
    if not len(table) or not len(areas):
        return np.zeros(len(table), np.int64)
    gap = np.hypot(
        table.x.to_numpy()[:, None] - areas.x.to_numpy(), table.y.to_numpy()[:, None] - areas.y.to_numpy()
    )
    outside = gap - areas.radius.to_numpy()
    best = outside.argmin(axis=1)
    near = outside[np.arange(len(table)), best] <= MARGIN
    return np.where(near, areas.area.to_numpy()[best], 0)


def timeline(fleet: Fleet, found: list[Episode], area: NDArray[np.int64]) -> Series:
    """Trucks in open episodes over time, a curve for each of the first areas and one for elsewhere."""
    steps = len(fleet.time)
    named = [a for a in sorted(set(area.tolist())) if 0 < a <= SHOWN]
    curves = {f"area {a}": np.zeros(steps) for a in named}
    rest = np.zeros(steps)
    for e, a in zip(found, area.tolist(), strict=True):
        curve = curves.get(f"area {a}", rest)
        curve[np.array(e.steps)] += [len(m) for m in e.members]
    if rest.any() or not curves:
        curves["elsewhere"] = rest
    return Series("episodes", fleet.time, curves, "time", "trucks", over_time=True)

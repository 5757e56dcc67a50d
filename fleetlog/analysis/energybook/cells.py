"""The battery through the segments of a book: voltage, collapse, emptiness, and the charge at the end."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.trajectory import Floats
from fleetlog.physics.battery import BatteryModel, discharge


@dataclass(frozen=True)
class Cells:
    """(S,) each: the model's state of charge at the end, lowest voltage [V], seconds collapsed and empty."""

    soc_end: Floats
    lowest: Floats
    collapsed: Floats
    empty: Floats


def follow_cells(
    starts: NDArray[np.intp], power: Floats, dt: Floats, soc: Floats, temperature: Floats,
    battery: BatteryModel,
) -> Cells:  # fmt: skip
    """Discharge the battery segment by segment, each from the charge that the log gives at its start.

    Where the log gives none, from full: the voltages then are those of a full battery, and the end of charge
    is unknown.
    """
    rows = []
    for a, b in itertools.pairwise([*starts.tolist(), len(power)]):
        known = np.isfinite(soc[a])
        warm = temperature[a:b][np.isfinite(temperature[a:b])]
        mean = float(warm.mean()) if len(warm) else float("nan")
        done = discharge(power[a:b], dt[a:b], battery, float(soc[a]) if known else 1.0, mean)
        end = done.soc[-1] if known else np.nan
        rows.append((end, done.voltage.min(), done.collapsed @ dt[a:b], done.empty @ dt[a:b]))
    return Cells(*np.array(rows, dtype=np.float64).T)

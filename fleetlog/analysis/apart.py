"""Time that an analysis leaves out, as its rows are too far apart to tell what lies between them."""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import binary_dilation

from fleetlog.core.arrays import Floats
from fleetlog.core.words import percent
from fleetlog.store import Dataset
from fleetlog.store.days import each_day
from fleetlog.store.trips import MAX_GAP

LONGEST = 15.0  # Between rows farther apart a truck is on no known road and in no known cell [s]


def left_out(dataset: Dataset, limit: float = LONGEST, vehicles: Sequence[str] = ()) -> float:
    """Share of the time of ``vehicles`` (all by default) between rows more than ``limit`` apart [s].

    A silence beside closer rows, as between shifts, is no time of the recording."""
    parts = [*each_day(dataset, _apart, limit, kinds=(np.ndarray,), vehicles=vehicles, cost=0.1e-6)]
    apart, total = np.sum(parts, axis=0) if parts else np.zeros(2)
    return float(apart / total) if total else 0.0


def _apart(dataset: Dataset, vehicle: str, date: str, limit: float) -> Floats:
    """(2,) seconds of one vehicle-day: between rows more than ``limit`` apart, and all."""
    dt = np.diff(dataset.read(vehicle, date, ()).time) * 1e-6
    counted = dt[(dt <= MAX_GAP) | ~binary_dilation(dt <= limit)]
    return np.array([counted[counted > limit].sum(), counted.sum()])


def told(what: str, share: float, lines: Sequence[str], limit: float = LONGEST) -> list[str]:
    """An answer's ``lines`` with the ``share`` of the time that it leaves out; all of it: it is unknown."""
    if share == 1.0:
        return [f"{what}: unknown, as all rows are more than {limit:g} s apart."]
    part = f"{percent(share)} of the time is left out, as rows there are more than {limit:g} s apart"
    return [*lines, f"{what}: {part}."] if share >= 0.005 else [*lines]

"""Time that an analysis leaves out, as its rows are too far apart to tell what lies between them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import binary_dilation

from fleetlog.core.arrays import Floats
from fleetlog.core.result import Result
from fleetlog.core.words import percent
from fleetlog.store import Dataset
from fleetlog.store.days import each_day
from fleetlog.store.trips import MAX_GAP

LONGEST = 15.0  # Between rows farther apart a truck is on no known road and in no known cell [s]


def settled(
    result: Result, dataset: Dataset, what: str, *unknown: str, limit: float = LONGEST,
    vehicles: Sequence[str] = (),
) -> Result:  # fmt: skip
    """Say in a ``result`` about ``what`` which share of the time it leaves out; where it is all of it, the
    keys ``unknown`` of its summary are null."""
    share = left_out(dataset, limit, vehicles)
    summary = result.summary | {"left_out_share": share}
    lines = [*result.lines, *remark(what, share, limit)]
    if share == 1.0:
        nothing = {k: dict.fromkeys(v) if isinstance(v := summary[k], dict) else None for k in unknown}
        summary, lines = summary | nothing, lines[-1:]
    return replace(result, summary=summary, lines=lines)


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


def remark(what: str, share: float, limit: float = LONGEST) -> list[str]:
    """The sentence about a ``share`` of the time that is left out; none where it does not show."""
    if share == 1.0:
        return [f"{what}: unknown, as all rows are more than {limit:g} s apart."]
    part = f"{percent(share)} of the time is left out, as rows there are more than {limit:g} s apart"
    return [f"{what}: {part}."] if share >= 0.005 else []

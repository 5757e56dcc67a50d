"""All vehicles of a selection side by side in time, for the formats that go by moments."""

from collections.abc import Iterator, Sequence

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fleetlog.core.trajectory import Trajectory, from_arrow
from fleetlog.exporters.base import Selection

WINDOW = 600_000_000
"""Stretch of time that is held at once [us]."""


def windows(selection: Selection, columns: Sequence[str]) -> Iterator[list[Trajectory]]:
    """All vehicles' rows, in stretches of time that follow one another."""
    meta = selection.dataset.meta
    first, last = (
        int(np.datetime64(str(meta[k]).rstrip("Z"), "us").astype(np.int64)) for k in ("start", "end")
    )
    for date in selection.dataset.dates:
        day = int(np.datetime64(date, "us").astype(np.int64))
        for begin in range(day, day + 86_400_000_000, WINDOW):
            if begin > last or begin + WINDOW <= first:
                continue
            pieces = [p for v in selection.vehicles if len(p := _read(selection, v, date, begin, columns))]
            if pieces:
                yield pieces


def _read(selection: Selection, vehicle: str, date: str, begin: int, columns: Sequence[str]) -> Trajectory:
    """A vehicle's rows from ``begin`` on for ``WINDOW``; parts and row groups outside are not read."""
    stamp = pa.timestamp("us", tz="UTC")
    inside = [
        ("timestamp", ">=", pa.scalar(begin, pa.int64()).cast(stamp)),
        ("timestamp", "<", pa.scalar(begin + WINDOW, pa.int64()).cast(stamp)),
    ]
    tables = []
    for part in selection.dataset.parts(vehicle, date):
        have = set(pq.read_schema(part).names)
        want = ["timestamp", *(c for c in columns if c in have)]
        tables.append(pq.read_table(part, columns=want, filters=inside, partitioning=None))
    if not tables:
        return Trajectory(vehicle, np.zeros(0, np.int64))
    return from_arrow(pa.concat_tables(tables, promote_options="permissive"), vehicle)

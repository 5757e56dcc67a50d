"""All vehicles of a selection side by side in time, for the formats that go by moments."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fleetlog.core.trajectory import Trajectory, from_arrow
from fleetlog.exporters.base import Selection

WINDOW = 600_000_000
"""Stretch of time that is held at once [us]."""


def windows(selection: Selection, columns: Sequence[str]) -> Iterator[list[Trajectory]]:
    """All vehicles' rows, in stretches of time that follow one another."""
    dataset = selection.dataset
    first, last = (
        int(np.datetime64(str(dataset.meta[k]).rstrip("Z"), "us").astype(np.int64)) for k in ("start", "end")
    )
    for begin in range(first - first % WINDOW, last + 1, WINDOW):
        date = str(np.datetime64(begin, "us"))[:10]
        found = (_read(p, v, begin, columns) for v in selection.vehicles for p in dataset.parts(v, date))
        if pieces := [piece for piece in found if len(piece)]:
            yield pieces


def _read(part: Path, vehicle: str, begin: int, columns: Sequence[str]) -> Trajectory:
    """The rows of a file from ``begin`` on for ``WINDOW``; row groups outside are not read."""
    first, last = (
        pa.scalar(t, pa.int64()).cast(pa.timestamp("us", tz="UTC")) for t in (begin, begin + WINDOW)
    )
    inside = [("timestamp", ">=", first), ("timestamp", "<", last)]
    want = [name for name in pq.read_schema(part).names if name in ("timestamp", *columns)]
    return from_arrow(pq.read_table(part, columns=want, filters=inside, partitioning=None), vehicle)

"""Rows set down on disk by vehicle and day, so that logs of any size and order fit into memory."""

import itertools
from collections import defaultdict
from collections.abc import Iterator, Sequence
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
from pyarrow import feather

from fleetlog.core.columns import BY_NAME
from fleetlog.core.trajectory import Labels, Trajectory, from_arrow
from fleetlog.importers._times import DAY, EARLIEST, LATEST
from fleetlog.ingest.rows import INTERNAL, join

BUDGET = 96 << 20  # Bytes of rows that wait in memory before they are set down
WINDOW_ROWS = 100_000  # Rows of a vehicle that are taken up again at a time, about


class Slip(NamedTuple):
    """A file of rows of one vehicle and day [days since 1970], with their first and last time [us]."""

    vehicle: str
    day: int
    path: Path
    first: int
    last: int
    rows: int


class Spill:
    """Sets rows down by vehicle and day, into files of ``folder`` whose names begin with ``name``."""

    def __init__(self, folder: Path, name: str) -> None:
        self.folder, self.name = folder, name
        self.slips: list[Slip] = []
        self.own: dict[str, bool] = {}
        """The log's own columns, and whether each is text."""
        self.rows = 0
        self._waiting: dict[tuple[str, int], list[Trajectory]] = defaultdict(list)
        self._bytes = 0

    def add(self, rows: Trajectory) -> None:
        """Set rows of one vehicle, at least one, aside."""
        for name, values in rows.columns.items():
            if name not in BY_NAME and name not in INTERNAL:
                self.own[name] = self.own.get(name, False) or isinstance(values, Labels)
        day = rows.time // DAY
        days = [int(day[0])] if day.min() == day.max() else np.unique(day).tolist()
        for one in days:
            self._waiting[rows.vehicle_id, one].append(rows if len(days) == 1 else rows[day == one])
        self.rows += len(rows)
        self._bytes += len(rows) * 8 * (1 + len(rows.columns))
        if self._bytes > BUDGET:
            self.set_down()

    def set_down(self) -> list[Slip]:
        """Write what waits; what has been written so far."""
        for (vehicle, day), waiting in self._waiting.items():
            rows = join(waiting)
            path = self.folder / f"{self.name}-{len(self.slips)}.arrow"
            _save(rows, path)
            first, last = int(rows.time.min()), int(rows.time.max())
            self.slips.append(Slip(vehicle, day, path, first, last, len(rows)))
        self._waiting.clear()
        self._bytes = 0
        return self.slips


def windows(slips: Sequence[Slip]) -> Iterator[tuple[Trajectory, bool]]:
    """A vehicle's rows in order of time, about ``WINDOW_ROWS`` at once, unsorted within; whether last."""
    before: list[Trajectory] = []
    for rows in _stretches(slips):
        if before and len(before[0]) + len(rows) > WINDOW_ROWS:
            yield before.pop(), False
        before = [join([*before, rows])]  # short days go together
    for rows in before:
        yield rows, True


def _stretches(slips: Sequence[Slip]) -> Iterator[Trajectory]:
    """Day after day, long days in pieces."""
    by_day = attrgetter("day")
    for _, group in itertools.groupby(sorted(slips, key=by_day), by_day):
        day = list(group)
        for low, high in itertools.pairwise(_edges(day)):
            rows = (_load(slip, low, high) for slip in day if slip.first < high and slip.last >= low)
            if pieces := [piece for piece in rows if len(piece)]:
                yield join(pieces)


def _edges(day: Sequence[Slip]) -> list[int]:
    """Times that cut a day into stretches of about equal numbers of rows."""
    pieces = -(-sum(slip.rows for slip in day) // WINDOW_ROWS)
    if pieces == 1:
        return [EARLIEST, LATEST + 1]
    tables = (feather.read_table(slip.path, ["timestamp"]) for slip in day)
    times = np.sort(np.concatenate([np.array(t.column("timestamp"), dtype=np.int64) for t in tables]))
    cuts = times[[len(times) * k // pieces for k in range(1, pieces)]]
    return [int(times[0]), *np.unique(cuts).tolist(), int(times[-1]) + 1]


def _save(rows: Trajectory, path: Path) -> None:
    columns = {"timestamp": pa.array(rows.time)}
    for name, values in rows.columns.items():
        if isinstance(values, Labels):
            codes = pa.array(values.codes, pa.int32(), mask=values.codes < 0)
            columns[name] = pa.DictionaryArray.from_arrays(codes, pa.array(list(values.names), pa.string()))
        else:
            columns[name] = pa.array(values)
    feather.write_feather(pa.table(columns), str(path), compression="uncompressed")


def _load(slip: Slip, low: int, high: int) -> Trajectory:
    """The rows from ``low`` on and before ``high``."""
    rows = from_arrow(feather.read_table(slip.path, memory_map=True), slip.vehicle)
    mask = (rows.time >= low) & (rows.time < high)
    return rows if mask.all() else rows[mask]

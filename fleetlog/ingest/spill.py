"""Rows set down on disk by vehicle and day, so that logs of any size and order fit into memory."""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import feather

from fleetlog.core.columns import BY_NAME
from fleetlog.core.trajectory import Labels, Trajectory, from_arrow
from fleetlog.importers._times import DAY, EARLIEST, LATEST
from fleetlog.ingest.rows import INTERNAL, join

BUDGET = 96 << 20
"""Bytes of rows that wait in memory before they are set down."""
WINDOW_ROWS = 100_000
"""Rows of a vehicle that are taken up again at a time, about."""


@dataclass
class Slot:
    """One vehicle, one day: files with their first and last time, and rows in all."""

    files: list[tuple[Path, int, int]] = field(default_factory=list)
    rows: int = 0


class Spill:
    """Sets rows down by vehicle and day, into files of ``folder`` whose names begin with ``name``."""

    def __init__(self, folder: Path, name: str) -> None:
        self.folder, self.name, self.down = folder, name, Down()
        self._waiting: dict[tuple[str, int], list[Trajectory]] = defaultdict(list)
        self._bytes = 0
        self._count = 0

    def add(self, rows: Trajectory) -> None:
        """Set rows of one vehicle aside."""
        for name, values in rows.columns.items():
            if name not in BY_NAME and name not in INTERNAL:
                self.down.own[name] = self.down.own.get(name, False) or isinstance(values, Labels)
        day = rows.time // DAY
        if len(rows) and day.min() == day.max():
            self._put(rows, int(day[0]))
        else:
            for one in np.unique(day).tolist():
                self._put(rows[day == one], one)
        if self._bytes > BUDGET:
            self.finish()

    def _put(self, rows: Trajectory, day: int) -> None:
        self._waiting[rows.vehicle_id, day].append(rows)
        self.down.slots.setdefault((rows.vehicle_id, day), Slot()).rows += len(rows)
        self._bytes += len(rows) * 8 * (1 + len(rows.columns))

    def finish(self) -> Down:
        """Set down what waits; what has been set down."""
        for key, waiting in self._waiting.items():
            rows = join(waiting)
            path = self.folder / f"{self.name}-{self._count}.arrow"
            self._count += 1
            _save(rows, path)
            self.down.slots[key].files.append((path, int(rows.time.min()), int(rows.time.max())))
        self._waiting.clear()
        self._bytes = 0
        return self.down


@dataclass
class Down:
    """Rows that were set down, by vehicle and day."""

    slots: dict[tuple[str, int], Slot] = field(default_factory=dict)
    own: dict[str, bool] = field(default_factory=dict)
    """The log's own columns, and whether each is text."""

    @property
    def vehicles(self) -> list[str]:
        """Ids, sorted."""
        return sorted({vehicle for vehicle, _ in self.slots})

    @property
    def rows(self) -> int:
        """Rows in all."""
        return sum(s.rows for s in self.slots.values())

    def of(self, vehicle: str) -> Down:
        """Those of one vehicle."""
        return Down({key: slot for key, slot in self.slots.items() if key[0] == vehicle}, self.own)

    def add(self, later: Down) -> None:
        """Take in what was set down of later logs."""
        for key, slot in later.slots.items():
            mine = self.slots.setdefault(key, Slot())
            mine.files += slot.files
            mine.rows += slot.rows
        for name, text in later.own.items():
            self.own[name] = self.own.get(name, False) or text

    def windows(self, vehicle: str) -> Iterator[tuple[Trajectory, bool]]:
        """A vehicle's rows in order of time, about ``WINDOW_ROWS`` at once, unsorted within; whether last."""
        before: list[Trajectory] = []
        for rows in self._stretches(vehicle):
            if before and len(before[0]) + len(rows) > WINDOW_ROWS:
                yield before.pop(), False
            before = [join([*before, rows])]  # short days go together
        for rows in before:
            yield rows, True

    def _stretches(self, vehicle: str) -> Iterator[Trajectory]:
        """Day after day, long days in pieces."""
        for day in sorted(day for v, day in self.slots if v == vehicle):
            slot = self.slots[vehicle, day]
            edges = self._edges(slot) if slot.rows > WINDOW_ROWS else [EARLIEST, LATEST + 1]
            for low, high in itertools.pairwise(edges):
                within = (path for path, first, last in slot.files if first < high and last >= low)
                pieces = [_between(_load(path, vehicle), low, high) for path in within]
                if any(map(len, pieces)):
                    yield join([p for p in pieces if len(p)])

    def _edges(self, slot: Slot) -> list[int]:
        """Times that cut a day into stretches of about equal numbers of rows."""
        tables = (feather.read_table(path, ["timestamp"]) for path, _, _ in slot.files)
        times = np.sort(np.concatenate([np.array(t.column("timestamp"), dtype=np.int64) for t in tables]))
        pieces = -(-len(times) // WINDOW_ROWS)
        cuts = times[[len(times) * k // pieces for k in range(1, pieces)]]
        return [int(times[0]), *np.unique(cuts).tolist(), int(times[-1]) + 1]


def _between(rows: Trajectory, low: int, high: int) -> Trajectory:
    mask = (rows.time >= low) & (rows.time < high)
    return rows if mask.all() else rows[mask]


def _save(rows: Trajectory, path: Path) -> None:
    columns = {n: _dictionary(v) if isinstance(v, Labels) else pa.array(v) for n, v in rows.columns.items()}
    table = pa.table({"timestamp": pa.array(rows.time), **columns})
    feather.write_feather(table, str(path), compression="uncompressed")


def _dictionary(values: Labels) -> pa.DictionaryArray:
    codes = pa.array(values.codes, pa.int32(), mask=values.codes < 0)
    return pa.DictionaryArray.from_arrays(codes, pa.array(list(values.names), pa.string()))


def _load(path: Path, vehicle: str) -> Trajectory:
    return from_arrow(feather.read_table(path, memory_map=True), vehicle)

"""From steps to rows of the dataset, in bounded memory, written by threads as the fleet drives on."""

import math
import os
import threading
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from mmap import mmap
from typing import Self

import numpy as np

from fleetlog.core.trajectory import Labels, Trajectory, Values
from fleetlog.simulate.arrays import Flags, Floats, Index
from fleetlog.simulate.energy import Batch, Energy
from fleetlog.simulate.state import Log
from fleetlog.store.writer import DatasetWriter

ROWS = 8_000_000
"""Rows that are kept at most before they are written; some 50 bytes each."""
DIGITS = {
    "x": 3, "y": 3, "z": 3, "heading": 5, "speed": 4, "edge_offset": 3, "lateral_offset": 3, "payload": 1,
    "fork_height": 3, "battery_power": 2, "battery_voltage": 3, "battery_current": 3, "soc": 8,
}  # fmt: skip
"""Decimals that are written, so that files are small; rows wait as whole numbers of them."""
MEANS = ("battery_power", "battery_voltage", "battery_current")
"""Columns of which a row has the mean over the time around it."""
CODES = ("edge_id", "trip_id")
NULL = int(np.iinfo(np.int32).min)
TOGETHER = 16
"""Trucks that are handed over to be written at once, where there are as many."""
BEHIND = 8
"""Such groups that may wait to be written; the fleet waits when there are more."""


class Recorder:
    """Takes batches of steps, keeps every ``every``-th one as a row, and writes a truck's rows when enough
    have come together.

    Power of a row is the mean over the ``every`` steps around it, so that power times the time between rows
    adds up to the energy.  Groups of trucks are written in turn, each by one thread at a time: the same bytes
    whatever the number of threads.  Leaving the block without :meth:`flush` gives up what is not written.
    """

    def __init__(
        self,
        writer: DatasetWriter,
        names: list[str],
        edges: tuple[str, ...],
        start: int,
        dt: float,
        every: int,
        step: int,
        total: int,
        columns: tuple[str, ...],
    ) -> None:
        self.writer, self.names, self.edges = writer, names, edges
        self.every, self.rows = every, step // every
        self.interval = every * round(dt * 1e6)
        self.start = start + every // 2 * round(dt * 1e6)
        self.columns = columns
        self._scale = np.array([10.0 ** DIGITS[c] for c in columns])
        self._mean = np.array([c in MEANS for c in columns])
        trucks, total = len(names), total // step
        self.together = min(TOGETHER, trucks)
        groups = -(-trucks // self.together)
        capacity = min(max(ROWS // trucks // self.rows, 1), total)
        blocks = groups + min(groups, BEHIND)
        self._kept = _untouched(blocks * self.together, capacity, len(columns) + len(CODES), self.rows)
        self._free = deque(range(groups, blocks))
        self._row = np.arange(trucks, dtype=np.int32)
        # Trucks become due one after the other, the first when its rows are half of the most that are kept;
        # where all rows can be kept, all trucks at the end.
        share = (np.arange(trucks) // self.together + 1) / (groups + 1)
        early = 1.0 if capacity == total else 0.5 + 0.5 * share
        self._due = np.full(trucks, np.maximum(early * capacity, 1.0))
        self._filled = np.zeros(trucks, np.int32)
        self._written = np.zeros(trucks, np.int64)
        self._pool = ThreadPoolExecutor(min(os.cpu_count() or 1, 4))
        self._space = threading.local()
        self._jobs: deque[tuple[Future[None], int]] = deque()
        self._last: dict[int, Future[None]] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)

    @property
    def written(self) -> int:
        """Rows so far."""
        return int(self._written.sum())

    def add(self, first: int, log: Log, place: Batch, energy: Energy) -> None:
        """One batch of trucks ``first`` ...; :meth:`next` when it was added for all of them."""
        from fleetlog.simulate.kernels.pack import pack, pack_codes

        known = {
            "x": place.x, "y": place.y, "z": place.z, "heading": place.heading, "speed": log.v,
            "edge_offset": place.offset, "lateral_offset": place.lateral, "payload": log.load,
            "fork_height": log.height, "battery_power": energy.power, "battery_voltage": energy.voltage,
            "battery_current": energy.current, "soc": energy.soc,
        }  # fmt: skip
        trucks = slice(first, first + len(log.v))
        row, at, values = self._row[trucks], self._filled[trucks], tuple(known[c] for c in self.columns)
        pack(values, self._mean, self._scale, self.every, NULL, self._kept, row, at)
        pack_codes((place.edge, log.trip), len(values), self.every, self._kept, row, at)

    def next(self) -> None:
        """All trucks have had their batch: those that are due are written."""
        self._filled += 1
        self._hand_over(self._filled >= np.floor(self._due))
        self._due[self._filled == 0] = self._kept.shape[1]

    def flush(self) -> None:
        """Write all that is left, and wait for it."""
        self._hand_over(self._filled > 0)
        while self._jobs:
            self._wait()

    def _wait(self) -> None:
        """Until what was handed over first is written: its rows can be filled again."""
        job, block = self._jobs.popleft()
        job.result()
        self._free.append(block)

    def _hand_over(self, due: Flags) -> None:
        """Let groups of trucks be written, and give them other rows to fill."""
        for group in np.flatnonzero(due[:: self.together]).tolist():
            if not self._free:
                self._wait()
            trucks = slice(group * self.together, (group + 1) * self.together)
            rows = self._row[trucks]
            kept = self._kept[rows[0] : rows[-1] + 1, : self._filled[trucks.start]]
            # What was handed over earlier of this group has begun already: waiting for it cannot block.
            job = self._pool.submit(self._write, trucks.start, kept, self._last.get(group))
            self._last[group] = job
            self._jobs.append((job, int(rows[0]) // self.together))
            self._row[trucks] = self._free.popleft() * self.together + np.arange(len(rows))
            self._filled[trucks] = 0

    def _write(self, first: int, group: Index, before: Future[None] | None) -> None:
        """(trucks, batches, columns, rows) of trucks ``first`` ..., after what was handed over ``before``."""
        from fleetlog.simulate.kernels.pack import unpack

        if before is not None:
            before.result()
        trucks, batches, _, rows = group.shape
        if not hasattr(self._space, "values"):
            # Each thread uses its memory again: fresh pages cost as much as what is done with them.
            self._space.values = np.empty((len(self.columns), self.together * self._kept.shape[1] * rows))
        values = self._space.values[:, : trucks * batches * rows]
        unpack(group, self._scale, NULL, values)
        edge, trip = np.moveaxis(group[:, :, len(self.columns) :], 2, 0).reshape(2, -1)
        columns: dict[str, Values] = dict(zip(self.columns, values, strict=True))
        columns["edge_id"], columns["trip_id"] = self._labels(edge), trip.astype(np.int64)
        steps = self._written[first] + np.arange(batches * rows)
        time = np.tile(self.start + steps * self.interval, trucks)
        names = self.names[first : first + trucks]
        self.writer.write_together(names, Trajectory(names[0], time, columns))
        self._written[first : first + trucks] += batches * rows

    def _labels(self, edge: Index) -> Labels:
        """Only the names that occur: dictionaries stay small."""
        count = np.bincount(edge, minlength=len(self.edges))
        used = np.flatnonzero(count)
        codes = np.cumsum(count > 0, dtype=np.int32) - 1
        return Labels(codes[edge], tuple(self.edges[i] for i in used))


def _untouched(*shape: int) -> Index:
    """An array that takes memory only where it is filled; NumPy's would take most of it at once."""
    return np.frombuffer(mmap(-1, 4 * math.prod(shape)), np.int32).reshape(shape)


def rounded(columns: dict[str, Floats]) -> dict[str, Values]:
    """Columns to the decimals that a simulation writes."""
    return {name: np.round(values, DIGITS[name]) for name, values in columns.items()}


def columns_of(hilly: bool, chemistry: bool) -> tuple[str, ...]:
    """Columns that are known: height of hilly sites, voltage and current by a battery's chemistry."""
    unknown = (() if hilly else ("z",)) + (() if chemistry else ("battery_voltage", "battery_current"))
    return tuple(c for c in DIGITS if c not in unknown)

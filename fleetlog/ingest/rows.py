"""Rows on their way into a dataset, unsorted, with where each came from; set down on disk by vehicle, so that
logs of any size and order fit into memory.  What was refused, by reason, and in ``rejected.parquet``."""

import itertools
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from pyarrow import feather

from fleetlog.core.arrays import Mask
from fleetlog.core.columns import BY_NAME
from fleetlog.core.trajectory import Labels, Trajectory, Values, as_labels, concatenate, from_arrow, own_array
from fleetlog.importers._units import EARLIEST, LATEST
from fleetlog.importers.base import Reject

FILE, RECORD, CHANNEL, STUCK, HELD = INTERNAL = ("_file", "_record", "_channel", "_stuck", "_held")
"""Columns of the import itself, never written: number of the file, line or record in it; 1 for rows without
positions, of a stuck sensor, and whose position repeats an older one."""
BUDGET = 96 << 20  # Bytes of rows that wait in memory before they are set down
WINDOW_ROWS = 100_000  # Rows of a vehicle that are taken up again at a time, about
SAMPLE = 20  # Of so many rows the time of one is looked at to find where these begin
REJECTED, _FLUSH = "rejected.parquet", 50_000
_COLUMNS = ("file", "record", "kind", "reason", "text")
_SCHEMA = pa.schema([(name, pa.int64() if name == "record" else pa.string()) for name in _COLUMNS])


def set_unknown(rows: Trajectory, where: Mask, *names: str) -> Trajectory:
    """A copy with some values of float columns unknown."""
    return rows.with_columns(**{name: np.where(where, np.nan, rows.floats(name)) for name in names})


def with_own_columns(rows: Trajectory, own: dict[str, bool]) -> Trajectory:
    """Rows as they are written: with every own column of the logs, without those of the import. An own column
    is null where this vehicle has none, and text where any vehicle has text: so all files of a dataset have
    the same columns, and databases read them together."""
    new: dict[str, Values] = {}
    for name, text in own.items():
        values = rows.columns.get(name)
        if text and not isinstance(values, Labels):
            new[name] = as_labels(values, len(rows))
        elif values is None:
            new[name] = np.full(len(rows), np.nan)
    return rows.without(*INTERNAL).with_columns(**new)


def picture(rows: Trajectory, row: int) -> str:
    """One row as text, for ``rejected.parquet``."""
    cells = [f"vehicle_id={rows.vehicle_id}", f"timestamp={np.datetime64(int(rows.time[row]), 'us')}Z"]
    for name, values in rows.columns.items():
        if name in (FILE, RECORD):
            continue
        if isinstance(values, Labels):
            value = values.names[values.codes[row]] if values.codes[row] >= 0 else None
        else:
            value = f"{float(values[row]):.10g}" if values[row] == values[row] else None
        if value is not None:
            cells.append(f"{name}={value}")
    return " ".join(cells)


class Slip(NamedTuple):
    """A file of rows of one vehicle, with their first and last time [us]."""

    vehicle: str
    path: Path
    first: int
    last: int
    rows: int


class Spill:
    """Sets rows down by vehicle, into files of ``folder`` whose names begin with ``name``."""

    def __init__(self, folder: Path, name: str) -> None:
        self.folder, self.name = folder, name
        self.slips: list[Slip] = []
        self.own: dict[str, bool] = {}  # The log's own columns, and whether each is text
        self.rows = 0
        self._waiting: dict[str, list[Trajectory]] = defaultdict(list)
        self._bytes = 0

    def add(self, rows: Trajectory) -> None:
        """Set rows of one vehicle, at least one, aside."""
        for name, values in rows.columns.items():
            if name not in BY_NAME and name not in INTERNAL:
                self.own[name] = self.own.get(name, False) or isinstance(values, Labels)
        self._waiting[rows.vehicle_id].append(rows)
        self.rows += len(rows)
        self._bytes += len(rows) * 8 * (1 + len(rows.columns))
        if self._bytes > BUDGET:
            self.set_down()

    def set_down(self) -> list[Slip]:
        """Write what waits; what has been written so far."""
        for vehicle, waiting in self._waiting.items():
            rows, path = concatenate(waiting), self.folder / f"{self.name}-{len(self.slips)}.arrow"
            columns = {"timestamp": pa.array(rows.time)}
            for name, values in rows.columns.items():
                columns[name] = own_array(values) if isinstance(values, Labels) else pa.array(values)
            feather.write_feather(pa.table(columns), str(path), compression="uncompressed")
            self.slips.append(Slip(vehicle, path, int(rows.time.min()), int(rows.time.max()), len(rows)))
        self._waiting.clear()
        self._bytes = 0
        return self.slips


def windows(slips: Sequence[Slip]) -> Iterator[tuple[Trajectory, bool]]:
    """A vehicle's rows in order of time, about ``WINDOW_ROWS`` at once, unsorted within; whether last."""
    edges = _edges(slips)
    for low, high in itertools.pairwise(edges):
        rows = (_load(slip, low, high) for slip in slips if slip.first < high and slip.last >= low)
        yield concatenate([piece for piece in rows if len(piece)]), high == edges[-1]


def _edges(slips: Sequence[Slip]) -> list[int]:
    """Times that cut a vehicle's rows into stretches of about equal numbers, by a sample of them."""
    pieces = -(-sum(slip.rows for slip in slips) // WINDOW_ROWS)
    tables = (feather.read_table(slip.path, ["timestamp"]) for slip in slips if pieces > 1)
    sample = [np.zeros(0, np.int64), *(t.column("timestamp").to_numpy()[::SAMPLE] for t in tables)]
    times = np.sort(np.concatenate(sample))
    cuts = times[[len(times) * k // pieces for k in range(1, pieces)]]
    return [EARLIEST, *np.unique(cuts[cuts > times[:1]]).tolist(), LATEST + 1]


def _load(slip: Slip, low: int, high: int) -> Trajectory:
    """The rows from ``low`` on and before ``high``."""
    table = feather.read_table(slip.path, memory_map=True)
    time = table.column("timestamp").to_numpy()
    mask = (time >= low) & (time < high)
    return from_arrow(table if mask.all() else table.filter(pa.array(mask)), slip.vehicle)


@dataclass
class Rejects:
    """What one job refused; ``names`` are those of the logs."""

    file: Path | None = None  # Where it is kept, in pieces; once closed, None where nothing was refused
    names: Sequence[str] = ()
    rows: Counter[str] = field(default_factory=Counter)  # Rows refused, by reason
    values: Counter[str] = field(default_factory=Counter)  # Single values refused (the row stayed), by reason
    _waiting: list[tuple[str, int, str, str, str]] = field(default_factory=list)
    _writer: Any = None

    def add(self, file: int, rejects: Iterable[Reject]) -> None:
        """Refusals of one log, by its number."""
        for r in rejects:
            (self.rows if r.whole else self.values)[r.reason] += 1
            if self.file is not None:
                kind = "row" if r.whole else "value"
                self._waiting.append((self.names[file], r.record, kind, r.reason, r.text))
        if len(self._waiting) >= _FLUSH:
            self._flush()

    def refuse(self, rows: Trajectory, mask: Mask, reason: str, *, whole: bool = True) -> None:
        """Refuse some rows, or a value of theirs."""
        for row in np.flatnonzero(mask).tolist():
            file, record = (int(rows.floats(n)[row]) for n in (FILE, RECORD))
            self.add(file, [Reject(record, reason, picture(rows, row), whole)])

    def _flush(self) -> None:
        table = pa.table(dict(zip(_COLUMNS, zip(*self._waiting, strict=True), strict=True)), schema=_SCHEMA)
        if self._writer is None:
            self._writer = pq.ParquetWriter(self.file, _SCHEMA, compression="zstd")
        self._writer.write_table(table)
        self._waiting = []

    def close(self) -> None:
        """Write what is left; what was refused can then go to another process."""
        if self._waiting:
            self._flush()
        if self._writer is None:
            self.file = None
        else:
            self._writer.close()
        self._writer, self.names = None, ()


def gather(all_rejects: Iterable[Rejects], folder: Path, older: Path | None = None) -> Rejects:
    """All refusals as one, their rows in one file of ``folder``, after those of an ``older`` file."""
    whole, writer = Rejects(), None
    before = [Rejects(older)] if older is not None and older.exists() else []
    for rejects in [*before, *all_rejects]:
        whole.rows.update(rejects.rows)
        whole.values.update(rejects.values)
        if rejects.file is None:
            continue
        with rejects.file.open("rb") as stream, pq.ParquetFile(stream) as source:
            if writer is None:
                whole.file = folder / REJECTED
                writer = pq.ParquetWriter(whole.file, source.schema_arrow, compression="zstd")
            for group in range(source.num_row_groups):
                writer.write_table(source.read_row_group(group))
    if writer is not None:
        writer.close()
    return whole

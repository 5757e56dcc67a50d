"""Every row and value that was refused: counted by reason, and kept in ``rejected.parquet``."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fleetlog.core.arrays import Mask
from fleetlog.core.trajectory import Trajectory
from fleetlog.importers.base import Reject
from fleetlog.ingest.rows import FILE, RECORD, picture

NAME = "rejected.parquet"
_FLUSH = 50_000
_COLUMNS = ("file", "record", "kind", "reason", "text")
_SCHEMA = pa.schema([(name, pa.int64() if name == "record" else pa.string()) for name in _COLUMNS])


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
                whole.file = folder / NAME
                writer = pq.ParquetWriter(whole.file, source.schema_arrow, compression="zstd")
            for group in range(source.num_row_groups):
                writer.write_table(source.read_row_group(group))
    if writer is not None:
        writer.close()
    return whole

"""Every row and value that was refused: counted by reason, and kept in ``rejected.parquet``."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from fleetlog.core.trajectory import Trajectory
from fleetlog.importers.base import Reject
from fleetlog.ingest.rows import FILE, RECORD, picture

NAME = "rejected.parquet"
_FLUSH = 50_000
_COLUMNS = ("file", "record", "kind", "reason", "text")
_SCHEMA = pa.schema([(name, pa.int64() if name == "record" else pa.string()) for name in _COLUMNS])


@dataclass
class Refused:
    """What one job refused: rows and values by reason, and the file that keeps them."""

    rows: Counter[str] = field(default_factory=Counter)
    values: Counter[str] = field(default_factory=Counter)
    file: Path | None = None


class Rejects:
    """Collects refusals and writes them in pieces; ``file`` exists only when there are any."""

    def __init__(self, file: Path | None, files: list[str]) -> None:
        self.file, self.files = file, files
        self.rows: Counter[str] = Counter()
        """Rows refused, by reason."""
        self.values: Counter[str] = Counter()
        """Single values refused (the row stayed), by reason."""
        self._waiting: list[tuple[int, Reject]] = []
        self._writer: Any = None

    def add(self, file: int, rejects: list[Reject]) -> None:
        """Refusals of one file."""
        for reject in rejects:
            (self.rows if reject.whole else self.values)[reject.reason] += 1
        if self.file is not None:
            self._waiting += [(file, r) for r in rejects]
            if len(self._waiting) >= _FLUSH:
                self._flush()

    def refuse(self, rows: Trajectory, mask: NDArray[np.bool_], reason: str, *, whole: bool = True) -> None:
        """Refuse some rows, or a value of theirs."""
        for row in np.flatnonzero(mask).tolist():
            file, record = (int(rows.floats(n)[row]) for n in (FILE, RECORD))
            self.add(file, [Reject(record, reason, picture(rows, row), whole)])

    def _flush(self) -> None:
        if not self._waiting or self.file is None:
            return
        rows = [
            (self.files[file], r.record, "row" if r.whole else "value", r.reason, r.text)
            for file, r in self._waiting
        ]
        table = pa.table(dict(zip(_COLUMNS, zip(*rows, strict=True), strict=True)), schema=_SCHEMA)
        if self._writer is None:
            self._writer = pq.ParquetWriter(self.file, table.schema, compression="zstd")
        self._writer.write_table(table)
        self._waiting = []

    def close(self) -> Refused:
        """Write what is left; say what was refused."""
        self._flush()
        if self._writer is None:
            return Refused(self.rows, self.values)
        self._writer.close()
        return Refused(self.rows, self.values, self.file)


def gather(all_refused: Iterable[Refused], folder: Path, older: Path | None = None) -> Refused:
    """All refusals as one, their rows in one file of ``folder``, after those of an ``older`` file."""
    whole, writer = Refused(), None
    before = [Refused(file=older)] if older is not None and older.exists() else []
    for refused in [*before, *all_refused]:
        whole.rows.update(refused.rows)
        whole.values.update(refused.values)
        if refused.file is None:
            continue
        with refused.file.open("rb") as stream, pq.ParquetFile(stream) as source:
            if writer is None:
                whole.file = folder / NAME
                writer = pq.ParquetWriter(whole.file, source.schema_arrow, compression="zstd")
            for group in range(source.num_row_groups):
                writer.write_table(source.read_row_group(group))
    if writer is not None:
        writer.close()
    return whole

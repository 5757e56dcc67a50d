"""Reading a log as a test wants it: counts, or the error."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fleetlog.core.trajectory import Labels
from fleetlog.importers._open import ReadReport
from fleetlog.importers.base import Importer, ReadOptions, detect


@dataclass
class Read:
    """What came out of a file."""

    report: ReadReport
    rows: int = 0
    channel_rows: int = 0
    rejects: Counter[str] = field(default_factory=Counter)
    vehicles: set[str] = field(default_factory=set)
    columns: dict[str, list[np.ndarray]] = field(default_factory=dict)

    def column(self, name: str) -> np.ndarray:
        return np.concatenate(self.columns[name])

    @property
    def status(self) -> int:
        """The exit status that an import of this file deserves."""
        return 3 if self.rejects or self.report.damage else 0


def read_log(path: Path, importer: Importer | None = None) -> Read:
    report = ReadReport(path)
    importer = importer or detect(path)
    report.format = report.format or importer.name
    out = Read(report)
    for batch in importer.read(path, ReadOptions(report)):
        assert 0.0 <= batch.progress <= 1.0
        assert len(batch.vehicle) == len(batch.time) == len(batch.record)
        assert not (batch.vehicle.codes < 0).any()
        assert all(len(v) == len(batch) for v in batch.columns.values())
        out.rejects.update(r.reason for r in batch.rejects)
        if not batch.has_position:
            out.channel_rows += len(batch)
        else:
            out.rows += len(batch)
        out.vehicles |= {batch.vehicle.names[c] for c in np.unique(batch.vehicle.codes)}
        kind = "time" if batch.has_position else "channel time"
        out.columns.setdefault(kind, []).append(batch.time)
        for name, values in batch.columns.items():
            plain = (
                np.array(values.strings(), object)
                if isinstance(values, Labels)
                else np.asarray(values, float)
            )
            out.columns.setdefault(name, []).append(plain)
    return out

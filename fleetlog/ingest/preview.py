"""The first rows of every log as they would be read; nothing is written."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.trajectory import Labels
from fleetlog.errors import EXIT_DAMAGED, EXIT_DONE, FleetlogError
from fleetlog.importers._profile import Profile, load_profile
from fleetlog.importers.base import RawBatch
from fleetlog.ingest.files import find_logs, names_of
from fleetlog.ingest.summary import FileSummary, ImportSummary
from fleetlog.store.documents import plain

ROWS = 5


@dataclass
class Preview:
    """What was found in each log."""

    files: list[FileSummary] = field(default_factory=list)
    rows: dict[str, list[dict[str, Any]]] = field(default_factory=dict)  # First rows by file, in SI units
    rejected: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    """First refusals by file: line or record, reason, text."""

    @property
    def exit_status(self) -> int:
        """0, or 3 where something was refused on the way to the first rows."""
        return EXIT_DAMAGED if any(self.rejected.values()) or any(f.damage for f in self.files) else EXIT_DONE

    def to_dict(self) -> dict[str, Any]:
        """As ``--json`` prints it."""
        return asdict(self)

    def lines(self) -> list[str]:
        """For a person: what was recognised, then the rows as a table."""
        out = []
        for f in self.files:
            head, *about = ImportSummary(files=[f]).lines()
            out += [head.replace(": " + f.format + ", ", f": {f.format}, the first "), *about]
            if f.damage and not self.rows[f.file]:
                continue
            out += _table(self.rows[f.file])
            for r in self.rejected[f.file]:
                out.append(f"  rejected: line {r['record']}: {r['reason']}: {r['text'][:80]}")
        return out


def preview(
    paths: Sequence[str | Path], *, format: str | None = None, profile: str | Path | Profile | None = None
) -> Preview:
    """The first rows of every log among ``paths``; an error only where none can be read."""
    profile = load_profile(profile) if isinstance(profile, str | Path) else profile
    out = Preview()
    logs = find_logs(paths, format)
    errors: list[FleetlogError] = []
    for log, name in zip(logs, names_of(logs), strict=True):
        rows, rejected = out.rows.setdefault(name, []), out.rejected.setdefault(name, [])
        try:
            report, batches = log.read(profile)
            for batch in batches:
                rows += _rows(batch, ROWS - len(rows))
                rejected += [r._asdict() for r in batch.rejects[: ROWS - len(rejected)]]
                if len(rows) >= ROWS:
                    break
            out.files.append(FileSummary.of(report, name, len(rows)))
        except FleetlogError as error:
            errors.append(error)
            out.files.append(log.unusable(name, error))
    if len(errors) == len(logs):
        raise errors[0]
    return out


def _rows(batch: RawBatch, count: int) -> list[dict[str, Any]]:
    """The first rows; what is unknown is None."""
    first = slice(min(count, len(batch)))
    table: dict[str, list[Any]] = {
        "vehicle_id": batch.vehicle[first].strings(),
        "timestamp": [f"{np.datetime64(t, 'us')}Z" for t in batch.time[first].tolist()],
    }
    for name, values in batch.columns.items():
        known = values[first]
        table[name] = known.strings() if isinstance(known, Labels) else plain(known.astype(float))
    return [dict(zip(table, row, strict=True)) for row in zip(*table.values(), strict=True)]


def _table(rows: list[dict[str, Any]]) -> list[str]:
    """Aligned columns; few enough rows that it need not be fast."""
    if not rows:
        return ["  no rows"]
    names = list(dict.fromkeys(n for r in rows for n in r))
    cells = [names] + [[_cell(r.get(n)) for n in names] for r in rows]
    width = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return ["  " + "  ".join(map(str.ljust, line, width)).rstrip() for line in cells]


def _cell(value: Any) -> str:
    return "" if value is None else f"{value:.9g}" if isinstance(value, float) else str(value)

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
from fleetlog.ingest.files import Log, find_logs, names_of
from fleetlog.ingest.summary import FileSummary, ImportSummary

ROWS = 5


@dataclass
class Preview:
    """What was found in each log."""

    files: list[FileSummary] = field(default_factory=list)
    rows: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    """First rows by file, in SI units."""
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
        out.rows[name], out.rejected[name] = [], []
        try:
            out.files.append(_first(out, log, name, profile))
        except FleetlogError as error:
            errors.append(error)
            out.files.append(log.unusable(name, error))
    if len(errors) == len(logs):
        raise errors[0]
    return out


def _first(out: Preview, log: Log, name: str, profile: Profile | None) -> FileSummary:
    """The first rows and refusals of one log go into ``out``."""
    report, batches = log.read(profile)
    rows, rejected = out.rows[name], out.rejected[name]
    for batch in batches:
        rows += _rows(batch, ROWS - len(rows))
        rejected += [r._asdict() for r in batch.rejects[: ROWS - len(rejected)]]
        if len(rows) >= ROWS:
            break
    return FileSummary.of(report, name, len(rows))


def _rows(batch: RawBatch, count: int) -> list[dict[str, Any]]:
    out = []
    for row in range(min(max(count, 0), len(batch))):
        stamp = f"{np.datetime64(int(batch.time[row]), 'us')}Z"
        cells: dict[str, Any] = {"vehicle_id": batch.vehicle[[row]].strings()[0], "timestamp": stamp}
        for name, values in batch.columns.items():
            if isinstance(values, Labels):
                cells[name] = values[[row]].strings()[0]
            else:
                cells[name] = None if values[row] != values[row] else float(values[row])
        out.append(cells)
    return out


def _table(rows: list[dict[str, Any]]) -> list[str]:
    """Aligned columns; few enough rows that it need not be fast."""
    if not rows:
        return ["  no rows"]
    names = list(dict.fromkeys(n for r in rows for n in r))
    cells = [names] + [[_cell(r.get(n)) for n in names] for r in rows]
    width = [max(len(line[i]) for line in cells) for i in range(len(names))]
    return ["  " + "  ".join(c.ljust(w) for c, w in zip(line, width, strict=True)).rstrip() for line in cells]


def _cell(value: Any) -> str:
    return "" if value is None else f"{value:.9g}" if isinstance(value, float) else str(value)

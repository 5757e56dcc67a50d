"""Which logs are meant: files, folders and patterns, as a sorted list; and the first rows of each."""

import glob
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.trajectory import Labels
from fleetlog.core.words import count
from fleetlog.errors import EXIT_DAMAGED, EXIT_DONE, DataError, FleetlogError, InputError
from fleetlog.importers._open import ReadReport
from fleetlog.importers._profile import Profile, load_profile
from fleetlog.importers.base import Importer, RawBatch, ReadOptions, by_name, detect, find, read_guarded
from fleetlog.ingest.summary import ImportSummary
from fleetlog.listening import notice
from fleetlog.store.documents import plain
from fleetlog.store.output import MARK

NAMED = 5  # Files that are named among those that are passed over


@dataclass(frozen=True)
class Log:
    """A log and how it is read; ``error`` where no format fits (others are still read)."""

    path: Path
    importer: Importer | None
    error: FleetlogError | None = None

    def read(self, profile: Profile | None) -> tuple[ReadReport, Iterator[RawBatch]]:
        """The report of the log, filled while its batches are taken; its error where no format fits."""
        if self.importer is None:
            raise self.error or FleetlogError("no format", where=self.path)
        report = ReadReport(self.path, self.importer.name)
        return report, read_guarded(self.importer, self.path, ReadOptions(report, profile))

    def unusable(self, name: str, error: FleetlogError) -> ReadReport:
        """What is said of a log that could not be read at all."""
        kind = self.importer.name if self.importer else "unknown format"
        report = ReadReport(self.path, kind, file=name)
        # A whole file that holds nothing of a truck's way is not damaged.
        tell = report.note if isinstance(error, DataError) else report.damaged
        tell(f"nothing is usable: {error.advice}")
        return report


def find_logs(paths: Sequence[str | Path], format: str | None = None) -> list[Log]:
    """The logs among ``paths`` in order of their names, whatever the order of the command line. A folder
    stands for the logs in it, recursively; files in it that no format fits, and outputs of fleetlog, are
    passed over. A pattern (``*``, ``?``, ``[``) stands for what it matches."""
    importer = by_name(format) if format else None
    logs: dict[Path, Log] = {}
    for given in expanded(paths):
        alone = [] if given.is_dir() else [_log(given, lambda p: importer or detect(p))]
        for log in alone or _in_folder(given, importer):
            logs.setdefault(log.path.resolve(), log)
    if not logs:
        do = "give files, or name the format with --format"
        raise InputError("no log in it", where=", ".join(map(str, paths)), do=do)
    found = sorted(logs.values(), key=lambda log: str(log.path))
    if found[0].error and all(log.error for log in found):
        raise found[0].error
    return found


def names_of(logs: Sequence[Log]) -> list[str]:
    """The logs by their names, or by their paths where two have the same name."""
    names = [log.path.name for log in logs]
    return names if len(set(names)) == len(names) else [str(log.path) for log in logs]


def expanded(paths: Sequence[str | Path]) -> list[Path]:
    """Files and folders that exist; of what a pattern matches, all but outputs of fleetlog."""
    out = []
    for path in map(Path, paths):
        if path.exists():
            out.append(path)
            continue
        matches = glob.glob(str(path), recursive=True)  # noqa: PTH207 - Path.glob takes no absolute pattern
        if not matches:
            raise InputError("no such file", where=path, do="check the name")
        out += [path for path in map(Path, matches) if not (path / MARK).exists()]
    return out


def _log(path: Path, importer_of: Callable[[Path], Importer | None]) -> Log:
    try:
        return Log(path, importer_of(path))
    except FleetlogError as error:
        return Log(path, None, error)


def _in_folder(folder: Path, importer: Importer | None) -> list[Log]:
    """A folder that is one log (a ROS 2 bag), or the logs below it."""
    whole = find(folder)
    if whole is not None and importer in (None, whole):
        return [Log(folder, whole)]
    logs = [_log(path, lambda p: find(p) if p.stat().st_size else None) for path in sorted(_files(folder))]
    found = [log for log in logs if log.error or (log.importer and importer in (None, log.importer))]
    taken = {log.path for log in found}
    other = [str(log.path.relative_to(folder)) for log in logs if log.path not in taken]
    if found and other:
        named = ", ".join(other[:NAMED]) + (" ..." if len(other) > NAMED else "")
        notice(f"{folder}: {count(len(other), 'file')} skipped, as their format does not fit: {named}")
    return found


def _files(folder: Path) -> Iterator[Path]:
    """The files below a folder but hidden ones and fleetlog's outputs; of a dataset named itself its rows."""
    rows = folder / "trajectories"
    for top, folders, files in os.walk(rows if (folder / "dataset.json").is_file() else folder):
        here = Path(top)
        folders[:] = [n for n in folders if not n.startswith(".") and not (here / n / MARK).exists()]
        yield from (here / n for n in files if not n.startswith(".") and (here / n).is_file())


ROWS = 5


@dataclass
class Preview:
    """What was found in each log."""

    files: list[ReadReport] = field(default_factory=list)
    rows: dict[str, list[dict[str, Any]]] = field(default_factory=dict)  # First rows by file, in SI units
    rejected: dict[str, list[dict[str, Any]]] = field(default_factory=dict)  # And refusals, with reasons

    @property
    def exit_status(self) -> int:
        """0, or 3 where something was refused on the way to the first rows."""
        return EXIT_DAMAGED if any(self.rejected.values()) or any(f.damage for f in self.files) else EXIT_DONE

    def to_dict(self) -> dict[str, Any]:
        """As ``--json`` prints it."""
        return asdict(self) | {"files": [f.to_dict() for f in self.files]}

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
    out, logs = Preview(), find_logs(paths, format)
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
            out.files.append(replace(report, rows=len(rows), file=name))
        except FleetlogError as error:
            errors.append(error)
            out.files.append(log.unusable(name, error))
    if len(errors) == len(logs):
        raise errors[0]
    return out


def _rows(batch: RawBatch, count: int) -> list[dict[str, Any]]:
    """The first rows; what is unknown is None."""
    first = slice(min(count, len(batch)))
    stamps = [f"{np.datetime64(t, 'us')}Z" for t in batch.time[first].tolist()]
    table: dict[str, list[Any]] = {"vehicle_id": batch.vehicle[first].strings(), "timestamp": stamps}
    for name, values in batch.columns.items():
        known = values[first]
        table[name] = known.strings() if isinstance(known, Labels) else plain(known.astype(float))
    return [dict(zip(table, row, strict=True)) for row in zip(*table.values(), strict=True)]


def _table(rows: list[dict[str, Any]]) -> list[str]:
    """Aligned columns; few enough rows that it need not be fast."""
    if not rows:
        return ["  no rows"]
    names = list(dict.fromkeys(n for r in rows for n in r))
    values: list[list[Any]] = [names, *([r.get(n) for n in names] for r in rows)]
    cells = [["" if v is None else f"{v:.9g}" if isinstance(v, float) else str(v) for v in r] for r in values]
    width = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return ["  " + "  ".join(map(str.ljust, line, width)).rstrip() for line in cells]

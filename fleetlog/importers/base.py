"""What every log format gives: batches of rows in SI units, and a report of what was read.

A format is one module of this package that holds ``IMPORTER``, an :class:`Importer`.  It turns a file into
:class:`RawBatch` es; cleaning, frames, derived columns and matching are :mod:`fleetlog.ingest`'s."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cached_property, partial
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

import numpy as np

from fleetlog.core.arrays import DAY, Floats, Ints
from fleetlog.core.columns import BY_NAME, HIVE_NULL
from fleetlog.core.trajectory import Labels, Values, as_labels
from fleetlog.core.words import count
from fleetlog.errors import REPORT, FleetlogError, FormatError, InputError, chosen, fault
from fleetlog.importers._open import ReadReport, compression, head_of, plain_stem, plain_suffix
from fleetlog.importers._profile import TARGETS, Profile
from fleetlog.importers._units import EARLIEST, EARLIEST_LOG, LATEST, OFF_TIME, microseconds
from fleetlog.registry import parts

GEOGRAPHIC, LOCAL = ("latitude", "longitude"), ("x", "y")
LONGEST_ID = 200  # Characters of a vehicle's id as the name of a folder
_OTHERWISE = "a profile may say when it was ([time] origin = ...)"
UNKNOWN_START = f"the times count from an unknown start, placed at 1970-01-01: {_OTHERWISE}"
WEEKS = 1024 * 7 * DAY  # After which the count of GPS weeks starts again [us]
OLD_CLOCK = "its first time is of {}: false where a clock was not set, or GPS weeks rolled over (then {})"
NO_NAME = f"the vehicle id is missing, longer than {LONGEST_ID} characters, or the word for unknown"


class Reject(NamedTuple):
    """A row that could not be used: its line or record number (from 1), why, and its text or values. Where
    ``whole`` is False only one value was refused; the row stays, with that value unknown."""

    record: int
    reason: str
    text: str
    whole: bool = True


@dataclass(frozen=True)
class RawBatch:
    """N rows as a log gives them, vehicles mixed, in any order; nothing cleaned but everything in SI units.

    vehicle : (N,) labels, no nulls.
    time : (N,) int64, microseconds since 1970-01-01 UTC.
    columns : (N,) arrays by name.  Positions are ``latitude``, ``longitude`` [degrees, WGS 84] or ``x``,
        ``y`` [m, site frame], ``z`` [m, up; ellipsoid or sea level as the log has it]; the further columns of
        :mod:`fleetlog.core.columns` in the contract's units (NaN for unknown); then the log's own columns
        under their own names, float64 or :class:`~fleetlog.core.trajectory.Labels`. A batch without position
        columns is a *channel*: its values are interpolated onto the rows that have positions (a battery
        message that comes at its own times).  A row with NaN for its position stays a row of its own.
    record : (N,) int64, line or record number in the file, from 1.
    rejects : rows met on the way that could not be used.
    progress : share of the file that has been read, 0 to 1."""

    vehicle: Labels
    time: Ints
    columns: dict[str, Values]
    record: Ints
    rejects: list[Reject] = field(default_factory=list)
    progress: float = 0.0

    def __len__(self) -> int:
        return len(self.time)

    @property
    def has_position(self) -> bool:
        """Whether the batch carries positions, or is a channel to be joined to them."""
        return any(all(n in self.columns for n in pair) for pair in (GEOGRAPHIC, LOCAL))

    @classmethod
    def of(
        cls, vehicle: str | Labels, time: Ints, columns: dict[str, Values], record: Ints | None = None,
        rejects: Iterable[Reject] = (), progress: float = 0.0,
    ) -> "RawBatch":  # fmt: skip
        """A batch; one vehicle may be named by a string, and records are numbered from 1 where not given."""
        n = len(time)
        labels = Labels(np.zeros(n, np.int32), (vehicle,)) if isinstance(vehicle, str) else vehicle
        numbers = np.arange(1, n + 1, dtype=np.int64) if record is None else record
        return cls(labels, np.asarray(time, np.int64), columns, numbers, list(rejects), progress)


@dataclass(frozen=True)
class ReadOptions:
    """How to read: the user's profile, if any, and the report to fill."""

    report: ReadReport
    profile: Profile | None = None

    @property
    def vehicle(self) -> str | None:
        """The constant vehicle id that the profile gives this file."""
        if self.profile is None or self.profile.vehicle is None:
            return None
        path, name = self.report.path, self.profile.vehicle
        return name.replace("{stem}", plain_stem(path)).replace("{folder}", path.absolute().parent.name)

    @cached_property
    def name(self) -> str:
        """The id of the vehicle of a log that names none: the profile's, or the file's name."""
        return self.vehicle or plain_stem(self.report.path)

    @cached_property
    def origin(self) -> int:
        """Microseconds since 1970 from which a time counts: the profile's word, or 0."""
        return self.profile.origin if self.profile else 0


@dataclass(frozen=True)
class Importer:
    """A log format.

    name : as ``--format`` takes it.
    suffixes : lower case with the dot, as ``(".gpx",)``; those of compression are taken off first.
    sniff : whether the file looks like this format, from its path and its first 64 KiB, decompressed (``b""``
        for a folder).
    read : the rows, batch by batch, in bounded memory; raises :class:`~fleetlog.errors.FormatError` when
        nothing is usable.
    rank : formats of a lower rank are asked first; 0 for those with a signature, 9 for a last resort."""

    name: str
    suffixes: tuple[str, ...]
    sniff: Callable[[Path, bytes], bool]
    read: Callable[[Path, ReadOptions], Iterator[RawBatch]]
    rank: int = 0


def holding(*marks: bytes, first: int = 4096) -> Callable[[Path, bytes], bool]:
    """The ``sniff`` of a format that has one of ``marks`` among its ``first`` bytes."""
    return partial(_holds, marks, first)


def _holds(marks: tuple[bytes, ...], first: int, _: Path, head: bytes) -> bool:
    return any(mark in head[:first] for mark in marks)


def importers() -> dict[str, Importer]:
    """Every known format by name."""
    return parts("fleetlog.importers", "IMPORTER")


def by_name(name: str) -> Importer:
    """The format called ``name``."""
    return chosen(importers(), name, f"no log format {name!r}", InputError)


def find(path: Path) -> Importer | None:
    """The format of ``path``: its suffix is asked first, then every signature; None when nothing fits."""
    head, suffix = head_of(path), plain_suffix(path)
    order = sorted(importers().values(), key=lambda i: (suffix not in i.suffixes, i.rank, i.name))
    return next((i for i in order if _fits(i, path, head)), None)


def _fits(importer: Importer, path: Path, head: bytes) -> bool:
    try:
        return importer.sniff(path, head)
    except Exception:  # bytes that its sniffing cannot take are none of its format
        return False


def detect(path: Path) -> Importer:
    """The format of ``path``, or an error that says what the file looks like."""
    if (importer := find(path)) is None:
        if path.is_file() and not path.stat().st_size:
            raise FormatError("the file is empty", where=path, do="give a log with rows")
        do = f"name it with --format: {', '.join(sorted(importers()))}"
        if path.suffix.lower() in (".xlsx", ".xls", ".ods") or head_of(path, 3) == b"PK\x03":
            do = "save its sheet as CSV, or unpack it"
        raise FormatError(f"no log format fits ({_looks(path)})", where=path, do=do)
    return importer


def _looks(path: Path) -> str:
    if path.is_dir():
        return "a folder"
    head, packed = head_of(path), compression(path)
    if not head:
        return "nothing in it can be unpacked"
    kind = "binary" if sum(b < 9 or 13 < b < 32 for b in head) > 0.02 * len(head) else "text"
    return f"{kind}, {count(path.stat().st_size, 'byte')}{', ' + packed if packed else ''}"


def read_guarded(importer: Importer, path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """The batches of a file, each checked; :class:`~fleetlog.errors.FleetlogError` where no row is usable.

    What cannot be read after the first row, for whatever reason, is damage in ``options.report``."""
    last, first, latest = 0, LATEST, -1
    try:
        for batch in importer.read(path, options):
            yield _sound(batch, options)
            last = max(last, int(batch.record.max(initial=0)))
            first = min(first, int(batch.time.min(initial=LATEST)))
            latest = max(latest, int(batch.time.max(initial=-1)))
    except FleetlogError as error:
        if not last:
            raise
        options.report.damaged(f"breaks off after record {last:,}: {error.what}")
    except Exception as error:
        what = fault(f"the reader of {importer.name}", error)
        if isinstance(error, MemoryError):
            what = "needs more memory than there is"
        if not last:
            raise FormatError(what, where=path, place="before the first row", do=REPORT) from error
        options.report.damaged(f"breaks off after record {last:,}: {what}; {REPORT}")
    else:
        if 0 <= latest < EARLIEST_LOG and not options.origin:
            options.report.note(UNKNOWN_START)
        elif first + WEEKS < microseconds(datetime.now(UTC)) and not options.origin:
            days = (str(np.datetime64(us, "us"))[:10] for us in (first, first + WEEKS))
            options.report.note(OLD_CLOCK.format(*days))


def _sound(batch: RawBatch, options: ReadOptions) -> RawBatch:
    """The batch with times that can be counted, names that can be written, and columns of their kind."""
    withheld = options.profile is not None and not options.profile.keep
    shown = (lambda _: "") if withheld else _text
    rejects = [r._replace(reason=_text(r.reason), text=shown(r.text)) for r in batch.rejects]
    columns: dict[str, Values] = {}
    nowhere = np.zeros(len(batch), bool)
    for given, values in batch.columns.items():
        if withheld and given not in TARGETS:
            continue
        name, found = _column(_text(given), values, options.report)
        columns[name] = found
        if isinstance(found, Labels) or not (wrong := np.isinf(found)).any():
            continue
        columns[name] = np.where(wrong, np.nan, found)
        if name in (*GEOGRAPHIC, *LOCAL):
            nowhere |= wrong
        elif name in BY_NAME:
            said = ((int(batch.record[i]), _said(values, i)) for i in np.flatnonzero(wrong).tolist())
            rejects += [Reject(n, f"{name} is not a number", text, False) for n, text in said]
    off, vehicle = (batch.time < EARLIEST) | (batch.time > LATEST), _named(batch.vehicle)
    sizes = [0 if v == HIVE_NULL else len(quote(v.strip(), safe="")) for v in vehicle.names]
    nameless = np.array([*(not 0 < size <= LONGEST_ID for size in sizes), True])[vehicle.codes]
    keep = ~(off | nowhere | nameless)
    for n in np.flatnonzero(~keep).tolist():
        reason = OFF_TIME if off[n] else NO_NAME if nameless[n] else "the position is not a number"
        cells = {"vehicle_id": _said(vehicle, n), "timestamp": f"{batch.time[n]} us"}
        cells |= {name: _said(values, n) for name, values in columns.items()}
        text = " ".join(f"{name}={cell}" for name, cell in cells.items())[:4000]
        rejects.append(Reject(int(batch.record[n]), reason, text))
    rows = slice(None) if keep.all() else keep
    columns = {n: v[rows] for n, v in columns.items()}
    return RawBatch(vehicle[rows], batch.time[rows], columns, batch.record[rows], rejects, batch.progress)


def _column(name: str, values: Values, report: ReadReport) -> tuple[str, Values]:
    """A column brought to its kind; whole numbers are -1 where unknown, or else the log's own."""
    kind = BY_NAME[name].kind if name in BY_NAME else "double" if name in GEOGRAPHIC else ""
    if kind == "double":
        return name, _figures(values)
    if kind == "int64":
        figures = values if not isinstance(values, Labels) and values.dtype.kind == "i" else _figures(values)
        known = figures[~np.isnan(figures)]
        if (np.abs(known) < 2**53).all() and not (known % 1).any():
            return name, np.where(np.isnan(figures), -1, figures).astype(np.int64)
        report.note(f"{name!r} holds more than whole numbers: kept as {name + '_log'!r}")
        return f"{name}_log", values
    is_text = kind or isinstance(values, Labels)
    return name, _named(as_labels(values, len(values))) if is_text else values


def _figures(values: Values) -> Floats:
    """(N,) numbers, NaN for unknown, infinite for what is none."""
    if not isinstance(values, Labels):
        return np.asarray(values, dtype=np.float64)
    return np.array([*map(_number, values.names), np.nan])[values.codes]


def _number(text: str) -> float:
    try:
        value = float(text.replace("_", "?")) if text.strip() else np.nan
    except ValueError:
        return np.nan if text.lower() in ("na", "n/a", "null", "none", "-") else np.inf
    return value if np.isfinite(value) or np.isnan(value) else np.inf


def _said(values: Values, row: int) -> str:
    if not isinstance(values, Labels):
        return str(values[row])
    return values.names[values.codes[row]][:400] if values.codes[row] >= 0 else ""


def _named(labels: Labels) -> Labels:
    """Labels whose names are valid text, each once."""
    return renamed(labels, [_text(name) for name in labels.names])


def _text(name: str) -> str:
    """Valid Unicode; half a surrogate pair is shown as a replacement character."""
    return name if name.isascii() else name.encode("utf-16", "surrogatepass").decode("utf-16", "replace")


def renamed(labels: Labels, names: Sequence[str | None]) -> Labels:
    """The labels with a new name for each of theirs; None is null, and equal names become one."""
    if list(names) == list(labels.names):
        return labels
    fresh = Labels.of(names)
    return Labels(np.append(fresh.codes, np.int32(-1))[labels.codes], fresh.names)

"""What every log format gives: batches of rows in SI units, and a report of what was read.

A format is one module of this package that holds ``IMPORTER``, an :class:`Importer`.  It turns a file into
:class:`RawBatch` es; cleaning, frames, derived columns and matching are :mod:`fleetlog.ingest`'s."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fleetlog.core.arrays import Ints
from fleetlog.core.trajectory import Labels, Values
from fleetlog.core.words import count
from fleetlog.errors import FormatError, InputError, chosen
from fleetlog.importers._open import ReadReport, compression, head_of, plain_stem, plain_suffix
from fleetlog.importers._profile import Profile
from fleetlog.registry import parts

GEOGRAPHIC = ("latitude", "longitude")
LOCAL = ("x", "y")


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
    head = head_of(path)
    suffix = plain_suffix(path)
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
        do = f"name it with --format: {', '.join(sorted(importers()))}"
        if path.suffix.lower() in (".xlsx", ".xls", ".ods"):
            do = "save its sheet as CSV"
        raise FormatError(f"no log format fits ({_looks(path)})", where=path, do=do)
    return importer


def _looks(path: Path) -> str:
    if path.is_dir():
        return "a folder"
    head = head_of(path)
    packed = compression(path)
    if not head:
        return "nothing in it can be unpacked" if packed else "the file is empty"
    kind = "binary" if sum(b < 9 or 13 < b < 32 for b in head) > 0.02 * len(head) else "text"
    return f"{kind}, {count(path.stat().st_size, 'byte')}{', ' + packed if packed else ''}"

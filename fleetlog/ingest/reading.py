"""Reading the logs: batches sorted out by vehicle, put in order, set down."""

import itertools
from collections import defaultdict
from collections.abc import Callable, Iterator, Set
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from fleetlog.core.columns import NAMES
from fleetlog.core.frames import geographic
from fleetlog.core.trajectory import Labels, Trajectory, Values
from fleetlog.errors import FleetlogError
from fleetlog.importers._profile import Profile
from fleetlog.importers._report import ReadReport
from fleetlog.importers._rows import renamed
from fleetlog.importers.base import LOCAL, RawBatch
from fleetlog.ingest.files import Log
from fleetlog.ingest.order import BACKWARDS, Order
from fleetlog.ingest.rejects import NAME, Refused, Rejects
from fleetlog.ingest.rows import CHANNEL, FILE, INTERNAL, RECORD
from fleetlog.ingest.spill import Down, Spill
from fleetlog.ingest.summary import FileSummary

_RESERVED = frozenset((*NAMES, "date", *INTERNAL))
GROUP = 4 << 20
"""Small logs are read together until they have this many bytes."""


Group = tuple[int, list[Log]]
"""The number of the first log among all, and the logs that one job reads."""


@dataclass
class Read:
    """What was read."""

    down: Down = field(default_factory=Down)
    refused: Refused = field(default_factory=Refused)
    files: list[FileSummary] = field(default_factory=list)
    rows: int = 0
    """Read, refused ones among them."""
    positioned: set[str] = field(default_factory=set)
    """Vehicles that have a position somewhere."""
    errors: list[FleetlogError] = field(default_factory=list)


def groups_of(logs: list[Log]) -> list[Group]:
    """The logs in groups of at least ``GROUP`` bytes, in their order; one log may be larger."""
    out: list[Group] = []
    size = GROUP
    for number, log in enumerate(logs):
        if size >= GROUP:
            out.append((number, []))
            size = 0
        out[-1][1].append(log)
        size += log.path.stat().st_size if log.path.is_file() else GROUP
    return out


def read_group(
    folder: Path, names: list[str], profile: Profile | None, tell: Callable[[Log, float], None] | None,
    group: Group,
) -> Read:  # fmt: skip
    """Read some logs; their rows are set down in ``folder``."""
    first, logs = group
    reading = Reading(folder, names, profile, first)
    for number, log in enumerate(logs, first):
        try:
            reading.read(number, log, partial(tell, log) if tell else lambda _: None)
        except FleetlogError as error:
            reading.failed(log, error)
    return reading.finish()


class Reading:
    """Takes in log after log."""

    def __init__(self, folder: Path, names: list[str], profile: Profile | None, first: int) -> None:
        self.spill, self.profile = Spill(folder, f"log-{first}"), profile
        self.rejects = Rejects(folder / f"log-{first}-{NAME}", names)
        self.out = Read()

    def finish(self) -> Read:
        """What was read, all of it on disk."""
        self.out.down, self.out.refused = self.spill.finish(), self.rejects.close()
        return self.out

    def read(self, number: int, log: Log, tell: Callable[[float], None]) -> None:
        """One log."""
        report, batches = log.read(self.profile)
        orders: dict[tuple[str, bool], Order] = defaultdict(Order)
        refused = self.rejects.rows.total()
        before = self.spill.down.rows
        for batch in batches:
            batch = self._geographic(batch)
            self.rejects.add(number, batch.rejects)
            for rows in split(batch, number, report):
                self._set_down(orders[rows.vehicle_id, CHANNEL in rows].sift(rows))
            tell(batch.progress)
        for order in orders.values():
            if rest := order.flush():
                self._set_down(rest)
        rows_read = self.spill.down.rows - before + self.rejects.rows.total() - refused
        self.out.rows += rows_read
        self.out.files.append(FileSummary.of(report, log.path.name, rows_read))

    def _geographic(self, batch: RawBatch) -> RawBatch:
        """A batch whose x, y are of the reference system that the profile states, in degrees."""
        crs = self.profile.crs if self.profile else None
        if crs is None or not all(n in batch.columns for n in LOCAL):
            return batch
        columns = dict(batch.columns)
        latitude, longitude = geographic(crs, *(np.asarray(columns.pop(n), float) for n in LOCAL))
        return replace(batch, columns={"latitude": latitude, "longitude": longitude, **columns})

    def _set_down(self, sifted: tuple[Trajectory, Trajectory]) -> None:
        good, bad = sifted
        if len(bad):
            self.rejects.refuse(bad, np.ones(len(bad), bool), BACKWARDS)
        if len(good):
            self.spill.add(good)
            if any(np.isfinite(good.floats(n)).any() for n in ("latitude", "x")):
                self.out.positioned.add(good.vehicle_id)

    def failed(self, log: Log, error: FleetlogError) -> None:
        """A log that could not be read at all."""
        self.out.errors.append(error)
        self.out.files.append(log.unusable(log.path.name, error))


def split(batch: RawBatch, number: int, report: ReadReport) -> Iterator[Trajectory]:
    """The rows of each vehicle in a batch, with the number of the file and of the record."""
    if not len(batch):
        return
    columns: dict[str, Values] = {}
    for name, values in batch.columns.items():
        columns[_own_name(name, batch.columns.keys() | columns.keys(), report)] = values
    columns[FILE] = np.full(len(batch), float(number))
    columns[RECORD] = batch.record.astype(np.float64)
    if not batch.has_position:
        columns[CHANNEL] = np.ones(len(batch))
    codes, names = batch.vehicle.codes, batch.vehicle.names
    present = np.unique(codes)
    for code in present.tolist():
        rows = slice(None) if len(present) == 1 else np.flatnonzero(codes == code)
        picked = {n: _trimmed(v[rows]) for n, v in columns.items()}
        yield Trajectory(names[code].strip(), batch.time[rows], picked)


def _trimmed(values: Values) -> Values:
    """Labels without names that no row has (a batch of many vehicles)."""
    if not isinstance(values, Labels) or len(values.names) < 64:
        return values
    used = set(np.unique(values.codes).tolist())
    return renamed(values, [name if code in used else None for code, name in enumerate(values.names)])


def _own_name(name: str, names: Set[str], report: ReadReport) -> str:
    """A column's name in the dataset; a taken one gets a suffix (databases do not tell capitals apart)."""
    if name.lower() not in _RESERVED or (name in NAMES and name not in ("vehicle_id", "timestamp")):
        return name
    other = next(n for k in itertools.count() if (n := f"{name}_log{k or ''}") not in names)
    report.note(f"{name!r} is kept as {other!r}: its name is taken")
    return other

"""Reading the logs: batches sorted out by vehicle, put in order, set down.

Late rows are sorted in, wrong clocks refused, restarted logs kept.  The rows of a vehicle in a file fall
into *runs*: a run ends where time steps back by more than ``WINDOW`` or leaps ahead by more than ``LEAP``.  A
run of fewer than ``SHORT`` rows beside a step back is a clock gone wrong and is refused; a longer one is the
log starting again (files put together in another order) and is kept."""

import itertools
from collections import defaultdict
from collections.abc import Iterator, Set
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from fleetlog.core.arrays import Ints, levels
from fleetlog.core.columns import NAMES
from fleetlog.core.site import geographic
from fleetlog.core.trajectory import Labels, Trajectory, Values, concatenate
from fleetlog.errors import FleetlogError
from fleetlog.importers._open import ReadReport
from fleetlog.importers._profile import Profile
from fleetlog.importers._units import EARLIEST
from fleetlog.importers.base import LOCAL, RawBatch, renamed
from fleetlog.ingest.files import Log
from fleetlog.ingest.rows import CHANNEL, FILE, INTERNAL, RECORD, Rejects, Slip, Spill
from fleetlog.listening import progress

_RESERVED = frozenset((*NAMES, "date", *INTERNAL))
WINDOW = 60_000_000  # A row may come this late and is still sorted in [us]
LEAP = 3600_000_000  # A longer silence begins a new run [us]
SHORT = 5  # Rows; a run with fewer beside a step back is refused
BACKWARDS = "time runs backwards"
READ_SHARE = 0.5  # Of an import, as its progress is told
GROUP = 4 << 20  # Small logs are read together until they have this many bytes
Group = tuple[int, list[Log]]  # The number of the first log among all, and the logs that one job reads


@dataclass
class Read:
    """What was read."""

    rejects: Rejects
    slips: list[Slip] = field(default_factory=list)
    own: dict[str, bool] = field(default_factory=dict)  # The logs' own columns, and whether each is text
    files: list[ReadReport] = field(default_factory=list)
    positioned: set[str] = field(default_factory=set)  # Vehicles that have a position somewhere
    driven: set[str] = field(default_factory=set)  # Vehicles that have a speed
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


def read_group(folder: Path, names: list[str], profile: Profile | None, group: Group) -> Read:
    """Read some logs; their rows are set down in ``folder``."""
    first, logs = group
    spill, out = Spill(folder, f"log-{first}"), Read(Rejects(folder / f"log-{first}.parquet", names))
    for number, log in enumerate(logs, first):
        before = spill.rows + out.rejects.rows.total()
        try:
            report, batches = log.read(profile)
            placed = (_geographic(batch, profile) for batch in batches)
            for good, bad in _sifted(placed, number, report, out.rejects):
                out.rejects.refuse(bad, np.ones(len(bad), bool), BACKWARDS)
                if len(good):
                    spill.add(good)
                for name in ("latitude", "x", "speed"):
                    vehicles = out.driven if name == "speed" else out.positioned
                    if good.vehicle_id not in vehicles and np.isfinite(good.floats(name)).any():
                        vehicles.add(good.vehicle_id)
            rows = spill.rows + out.rejects.rows.total() - before
            out.files.append(replace(report, rows=rows, file=log.path.name))
        except FleetlogError as error:
            out.errors.append(error)
            out.files.append(log.unusable(log.path.name, error))
    out.slips, out.own = spill.set_down(), spill.own
    out.rejects.close()
    return out


def _sifted(
    batches: Iterator[RawBatch], number: int, report: ReadReport, rejects: Rejects
) -> Iterator[tuple[Trajectory, Trajectory]]:
    """Rows to keep and rows to refuse of one log, in the order of time as far as the log has one."""
    orders: dict[tuple[str, bool], Order] = defaultdict(Order)
    for batch in batches:
        rejects.add(number, batch.rejects)
        for rows in split(batch, number, report):
            yield orders[rows.vehicle_id, CHANNEL in rows].sift(rows)
        progress(f"reading {report.path.name}", READ_SHARE * (number + batch.progress) / len(rejects.names))
    for order in orders.values():
        yield from order.flush()


def _geographic(batch: RawBatch, profile: Profile | None) -> RawBatch:
    """A batch whose x, y are of the reference system that the profile states, in degrees."""
    if profile is None or profile.crs is None or not all(n in batch.columns for n in LOCAL):
        return batch
    columns = dict(batch.columns)
    latitude, longitude = geographic(profile.crs, *(np.asarray(columns.pop(n), float) for n in LOCAL))
    return replace(batch, columns={"latitude": latitude, "longitude": longitude, **columns})


def split(batch: RawBatch, number: int, report: ReadReport) -> Iterator[Trajectory]:
    """The rows of each vehicle in a batch, with the number of the file and of the record."""
    columns: dict[str, Values] = {}
    for name, values in batch.columns.items():
        columns[_own_name(name, batch.columns.keys() | columns.keys(), report)] = values
    columns |= {FILE: np.full(len(batch), float(number)), RECORD: batch.record.astype(np.float64)}
    if not batch.has_position:
        columns[CHANNEL] = np.ones(len(batch))
    codes, names = batch.vehicle.codes, batch.vehicle.names
    present = levels(codes).tolist()
    for code in present:
        rows = slice(None) if len(present) == 1 else np.flatnonzero(codes == code)
        picked = {n: _trimmed(v[rows]) for n, v in columns.items()}
        yield Trajectory(names[code].strip(), batch.time[rows], picked)


def _trimmed(values: Values) -> Values:
    """Labels without names that no row has (a batch of many vehicles)."""
    if not isinstance(values, Labels) or len(values.names) < 64:
        return values
    used = set(levels(values.codes).tolist())
    return renamed(values, [name if code in used else None for code, name in enumerate(values.names)])


def _own_name(name: str, names: Set[str], report: ReadReport) -> str:
    """A column's name in the dataset; a taken one gets a suffix (databases do not tell capitals apart)."""
    if name.lower() not in _RESERVED or (name in NAMES and name not in ("vehicle_id", "timestamp")):
        return name
    other = next(n for k in itertools.count() if (n := f"{name}_log{k or ''}") not in names)
    report.note(f"{name!r} is kept as {other!r}: its name is taken")
    return other


class Order:
    """The rows of one vehicle in one file, batch by batch; the last short run waits for the next batch."""

    def __init__(self) -> None:
        self._waiting: list[Trajectory] = []
        self._tally = np.zeros(2, np.int64)  # Rows out of order and in order, so far
        self._end, self._size = EARLIEST - 2 * LEAP, 0  # Latest time of the last run kept [us], and its rows

    def sift(self, rows: Trajectory, *, last: bool = False) -> tuple[Trajectory, Trajectory]:
        """Rows to keep and rows to refuse."""
        rows, self._waiting = concatenate([*self._waiting, rows]), []
        begin, keep = run_starts(rows.time), np.ones(len(rows), bool)
        for start, stop in zip(begin, [*begin[1:], len(rows)], strict=True):
            run, size, final = rows.time[start:stop], stop - start, stop == len(rows)
            goes_on = start == 0 and self._end - WINDOW <= run[0] <= self._end + LEAP
            if goes_on:
                size += self._size
            if size < SHORT and final and not last:
                self._waiting = [rows[start:]]
                rows, keep = rows[:start], keep[:start]
                break
            back = run[0] < self._end - WINDOW or (not final and rows.time[stop] < run.max() - WINDOW)
            if size < SHORT and back:
                keep[start:stop] = False
            else:
                self._end = max(int(run.max()), self._end) if goes_on else int(run.max())
                self._size = size
        self._tally += np.bincount(keep, minlength=2)
        if self._tally[0] > max(SHORT, self._tally[1]):  # no clock slips in most rows: the log has no order
            keep[:] = True
        return rows[slice(None) if keep.all() else keep], rows[~keep]

    def flush(self) -> list[tuple[Trajectory, Trajectory]]:
        """What still waits at the end of the file."""
        waiting, self._waiting = self._waiting, []
        return [self.sift(rows, last=True) for rows in waiting]


def run_starts(time: Ints) -> list[int]:
    """First rows of the runs."""
    step = np.diff(time)
    late = (time < np.maximum.accumulate(time) - WINDOW).any()  # small steps back may add up
    if not late and not (step > LEAP).any():
        return [0][: len(time)]
    starts, high, before = [0], int(time[0]), 0
    for at in (np.flatnonzero((step < 0) | (step > LEAP)) + 1).tolist():
        high = max(high, int(time[before:at].max()))
        if not high - WINDOW <= time[at] <= high + LEAP:
            starts.append(at)
            high = int(time[at])
        before = at
    return starts

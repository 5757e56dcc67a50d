"""Rows gathered one at a time into batches, and the small conversions that formats share."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fleetlog.core.trajectory import Labels, Values
from fleetlog.errors import REPORT
from fleetlog.importers._times import EARLIEST, LATEST, OFF_TIME, iso_time
from fleetlog.importers.base import GEOGRAPHIC, LOCAL, RawBatch, Reject

BATCH = 1 << 16  # Rows in a batch: large enough for columns to pay, small enough for bounded memory
Row = dict[str, Any]  # Values by the names of columns; a string is a label
REJECT_TEXT = 400  # Characters of a rejected record that are kept
NAN = float("nan")


class Sample(NamedTuple):
    """One message: its stamp [us] (0: none) and values; ``fix`` False where the receiver had none.

    ``vehicle`` is that which the message itself names.
    """

    stamp: int
    values: dict[str, Any]
    fix: bool = True
    vehicle: str = ""


class Rows:
    """Rows of one kind, gathered one by one; :meth:`take` gives them as a :class:`RawBatch`.

    ``always`` names the columns that every batch has (the positions, unless the rows are a channel);
    ``share`` says how much of the file has been read.
    """

    def __init__(self, *always: str, share: Callable[[], float] = lambda: 0.0) -> None:
        self._always, self._share = always, share
        self._place = next((pair for pair in (GEOGRAPHIC, LOCAL) if {*pair} <= {*always}), None)
        self.total = self.rejected = 0  # Rows taken or waiting, and those that were refused so far
        self._clear()

    def _clear(self) -> None:
        self._vehicle: list[str] = []
        self._time: list[int] = []
        self._record: list[int] = []
        self._columns: dict[str, list[Any]] = {name: [] for name in self._always}
        self._rejects: list[Reject] = []

    def add(self, vehicle: str, time: int, record: int, values: Row, written: object = None) -> None:
        """One row at ``time`` [us]; a value is a float, or a string for a label; missing is null.

        It is rejected, as it was ``written``, where its place is no number or its time off.
        """
        if self._place and unplaced(values, *self._place):
            self.reject(record, f"{' or '.join(self._place)} is not a number", written or values)
        elif not EARLIEST <= time <= LATEST:
            self.reject(record, OFF_TIME, values)
        else:
            columns = self._columns
            if not values.keys() <= columns.keys():
                columns.update({name: [None] * len(self._time) for name in values if name not in columns})
            for name, column in columns.items():
                column.append(values.get(name))
            self._vehicle.append(vehicle)
            self._time.append(time)
            self._record.append(record)
            self.total += 1

    def add_iso(self, vehicle: str, time: str | None, record: int, values: Row, written: Any = None) -> None:
        """One row with its time in ISO 8601."""
        try:
            stamp = iso_time(time) if time else None
        except ValueError:
            self.reject(record, "time is not ISO 8601", time)
            return
        if stamp is None:
            self.reject(record, "point without a time", written or values)
        else:
            self.add(vehicle, stamp, record, values, written)

    def reject(self, record: int, reason: str, text: object = "") -> None:
        """A row that cannot be used."""
        self.rejected += 1
        self._rejects.append(Reject(record, reason, str(text)[:REJECT_TEXT]))

    @property
    def full(self) -> bool:
        """Whether it is time to :meth:`take`."""
        return len(self._time) >= BATCH or len(self._rejects) >= BATCH

    def take(self) -> RawBatch:
        """The rows so far as a batch; starts afresh."""
        columns = {name: _column(values) for name, values in self._columns.items()}
        time, record = (np.array(v, dtype=np.int64) for v in (self._time, self._record))
        batch = RawBatch(Labels.of(self._vehicle), time, columns, record, self._rejects, self._share())
        self._clear()
        return batch

    def drain(self) -> Iterator[RawBatch]:
        """The last batch, if anything waits."""
        if self._time or self._rejects:
            yield self.take()


def gather(records: Iterable[Any], take: Callable[[Any, int], None], *tables: Rows) -> Iterator[RawBatch]:
    """Give every record and its number, from 1, to ``take``; the batches of ``tables`` as they fill.

    Whatever goes wrong in ``take`` is one rejected record of the first table.
    """
    for number, record in enumerate(records, 1):
        try:
            take(record, number)
        except Exception as error:
            tables[0].reject(number, f"a fault in the reader ({type(error).__name__}); {REPORT}", record)
        for rows in tables:
            if rows.full:
                yield rows.take()


def figures(line: bytes, count: int) -> list[float] | None:
    """The ``count`` finite numbers that a line consists of, or None."""
    try:
        numbers = [float(cell) for cell in line.split()]
    except ValueError:
        return None
    return numbers if len(numbers) == count and all(map(isfinite, numbers)) else None


def mostly(parse: Callable[[bytes], object]) -> Callable[[Path, bytes], bool]:
    """The ``sniff`` of a format where ``parse`` makes something of most of the first lines but comments."""
    return partial(_mostly, parse)


def _mostly(parse: Callable[[bytes], object], _: Path, head: bytes) -> bool:
    lines = [s for s in head.split(b"\n")[:20] if s.strip() and not s.lstrip().startswith(b"#")]
    return 2 * sum(parse(line) is not None for line in lines) > len(lines)


def _column(values: list[Any]) -> Values:
    try:
        return np.array(values, dtype=np.float64)  # None becomes NaN
    except (TypeError, ValueError):
        return Labels.of([None if v is None else str(v) for v in values])


def finite(value: Any) -> float:
    """A float of anything, NaN where there is none."""
    if value is None or value is True or value is False:
        return NAN
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return NAN
    return number if isfinite(number) else NAN


def heading_of_course(degrees: float) -> float:
    """Heading [rad], counter-clockwise from east, of a course over ground [degrees], clockwise from north."""
    return math.remainder(math.radians(90.0 - degrees), math.tau)


def heading_of_quaternion(x: float, y: float, z: float, w: float) -> float:
    """Yaw [rad] of a unit quaternion: atan2(2 (w z + x y), 1 - 2 (y^2 + z^2)); NaN for zero."""
    if not x * x + y * y + z * z + w * w > 1e-6:
        return NAN
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def unplaced(values: Mapping[str, float], across: str, along: str) -> bool:
    """Whether the position is not a number."""
    return not (isfinite(values.get(across, NAN)) and isfinite(values.get(along, NAN)))


def renamed(labels: Labels, names: Sequence[str | None]) -> Labels:
    """The labels with a new name for each of theirs; None is null, and equal names become one."""
    if list(names) == list(labels.names):
        return labels
    fresh = Labels.of(names)
    return Labels(np.append(fresh.codes, np.int32(-1))[labels.codes], fresh.names)

"""Rows gathered one at a time into batches, and the small conversions that formats share."""

import math
import re
import tomllib
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
from math import isfinite
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from lxml import etree

from fleetlog.core.trajectory import Labels, Values
from fleetlog.errors import REPORT, FormatError
from fleetlog.importers._open import open_bytes
from fleetlog.importers._units import EARLIEST, LATEST, OFF_TIME, iso_time
from fleetlog.importers.base import GEOGRAPHIC, LOCAL, RawBatch, ReadOptions, Reject

BATCH = 1 << 16  # Rows in a batch: large enough for columns to pay, small enough for bounded memory
LOOKED_FOR = 64  # Records between two looks whether a batch is full
Row = dict[str, Any]  # Values by the names of columns; a string is a label
REJECT_TEXT = 400  # Characters of a rejected record that are kept
NAN = float("nan")
_TEXT = tomllib.loads(Path(__file__).with_name("formats.toml").read_text("utf-8"))
RECOGNISED, NAMES, LACKING, LEFT_OUT, TOPICS = _TEXT.values()
ZONED = re.compile(r"([zZ]|[+-]\d\d(:?\d\d)?)\s*$")  # The end of a time of day that states its zone
LIMIT = 1 << 24  # Bytes between two elements of interest; beyond it is no log but an attack or a mistake
AT_ONCE = 64  # Elements that wait to be dropped, and elements in one that may


class Sample(NamedTuple):
    """A message: stamp [us] (0: none), values, whether there is a ``fix``, the ``vehicle`` that it names."""

    stamp: int
    values: dict[str, Any]
    fix: bool = True
    vehicle: str = ""


class Rows:
    """Rows of one kind, gathered one by one; :meth:`take` gives a :class:`RawBatch`. ``always`` names columns
    that every batch has (positions, unless it is a channel); ``share`` says how much of the file was read."""

    def __init__(self, *always: str, share: Callable[[], float] = lambda: 0.0) -> None:
        self._always, self._share = always, share
        self.place = next((pair for pair in (GEOGRAPHIC, LOCAL) if {*pair} <= {*always}), ())
        self.total, self.rejected, self.bare = 0, 0, False  # Rows so far, refused ones; a time without a zone
        self._clear()

    def _clear(self) -> None:
        self._kept: list[tuple[Any, ...]] = []  # Vehicle, time, record and values of each
        self._rejects: list[Reject] = []

    def add(self, vehicle: str, time: int, record: int, values: Row, written: object = None) -> None:
        """One row at ``time`` [us]; a value is a float, or a string for a label; missing is null. It is
        rejected, as it was ``written``, where its place is no number or its time off."""
        if not isfinite(sum([values.get(name, NAN) for name in self.place])):
            self.reject(record, f"{' or '.join(self.place)} is not a number", written or values)
        elif not EARLIEST <= time <= LATEST:
            self.reject(record, OFF_TIME, values)
        else:
            self._kept.append((vehicle, time, record, values))
            self.total += 1

    def add_iso(self, vehicle: str, time: str | None, record: int, values: Row, written: Any = None) -> None:
        """One row with its time in ISO 8601."""
        try:
            self.add(vehicle, iso_time(time or ""), record, values, written)
            self.bare |= str(time)[-1] not in "zZ" and not ZONED.search(str(time))
        except ValueError:
            why = "time is not ISO 8601" if time else "point without a time"
            self.reject(record, why, time or written or values)

    def reject(self, record: int, reason: str, text: object = "") -> None:
        """A row that cannot be used."""
        self.rejected += 1
        self._rejects.append(Reject(record, reason, str(text)[:REJECT_TEXT]))

    @property
    def full(self) -> bool:
        """Whether it is time to :meth:`take`."""
        return len(self._kept) >= BATCH or len(self._rejects) >= BATCH

    def take(self) -> RawBatch:
        """The rows so far as a batch; starts afresh."""
        vehicle, when, number, rows = ([kept[k] for kept in self._kept] for k in range(4))
        kinds = dict.fromkeys(map(tuple, rows))
        names = dict.fromkeys(name for kind in (self._always, *kinds) for name in kind)
        columns = {name: _column([row.get(name) for row in rows]) for name in names}
        time, record = (np.array(v, dtype=np.int64) for v in (when, number))
        batch = RawBatch(Labels.of(vehicle), time, columns, record, self._rejects, self._share())
        self._clear()
        return batch

    def drain(self) -> Iterator[RawBatch]:
        """The last batch, if anything waits."""
        if self._kept or self._rejects:
            yield self.take()


class Records(ABC):
    """A log that is read record by record, a subclass a format; :meth:`batches` is what its importer reads.
    ``places`` are the columns that each of its tables has always, () for a channel; ``rows`` is the first."""

    places: ClassVar[tuple[tuple[str, ...], ...]] = (GEOGRAPHIC,)
    longest: ClassVar[int] = 4096  # Bytes of a line

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self.path, self.report, self.vehicle, self.origin = path, options.report, options.name, options.origin
        self.options = options
        self.stream, share = open_bytes(path, options.report)
        self.tables = [Rows(*place, share=share) for place in self.places]
        self.rows = self.tables[0]
        self.seen: Counter[str] = Counter()  # How many of each kind were met, as a format tells them apart

    def records(self) -> Iterable[Any]:
        """What the log consists of: its lines, unless a format says otherwise."""
        return iter(lambda: self.stream.readline(self.longest), b"")

    @abstractmethod
    def take(self, record: Any, number: int) -> None:
        """Make rows of a record, by its number from 1; whatever goes wrong here is one rejected record."""

    def nothing(self) -> tuple[str, str]:
        """What is wrong with a log without a position, and what to do."""
        what, do = LACKING.get(self.report.format, ("no position in it", "check the format"))
        return what, do

    def describe(self) -> None:
        """Tell the report what was recognised and left out."""
        since = " since the profile's origin" if self.origin else ""
        known = RECOGNISED.get(self.report.format, {})
        self.report.recognised |= {name: meaning.format(since=since) for name, meaning in known.items()}
        if any(rows.bare for rows in self.tables):
            self.report.note("the times state no zone: taken as UTC")
        for kind, (noun, why) in LEFT_OUT.get(self.report.format, {}).items():
            self.report.tally(self.seen[kind], noun, why)

    @classmethod
    def batches(cls, path: Path, options: ReadOptions) -> Iterator[RawBatch]:
        """The rows, batch by batch."""
        log = cls(path, options)
        with log.stream:
            for number, record in enumerate(log.records(), 1):
                try:
                    log.take(record, number)
                except Exception as error:
                    what = f"a fault in the reader ({type(error).__name__}); {REPORT}"
                    log.rows.reject(number, what, record)
                if not number % LOOKED_FOR:
                    yield from (rows.take() for rows in log.tables if rows.full)
        if not any(rows.total for rows in log.tables if rows.place):
            raise log.report.nothing(*log.nothing())
        log.describe()
        for rows in log.tables:
            yield from rows.drain()


class Elements(Records):
    """Elements of the ``wanted`` tags at their ends; like the ``passed`` ones counted, then dropped.

    So memory does not grow with the file. Entities are not expanded, nothing is loaded from elsewhere,
    libxml2's limits on depth and text stay on. A broken file gives what came before; the report says so."""

    wanted: ClassVar[tuple[str, ...]]
    passed: ClassVar[tuple[str, ...]] = ()
    _since, _begun = 0, False  # Bytes since the last element; whether anything was read

    def read(self, size: int = -1) -> bytes:
        """For the parser."""
        data = self.stream.read(min(size, 1 << 15) if size > 0 else 1 << 15)
        data = data if self._begun else data.lstrip()  # XML may not begin with blanks, but devices do
        self._since, self._begun = self._since + len(data), True
        if self._since > LIMIT:
            what = f"one element holds more than {LIMIT >> 20} MB of XML"
            raise FormatError(what, where=self.path, do="this is no log; leave it out")
        return data

    def records(self) -> Iterator[Any]:
        """The wanted elements."""
        events = etree.iterparse(
            self, events=("end",), tag=[f"{{*}}{t}" for t in (*self.wanted, *self.passed)],
            resolve_entities=False, no_network=True, load_dtd=False, dtd_validation=False, huge_tree=False,
        )  # fmt: skip
        try:
            for number, (_, element) in enumerate(events):
                self._since, tag = 0, bare(element.tag)
                self.seen[tag] += 1
                if tag in self.wanted:
                    yield element
                if len(element) > AT_ONCE:
                    element.clear()
                if number % AT_ONCE:
                    continue
                # Drop what stands before the element, and before all that it is in, but for names.
                while (parent := element.getparent()) is not None:
                    name = next(element.itersiblings("{*}name", preceding=True), None)
                    begin = 0 if name is None else parent.index(name) + 1
                    del parent[begin : parent.index(element)]
                    element = parent
        except etree.XMLSyntaxError as error:
            line = f"line {error.position[0]}" if error.position and error.position[0] else "the start"
            why = " ".join(str(error).split())[:120]
            self.report.damaged(f"the XML breaks off or is wrong at {line} ({why})")


@lru_cache(1 << 10)
def bare(tag: Any) -> str:
    """A tag without its namespace, or a prefix that none stands for; ``""`` for comments and instructions."""
    return tag.replace(":", "}").rsplit("}", 1)[-1] if isinstance(tag, str) else ""


def figures(line: bytes, count: int) -> list[float] | None:
    """The ``count`` finite numbers that a line consists of, or None."""
    numbers = [*map(finite, line.split())]
    return numbers if len(numbers) == count and all(map(isfinite, numbers)) else None


def mostly(parse: Callable[[bytes], object], _: Path, head: bytes) -> bool:
    """Whether ``parse`` makes something of most of the first lines but comments."""
    lines = [s for s in head.split(b"\n")[:20] if s.strip() and not s.lstrip().startswith(b"#")]
    return 2 * sum(parse(line) is not None for line in lines) > len(lines)


def _column(values: list[Any]) -> Values:
    try:
        return np.array(values, dtype=np.float64)  # None becomes NaN
    except (TypeError, ValueError):
        return Labels.of([None if v is None else str(v) for v in values])


def finite(value: Any) -> float:
    """A float of anything, NaN where there is none."""
    if type(value) is float:
        return value if isfinite(value) else NAN
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

"""NMEA 0183 logs, also with binary bytes and u-blox UBX messages between the sentences.

All sentences of one moment make one fix, whatever talker they come from.  Dates come from RMC, ZDA and
NAV-PVT; a fix before the first date gets it in hindsight.  Broken sentences are rejected and counted; other
ships' AIS messages are left out.
"""

from collections import Counter, deque
from collections.abc import Iterator
from pathlib import Path

from fleetlog.core.words import count
from fleetlog.importers._nmea_fix import Part, decode
from fleetlog.importers._nmea_frames import Frame, frames
from fleetlog.importers._open import open_bytes
from fleetlog.importers._report import ReadReport
from fleetlog.importers._rows import Rows
from fleetlog.importers._times import DAY
from fleetlog.importers.base import Importer, RawBatch, ReadOptions

WAITING = 1 << 18  # Fixes that may wait for the first date
_AIS = (b"VDM", b"VDO")
_SOURCES = ("RMC", "GGA", "GNS", "GLL", "VTG", "ZDA")


def sniff(path: Path, head: bytes) -> bool:
    """Whether something framed has a right checksum, and most of it is right."""
    from io import BufferedReader, BytesIO

    good = bad = 0
    for frame in frames(BufferedReader(BytesIO(head))):
        good += frame.fault is None and (frame.checked or frame.kind[-3:] in (b"GGA", b"RMC"))
        bad += frame.fault is not None
    return (good > 0 and (good >= bad or path.suffix.lower() in IMPORTER.suffixes)) or bad > 2 * good > 0


class Epochs:
    """Fixes put together from parts, one a moment."""

    def __init__(self, rows: Rows, vehicle: str) -> None:
        self.rows, self.vehicle = rows, vehicle
        self.no_fix = 0
        self.waiting: deque[tuple[Part, int]] = deque()
        """Fixes before the first date."""
        self._day: int | None = None
        self._last_tod = -1
        self._open: Part | None = None
        self._line = 0

    def add(self, part: Part, line: int) -> None:
        """One more part; a new time of day closes the fix before it."""
        if self._open is not None and self._open.tod is not None and part.tod not in (None, self._open.tod):
            self.close()
        if self._open is None:
            self._open, self._line = part, line
        else:
            _merge(self._open, part)

    def close(self) -> None:
        """End the current fix."""
        part, self._open = self._open, None
        if part is None or part.tod is None:
            return
        if part.day is None and self._day is None:
            if part.rank and part.valid is not False and len(self.waiting) < WAITING:
                self.waiting.append((part, self._line))
            return
        if part.day is None and self._day is not None:
            part.day = self._day + (self._last_tod - part.tod > DAY // 2)  # past midnight the next
        elif self._day is None:
            self._in_hindsight(part)
        self._day, self._last_tod = part.day, part.tod
        self._emit(part, self._line)

    def _in_hindsight(self, later: Part) -> None:
        """Date the fixes that came before the first date, from the last back."""
        for waiting, _ in reversed(self.waiting):
            assert later.day is not None and later.tod is not None and waiting.tod is not None
            waiting.day = later.day - (waiting.tod - later.tod > DAY // 2)
            later = waiting
        while self.waiting:
            self._emit(*self.waiting.popleft())

    def _emit(self, part: Part, line: int) -> None:
        if not part.rank or part.valid is False:
            self.no_fix += 1
            return
        assert part.day is not None and part.tod is not None
        self.rows.add(self.vehicle, part.day * DAY + part.tod, line, part.values)


def _merge(into: Part, part: Part) -> None:
    into.tod = part.tod if into.tod is None else into.tod
    into.day = part.day if part.day is not None else into.day
    if part.valid is not None:
        into.valid = part.valid or bool(into.valid)
    better = part.rank > into.rank
    into.values = into.values | part.values if better else part.values | into.values
    into.rank = max(into.rank, part.rank)


def read(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """One row a moment with a fix."""
    stream, raw = open_bytes(path, options.report)
    rows = Rows("latitude", "longitude", share=lambda: raw.share)
    reader = _Reader(rows, options.name)
    with stream:
        for frame in frames(stream):
            reader.take(frame)
            if rows.full:
                yield rows.take()
    reader.epochs.close()
    if not rows.total:
        wanted = "RMC or ZDA as well" if reader.epochs.waiting else "RMC or GGA sentences or UBX NAV-PVT"
        raise options.report.nothing(reader.nothing(), f"record {wanted}")
    reader.describe(options.report)
    yield from rows.drain()


class _Reader:
    """Frames to fixes, with what they are counted."""

    def __init__(self, rows: Rows, vehicle: str) -> None:
        self.rows, self.epochs = rows, Epochs(rows, vehicle)
        self.kinds: Counter[str] = Counter()
        self.ais = self.unchecked = 0

    def take(self, frame: Frame) -> None:
        """One more frame; what cannot be used is rejected."""
        fault = frame.fault
        if fault is None and not frame.checked and self.kinds and not self.unchecked:
            fault = "the sentence has no checksum, unlike those before it"
        if frame.bang or frame.kind[-3:] in _AIS:
            self.ais += 1
        elif fault is not None:
            self.rows.reject(frame.line, fault, _text(frame))
        else:
            self.unchecked += not frame.checked
            kind = _kind(frame)
            self.kinds[kind] += 1
            try:
                part = decode(frame.kind, frame.body)
            except (ValueError, OverflowError) as error:
                self.rows.reject(frame.line, f"{kind}: {error}", _text(frame))
            else:
                if part is not None:
                    self.epochs.add(part, frame.line)

    def nothing(self) -> str:
        """What the log holds instead of dated positions."""
        if self.epochs.waiting:
            undated = count(len(self.epochs.waiting), "position")
            return f"{undated} with a time of day but no date (no RMC or ZDA sentence with one)"
        if self.epochs.no_fix:
            return f"the receiver had no fix in any of its {count(self.epochs.no_fix, 'moment')}"
        if self.ais and not self.kinds:
            return f"only AIS: {count(self.ais, 'message')} of ships, no position of the receiver"
        found = ", ".join(f"{n} {k}" for k, n in self.kinds.most_common(8)) or "none"
        first, why = self.rows.take().rejects[:1], ""
        if first:
            why = f"; {self.rows.rejected} rejected, the first on line {first[0].record}: {first[0].reason}"
        return f"no sentence with a position (readable sentences: {found}){why}"

    def describe(self, report: ReadReport) -> None:
        """Say what was read and left out."""
        sources = sorted(k for k in self.kinds if k[-3:] in _SOURCES or k == "UBX-0107")
        meaning = "position, time, speed from knots, heading from course, z above sea level"
        report.recognised[", ".join(sources)] = meaning
        for number, noun, what in (
            (self.epochs.no_fix, "moment", "without a fix left out"),
            (len(self.epochs.waiting), "position", "without a date left out"),
            (self.ais, "AIS message", "of other ships left out"),
            (self.unchecked, "sentence", "without a checksum read"),
        ):
            if number:
                report.note(f"{count(number, noun)} {what}")


def _kind(frame: Frame) -> str:
    return f"UBX-{frame.body[:2].hex()}" if frame.kind == b"UBX" else frame.kind.decode("ascii")


def _text(frame: Frame) -> str:
    if frame.kind == b"UBX":
        return f"UBX {frame.body[:2].hex()}"
    return (frame.kind + b"," + frame.body).decode("latin-1")


IMPORTER = Importer("nmea", (".nmea", ".nma", ".ubx", ".log"), sniff, read, rank=1)

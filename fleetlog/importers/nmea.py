"""NMEA 0183 logs, also with binary bytes and u-blox UBX messages between the sentences.

All sentences of one moment make one fix, whatever talker they come from.  Dates come from RMC, ZDA and
NAV-PVT; a fix before the first date gets it in hindsight.  Broken sentences are rejected and counted; other
ships' AIS messages are left out.
"""

from collections import Counter
from collections.abc import Iterator
from io import BufferedReader, BytesIO
from pathlib import Path

from fleetlog.core.words import count
from fleetlog.importers._nmea import Frame, Part, decode, frames
from fleetlog.importers._open import ReadReport, open_bytes
from fleetlog.importers._rows import Rows
from fleetlog.importers._times import DAY
from fleetlog.importers.base import Importer, RawBatch, ReadOptions

WAITING = 1 << 18  # Fixes that may wait for the first date
_AIS = (b"VDM", b"VDO")
_SOURCES = ("RMC", "GGA", "GNS", "GLL", "VTG", "ZDA")


def sniff(path: Path, head: bytes) -> bool:
    """Whether something framed has a right checksum, and most of it is right."""
    good = bad = 0
    for frame in frames(BufferedReader(BytesIO(head))):
        good += frame.fault is None and (frame.checked or frame.kind[-3:] in (b"GGA", b"RMC"))
        bad += frame.fault is not None
    return (good > 0 and (good >= bad or path.suffix.lower() in IMPORTER.suffixes)) or bad > 2 * good > 0


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
    reader.close()
    if not rows.total:
        wanted = "RMC or ZDA as well" if reader.waiting else "RMC or GGA sentences or UBX NAV-PVT"
        raise options.report.nothing(reader.nothing(), f"record {wanted}")
    reader.describe(options.report)
    yield from rows.drain()


class _Reader:
    """Frames to fixes, one a moment, with what they are counted."""

    def __init__(self, rows: Rows, vehicle: str) -> None:
        self.rows, self.vehicle = rows, vehicle
        self.kinds: Counter[str] = Counter()
        self.ais = self.unchecked = self.no_fix = 0
        self.waiting: list[tuple[Part, int]] = []  # Fixes before the first date, and their lines
        self._open: Part | None = None
        self._line = 0
        self._last: Part | None = None  # The last fix with a date

    def take(self, frame: Frame) -> None:
        """One more frame; what cannot be used is rejected."""
        fault = frame.fault
        if fault is None and not frame.checked and self.kinds and not self.unchecked:
            fault = "the sentence has no checksum, unlike those before it"
        if frame.kind[:1] == b"!" or frame.kind[-3:] in _AIS:
            self.ais += 1
        elif fault is not None:
            self.rows.reject(frame.line, fault, _text(frame))
        else:
            self.unchecked += not frame.checked
            kind = f"UBX-{frame.body[:2].hex()}" if frame.kind == b"UBX" else frame.kind.decode("ascii")
            self.kinds[kind] += 1
            try:
                part = decode(frame.kind, frame.body)
            except (ValueError, OverflowError) as error:
                self.rows.reject(frame.line, f"{kind}: {error}", _text(frame))
            else:
                if part is not None:
                    self._add(part, frame.line)

    def _add(self, part: Part, line: int) -> None:
        """A new time of day closes the fix before it."""
        fix = self._open
        if fix is not None and fix.tod is not None and part.tod not in (None, fix.tod):
            self.close()
            fix = None
        if fix is None:
            self._open, self._line = part, line
            return
        fix.tod = part.tod if fix.tod is None else fix.tod
        fix.day = part.day if part.day is not None else fix.day
        fix.valid = fix.valid if part.valid is None else part.valid or bool(fix.valid)
        fix.values = fix.values | part.values if part.rank > fix.rank else part.values | fix.values
        fix.rank = max(fix.rank, part.rank)

    def close(self) -> None:
        """End the current fix."""
        part, self._open = self._open, None
        if part is None or part.tod is None:
            return
        if part.day is None and self._last is None:
            if part.rank and part.valid is not False and len(self.waiting) < WAITING:
                self.waiting.append((part, self._line))
            return
        if part.day is None and self._last is not None:
            part.day = _day_beside(part, self._last, 1)
        elif self._last is None:
            self._date_in_hindsight(part)
        self._last = part
        self._emit(part, self._line)

    def _date_in_hindsight(self, later: Part) -> None:
        """The fixes that came before the first date, from the last back."""
        for waiting, _ in reversed(self.waiting):
            waiting.day = _day_beside(waiting, later, -1)
            later = waiting
        for waiting, line in self.waiting:
            self._emit(waiting, line)
        self.waiting.clear()

    def _emit(self, part: Part, line: int) -> None:
        if not part.rank or part.valid is False:
            self.no_fix += 1
            return
        assert part.day is not None and part.tod is not None
        self.rows.add(self.vehicle, part.day * DAY + part.tod, line, part.values)

    def nothing(self) -> str:
        """What the log holds instead of dated positions."""
        if self.waiting:
            undated = count(len(self.waiting), "position")
            return f"{undated} with a time of day but no date (no RMC or ZDA sentence with one)"
        if self.no_fix:
            return f"the receiver had no fix in any of its {count(self.no_fix, 'moment')}"
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
            (self.no_fix, "moment", "without a fix left out"),
            (len(self.waiting), "position", "without a date left out"),
            (self.ais, "AIS message", "of other ships left out"),
            (self.unchecked, "sentence", "without a checksum read"),
        ):
            if number:
                report.note(f"{count(number, noun)} {what}")


def _day_beside(part: Part, known: Part, step: int) -> int:
    """The day of a part, which comes next after (1) or before (-1) one whose day is known."""
    assert part.tod is not None and known.tod is not None and known.day is not None
    return known.day + step * ((known.tod - part.tod) * step > DAY // 2)


def _text(frame: Frame) -> str:
    if frame.kind == b"UBX":
        return f"UBX {frame.body[:2].hex()}"
    return (frame.kind + b"," + frame.body).decode("latin-1")


IMPORTER = Importer("nmea", (".nmea", ".nma", ".ubx", ".log"), sniff, read, rank=1)

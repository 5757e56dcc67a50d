"""NMEA 0183 logs, also with binary bytes and u-blox UBX messages between the sentences.

All sentences of one moment make one fix, whatever talker they come from.  Dates come from RMC, ZDA and
NAV-PVT; a fix before the first date gets it in hindsight.  Broken sentences are rejected and counted; other
ships' AIS messages are left out.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fleetlog.errors import FormatError
from fleetlog.importers._nmea_fix import DAY, Part, decode
from fleetlog.importers._nmea_frames import Frame, frames
from fleetlog.importers._open import open_bytes, plain_stem, plural
from fleetlog.importers._report import ReadReport
from fleetlog.importers._rows import Rows
from fleetlog.importers.base import Importer, RawBatch, ReadOptions

WAITING = 1 << 18
"""Fixes that may wait for the first date."""
_AIS = (b"VDM", b"VDO")


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
        self.day: int | None = None
        self._last_tod = -1
        self._open: Part | None = None
        self._line = 0
        self._waiting: deque[tuple[Part, int]] = deque()

    def add(self, part: Part, line: int) -> None:
        """One more part; a new time of day closes the fix before it."""
        if (
            self._open is not None
            and part.tod is not None
            and part.tod != self._open.tod
            and self._open.tod is not None
        ):
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
        if part.day is None and self.day is None:
            if part.rank and part.valid is not False and len(self._waiting) < WAITING:
                self._waiting.append((part, self._line))
            return
        self._date(part)
        self._emit(part, self._line)

    def _date(self, part: Part) -> None:
        """Set the day: the part's own, or the last one, past midnight the next."""
        assert part.tod is not None
        if part.day is None:
            assert self.day is not None
            part.day = self.day + (self._last_tod - part.tod > DAY // 2)
        elif self.day is None:
            self._in_hindsight(part.day, part.tod)
        self.day, self._last_tod = part.day, part.tod

    def _in_hindsight(self, day: int, tod: int) -> None:
        """Date the fixes that came before the first date, from the last back."""
        dated = []
        for waiting, line in reversed(self._waiting):
            assert waiting.tod is not None
            day -= waiting.tod - tod > DAY // 2
            waiting.day, tod = day, waiting.tod
            dated.append((waiting, line))
        self._waiting.clear()
        for waiting, line in reversed(dated):
            self._emit(waiting, line)

    def _emit(self, part: Part, line: int) -> None:
        if not part.rank or part.valid is False:
            self.no_fix += 1
            return
        assert part.day is not None and part.tod is not None
        values: dict[str, Any] = {"latitude": part.latitude, "longitude": part.longitude, **part.values}
        self.rows.add(self.vehicle, part.day * DAY + part.tod, line, values)

    @property
    def undated(self) -> int:
        """Fixes that never got a date."""
        return len(self._waiting)


def _merge(into: Part, part: Part) -> None:
    if into.tod is None:
        into.tod = part.tod
    if part.day is not None:
        into.day = part.day
    if part.valid is not None:
        into.valid = part.valid or bool(into.valid)
    if part.rank > into.rank and part.valid is not False:
        into.rank, into.latitude, into.longitude = part.rank, part.latitude, part.longitude
        into.values |= part.values
    else:
        into.values = part.values | into.values


def read(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """One row a moment with a fix."""
    stream, raw = open_bytes(path, options.report)
    rows = Rows("latitude", "longitude", share=lambda: raw.share)
    epochs = Epochs(rows, options.vehicle or plain_stem(path))
    kinds: Counter[str] = Counter()
    ais = unchecked = 0
    with stream:
        for frame in frames(stream):
            if frame.bang or frame.kind[-3:] in _AIS:
                ais += 1
            elif _usable(frame, rows, unchecked, kinds):
                unchecked += not frame.checked
                _take(frame, epochs, kinds)
            if rows.full:
                yield rows.take()
    epochs.close()
    if not rows.total:
        raise FormatError(*_nothing(epochs, kinds, ais, rows), where=path, do=_remedy(epochs, ais))
    _describe(options.report, epochs, kinds, ais, unchecked)
    yield from rows.drain()


def _usable(frame: Frame, rows: Rows, unchecked: int, kinds: Counter[str]) -> bool:
    fault = frame.fault
    if fault is None and not frame.checked and kinds and not unchecked:
        fault = "the sentence has no checksum, unlike those before it"
    if fault is None:
        return True
    rows.reject(frame.line, fault, _text(frame))
    return False


def _text(frame: Frame) -> str:
    return (
        f"UBX {frame.body[:2].hex()}"
        if frame.kind == b"UBX"
        else (frame.kind + b"," + frame.body).decode("latin-1")
    )


def _take(frame: Frame, epochs: Epochs, kinds: Counter[str]) -> None:
    kind = f"UBX-{frame.body[:2].hex()}" if frame.kind == b"UBX" else frame.kind.decode("ascii")
    kinds[kind] += 1
    try:
        part = decode(frame.kind, frame.body)
    except (ValueError, OverflowError) as error:
        epochs.rows.reject(frame.line, f"{kind}: {error}", _text(frame))
        return
    if part is not None:
        epochs.add(part, frame.line)


def _nothing(epochs: Epochs, kinds: Counter[str], ais: int, rows: Rows) -> tuple[str]:
    if epochs.undated:
        return (
            f"{plural(epochs.undated, 'position')} with a time of day but no date (no RMC or ZDA sentence "
            "with one)",
        )
    if epochs.no_fix:
        return (f"the receiver had no fix in any of its {plural(epochs.no_fix, 'moment')}",)
    if ais and not kinds:
        return (f"only AIS: {plural(ais, 'message')} of ships, no position of the receiver",)
    first = rows.take().rejects[:1]
    why = (
        f"; {rows.rejected} rejected, the first on line {first[0].record}: {first[0].reason}" if first else ""
    )
    found = ", ".join(f"{n} {k}" for k, n in kinds.most_common(8)) or "none"
    return (f"no sentence with a position (readable sentences: {found}){why}",)


def _remedy(epochs: Epochs, ais: int) -> str:
    if epochs.undated:
        return "record RMC or ZDA as well"
    return "record RMC or GGA sentences or UBX NAV-PVT"


def _describe(report: ReadReport, epochs: Epochs, kinds: Counter[str], ais: int, unchecked: int) -> None:
    sources = [k for k in kinds if k[-3:] in ("RMC", "GGA", "GNS", "GLL", "VTG", "ZDA") or k == "UBX-0107"]
    report.recognised[", ".join(sorted(sources))] = (
        "position, time, speed from knots, heading from course, z above sea level"
    )
    if epochs.no_fix:
        report.note(f"{plural(epochs.no_fix, 'moment')} without a fix left out")
    if epochs.undated:
        report.note(f"{plural(epochs.undated, 'position')} without a date left out")
    if ais:
        report.note(f"{plural(ais, 'AIS message')} of other ships left out")
    if unchecked:
        report.note(f"{plural(unchecked, 'sentence')} without a checksum read")


IMPORTER = Importer("nmea", (".nmea", ".nma", ".ubx", ".log"), sniff, read, rank=1)

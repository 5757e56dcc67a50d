"""NMEA 0183 logs, also with binary bytes and u-blox UBX messages between the sentences.

All sentences of one moment make one fix, whatever their talker.  Dates come from RMC, ZDA and NAV-PVT; a fix
before the first date gets it in hindsight.  Broken sentences are rejected and counted; other ships' AIS is
left out.  Sentences are read by pynmeagps; UBX, NAV-PVT: u-blox M10 interface description (UBX-21035062)."""

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import date
from functools import lru_cache
from io import BufferedReader, BytesIO
from itertools import accumulate
from math import isfinite
from pathlib import Path
from typing import Any

from pynmeagps import NMEA_PAYLOADS_GET, NMEAMessage, calc_checksum

from fleetlog.core.arrays import DAY
from fleetlog.core.words import count
from fleetlog.importers._rows import NAMES, Records, heading_of_course
from fleetlog.importers.base import Importer

WAITING = 1 << 18  # Fixes that may wait for the first date
BLOCK = 1 << 18
LIMIT = 8200  # Longest UBX message [bytes] that is believed; a longer one is two bytes of chance
KNOT = 1852.0 / 3600.0  # One knot [m/s]
_START = re.compile(rb"\xb5b|[$!][A-Z][A-Z0-9]{1,11},[ -#%-)+-~]{0,1000}(\*[0-9A-Fa-f]{2})?\r?\n?")
_EPOCH = date(1970, 1, 1).toordinal()
RANKS = {"GGA": 4, "GNS": 3, "RMC": 2, "GLL": 1, "VTG": 0, "ZDA": 0}  # The trust in a sentence's position
_STATES = {"GGA": "quality", "GNS": "posMode", "RMC": "status", "GLL": "status"}
_MOMENT = {"time", "date", "year", "month", "day"}
_COLUMNS: dict[str, str] = NAMES["nmea"]
# By pynmeagps' type of a cell: it takes a time of five figures and -958.1 as well.
_SHAPES = {
    "TM": re.compile(r"\d{6}(\.\d+)?"), "LA": re.compile(r"\d\d+[0-5]\d\.\d*"),
    "DT": re.compile(r"\d{6}"), "LN": re.compile(r"\d{3,}[0-5]\d\.\d*"),
}  # fmt: skip
_PVT = struct.Struct("<4xH6B4xiBBxBii4xi20xii")


@dataclass(slots=True)
class Part:
    """What one frame says, or all frames of one moment. ``tod`` is the time of day [us] (-1: not told),
    ``day`` days since 1970 (0: not told), ``rank`` the trust in the position (0: none), ``valid`` False where
    the receiver says that it has no fix, None where it does not say."""

    line: int = 0
    tod: int = -1
    day: int = 0
    rank: int = 0
    valid: bool | None = None
    values: dict[str, float] = field(default_factory=dict)

    @property
    def placed(self) -> bool:
        """Whether there is a fix."""
        return self.rank > 0 and self.valid is not False


def frames(stream: BufferedReader) -> Iterator[tuple[int, bytes, str | None]]:
    """The line and bytes of every frame, and why it cannot be used; what lies between is passed over."""
    buffer, line, done = b"", 1, False
    while not done:
        block = stream.read(BLOCK)
        done = not block
        buffer += block
        at = 0
        while (found := _START.search(buffer, at)) and (done or len(buffer) - found.start() >= LIMIT):
            start, end = found.span()
            if found[0] == b"\xb5b":
                end = start + 8 + int.from_bytes(buffer[start + 4 : start + 6], "little")
            line += buffer.count(b"\n", at, start)
            at = start + 2
            if end - start <= LIMIT:
                frame = buffer[start:end]
                fault = _fault(frame, end - start)
                yield line, frame, fault
                at = at if fault and frame[0] == 0xB5 else end
            line += buffer.count(b"\n", start, at)
        keep = found.start() if found else max(at, len(buffer) - LIMIT)
        line += buffer.count(b"\n", at, keep)
        buffer = buffer[keep:]


def _fault(frame: bytes, size: int) -> str | None:
    """What is wrong with a frame, which should have ``size`` bytes."""
    if frame[:1] == b"\xb5":
        body = frame[2:-2]
        if len(frame) < size:
            return "the UBX message is cut off by the end of the file"
        right = bytes((sum(body) & 0xFF, sum(accumulate(body)) & 0xFF)) == frame[-2:]
        return None if right else "checksum of the UBX message is wrong"
    content, _, check = frame.decode().rstrip("\r\n").partition("*")
    if not check:
        return None if frame[-1:] in b"\r\n" else "the sentence is broken off"
    return None if check.upper() == calc_checksum(content[1:]) else "checksum of the sentence is wrong"


def kind_of(frame: bytes) -> str:
    """The address of a sentence (``GPGGA``, ``!AIVDM``), or class and id of a UBX message (``UBX-0107``)."""
    if frame[:1] == b"\xb5":
        return f"UBX-{frame[2:4].hex()}"
    return frame.split(b",", 1)[0].decode().removeprefix("$")


def decode(frame: bytes, line: int) -> Part:
    """What a frame says, nothing for a kind without motion; :class:`ValueError` for broken fields."""
    address = kind_of(frame)
    if address == "UBX-0107":
        return _nav_pvt(frame, line)
    kind = address[2:]
    if address[0] == "P" or kind not in RANKS:
        return Part()
    types = NMEA_PAYLOADS_GET[kind]
    cells = frame.decode().rstrip("\r\n").partition("*")[0].split(",")[1:]
    if len(cells) < (9 if kind in ("GGA", "GNS", "RMC") else 4):
        raise ValueError("the sentence has too few fields")
    written = {name: cell for name, cell in zip(types, cells, strict=False) if cell}
    part, state = Part(line), written.get(_STATES.get(kind, ""), "")
    if state or kind in ("GGA", "GNS", "RMC"):
        part.valid = bool(state.strip("0NV"))
    # Where the receiver says that it has no fix, what stands there is filler.
    wanted = _MOMENT if part.valid is False else _MOMENT | _COLUMNS.keys()
    told = {name: _value(name, types[name], cell) for name, cell in written.items() if name in wanted}
    if time := told.get("time"):
        part.tod = ((time.hour * 60 + time.minute) * 60 + time.second) * 1_000_000 + time.microsecond
    if {"year", "month", "day"} <= told.keys():
        told["date"] = date(told["year"], told["month"], told["day"])
    if "date" in told:
        part.day = told["date"].toordinal() - _EPOCH
    if {"lat", "lon"} & told.keys():
        part.rank, sides = RANKS[kind], written.get("NS", "") + written.get("EW", "")
        if not {"lat", "lon"} <= told.keys() or sides not in ("NE", "NW", "SE", "SW"):
            raise ValueError("the position is not whole: latitude, N or S, longitude, E or W")
        told["lat"] *= -1.0 if "S" in sides else 1.0
        told["lon"] *= -1.0 if "W" in sides else 1.0
    part.values = {_COLUMNS[n]: float(v) for n, v in told.items() if n in _COLUMNS and isfinite(v)}
    return part


@lru_cache(64)  # The sentences of one moment repeat one another's cells
def _value(name: str, kind: str, cell: str) -> Any:
    """A cell as pynmeagps reads it, speed [m/s] and heading [rad]."""
    try:
        value = NMEAMessage.str2val(cell, kind)
    except ValueError:
        value = ""
    if value == "" or (kind in _SHAPES and not _SHAPES[kind].fullmatch(cell)):
        raise ValueError(f"{name} cannot be read: {cell}")
    if name in ("spd", "sogn"):
        return value * KNOT
    return heading_of_course(value % 360.0) if name in ("cog", "cogt") else value


def _nav_pvt(frame: bytes, line: int) -> Part:
    """NAV-PVT: date, time, fix type, 1e-7 degrees, mm, mm/s, 1e-5 degrees."""
    if len(frame) < 8 + _PVT.size:
        raise ValueError("NAV-PVT is too short")
    year, month, day, hour, minute, second, known, nano, fix, flags, *rest = _PVT.unpack_from(frame, 6)
    satellites, longitude, latitude, above_sea, speed, course = rest
    part = Part(line, valid=fix in (2, 3, 4) and bool(flags & 1))
    if known & 2:
        # Rounded to 10 ms, as the same receiver's sentences are, so that both make one fix.
        moment = ((hour * 60 + minute) * 60 + second) * 1_000_000 + round(nano * 1e-7) * 10_000
        part.tod = moment % DAY
        if known & 1:
            part.day = date(year, month, day).toordinal() - _EPOCH + moment // DAY
    if part.valid:
        part.rank = 5
        part.values = {
            "latitude": latitude * 1e-7, "longitude": longitude * 1e-7, "z": above_sea * 1e-3,
            "speed": speed * 1e-3, "heading": heading_of_course(course * 1e-5),
            "satellites": float(satellites),
        }  # fmt: skip
    return part


def sniff(path: Path, head: bytes) -> bool:
    """Whether something framed has a right checksum, and most of it is right."""
    good = bad = 0
    for _, frame, fault in frames(BufferedReader(BytesIO(head))):
        kind = kind_of(frame)
        good += fault is None and (kind[:3] == "UBX" or b"*" in frame or kind[-3:] in ("GGA", "RMC"))
        bad += fault is not None
    return (good > 0 and (good >= bad or path.suffix.lower() in IMPORTER.suffixes)) or bad > 2 * good > 0


class _Nmea(Records):
    """One row a moment with a fix; ``ais`` sentences are other ships', ``unchecked`` have no checksum."""

    ais = unchecked = no_fix = 0

    def records(self) -> Iterator[tuple[int, bytes, str | None]]:
        self.waiting: list[Part] = []  # Fixes before the first date
        self._open = Part()
        self._last: Part | None = None  # The last fix with a date
        yield from frames(self.stream)
        self._close()

    def take(self, found: tuple[int, bytes, str | None], _: int) -> None:
        line, frame, fault = found
        kind = kind_of(frame)
        if kind[0] == "!" or kind[-3:] in ("VDM", "VDO"):
            self.ais += 1
            return
        unchecked = kind[:3] != "UBX" and b"*" not in frame
        if fault is None and unchecked and self.seen and not self.unchecked:
            fault = "the sentence has no checksum, unlike those before it"
        if fault is None:
            self.unchecked += unchecked
            self.seen[kind] += 1
            try:
                self._add(decode(frame, line))
            except (ValueError, OverflowError) as error:
                fault = f"{kind}: {error}"
        if fault is not None:
            self.rows.reject(line, fault, kind if kind[:3] == "UBX" else frame.decode().strip())

    def _add(self, part: Part) -> None:
        """A new time of day closes the fix before it."""
        if self._open.tod >= 0 and part.tod not in (-1, self._open.tod):
            self._close()
        fix = self._open
        fix.line = fix.line or part.line
        fix.tod, fix.day = max(fix.tod, part.tod), part.day or fix.day
        fix.valid = fix.valid if part.valid is None else part.valid or bool(fix.valid)
        fix.values = fix.values | part.values if part.rank > fix.rank else part.values | fix.values
        fix.rank = max(fix.rank, part.rank)

    def _close(self) -> None:
        """End the current fix; the first with a date gives one to those before it, from the last back."""
        fix, self._open, last = self._open, Part(), self._last
        if fix.tod < 0:
            return
        if last is not None and not fix.day:
            fix.day = last.day + (last.tod - fix.tod > DAY // 2)
        if not fix.day:
            if fix.placed and len(self.waiting) < WAITING:
                self.waiting.append(fix)
            return
        self._last = later = fix
        for early in reversed(self.waiting):
            early.day, later = later.day - (early.tod - later.tod > DAY // 2), early
        for known in (*self.waiting, fix):
            if known.placed:
                self.rows.add(self.vehicle, known.day * DAY + known.tod, known.line, known.values)
            else:
                self.no_fix += 1
        self.waiting.clear()

    def nothing(self) -> tuple[str, str]:
        if self.waiting:
            what = f"{count(len(self.waiting), 'position')} with a time of day but no date"
            return f"{what} (no RMC or ZDA sentence with one)", "record RMC or ZDA as well"
        do = "record RMC or GGA sentences or UBX NAV-PVT"
        if self.no_fix:
            return f"the receiver had no fix in any of its {count(self.no_fix, 'moment')}", do
        if self.ais and not self.seen:
            return f"only AIS: {count(self.ais, 'message')} of ships, no position of the receiver", do
        found = ", ".join(f"{n} {k}" for k, n in self.seen.most_common(8)) or "none"
        why = ""
        for first in self.rows.take().rejects[:1]:
            why = f"; {self.rows.rejected} rejected, the first on line {first.record}: {first.reason}"
        return f"no sentence with a position (readable sentences: {found}){why}", do

    def describe(self) -> None:
        sources = sorted(k for k in self.seen if k[-3:] in RANKS or k == "UBX-0107")
        meaning = "position, time, speed from knots, heading from course, z above sea level"
        self.report.recognised[", ".join(sources)] = meaning
        self.report.tally(self.no_fix, "moment", "without a fix left out")
        self.report.tally(len(self.waiting), "position", "without a date left out")
        self.report.tally(self.ais, "AIS message", "of other ships left out")
        self.report.tally(self.unchecked, "sentence", "without a checksum read")


IMPORTER = Importer("nmea", (".nmea", ".nma", ".ubx", ".log"), sniff, _Nmea.batches, rank=1)

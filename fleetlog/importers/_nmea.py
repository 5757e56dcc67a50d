"""A receiver's bytes cut into NMEA sentences and UBX messages, and what each says of a fix.

Fields: NMEA 0183 version 4.11; checksums and NAV-PVT: u-blox M10 interface description (UBX-21035062).
"""

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import date
from functools import lru_cache, reduce
from io import BufferedReader
from itertools import accumulate
from operator import xor
from typing import NamedTuple

from fleetlog.importers._rows import finite, heading_of_course
from fleetlog.importers._times import DAY

BLOCK = 1 << 18
UBX_LIMIT = 8192  # Longest UBX payload that is believed; a longer one is two bytes of chance
SENTENCE_LIMIT = 1024
KNOT = 1852.0 / 3600.0  # One knot [m/s]
_START = re.compile(
    rb"\xb5b|([$!][A-Z][A-Z0-9]{1,11}),([\x20-\x23\x25-\x29\x2b-\x7e]{0,1000})"
    rb"(\*[0-9A-Fa-f]{2})?(?=(\r?\n|\r)?)"
)
_EPOCH = date(1970, 1, 1).toordinal()
_TIME = re.compile(rb"(\d\d)(\d\d)(\d\d)(?:\.(\d*))?")
_ANGLE = re.compile(rb"(\d{2,})(\d\d(?:\.\d*)?)")
_PVT = struct.Struct("<4xH6B4xiBBxBii4xi20xii10x")


class Frame(NamedTuple):
    """A sentence or a UBX message, or what is wrong with it.

    ``kind`` is the address of a sentence (``b"GPGGA"``, ``b"!AIVDM"``) or ``b"UBX"``; ``body`` the
    comma-separated fields, or class, id and payload; ``fault`` is None, or why the frame cannot be used;
    ``checked`` whether a checksum was there and right.
    """

    kind: bytes
    body: bytes
    line: int
    fault: str | None
    checked: bool


@dataclass(slots=True)
class Part:
    """What one frame says.

    ``tod`` is the time of day [us] or None, ``day`` days since 1970 or None, ``rank`` the trust in the
    position (0: none is given), ``valid`` False where the receiver says that it has no fix, None where the
    sentence does not say.
    """

    tod: int | None = None
    day: int | None = None
    rank: int = 0
    valid: bool | None = None
    values: dict[str, float] = field(default_factory=dict)


class _Layout(NamedTuple):
    """Where the cells of a sentence stand, their least number, and the rank of its position."""

    least: int
    tod: int | None
    state: int | None
    place: int | None
    rank: int
    values: dict[str, int]


_LAYOUTS = {
    b"RMC": _Layout(9, 0, 1, 2, 2, {"speed": 6, "heading": 7}),
    b"GGA": _Layout(9, 0, 5, 1, 4, {"gps_quality": 5, "satellites": 6, "hdop": 7, "z": 8}),
    b"GNS": _Layout(9, 0, 5, 1, 3, {"satellites": 6, "hdop": 7, "z": 8}),
    b"GLL": _Layout(5, 4, 5, 0, 1, {}),
    b"VTG": _Layout(5, None, None, None, 0, {"heading": 0, "speed": 4}),
    b"ZDA": _Layout(4, 0, None, None, 0, {}),
}


def frames(stream: BufferedReader) -> Iterator[Frame]:
    """All frames of the stream; what lies between them is passed over."""
    buffer, line, done = b"", 1, False
    while not done:
        block = stream.read(BLOCK)
        done = not block
        buffer += block
        at = 0
        while True:
            found = _START.search(buffer, at)
            keep = found.start() if found else max(at, len(buffer) - SENTENCE_LIMIT)
            if found is None or (not done and len(buffer) - keep < UBX_LIMIT + 8):
                break
            line += buffer.count(b"\n", at, keep)
            frame, at = _sentence(found, line, done) if found[1] else _ubx(buffer, keep, line)
            line += buffer.count(b"\n", keep, at)
            if frame is not None:
                yield frame
        if not done:
            keep = max(at, keep)
            line += buffer.count(b"\n", at, keep)
            buffer = buffer[keep:]


def _sentence(found: re.Match[bytes], line: int, at_end: bool) -> tuple[Frame, int]:
    address, body, check, ended = found.groups()
    fault = None
    if check is None and at_end and found.end() == len(found.string):
        fault = "the sentence is cut off by the end of the file"
    elif check is None and not ended:
        fault = "the sentence is broken off"
    elif check and int(check[1:], 16) != reduce(xor, address[1:] + b"," + body):
        fault = "checksum of the sentence is wrong"
    return Frame(address.removeprefix(b"$"), body, line, fault, check is not None), found.end()


def _ubx(buffer: bytes, start: int, line: int) -> tuple[Frame | None, int]:
    end = start + 8 + int.from_bytes(buffer[start + 4 : start + 6], "little")
    if end - start - 8 > UBX_LIMIT or len(buffer) < start + 6:
        return None, start + 2
    body = buffer[start + 2 : end - 2]
    if end > len(buffer):
        fault = "the UBX message is cut off by the end of the file"
    elif (sum(body) & 0xFF, sum(accumulate(body)) & 0xFF) != (buffer[end - 2], buffer[end - 1]):
        fault = "checksum of the UBX message is wrong"
    else:
        return Frame(b"UBX", body[:2] + body[4:], line, None, True), end
    return Frame(b"UBX", body[:2], line, fault, end <= len(buffer)), start + 2


def decode(kind: bytes, body: bytes) -> Part | None:
    """The parts of a frame; None for a kind without motion; :class:`ValueError` for broken fields."""
    if kind == b"UBX":
        return _nav_pvt(body) if body[:2] == b"\x01\x07" else None
    name, cells = kind[2:], body.split(b",")
    layout = _LAYOUTS.get(name)
    if kind[:1] == b"P" or layout is None or (name == b"VTG" and cells[1:2] != [b"T"]):
        return None
    if len(cells) < layout.least:
        raise ValueError("the sentence has too few fields")
    part = Part()
    if layout.tod is not None and (clock := cells[layout.tod]):
        part.tod = _time_of_day(clock)
    if name == b"RMC" and (day := cells[8]):
        part.day = _day(day[4:], day[2:4], day[:2])
    elif name == b"ZDA" and all(cells[1:4]):
        part.day = _day(*cells[3:0:-1])
    if (at := layout.state) is not None and (name != b"GLL" or any(cells[at : at + 1])):
        part.valid = bool(cells[at].strip(b"0NV"))
    # Where the receiver says that it has no fix, what stands there is filler.
    if (at := layout.place) is not None and part.valid is not False and cells[at] and cells[at + 2]:
        part.values["latitude"] = _angle(cells[at], cells[at + 1], 2)
        part.values["longitude"] = _angle(cells[at + 2], cells[at + 3], 3)
        part.rank = layout.rank
    if part.valid or name == b"VTG":
        _add_figures(part.values, layout, cells)
    return part


def _add_figures(values: dict[str, float], layout: _Layout, cells: list[bytes]) -> None:
    """The figures beside the position; a broken one makes the whole sentence suspect."""
    for name, at in layout.values.items():
        if cells[at] and finite(value := float(cells[at])) == value:
            if name == "speed":
                value *= KNOT
            elif name == "heading":
                value = heading_of_course(value % 360.0)
            values[name] = value


# The sentences of one moment repeat one another's time, day and angles.
@lru_cache(16)
def _time_of_day(cell: bytes) -> int:
    """Microseconds since midnight of ``hhmmss.sss``."""
    match = _TIME.fullmatch(cell)
    if match is None:
        raise ValueError("the time of day is not hhmmss")
    hour, minute, second = (int(match[k]) for k in (1, 2, 3))
    if hour > 23 or minute > 59 or second > 60:
        raise ValueError("there is no such time of day")
    return ((hour * 60 + minute) * 60 + second) * 1_000_000 + int((match[4] or b"")[:6].ljust(6, b"0"))


@lru_cache(16)
def _angle(cell: bytes, side: bytes, digits: int) -> float:
    """Degrees of ``dddmm.mmmm`` and a hemisphere."""
    match = _ANGLE.fullmatch(cell)
    if match is None or len(match[1]) < digits or side not in (b"N", b"S", b"E", b"W"):
        raise ValueError("the position is not degrees and minutes with a hemisphere")
    minutes = float(match[2])
    value = int(match[1]) + minutes / 60.0
    if minutes >= 60.0 or value > (90.0 if digits == 2 else 180.0):
        raise ValueError("there is no such position")
    return -value if side in (b"S", b"W") else value


@lru_cache(16)
def _day(year: bytes, month: bytes, day: bytes) -> int:
    """Days since 1970; a year of two figures lies in 1980 to 2079."""
    if not (year.isdigit() and month.isdigit() and day.isdigit()):
        raise ValueError("the date is not ddmmyy")
    number = int(year)
    if len(year) == 2:
        number += 1900 if number >= 80 else 2000
    return date(number, int(month), int(day)).toordinal() - _EPOCH


def _nav_pvt(body: bytes) -> Part:
    """NAV-PVT: date, time, fix type, 1e-7 degrees, mm, mm/s, 1e-5 degrees."""
    if len(body) < 2 + _PVT.size:
        raise ValueError("NAV-PVT is too short")
    told = _PVT.unpack_from(body, 2)
    year, month, day, hour, minute, second, known, nano, fix, flags, satellites, *place = told
    longitude, latitude, above_sea, speed, course = place
    part = Part(valid=fix in (2, 3, 4) and bool(flags & 1))
    if known & 2 and hour < 24 and minute < 60 and second < 61:
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

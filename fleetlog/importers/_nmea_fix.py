"""Sentences and UBX messages to the parts of a fix: time of day, date, position, speed, course.

Field positions: NMEA 0183 version 4.11; NAV-PVT: u-blox M10 interface description (UBX-21035062).
"""

import re
import struct
from dataclasses import dataclass, field
from datetime import date
from typing import NamedTuple

from fleetlog.importers._rows import finite, heading_of_course
from fleetlog.importers._times import DAY

KNOT = 1852.0 / 3600.0  # One knot [m/s]
_EPOCH = date(1970, 1, 1).toordinal()
_TIME = re.compile(rb"(\d\d)(\d\d)(\d\d)(?:\.(\d*))?")
_ANGLE = re.compile(rb"(\d{2,})(\d\d(?:\.\d*)?)")
_PVT = struct.Struct("<4xH6B4xiBBxBii4xi20xii10x")


@dataclass(slots=True)
class Part:
    """What one sentence says.

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
    """Where the cells of a sentence stand: least number, time of day, position and its rank, values."""

    least: int
    tod: int | None
    place: int | None
    rank: int
    values: dict[str, int]


_LAYOUTS = {
    b"RMC": _Layout(9, 0, 2, 2, {"speed": 6, "heading": 7}),
    b"GGA": _Layout(9, 0, 1, 4, {"gps_quality": 5, "satellites": 6, "hdop": 7, "z": 8}),
    b"GNS": _Layout(9, 0, 1, 3, {"satellites": 6, "hdop": 7, "z": 8}),
    b"GLL": _Layout(5, 4, 0, 1, {}),
    b"VTG": _Layout(5, None, None, 0, {"heading": 0, "speed": 4}),
    b"ZDA": _Layout(4, 0, None, 0, {}),
}


def decode(kind: bytes, body: bytes) -> Part | None:
    """The parts of a frame; None for a kind without motion; :class:`ValueError` for broken fields."""
    if kind == b"UBX":
        return _nav_pvt(body) if body[:2] == b"\x01\x07" else None
    layout, cells = _LAYOUTS.get(kind[-3:]), body.split(b",")
    if kind[:1] == b"P" or len(kind) != 5 or layout is None or (kind[-3:] == b"VTG" and cells[1:2] != [b"T"]):
        return None
    if len(cells) < layout.least:
        raise ValueError("the sentence has too few fields")
    return _part(kind[-3:], layout, cells)


def _part(kind: bytes, layout: _Layout, cells: list[bytes]) -> Part:
    part = Part(valid=_valid(kind, cells))
    if layout.tod is not None and cells[layout.tod]:
        part.tod = _time_of_day(cells[layout.tod])
    if kind == b"RMC" and cells[8]:
        part.day = _day(cells[8][4:], cells[8][2:4], cells[8][:2])
    elif kind == b"ZDA" and all(cells[1:4]):
        part.day = _day(*cells[3:0:-1])
    # Where the receiver says that it has no fix, what stands there is filler.
    at = layout.place
    if at is not None and part.valid is not False and cells[at] and cells[at + 2]:
        part.values["latitude"] = _angle(cells[at], cells[at + 1], 2)
        part.values["longitude"] = _angle(cells[at + 2], cells[at + 3], 3)
        part.rank = layout.rank
    if part.valid or kind == b"VTG":
        part.values |= _values(layout, cells)
    return part


def _valid(kind: bytes, cells: list[bytes]) -> bool | None:
    """Whether the receiver says that it has a fix; None where it does not say."""
    if kind == b"GGA":
        return cells[5] not in (b"", b"0")
    if kind == b"GNS":
        return bool(cells[5].strip(b"N"))
    if kind == b"RMC":
        return cells[1] in (b"A", b"D")
    return cells[5] in (b"A", b"D") if kind == b"GLL" and any(cells[5:6]) else None


def _values(layout: _Layout, cells: list[bytes]) -> dict[str, float]:
    """The figures beside the position; a broken one makes the whole sentence suspect."""
    given = {name: float(cells[at]) for name, at in layout.values.items() if cells[at]}
    values = {name: value for name, value in given.items() if finite(value) == value}
    if "speed" in values:
        values["speed"] *= KNOT
    if "heading" in values:
        values["heading"] = heading_of_course(values["heading"] % 360.0)
    return values


def _time_of_day(cell: bytes) -> int:
    """Microseconds since midnight of ``hhmmss.sss``."""
    match = _TIME.fullmatch(cell)
    if match is None:
        raise ValueError("the time of day is not hhmmss")
    hour, minute, second = (int(match[k]) for k in (1, 2, 3))
    if hour > 23 or minute > 59 or second > 60:
        raise ValueError("there is no such time of day")
    return ((hour * 60 + minute) * 60 + second) * 1_000_000 + int((match[4] or b"")[:6].ljust(6, b"0"))


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
    year, month, day, hour, minute, second, known, nano, fix, flags, satellites, *place = _PVT.unpack_from(
        body, 2
    )
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

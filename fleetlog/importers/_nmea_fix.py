"""Sentences and UBX messages to the parts of a fix: time of day, date, position, speed, course.

Field positions: NMEA 0183 version 4.11; NAV-PVT: u-blox M10 interface description (UBX-21035062).
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import date
from functools import partial
from typing import NamedTuple

from fleetlog.importers._rows import NAN, finite, heading_of_course

KNOT = 1852.0 / 3600.0
"""One knot [m/s]."""
DAY = 86_400_000_000
_PVT = struct.Struct("<IHBBBBBBIiBBBBiiiiIIiiiiiIIH")
_PVT_FIELDS = (
    "itow", "year", "month", "day", "hour", "minute", "second", "valid", "t_accuracy", "nano", "fix", "flags",
    "flags2", "satellites", "lon", "lat", "height", "above_sea", "h_accuracy", "v_accuracy", "north", "east",
    "down", "speed", "course", "s_accuracy", "c_accuracy", "dop",
)  # fmt: skip
_NO_FIX = frozenset({b"", b"0"})


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
    latitude: float = NAN
    longitude: float = NAN
    valid: bool | None = None
    values: dict[str, float] = field(default_factory=dict)


def decode(kind: bytes, body: bytes) -> Part | None:
    """The parts of a frame; None for a kind without motion; :class:`ValueError` for broken fields."""
    if kind == b"UBX":
        return _nav_pvt(body) if body[:2] == b"\x01\x07" else None
    if kind[:1] == b"P":
        return None
    decoder = _DECODERS.get(kind[-3:])
    return decoder(body.split(b",")) if decoder and len(kind) == 5 else None


def time_of_day(cell: bytes) -> int | None:
    """Microseconds since midnight of ``hhmmss.sss``; None where empty."""
    if not cell:
        return None
    whole, _, fraction = cell.partition(b".")
    if len(whole) != 6 or not whole.isdigit() or (fraction and not fraction.isdigit()):
        raise ValueError("the time of day is not hhmmss")
    hour, minute, second = int(whole[:2]), int(whole[2:4]), int(whole[4:])
    if hour > 23 or minute > 59 or second > 60:
        raise ValueError("there is no such time of day")
    return ((hour * 60 + minute) * 60 + second) * 1_000_000 + int(fraction[:6].ljust(6, b"0") or 0)


def _angle(cell: bytes, side: bytes, degrees: int) -> float:
    """Degrees of ``dddmm.mmmm`` and a hemisphere."""
    point = cell.find(b".")
    point = len(cell) if point < 0 else point
    if point < degrees + 2 or side not in (b"N", b"S", b"E", b"W"):
        raise ValueError("the position is not degrees and minutes with a hemisphere")
    minutes = float(cell[point - 2 :])
    value = int(cell[: point - 2]) + minutes / 60.0
    if not 0.0 <= minutes < 60.0 or value > (90.0 if degrees == 2 else 180.0):
        raise ValueError("there is no such position")
    return -value if side in (b"S", b"W") else value


def _position(part: Part, cells: list[bytes], at: int, rank: int) -> None:
    """Where the receiver says that it has no fix, what stands there is filler."""
    if part.valid is not False and cells[at] and cells[at + 2]:
        part.latitude = _angle(cells[at], cells[at + 1], 2)
        part.longitude = _angle(cells[at + 2], cells[at + 3], 3)
        part.rank = rank


def _put(part: Part, name: str, cell: bytes, factor: float = 1.0) -> None:
    if cell:
        value = float(cell)  # a broken number makes the whole sentence suspect
        if finite(value) == value:
            part.values[name] = value * factor


class _Layout(NamedTuple):
    """Where the cells of a sentence stand: least number, time of day, position and its rank, values."""

    least: int
    tod: int
    place: int
    rank: int
    values: dict[str, int]


_LAYOUTS = {
    b"RMC": _Layout(9, 0, 2, 2, {}),
    b"GGA": _Layout(9, 0, 1, 4, {"gps_quality": 5, "satellites": 6, "hdop": 7, "z": 8}),
    b"GNS": _Layout(9, 0, 1, 3, {"satellites": 6, "hdop": 7, "z": 8}),
    b"GLL": _Layout(5, 4, 0, 1, {}),
}


def _valid(kind: bytes, cells: list[bytes]) -> bool | None:
    """Whether the receiver says that it has a fix; None where it does not say."""
    if kind == b"GGA":
        return cells[5] not in _NO_FIX
    if kind == b"GNS":
        return bool(cells[5].strip(b"N"))
    cell = cells[1] if kind == b"RMC" else cells[5] if len(cells) > 5 else b""
    return cell in (b"A", b"D") if cell or kind == b"RMC" else None


def _fix(kind: bytes, cells: list[bytes]) -> Part:
    layout = _LAYOUTS[kind]
    _need(cells, layout.least)
    part = Part(time_of_day(cells[layout.tod]), valid=_valid(kind, cells))
    if kind == b"RMC" and cells[8]:
        part.day = _day(cells[8][4:], cells[8][2:4], cells[8][:2])
    _position(part, cells, layout.place, layout.rank)
    if part.valid:
        for name, at in layout.values.items():
            _put(part, name, cells[at])
        if kind == b"RMC":
            _put(part, "speed", cells[6], KNOT)
            _course(part, cells[7])
    return part


def _need(cells: list[bytes], count: int) -> None:
    if len(cells) < count:
        raise ValueError("the sentence has too few fields")


def _course(part: Part, cell: bytes) -> None:
    if cell:
        part.values["heading"] = heading_of_course(float(cell) % 360.0)


def _day(year: bytes, month: bytes, day: bytes) -> int:
    """Days since 1970; a year of two figures lies in 1980 to 2079."""
    if not (year.isdigit() and month.isdigit() and day.isdigit()):
        raise ValueError("the date is not ddmmyy")
    number = int(year)
    if len(year) == 2:
        number += 1900 if number >= 80 else 2000
    return date(number, int(month), int(day)).toordinal() - 719_163


def _vtg(cells: list[bytes]) -> Part:
    part = Part()
    if len(cells) >= 5 and cells[1] == b"T":
        _course(part, cells[0])
        _put(part, "speed", cells[4], KNOT)
    return part


def _zda(cells: list[bytes]) -> Part:
    _need(cells, 4)
    part = Part(time_of_day(cells[0]))
    if all(cells[1:4]):
        part.day = _day(cells[3], cells[2], cells[1])
    return part


_DECODERS: dict[bytes, Callable[[list[bytes]], Part]] = {k: partial(_fix, k) for k in _LAYOUTS}
_DECODERS |= {b"VTG": _vtg, b"ZDA": _zda}


def _nav_pvt(body: bytes) -> Part:
    """NAV-PVT: date, time, fix type, 1e-7 degrees, mm, mm/s, 1e-5 degrees."""
    if len(body) < 2 + _PVT.size:
        raise ValueError("NAV-PVT is too short")
    f = dict(zip(_PVT_FIELDS, _PVT.unpack_from(body, 2), strict=True))
    part = Part(valid=f["fix"] in (2, 3, 4) and bool(f["flags"] & 1))
    if f["valid"] & 2 and f["hour"] < 24 and f["minute"] < 60 and f["second"] < 61:
        # Rounded to 10 ms, as the same receiver's sentences are, so that both make one fix.
        seconds = (f["hour"] * 60 + f["minute"]) * 60 + f["second"]
        moment = seconds * 1_000_000 + round(f["nano"] * 1e-7) * 10_000
        part.tod = moment % DAY
        if f["valid"] & 1:
            part.day = date(f["year"], f["month"], f["day"]).toordinal() - 719_163 + moment // DAY
    part.latitude, part.longitude, part.rank = f["lat"] * 1e-7, f["lon"] * 1e-7, 5
    if part.valid:
        part.values = {
            "z": f["above_sea"] * 1e-3, "speed": f["speed"] * 1e-3,
            "heading": heading_of_course(f["course"] * 1e-5), "satellites": float(f["satellites"]),
        }  # fmt: skip
    return part

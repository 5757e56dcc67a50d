"""Units of logs and their way to SI; names of columns and their meaning; times in microseconds since 1970."""

import re
import tomllib
import unicodedata
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta, tzinfo
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray

from fleetlog.core.arrays import DAY, Floats, Ints, Mask
from fleetlog.core.columns import NAMES
from fleetlog.errors import InputError, nearest


@dataclass(frozen=True)
class Unit:
    """``si = (value + shift) * factor``; ``kind`` is the quantity it measures."""

    name: str
    kind: str
    factor: float = 1.0
    shift: float = 0.0

    def to_si(self, values: Floats) -> Floats:
        """Values in SI; angles within -pi and pi, compass angles turned into the site's sense."""
        if self.name.startswith("compass"):
            values = np.pi / 2.0 / self.factor - values
        if self.name == "ddmm":
            whole = np.trunc(values / 100.0)  # dddmm.mmmm, as NMEA 0183 has it
            values = whole + (values - 100.0 * whole) / 60.0
        out = values if (self.factor, self.shift) == (1.0, 0.0) else (values + self.shift) * self.factor
        if self.kind == "angle":  # radians within their bounds stay, to the last bit
            stays = (np.abs(out) <= np.pi) & (self.name == "rad")
            out = np.where(stays, out, np.pi - np.mod(np.pi - out, 2 * np.pi))
        return np.asarray(out, dtype=np.float64)


_TEXT = tomllib.loads(Path(__file__).with_name("spellings.toml").read_text(encoding="utf-8"))
UNITS = tuple(Unit(name, kind, *si) for kind, units in _TEXT["si"].items() for name, si in units.items())
MISSING_WORDS = _TEXT["missing"]["words"].split()
_ALIASES = {alias: name for name, words in _TEXT["units"].items() for alias in words.split()}
KINDS = {c: kind for kind, names in _TEXT["measure"].items() for c in names.split()}  # What each measures


def find_unit(text: str, kind: str) -> Unit | None:
    """The unit that ``text`` spells for a quantity, or None."""
    text = text.strip()
    low = text.lower()
    spelt = {text, low, _ALIASES.get(low, text), _ALIASES.get(re.sub(r"\W+", "_", low), text)}
    return next((u for u in UNITS if u.kind == kind and u.name in spelt), None)


def unit(text: str, column: str, where: str | None = None) -> Unit:
    """The unit that a user wrote for ``column``; :class:`InputError` names those that it can have."""
    kind = KINDS[column]
    if (found := find_unit(text, kind)) is None:
        do = nearest(text, [u.name for u in UNITS if u.kind == kind])
        raise InputError(f"{text!r} is no unit of {kind}", where=where, place=column, do=do)
    return found


def si_unit(column: str) -> Unit:
    """The unit that the dataset has for ``column``."""
    return next(u for u in UNITS if (u.kind, u.factor, u.shift) == (KINDS[column], 1.0, 0.0))


_BY_SPELLING = {s: name for name, words in _TEXT["columns"].items() for s in [name, *words.split()]}
_BY_SPELLING.update({n: n for n in NAMES})
_COMPASS, LAST = (frozenset(_TEXT[kind]["words"].split()) for kind in ("compass", "last"))
EPOCH_UNITS = {"s": 1e6, "ms": 1e3, "us": 1.0, "ns": 1e-3, "days": 8.64e10}  # Microseconds in one unit
_EPOCH_ALIASES = {alias: name for name, words in _TEXT["epoch"].items() for alias in words.split()}
_BRACKETS = re.compile(r"^(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]\s*$")


@dataclass(frozen=True)
class Meaning:
    """What a column is taken for. ``unit`` is None where the name does not say it (then the dataset's unit
    holds); ``epoch`` is the unit of a time that counts from 1970, where the name says it."""

    column: str
    unit: Unit | None = None
    epoch: str | None = None
    exact: bool = False  # Whether it is spelt as the contract spells it


def normal(name: str) -> str:
    """Lower case without accents, joined by underscores: ``batteryPower`` gives ``battery_power``."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z][a-z])", "_", name.strip())
    plain = re.sub("[\u0300-\u036f]", "", unicodedata.normalize("NFKD", spaced.casefold()))
    return re.sub(r"[^0-9a-z]+", "_", plain).strip("_")


def recognise(name: str) -> Meaning | None:
    """What the column called ``name`` is, or None where its name does not say."""
    if bracket := _BRACKETS.match(name):
        return _with_unit(normal(bracket[1]), bracket[2])
    whole = normal(name)
    if whole in _BY_SPELLING:
        return _plain(whole, exact=name.strip() == whole == _BY_SPELLING[whole])
    for cut in reversed([i for i, c in enumerate(whole) if c == "_"]):
        meaning = _with_unit(whole[:cut], whole[cut + 1 :])
        if meaning and (meaning.unit or meaning.epoch):
            return meaning
    return None


def nearly(name: str) -> str | None:
    """The column that ``name`` would be, were what stands behind it in brackets (or its degrees) known."""
    front = bracket[1] if (bracket := _BRACKETS.match(name)) else re.sub(r"(?i)_deg(rees)?$", "", name)
    return _BY_SPELLING.get(normal(front)) if front != name else None


def _plain(spelling: str, *, exact: bool = False) -> Meaning:
    column = _BY_SPELLING[spelling]
    return Meaning(column, find_unit("compass_deg", "angle") if spelling in _COMPASS else None, exact=exact)


def _with_unit(spelling: str, text: str) -> Meaning | None:
    if (column := _BY_SPELLING.get(spelling)) is None:
        return None
    if column == "timestamp":
        epoch = _EPOCH_ALIASES.get(normal(text))
        known = epoch or normal(text) in ("", "utc", "iso", "iso_8601")
        return Meaning(column, epoch=epoch) if known else None
    if spelling in _COMPASS:
        sense = find_unit(text or "deg", "angle")
        return Meaning(column, find_unit(f"compass_{sense.name}", "angle")) if sense else None
    if column not in KINDS or not text:
        return Meaning(column) if not text else None
    if spelling == "heading" and find_unit(text, "angle") != si_unit("heading"):
        return None  # degrees of the compass or of mathematics: the name does not tell
    unit = find_unit(text, KINDS[column])
    return Meaning(column, unit) if unit else None


NONE = np.iinfo(np.int64).min  # A time that could not be read
MISSING, UNREADABLE = "the time is missing", "the time cannot be read"
OFF_TIME = "the time is outside 1678 to 2262"
SKIPPED = "a local time that does not exist (the clocks went forward over it)"
EARLIEST_LOG, _LATEST = 157_766_400_000_000, 4_102_444_800_000_000  # 1975 and 2100 [us]
EARLIEST, LATEST = -9_214_560_000_000_000, 9_223_286_400_000_000
"""Times that a dataset can hold [us]: 1678-01-01 to 2262-04-11, what nanoseconds in 64 bits can count."""
OF_DAY = r"^\s*\d{1,2}:\d{2}:\d{2}([.,]\d+)?\s*$"
_EPOCH, _MICROSECOND = datetime(1970, 1, 1, tzinfo=UTC), timedelta(microseconds=1)


@dataclass
class LocalClock:
    """Local times of one file to UTC; an hour that comes twice is told apart by the order of the rows.
    ``last`` is each vehicle's latest UTC time, which shows the second pass over an ambiguous hour."""

    zone: ZoneInfo
    last: dict[str, int] = field(default_factory=dict)
    twice: int = 0

    def to_utc(self, local: Ints, vehicle: NDArray[np.object_]) -> Ints:
        """UTC of local times; ``NONE`` where the clocks never showed such a time."""
        known = local != NONE
        stamps = pd.DatetimeIndex(np.where(known, local, 0).astype("datetime64[us]"))
        zone: Any = self.zone
        first = _epoch(stamps.tz_localize(zone, ambiguous=np.ones(len(local), bool), nonexistent="NaT"))
        second = _epoch(stamps.tz_localize(zone, ambiguous=np.zeros(len(local), bool), nonexistent="NaT"))
        out = np.where(known, first, NONE)
        for row in np.flatnonzero(known & (first != second)).tolist():
            begin = max(0, row - 1000)  # the latest time of the same vehicle before this row
            earlier = np.flatnonzero(vehicle[begin:row] == vehicle[row])
            if out[row] < (out[begin + earlier[-1]] if len(earlier) else self.last.get(vehicle[row], NONE)):
                out[row] = second[row]
            self.last[vehicle[row]] = int(out[row])
            self.twice += 1
        self.last |= dict(zip(vehicle.tolist(), out.tolist(), strict=True))  # the last one stays
        return out


def _epoch(stamps: Any) -> Ints:
    """Microseconds of a pandas index of times, with or without a zone; ``NONE`` for NaT."""
    bare = stamps.tz_convert(None) if stamps.tz is not None else stamps
    return np.asarray(bare.to_numpy().astype("datetime64[us]").astype(np.int64))


def epoch_unit(count: float) -> str | None:
    """The unit in which a count from 1970 gives a date from 1975 to 2100; None where none but days does."""
    known = (k for k, us in EPOCH_UNITS.items() if EARLIEST_LOG <= count * us <= _LATEST)
    return next((k for k in known if k != "days"), None)


def from_counts(values: Floats | Ints, unit: str, origin: int = 0) -> Ints:
    """Times counted in ``unit`` from ``origin`` [us]; ``NONE`` where not finite or out of reach."""
    good = np.abs(values.astype(np.float64)) * EPOCH_UNITS[unit] < LATEST - EARLIEST
    known = np.where(good, values, 0)
    if values.dtype.kind == "i" and unit != "days":
        time = known.astype(f"timedelta64[{unit}]").astype("timedelta64[us]").astype(np.int64)
    else:
        time = np.rint(known * EPOCH_UNITS[unit]).astype(np.int64)
    return np.where(good, origin + time, NONE)


def of_day(cells: pa.Array, style: str) -> Ints:
    """Microseconds since midnight, in a ``strptime`` format or as hh:mm:ss; ``NONE`` elsewhere."""
    if style != "of day":
        return np.where((time := from_format(cells, style)[0]) == NONE, NONE, np.mod(time, DAY))
    text = pd.Series(cells.to_pandas(), dtype=object)
    span = pd.to_timedelta(text.where(text.str.match(OF_DAY, na=False)), errors="coerce")
    time = span.to_numpy().astype("timedelta64[us]").astype(np.int64)
    return np.where((time >= 0) & (time < DAY), time, NONE)


@dataclass
class Days:
    """Days of times of day from a given first one; a step back by half a day or more is midnight."""

    first: int
    last: int = 0

    def dated(self, of_day: Ints) -> Ints:
        """Times [us] of times of day; ``NONE`` stays."""
        known = of_day != NONE
        turns = np.cumsum(np.diff(of_day[known], prepend=self.last) < -DAY // 2)
        out = of_day.copy()
        out[known] += self.first + turns * DAY
        if len(turns):
            self.first, self.last = self.first + int(turns[-1]) * DAY, int(of_day[known][-1])
        return out


def from_iso(cells: pa.Array) -> tuple[Ints, Mask]:
    """Times of ISO 8601 cells, and which state no zone; ``NONE`` where null or not ISO 8601."""
    for kind, bare in ((pa.timestamp("ns", "UTC"), False), (pa.timestamp("ns"), True)):
        try:
            time = cells.cast(kind)
        except pa.ArrowInvalid:
            continue
        # Times before 1970 round down like the others.
        micro = np.asarray(time.cast(pa.int64()).fill_null(0).to_numpy()) // 1000
        return np.where(np.asarray(cells.is_null()), NONE, micro), np.full(len(cells), bare)
    text = pd.Series(cells.to_pandas(), dtype=object).str.strip()
    # Loggers write a decimal comma, which ISO 8601 prefers, and databases the name of the zone.
    text = text.str.replace(r",(?=\d)", ".", regex=True).str.replace(r" (UTC|GMT)$", "Z", regex=True)
    # The date itself ends in -DD; a zone only counts after a time of day.
    zoned = text.str.contains(r"(?:[zZ]|[+-]\d\d(?::?\d\d)?)$", na=False) & text.str.contains(":", na=False)
    found = pd.to_datetime(pd.Index(text), format="ISO8601", errors="coerce", utc=True)
    return _epoch(found), ~np.asarray(zoned)


def from_format(cells: pa.Array, style: str) -> tuple[Ints, Mask]:
    """Times of cells in a ``strptime`` format, and which state no zone; ``NONE`` where one does not fit."""
    zoned = "%z" in style or "%Z" in style
    text = pd.Index(cells.to_pandas(), dtype=object)
    time = _epoch(pd.to_datetime(text, format=style, errors="coerce", utc=zoned))
    return time, np.full(len(cells), not zoned)


def microseconds(moment: datetime, zone: tzinfo | None = None) -> int:
    """Microseconds since 1970 UTC; a time that states no zone is taken for one of ``zone``, else for UTC."""
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=zone or UTC)
    return (moment - _EPOCH) // _MICROSECOND


def iso_time(text: str) -> int:
    """Microseconds since 1970 UTC of an ISO 8601 time; :class:`ValueError` where it is none."""
    return microseconds(datetime.fromisoformat(text.strip()))

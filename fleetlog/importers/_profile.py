"""What the columns of a log are: a profile says it (see ``docs/logs.md``), else their names do."""

import codecs
import re
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import date, datetime, time
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np

from fleetlog.core import schema
from fleetlog.core.arrays import Floats
from fleetlog.core.columns import NAMES
from fleetlog.core.schema import Keys, Wrong, either, flag, list_of, one_of, real, table, text
from fleetlog.core.site import MapFrame, crs, map_frames
from fleetlog.errors import InputError
from fleetlog.importers import _units
from fleetlog.importers._open import ReadReport
from fleetlog.importers._units import EPOCH_UNITS, KINDS, LAST, Meaning, Unit, microseconds

_PARTS_OF_DATES = "YyGmbBdjUWVuwaA"
TARGETS = (*NAMES, "latitude", "longitude")


@dataclass(frozen=True)
class Source:
    """Where a column of the dataset comes from."""

    column: str  # Name in the log
    unit: Unit | None = None
    sentinels: tuple[float | str, ...] = ()
    scale: float = 1.0  # Multiplied last; -1 turns a current that is negative when discharging

    def known(self, values: Floats) -> Floats:
        """The values, NaN where they mean "missing"."""
        figures = [float(s) for s in self.sentinels if not isinstance(s, str)]
        return np.where(np.isin(values, figures), np.nan, values) if figures else values

    def to_si(self, values: Floats) -> Floats:
        """The values in SI."""
        values = self.unit.to_si(values) if self.unit else values
        return values if self.scale == 1.0 else values * self.scale


@dataclass(frozen=True)
class Profile:
    """How to read logs of one kind."""

    path: str = ""
    vehicle: str | None = None
    """Constant vehicle id; ``"{stem}"`` and ``"{folder}"`` stand for the file's name and its folder's."""
    delimiter: str | None = None
    decimal: str | None = None  # ``","`` or ``"."``; found from the first lines where it is not given
    encoding: str | None = None
    skip_lines: int = 0
    comment: str | None = None
    names: tuple[str, ...] = ()  # Column names of a file that has no header line
    sentinels: tuple[float | str, ...] = ()  # Cells that mean "missing" in any column
    time: tuple[str, ...] = ()  # The column of the time, or two: date and time of day
    time_format: str | None = None  # As ``strptime`` takes it, or ``iso``, ``s``, ``ms``, ``us``, ``ns``
    time_zone: str | None = None
    time_origin: datetime | None = None
    """Instant from which times count, or the first day of times of day; local without a zone."""
    columns: dict[str, Source] = field(default_factory=dict)
    crs: str | None = None  # Reference system of x, y, as ``EPSG:25832``
    map_frames: tuple[MapFrame, ...] = ()  # How the log's own frames lie in the site's
    keep: bool = True  # Whether columns that are neither mapped nor recognised are kept under their own names

    @property
    def origin(self) -> int:
        """``time_origin`` in microseconds since 1970 UTC, 0 where there is none."""
        zone = self.zone if self.time_format != "days" else None  # those of a spreadsheet are local days
        return 0 if self.time_origin is None else microseconds(self.time_origin, zone)

    @property
    def zone(self) -> ZoneInfo | None:
        """The time zone, or None for UTC."""
        return ZoneInfo(self.time_zone) if self.time_zone else None


def _encoding(value: Any) -> str:
    with suppress(LookupError, ValueError):
        if codecs.lookup(text(value))._is_text_encoding:
            return str(value)
    raise Wrong("is no encoding; write it as utf-8 or latin-1")


def has_date(style: str) -> bool:
    """Whether a time format says year, month and day."""
    parts = set(re.findall("%(.)", style))
    day = {"j"} <= parts or bool(parts & {"m", "b", "B"} and "d" in parts) or {"V", "u"} <= parts
    return "%" not in style or bool(parts & {"c", "x"}) or bool(parts & {"Y", "y", "G"} and day)


def _origin(value: Any) -> datetime:
    """An instant, or a day: its midnight."""
    with suppress(ValueError):
        if isinstance(value, str):
            value = date.fromisoformat(value) if len(value) == 10 else datetime.fromisoformat(value)
    if isinstance(value, date) and not isinstance(value, datetime):
        return datetime.combine(value, time())
    if not isinstance(value, datetime) or value.tzinfo is None:
        raise Wrong('is no instant; write it as "2026-03-02T05:00:00Z", or "2026-03-02" for a day')
    return value


def _style(value: Any) -> str:
    """``iso``, a unit of a count, or a format of ``strptime`` whose directives all exist."""
    style = text(value)
    if style in ("iso", *EPOCH_UNITS):
        return style
    try:
        datetime.strptime("", style)
    except (ValueError, re.error) as error:
        if "%" in style and "does not match format" in str(error):
            if not has_date(style) and set(re.findall("%(.)", style)) & set(_PARTS_OF_DATES):
                raise Wrong("leaves part of the date out; a date is never made up") from None
            return style
    raise Wrong("is no time format; write iso, s, ms, us, ns, days or a strptime format as %d.%m.%Y %H:%M:%S")


def _delimiter(value: Any) -> str:
    found = "\t" if value in ("tab", "\\t") else text(value)
    if len(found) != 1 or found in '\r\n"' or not found.isascii():
        raise Wrong("is not one character")
    return found


def _vehicle(value: Any) -> str:
    bare = text(value).replace("{stem}", "").replace("{folder}", "")
    if "{" in bare or "}" in bare:
        raise Wrong("has a placeholder other than {stem} and {folder}")
    return str(value)


_SENTINELS, _NAMES = list_of(either(real(), text)), list_of(text, 1)
_FILE: Keys = {
    "delimiter": _delimiter, "decimal": one_of(",", "."), "encoding": _encoding, "comment": text,
    "skip_lines": schema.whole(0), "names": _NAMES, "sentinels": _SENTINELS, "vehicle": _vehicle,
    "keep": flag, "crs": crs,
}  # fmt: skip
_TIME: Keys = {
    "column": either(text, list_of(text, 1, 2)), "format": _style, "zone": schema.time_zone,
    "origin": _origin,
}  # fmt: skip
_COLUMN: Keys = {"column": text, "unit": text, "sentinels": _SENTINELS, "scale": real(-1e12, 1e12)}


def load_profile(path: str | Path) -> Profile:
    """Read a profile; :class:`InputError` names the key at fault and the nearest known one."""
    return profile_from_dict(schema.load_toml(Path(path), do="give a profile with --profile"), str(path))


def profile_from_dict(data: dict[str, Any], where: str = "profile") -> Profile:
    """A profile of nested sections, checked."""
    unread = dict.fromkeys(("time", "columns", "map_frame"), schema.anything)
    given = table(data, {**_FILE, **unread}, where, "")
    frames = map_frames(given, where)
    given.pop("map_frame", None)
    stamp, columns = given.pop("time", {}), given.pop("columns", {})
    stamp = table({"column": stamp} if isinstance(stamp, str | list) else stamp, _TIME, where, "time")
    columns = table(columns, dict.fromkeys((*TARGETS, "timestamp"), schema.anything), where, "columns")
    if "timestamp" in columns:
        do = "write [time] column = ..."
        raise InputError("the time has a section of its own", where=where, place="columns.timestamp", do=do)
    names = stamp.pop("column", ())
    given |= {f"time_{name}": value for name, value in stamp.items()}
    given["columns"] = {k: _source(k, v, where) for k, v in columns.items()}
    time = (names,) if isinstance(names, str) else names
    return Profile(path=where, time=time, map_frames=frames, **given)


def _source(target: str, value: Any, where: str) -> Source:
    if isinstance(value, str):
        return Source(value)
    place = f"columns.{target}"
    value = table(value, _COLUMN, where, place)
    if "unit" in value and target not in KINDS:
        raise InputError("has no unit", where=where, place=place, do="leave the unit out")
    known = _units.unit(value["unit"], target, where) if "unit" in value else None
    return Source(**{"column": target, **value, "unit": known})


@dataclass
class Fields:
    """What the fields called ``names`` are: ``columns`` of the dataset and their sources; the log's own
    names of its ``time`` (one, or date and time of day), its ``vehicle`` and what is kept as it is."""

    names: list[str]
    profile: Profile
    report: ReadReport
    columns: dict[str, Source] = field(default_factory=dict)
    time: tuple[str, ...] = ()
    epoch: str | None = None  # Unit of a time that counts, where the name or the profile states it
    vehicle: str | None = None
    kept: list[str] = field(default_factory=list)

    @property
    def used(self) -> set[str]:
        """Names in the log that are taken for something."""
        return {*(s.column for s in self.columns.values()), *self.time, self.vehicle or ""}

    def take_profile(self) -> None:
        """What the profile says of names that are there."""
        profile = self.profile
        for target, source in profile.columns.items():
            if source.column not in self.names:
                continue
            if target == "vehicle_id":
                self.vehicle = source.column
            else:
                self.columns[target] = replace(source, sentinels=(*source.sentinels, *profile.sentinels))
            unit = f", from {source.unit.name}" if source.unit else ""
            self.report.recognised[source.column] = f"{target}{unit} (profile)"
        if profile.time and {*profile.time} <= {*self.names}:
            self.time = profile.time
            self.report.recognised |= dict.fromkeys(profile.time, "timestamp (profile)")
        self.epoch = profile.time_format if profile.time_format in EPOCH_UNITS else None

    def take(self, name: str, meaning: Meaning) -> None:
        """Give a recognised field its place, unless that is taken."""
        target = meaning.column
        taken = {"timestamp": self.time, "vehicle_id": self.vehicle}.get(target, target in self.columns)
        if taken:
            if name not in self.used:
                self.report.note(f"{name!r} could be the {target} too; kept under its own name")
            return
        if target == "timestamp":
            self.time, self.epoch = (name,), self.epoch or meaning.epoch
        elif target == "vehicle_id":
            self.vehicle = name
        else:
            self.columns[target] = Source(name, meaning.unit)
        if not meaning.exact:
            self.report.recognised[name] = target + _unit_text(target, meaning)

    def instant(self, value: Any, epoch: str | None = "") -> int:
        """[us] UTC of a text, or of a count in ``epoch`` (None: the likely one); ValueError if it is none."""
        if isinstance(value, str):
            style, text = self.profile.time_format, value.strip()
            dated = style is not None and "%" in style and has_date(style)
            moment = datetime.strptime(text, str(style)) if dated else datetime.fromisoformat(text)
            return microseconds(moment, self.profile.zone)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError("no time")
        unit, likely = self.epoch if epoch == "" else epoch, _units.epoch_unit(value)
        if not (self.profile.time_format or self.profile.time_origin):
            unit = likely if unit in (None, likely) else None
        if unit is None or not abs(value) < 1e19:
            raise ValueError("no time, or one that counts from an unknown start")
        whole = value // 1000 if unit == "ns" and isinstance(value, int) else round(value * EPOCH_UNITS[unit])
        return self.profile.origin + whole


def fields_of(
    names: Iterable[str], profile: Profile | None, report: ReadReport, time: tuple[str, ...] = ()
) -> Fields:
    """What fields are, told to ``report``: the profile's word first, then spelling; ``time`` is known."""
    found = Fields([*names], profile or Profile(), report, time=time)
    found.take_profile()
    meanings = {n: m for n in found.names if n not in found.used and (m := _units.recognise(n))}
    claim = {n: (_units.normal(n) in LAST, not m.exact, "utc" not in n.lower()) for n, m in meanings.items()}
    for name in sorted(meanings, key=claim.__getitem__):
        found.take(name, meanings[name])
    free = [n for n in found.names if n not in found.used]
    for name in free:
        if (target := _units.nearly(name)) and target not in found.columns:
            report.note(f"{name!r} may be the {target}, in a unit or sense not known: kept as it is")
    found.kept = free if found.profile.keep else []
    return found


def _unit_text(target: str, meaning: Meaning) -> str:
    if target == "timestamp":
        return f", counted in {meaning.epoch}" if meaning.epoch else ""
    if target not in KINDS or target in ("latitude", "longitude"):
        return ""
    if meaning.unit is None:
        return f", no unit in the name, taken as {_units.si_unit(target).name}"
    compass = meaning.unit.name == "compass_deg"
    return ", from degrees of the compass" if compass else f", from {meaning.unit.name}"

"""A profile: what a log's columns are, where their names do not say it; see ``docs/logs.md``."""

import codecs
import re
from contextlib import suppress
from dataclasses import dataclass, field
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
from fleetlog.importers._times import microseconds
from fleetlog.importers._units import EPOCH_UNITS, KINDS, Unit, unit

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
        for sentinel in self.sentinels:
            if not isinstance(sentinel, str):
                values = np.where(values == float(sentinel), np.nan, values)
        return values

    def to_si(self, values: Floats) -> Floats:
        """The values in SI."""
        if self.unit is not None:
            values = self.unit.to_si(values)
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
        return 0 if self.time_origin is None else microseconds(self.time_origin, self.zone)

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
    raise Wrong("is no time format; write iso, s, ms, us, ns or a strptime format as %d.%m.%Y %H:%M:%S")


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


_SENTINELS = list_of(either(real(), text))
_NAMES = list_of(text, 1)
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
    known = unit(value["unit"], target, where) if "unit" in value else None
    return Source(**{"column": target, **value, "unit": known})

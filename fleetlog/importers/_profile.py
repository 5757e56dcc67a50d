"""A profile: what a log's columns are, where their names do not say it.  ``docs/logs.md`` has a worked one."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

from fleetlog.core.columns import NAMES
from fleetlog.errors import InputError, nearest
from fleetlog.importers._names import EPOCH_UNITS
from fleetlog.importers._units import KINDS, Unit, unit

TARGETS = (*NAMES, "latitude", "longitude")


@dataclass(frozen=True)
class Source:
    """Where a column of the dataset comes from."""

    column: str
    """Name in the log."""
    unit: Unit | None = None
    sentinels: tuple[float | str, ...] = ()
    scale: float = 1.0
    """Multiplied last; -1 turns a current that is negative when discharging."""


@dataclass(frozen=True)
class Profile:
    """How to read logs of one kind."""

    path: str = ""
    vehicle: str | None = None
    """Constant vehicle id; ``"{stem}"`` and ``"{folder}"`` stand for the file's name and its folder's."""
    delimiter: str | None = None
    decimal: str | None = None
    """``","`` or ``"."``; found from the first lines where it is not given."""
    encoding: str | None = None
    skip_lines: int = 0
    comment: str | None = None
    names: tuple[str, ...] = ()
    """Column names of a file that has no header line."""
    sentinels: tuple[float | str, ...] = ()
    """Cells that mean "missing" in any column."""
    time: tuple[str, ...] = ()
    """The column of the time, or two: date and time of day."""
    time_format: str | None = None
    """As ``strptime`` takes it, or ``iso``, ``s``, ``ms``, ``us``, ``ns``."""
    time_zone: str | None = None
    time_origin: str | None = None
    """ISO 8601 instant from which a time in seconds counts, where that is not 1970."""
    columns: dict[str, Source] = field(default_factory=dict)
    keep: bool = True
    """Whether columns that are neither mapped nor recognised are kept under their own names."""

    @property
    def zone(self) -> ZoneInfo | None:
        """The time zone, or None for UTC."""
        return ZoneInfo(self.time_zone) if self.time_zone else None


_FILE = {"delimiter": str, "decimal": str, "encoding": str, "skip_lines": int, "comment": str, "names": list, "sentinels": list,
         "vehicle": str, "keep": bool}  # fmt: skip
_TIME = {"column": (str, list), "format": str, "zone": str, "origin": str}
_COLUMN = {"column": str, "unit": str, "sentinels": list, "scale": (int, float)}


def load_profile(path: str | Path) -> Profile:
    """Read a profile; :class:`InputError` names the key at fault and the nearest known one."""
    path = Path(path)
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError("no such file", where=path, do="give a profile with --profile") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"not readable as TOML: {error}", where=path) from None
    return profile_from_dict(data, str(path))


def profile_from_dict(data: dict[str, Any], where: str = "profile") -> Profile:
    """A profile of nested sections, checked."""
    _check(data, {**_FILE, "time": (dict, str), "columns": dict}, where, "")
    time = data.get("time", {})
    time = {"column": time} if isinstance(time, str) else time
    _check(time, _TIME, where, "time.")
    _check_time(time, where)
    columns = data.get("columns", {})
    _known_targets(columns, where)
    given = {k: v for k, v in data.items() if k in _FILE}
    for key in ("names", "sentinels"):
        given[key] = tuple(given.get(key, ()))
    if given.get("delimiter") in ("tab", "\\t"):
        given["delimiter"] = "\t"
    _check_encoding(given.get("encoding"), where)
    names = time.get("column", ())
    return Profile(
        path=where,
        time=(names,) if isinstance(names, str) else tuple(names),
        time_format=time.get("format"),
        time_zone=time.get("zone"),
        time_origin=time.get("origin"),
        columns={k: _source(k, v, where) for k, v in columns.items()},
        **given,
    )


def _check(section: dict[str, Any], known: dict[str, Any], where: str, prefix: str) -> None:
    for key, value in section.items():
        if key not in known:
            raise InputError("unknown key", where=where, place=prefix + key, do=nearest(key, known))
        kind = known[key]
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise InputError(
                f"{value!r} is of the wrong kind", where=where, place=prefix + key, do="see docs/logs.md"
            )


def _check_time(time: dict[str, Any], where: str) -> None:
    zone, style = time.get("zone"), time.get("format")
    if zone is not None:
        try:
            ZoneInfo(zone)
        except (KeyError, ValueError, OSError):
            raise InputError(
                f"no time zone {zone!r}", where=where, place="time.zone", do="write it as Europe/Berlin"
            ) from None
    if style is not None and "%" not in style and style not in ("iso", *EPOCH_UNITS):
        do = "write iso, s, ms, us, ns or a strptime format as %d.%m.%Y %H:%M:%S"
        raise InputError(f"no time format {style!r}", where=where, place="time.format", do=do)


def _check_encoding(encoding: str | None, where: str) -> None:
    try:
        "".encode(encoding or "utf-8")
    except LookupError:
        raise InputError(
            f"no encoding {encoding!r}", where=where, place="encoding", do="write it as utf-8 or latin-1"
        ) from None


def _known_targets(columns: dict[str, Any], where: str) -> None:
    for key in columns:
        if key == "timestamp":
            raise InputError(
                "the time has a section of its own",
                where=where,
                place="columns.timestamp",
                do="write [time] column = ...",
            )
        if key not in TARGETS:
            raise InputError("unknown column", where=where, place=f"columns.{key}", do=nearest(key, TARGETS))


def _source(target: str, value: Any, where: str) -> Source:
    if isinstance(value, str):
        return Source(value)
    place = f"columns.{target}"
    if not isinstance(value, dict):
        raise InputError(
            f"{value!r} names no column",
            where=where,
            place=place,
            do='write { column = "...", unit = "..." }',
        )
    _check(value, _COLUMN, where, place + ".")
    if "unit" in value and target not in KINDS:
        raise InputError("has no unit", where=where, place=place, do="leave the unit out")
    return Source(
        value.get("column", target),
        unit(value["unit"], target, where) if "unit" in value else None,
        tuple(value.get("sentinels", ())),
        float(value.get("scale", 1.0)),
    )

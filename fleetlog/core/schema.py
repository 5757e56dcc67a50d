"""The one checker of settings (TOML): every key is known, every value of its kind, finite and in range.

A schema is a dictionary: key -> check.  A check takes the value as TOML gives it and returns it as it is
used, or raises :class:`Wrong` with what was expected."""

import math
import sys
import tomllib
from collections.abc import Callable, Iterable, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

from fleetlog.core.files import SETTINGS, read_whole
from fleetlog.errors import InputError, chosen

Check = Callable[[Any], Any]
Keys = Mapping[str, Check]
Errors = type[InputError]
_SHOWN = 60
FARTHEST = 1e7  # No point lies farther from an origin [m]


class Wrong(Exception):
    """A value is not of its kind; the text says what is expected."""


def load_toml(path: Path, error: Errors = InputError, do: str | None = None) -> dict[str, Any]:
    """The tables of a TOML file; ``error`` where it cannot be read, with ``do`` where there is none."""
    if not path.exists():
        raise error("no such file", where=path, do=do)
    try:
        return tomllib.loads(read_whole(path, SETTINGS, error).decode("utf-8-sig"))
    except (ValueError, RecursionError) as problem:  # ValueError: also integers of thousands of digits
        why = "it is nested too deeply" if isinstance(problem, RecursionError) else str(problem)[:200]
        raise error(f"not readable as TOML: {why}", where=path, do="correct it") from None


def real(low: float = -math.inf, high: float = math.inf, unit: str = "") -> Check:
    """A finite number in a range."""

    def check(value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise Wrong("is not a number")
        if not abs(value) <= sys.float_info.max:
            raise Wrong("is not a finite number")
        if not low <= value <= high:
            raise Wrong(f"is outside {low:g} to {high:g} {'' if unit == '1' else unit}".rstrip())
        return float(value)

    return check


def whole(low: int = 1, high: int = 1_000_000) -> Check:
    """A whole number in a range."""

    def check(value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise Wrong(f"is not a whole number from {low} to {high:,}")
        return value

    return check


def text(value: Any) -> str:
    """A text, not empty."""
    if not isinstance(value, str) or not value:
        raise Wrong("is not a text")
    return value


def time_zone(value: Any) -> str:
    """The IANA name of a time zone."""
    try:
        ZoneInfo(text(value))
    except (ValueError, OSError, LookupError):
        raise Wrong("is no time zone such as Europe/Berlin") from None
    return str(value)


def moment(value: Any) -> float:
    """A date and time with its zone, as seconds since 1970."""
    if not isinstance(value, datetime):
        raise Wrong("is not a date and time, as 2026-03-14T09:00:00Z")
    if value.tzinfo is None:
        raise Wrong("has no time zone; put Z behind it for UTC")
    return value.timestamp()


def flag(value: Any) -> bool:
    """True or false."""
    if not isinstance(value, bool):
        raise Wrong("is neither true nor false")
    return value


def one_of(*known: str) -> Check:
    """One of a few words."""

    def check(value: Any) -> str:
        if value not in known:
            raise Wrong(f"is none of {', '.join(known)}")
        return str(value)

    return check


def either(*checks: Check) -> Check:
    """The first check that the value passes."""

    def check(value: Any) -> Any:
        reasons = []
        for one in checks:
            try:
                return one(value)
            except Wrong as wrong:
                reasons.append(str(wrong))
        raise Wrong(" and ".join(reasons))

    return check


def list_of(item: Check, least: int = 0, most: int = 1_000_000) -> Check:
    """A list, as a tuple."""

    def check(value: Any) -> tuple[Any, ...]:
        if not isinstance(value, list) or not least <= len(value) <= most:
            count = f"{least}" if least == most else f"{least} or more"
            raise Wrong("is not a list" + (f" of {count}" if least else ""))
        return tuple(item(v) for v in value)

    return check


def table(
    data: Any, keys: Keys, where: str | Path | None, place: str, required: Iterable[str] = (),
    error: Errors = InputError,
) -> dict[str, Any]:  # fmt: skip
    """The checked values of one table; ``error`` names the key at fault and the nearest known one."""
    if not isinstance(data, dict):
        raise error("is not a table", where=where, place=place, do=f"write [{place}] and its keys below")
    out = {}
    for key, value in data.items():
        spot = f"{place}.{key}" if place else key
        check = chosen(keys, key, "unknown key", error, where=where, place=spot[:200])
        try:
            out[key] = check(value)
        except Wrong as wrong:
            raise error(f"{shown(value)} {wrong}", where=where, place=spot, do="correct it") from None
    if (key := next((k for k in required if k not in out), None)) is not None:
        raise error(f"{key} is missing", where=where, place=place or None, do=f"add {key} = ...")
    return out


def rows(
    data: Mapping[str, Any], name: str, keys: Keys, where: str | Path | None, required: Iterable[str] = (),
    error: Errors = InputError,
) -> list[dict[str, Any]]:  # fmt: skip
    """The checked tables of the list [[name]]; none where it is absent."""
    if not isinstance(given := data.get(name, []), list):
        raise error("is not a list of tables", where=where, place=name, do=f"write [[{name}]]")
    return [table(row, keys, where, f"{name}[{n}]", required, error) for n, row in enumerate(given)]


def tables(value: Any) -> dict[str, dict[str, Any]]:
    """A table of tables, whose names and contents are checked elsewhere."""
    if not isinstance(value, dict) or not all(isinstance(inner, dict) for inner in value.values()):
        raise Wrong("is not a table of tables")
    return value


def anything(value: Any) -> Any:
    """A value that is checked elsewhere."""
    return value


def shown(value: Any) -> str:
    """A value as an error quotes it: never longer than a line."""
    try:
        written = repr(value)
    except (ValueError, RecursionError):  # an integer of thousands of digits
        return "this value"
    return written if len(written) <= _SHOWN else written[:_SHOWN] + " ..."

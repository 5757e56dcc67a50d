"""What arguments may be: bounds and spellings, as annotations that functions, commands and pages share.

    def density(dataset: Dataset, *, threshold: Annotated[float, Between(0.01, 1e6)] = 15.0) -> Result: ...

A check takes what a user gave, a text or a value, and returns the value; ``ValueError`` says what is wrong.
"""

import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from fleetlog.errors import nearest
from fleetlog.registry import part, part_lines

UNITS = {"s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0, "d": 86400.0}
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
LONGEST = 366 * 86400.0  # Of a duration [s]
NONE = "none"  # The value of a factor that leaves the scenario as it is


@dataclass(frozen=True)
class Named:
    """Any value that passes ``check``, called ``metavar`` in help. With ``path`` it is (also) the name of a
    file or folder, with ``many`` a sequence of such values."""

    metavar: str = "TEXT"
    path: bool = False
    many: bool = False
    check: Callable[[Any], Any] | None = None

    def __call__(self, value: Any) -> Any:
        """Return the value as functions take it."""
        return value if self.check is None else self.check(value)


@dataclass(frozen=True)
class Between:
    """A finite number from ``low`` to ``high``; ``above`` and ``below`` leave the bound itself out."""

    low: float = -math.inf
    high: float = math.inf
    above: bool = False
    below: bool = False
    whole: bool = False

    @property
    def metavar(self) -> str:
        """In help."""
        return "INTEGER" if self.whole else "NUMBER"

    def __call__(self, value: Any) -> float | int:
        """Return the number."""
        try:
            number: float | int = (int if self.whole else float)(value)
        except (TypeError, ValueError, OverflowError):
            raise ValueError(f"{value!r} is not {'a whole number' if self.whole else 'a number'}") from None
        if not (self.whole or math.isfinite(number)) or (isinstance(value, float) and number != value):
            raise ValueError(f"{value} is not a {'whole' if self.whole else 'finite'} number")
        on_bound = (self.above and number == self.low) or (self.below and number == self.high)
        if on_bound or not self.low <= number <= self.high:
            raise ValueError(f"{value} must be {self}")
        return number

    def __str__(self) -> str:
        low = f"{'over' if self.above else 'at least'} {self.low:g}" if self.low > -math.inf else ""
        high = f"{'under' if self.below else 'at most'} {self.high:g}" if self.high < math.inf else ""
        return " and ".join(filter(None, (low, high)))


@dataclass(frozen=True)
class PartOf:
    """The name of a part, a log or export format: one file of ``package`` each, or another distribution's."""

    package: str
    attribute: str
    metavar: str = "FORMAT"

    def names(self) -> dict[str, str]:
        """Every name in order, and that of its module, without importing a part."""
        modules = part_lines(self.package, self.attribute)
        return dict(sorted((name.replace("_", "-"), name) for name in modules))

    def part(self, name: str) -> Any:
        """Return the part of that name, importing no other one."""
        return part(self.package, self.attribute, self.names()[name])

    def __call__(self, value: str) -> str:
        """Return the name."""
        if value not in self.names():
            raise ValueError(f"no format {value!r}; {nearest(value, self.names())}")
        return value


def seconds(value: Any) -> float:
    """``8h``, ``90m``, ``1.5h``, ``600`` (seconds), as seconds."""
    if not (found := re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*(s|m|min|h|d)?\s*", str(value))):
        raise ValueError(f"{value!r} is not a duration; write 8h, 30m or 600s")
    duration = float(found[1]) * UNITS[found[2] or "s"]
    if not 0.0 < duration <= LONGEST:
        raise ValueError(f"{value!r} is no time over 0 s and of at most {LONGEST / 86400.0:.0f} days")
    return duration


def moment(value: Any) -> int:
    """``2026-01-05T06:00``, UTC unless it says otherwise, as microseconds since 1970."""
    try:
        time = datetime.fromisoformat(str(value))
    except ValueError:
        time = datetime.min
    if not 1970 <= time.year < 2200:
        raise ValueError(f"{value!r} is no time between the years 1970 and 2200; write 2026-01-05T06:00")
    return (time.replace(tzinfo=time.tzinfo or UTC) - EPOCH) // timedelta(microseconds=1)


def hour_range(value: Any) -> tuple[int, int]:
    """``6-14``, or a pair: from one hour of the day to another, which is excluded."""
    try:
        given = value.split("-") if isinstance(value, str) else value
        first, last = (int(Between(0, 24, whole=True)(hour)) for hour in given)
    except (TypeError, ValueError):
        raise ValueError(f"{value!r} is not a range of hours from 0 to 24; write 6-14") from None
    return first, last


def shift_hours(value: Any) -> tuple[int, ...]:
    """``6,14,22``, or a sequence: hours of the day, in rising order."""
    try:
        hours = tuple(sorted({int(h) for h in (value.split(",") if isinstance(value, str) else value)}))
    except (TypeError, ValueError):
        raise ValueError(f"{value!r} is not a list of hours; write 6,14,22") from None
    if not hours or not all(0 <= h < 24 for h in hours):
        raise ValueError("hours run from 0 to 23")
    return hours


def names(value: str | Iterable[str]) -> tuple[str, ...]:
    """``a,b,c``, or a sequence of names."""
    return tuple(p.strip() for p in (value.split(",") if isinstance(value, str) else value) if p.strip())


def count_or_range(value: Any) -> int | str:
    """A whole number, or the text of several for an experiment: ``6..14``, ``6..14..2``, ``6,8,12``."""
    text = str(value).strip()
    numbers = [int(Between(1, 100_000, whole=True)(n)) for n in factor(f"vehicles={text}").values]
    return text if {*text} & {*".,"} else numbers[0]


class Factor(NamedTuple):
    """A setting that is varied; a value that is a number is also drawn as one. ``file`` that names it."""

    name: str
    values: tuple[str, ...]
    file: Path | None = None


def factor(value: Any) -> Factor:
    """The factor of ``NAME=VALUES``; ``2..6``, ``2..10..2`` and ``a,b,c`` are values, also mixed."""
    if isinstance(value, Factor):
        return value
    name, equals, values = (part.strip() for part in str(value).partition("="))
    if not (name and equals and values):
        raise ValueError(f"{value!r} is no setting with values; write NAME=VALUES, such as plugs=2..6")
    kept = tuple(dict.fromkeys(v for part in values.split(",") for v in _values(part.strip())))
    # What a road costs shows beside the site without it.
    return Factor(name, (NONE, *(v for v in kept if v != NONE)) if name == "close" else kept)


def _values(part: str) -> list[str]:
    if not (found := re.fullmatch(r"(\d{1,5})\.\.(\d{1,5})(?:\.\.(\d{1,5}))?", part)):
        return [part]
    low, high, step = (int(n or 1) for n in found.groups())
    if high < low or not step:
        raise ValueError(f"{part!r} is an empty range; write the lower number first, such as 2..6")
    return [str(k) for k in range(low, high + 1, step)]


Moment = Annotated[int | str, Named(check=moment)]
Duration = Annotated[float | str, Named("DURATION", check=seconds)]
HourRange = Annotated[tuple[int, int], Named("FROM-TO", check=hour_range)]
ShiftHours = Annotated[tuple[int, ...], Named("HOURS", check=shift_hours)]
Names = Annotated[tuple[str, ...], Named("NAME,...", check=names)]
Factors = tuple[Annotated[str, Named("NAME=VALUES", check=factor)], ...]
Counts = Annotated[int | str, Named("N or RANGE", check=count_or_range)]
Seed = Annotated[int, Between(0, 2**63 - 1, whole=True)]
Count = Annotated[int, Between(1, 100_000, whole=True)]
Share = Annotated[float, Between(0.0, 1.0)]

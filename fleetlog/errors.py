"""The family of errors.  Each says where, what is wrong and what to do next, in one line.

    FleetlogError                     exit status 1
    ├── InputError                    a file or a row of the user's is at fault
    │   ├── FormatError               not of the format it was taken for
    │   ├── SiteError                 a map or a site file
    │   └── TruckError                a truck file
    ├── ArgumentError                 wrong usage: exit status 2
    ├── DataError                     the files are well formed, the data cannot carry the question
    └── OutputError                   the result cannot be written where it was asked for

``fleetlog.cli.main`` is the one place that turns these into a line on standard error."""

import difflib
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

EXIT_DONE, EXIT_INPUT, EXIT_USAGE, EXIT_DAMAGED, EXIT_INTERRUPTED = 0, 1, 2, 3, 130
T = TypeVar("T")
LONGEST = 500  # Characters of one part of a line: a place, or what is wrong


class FleetlogError(Exception):
    """Base of everything that fleetlog raises on purpose.

    what : what is wrong, a clause without a full stop.
    where : the file, and ``place`` in it (line, record, key), or the option, when there is one.
    do : what the reader should do about it."""

    def __init__(
        self, what: str, *, where: str | Path | None = None, place: str | None = None, do: str | None = None
    ) -> None:
        self.what, self.where, self.place, self.do = what, where, place, do
        super().__init__(self.line())

    @property
    def advice(self) -> str:
        """What is wrong and what to do, without the place."""
        return f"{_short(self.what)}; {self.do}" if self.do else _short(self.what)

    def line(self) -> str:
        """The whole message on one line: where, place: what; what to do."""
        head = ", ".join(_short(str(part)) for part in (self.where, self.place) if part is not None)
        return " ".join((f"{head}: {self.advice}" if head else self.advice).split())


def _short(text: str) -> str:
    """The text, or the beginning of one that some file made very long."""
    return text if len(text) <= LONGEST else text[:LONGEST] + " ..."


class InputError(FleetlogError):
    """A file or a row that the user gave is at fault."""


class FormatError(InputError):
    """A file is not of the format that it was taken for."""


class SiteError(InputError):
    """A map or a site file is at fault."""


class TruckError(InputError):
    """A truck file is at fault."""


class ArgumentError(FleetlogError, ValueError):
    """An argument of a function, or an option of a command, is wrong, or does not go with another one."""


class DataError(FleetlogError):
    """The data are well formed but cannot carry the question that was asked of them."""


class OutputError(FleetlogError):
    """The result cannot be written where it was asked for."""


REPORT = "please report it, with the file if you may"  # What to do about a fault of fleetlog's own
MOST_NAMED = 40  # Known words that an error lists: all terms and kinds, not all roads of a town


def nearest(word: str, known: Iterable[str], said: Mapping[str, str] | None = None) -> str:
    """``'did you mean X?'`` for known words of which it is ``said``, or the closest; else the first known."""
    names = sorted(known)
    texts = {name: re.findall("[a-z]+", text.lower()) for name, text in (said or {}).items()}
    low = word.lower()
    meant = [n for n in texts if low in n.split("_")] or [n for n in texts if low in texts[n]]
    if meant:
        return f"did you mean {' or '.join(map(repr, meant[:4]))}?"
    if close := difflib.get_close_matches(word, names, n=1, cutoff=0.5):
        return f"did you mean {close[0]!r}?"
    more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
    return f"known are {', '.join(names[:MOST_NAMED])}{more}"


def chosen(known: Mapping[str, T], name: str, what: str, error: type[FleetlogError], **place: Any) -> T:
    """What is known by a name; where nothing is, the ``error`` says ``what`` and the nearest name."""
    if name not in known:
        raise error(what, do=nearest(name, known), **place)
    return known[name]


def fault(part: str, error: Exception) -> str:
    """What an error says of an exception that nobody foresaw: the part it came from, its kind, its text."""
    why = " ".join(f"{type(error).__name__}: {error}".split())[:200]
    return f"a fault in {part} ({why})"

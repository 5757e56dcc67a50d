"""Numbers in sentences: singular and plural, percent as percent; the sentences of a module."""

import tomllib
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from string import Formatter
from typing import Any


def count(number: Any, noun: str, plural: str = "") -> str:
    """``1 truck``, ``2,000 trucks``; a noun of another plural gives it."""
    return f"{number:,} {noun if number == 1 else plural or f'{noun}s'}"


def percent(share: Any, digits: int = 0) -> str:
    """``84 %`` of 0.84."""
    return f"{100.0 * share:.{digits}f} %"


def reasons(counts: Mapping[str, int]) -> str:
    """The most frequent first: ``no time: 7; no position: 2``; one alone without its number."""
    if len(counts) == 1:
        return next(iter(counts))
    return "; ".join(f"{why}: {n:,}" for why, n in sorted(counts.items(), key=lambda i: -i[1]))


def listed(parts: Sequence[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    return " and ".join([*([", ".join(parts[:-1])] if parts[1:] else []), *parts[-1:]])


class Sentences(Formatter):
    """What a module tells people, in whole sentences: its table of the ``sentences.toml`` beside it. Fields
    are those of ``str.format``; ``{n:count truck}`` and ``{share:percent 1}`` are the functions above."""

    def __init__(self, module: str) -> None:
        self.module = Path(module)

    @cached_property
    def texts(self) -> dict[str, str]:
        """Sentences by name, read when the first is told: not by everybody who loads the module."""
        every = tomllib.loads(self.module.with_name("sentences.toml").read_text(encoding="utf-8"))
        return dict(every[self.module.stem])

    def __call__(self, name: str, /, **figures: Any) -> str:
        """The sentence ``name`` with its figures."""
        return self.vformat(self.texts[name], (), figures)

    def format_field(self, value: Any, format_spec: str) -> str:
        """One figure as its field asks for it."""
        how, _, more = format_spec.partition(" ")
        if how == "percent":
            return percent(value, int(more or 0))
        return count(value, more) if how == "count" else format(value, format_spec)


def wrong_sign(vehicles: Sequence[str]) -> str:
    """What to do where the battery seems to be charged by driving."""
    what = f"battery power of {listed(vehicles)} is negative while driving, and should be positive"
    return f"{what} when discharging: turn its sign with scale = -1 in a profile (--profile)"

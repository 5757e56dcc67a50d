"""Numbers in sentences: singular and plural, percent as percent."""

from collections.abc import Mapping, Sequence
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


def wrong_sign(vehicles: Sequence[str]) -> str:
    """What to do where the battery seems to be charged by driving."""
    what = f"battery power of {listed(vehicles)} is negative while driving, and should be positive"
    return f"{what} when discharging: turn its sign with scale = -1 in a profile (--profile)"

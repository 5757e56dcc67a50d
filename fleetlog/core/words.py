"""Numbers in sentences: singular and plural, percent as percent."""

from collections.abc import Sequence
from typing import Any


def count(number: Any, noun: str, plural: str = "") -> str:
    """``1 truck``, ``2,000 trucks``; a noun of another plural gives it."""
    return f"{number:,} {noun if number == 1 else plural or f'{noun}s'}"


def percent(share: Any, digits: int = 0) -> str:
    """``84 %`` of 0.84."""
    return f"{100.0 * share:.{digits}f} %"


def listed(parts: Sequence[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    return " and ".join([*([", ".join(parts[:-1])] if parts[1:] else []), *parts[-1:]])

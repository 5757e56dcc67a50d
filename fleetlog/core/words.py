"""Numbers in sentences: singular and plural, percent as percent."""

from __future__ import annotations

from typing import Any


def count(number: Any, noun: str, plural: str = "") -> str:
    """``1 truck``, ``2,000 trucks``; a noun of another plural gives it."""
    return f"{number:,} {noun if number == 1 else plural or f'{noun}s'}"


def percent(share: Any, digits: int = 0) -> str:
    """``84 %`` of 0.84."""
    return f"{100.0 * share:.{digits}f} %"

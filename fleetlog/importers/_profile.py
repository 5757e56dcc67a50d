"""A profile: what a log's columns are, where their names do not say it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Profile:
    """How to read logs of one kind; see ``docs/logs.md``."""

    vehicle: str | None = None
    """Constant vehicle id."""

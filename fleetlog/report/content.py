"""What stands on a page: sections of sentences, tables and pictures, ready for the templates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd


@dataclass(frozen=True)
class Table:
    """Texts, row by row; ``right`` says which columns are numbers."""

    head: list[str]
    rows: list[list[str]]
    right: list[bool]
    caption: str = ""
    more: int = 0
    """Rows that are left out here, and are in the tables."""


@dataclass(frozen=True)
class Picture:
    """An SVG element and what it shows."""

    svg: str
    caption: str = ""


@dataclass
class Part:
    """What a section says of one dataset."""

    lines: list[str] = field(default_factory=list)
    blocks: list[Table | Picture] = field(default_factory=list)
    name: str = ""


@dataclass
class Section:
    """A heading, and one part for each dataset."""

    title: str
    parts: list[Part]


Format = Callable[[Any], str] | None
"""None: a text as it is."""


def table(
    frame: pd.DataFrame, columns: Sequence[tuple[str, str, Format]], caption: str = "", most: int = 12
) -> Table:
    """The first rows of a frame; ``columns`` are name, heading and format of each column that is shown."""
    shown = [c for c in columns if c[0] in frame]
    rows = [
        [str(row[name]) if show is None else show(row[name]) for name, _, show in shown]
        for row in frame.head(most).to_dict("records")
    ]
    right = [show is not None and show is not clock for _, _, show in shown]
    return Table([h for _, h, _ in shown], rows, right, caption, max(len(frame) - most, 0))


def number(value: Any) -> str:
    """Three significant digits, all before the point; a dash where it is unknown."""
    v = float(value) if value is not None else float("nan")
    if not np.isfinite(v):
        return "–"
    if v == 0.0 or abs(v) >= 100.0 or v == round(v):
        return f"{v:,.0f}"
    return f"{v:.1f}" if abs(v) >= 10.0 else f"{v:.2f}" if abs(v) >= 0.1 else f"{v:.2g}"


def fixed(digits: int) -> Callable[[Any], str]:
    """A format with so many digits after the point; a dash where a number is unknown."""

    def show(value: Any) -> str:
        v = float(value) if value is not None else float("nan")
        return f"{v:,.{digits}f}" if np.isfinite(v) else "–"

    return show


whole = fixed(0)


def percent(value: Any) -> str:
    """A share of 1 in per cent."""
    v = float(value) if value is not None else float("nan")
    return f"{100.0 * v:.0f} %" if np.isfinite(v) else "–"


def clock(value: Any) -> str:
    """A local time to the second."""
    return "–" if pd.isna(value) else f"{value:%d %b %H:%M:%S}"

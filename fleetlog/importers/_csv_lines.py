"""Lines of delimited text: where they end, and their cells, however long and however broken."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterable

from fleetlog.importers._report import ReadReport

_LONE = re.compile(rb"\r(?!\n)")
_SEPARATORS = bytes.maketrans(b";\t|", b",,,")


def cells_of(line: str, delimiter: str) -> list[str]:
    """The cells of one line; cut at every delimiter where the quotes make no sense or a cell is very long."""
    try:
        return next(csv.reader([line], delimiter=delimiter), [])
    except csv.Error:
        return line.split(delimiter)


def rows_of(lines: Iterable[str], delimiter: str) -> list[list[str]]:
    """The cells of every line that is not blank."""
    return [cells for line in lines if (cells := cells_of(line, delimiter))]


def with_line_feeds(text: bytes, report: ReadReport) -> bytes:
    """The text with carriage returns that stand alone as line ends, or as blanks where they lie inside a row.

    A row that is whole only together with what follows the carriage return holds a stray one; whether it is
    whole is told by the usual number of separators in a line.
    """
    if text.count(b"\r") == text.count(b"\r\n"):
        return text
    if b"\n" not in text:
        return text.replace(b"\r", b"\n")
    pieces = _LONE.split(text.replace(b"\r\n", b"\n"))
    counts = Counter(_separators(line) for piece in pieces for line in piece.split(b"\n") if line.strip())
    usual = counts.most_common(1)[0][0] if counts else 0
    out, stray = [pieces[0]], 0
    for piece in pieces[1:]:
        before, after = out[-1].rpartition(b"\n")[2], piece.partition(b"\n")[0]
        torn = _torn(before, after, usual)
        stray += torn
        out[-1:] = [out[-1] + b" " + piece] if torn else [out[-1], piece]
    if stray:
        report.note(f"carriage returns inside of rows are read as blanks ({stray} in one block)")
    if len(out) > 1:
        report.note("some lines end with a carriage return alone")
    return b"\n".join(out)


def _separators(line: bytes) -> int:
    return line.translate(_SEPARATORS).count(b",")


def _torn(before: bytes, after: bytes, usual: int) -> bool:
    """Whether two pieces are one row that a carriage return tears apart."""
    if not before.strip() or not after.strip() or before.startswith(b"#") or after.startswith(b"#"):
        return False
    first, second = _separators(before), _separators(after)
    return first + second <= usual and (first < usual or second == 0)

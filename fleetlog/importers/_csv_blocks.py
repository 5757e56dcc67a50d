"""A text log as blocks of whole lines in UTF-8, with the number of each line."""

import codecs
import csv
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fleetlog.core.arrays import Ints
from fleetlog.errors import FormatError
from fleetlog.importers._open import ReadReport, open_bytes

SIZE = 8 << 20  # Bytes in a block
LONGEST = 8 << 20  # Bytes in a line
TORN = 1 << 20  # Bytes of a quoted cell of several lines that the end of a block would tear apart
_LONE = re.compile(rb"\r(?!\n)")
_SEPARATORS = bytes.maketrans(b";\t|", b",,,")


@dataclass(frozen=True)
class Block:
    """Whole lines from number ``first`` (from 1); ``cut``: the last one lacks its line end."""

    text: bytes
    first: int
    progress: float
    cut: bool = False

    def lines(self) -> Ints:
        """Numbers of the lines that are not blank."""
        raw = np.frombuffer(self.text + b"\n", np.uint8)
        ends = np.flatnonzero(raw == ord("\n"))
        size = np.diff(ends, prepend=-1) - 1
        blank = (size == 0) | ((size == 1) & (raw[ends - 1] == ord("\r")))
        return np.asarray(self.first + np.flatnonzero(~blank), dtype=np.int64)

    def texts(self, numbers: list[int]) -> list[str]:
        """The text of some lines, by their numbers."""
        if not numbers:
            return []
        lines = self.text.decode("utf-8", "replace").split("\n")
        return [lines[n - self.first].rstrip("\r") for n in numbers]


def guess_encoding(head: bytes) -> str:
    """``utf-8-sig``, ``utf-16`` or ``utf-8`` where the bytes say so, else ``cp1252``, which fits all."""
    if head.startswith(codecs.BOM_UTF8):
        return "utf-8-sig"
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    if len(head) > 3 and head[1::2].count(0) > 0.4 * len(head[1::2]):
        return "utf-16-le"
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8"


def blocks(path: Path, encoding: str, report: ReadReport, size: int = SIZE) -> Iterator[Block]:
    """The file, block by block; carriage returns alone end lines too (:func:`with_line_feeds`)."""
    stream, share = open_bytes(path, report)
    decoder = codecs.getincrementaldecoder(encoding)(errors="replace") if encoding != "utf-8" else None
    rest, first, ended = b"", 1, False
    with stream:
        while not ended:
            data = stream.read(size)
            ended = not stream.peek(1)
            text = rest + (decoder.decode(data, ended).encode("utf-8", "replace") if decoder else data)
            # A carriage return at the very end may be half of a line end.
            half = b"\r" if text.endswith(b"\r") and not ended else b""
            text = with_line_feeds(text.removesuffix(half), report) + half
            last = text.rfind(b"\n") + 1
            end = last if ended else _end_of_record(text, last)
            if end:
                yield Block(text[:end], first, share())
                first += text.count(b"\n", 0, end)
            rest = text[end:]
            if len(text) - last > LONGEST:
                what, place = f"the line is longer than {LONGEST >> 20} MB", first + rest.count(b"\n")
                raise FormatError(what, where=path, place=f"line {place}", do="check the format")
        if rest:
            yield Block(rest, first, 1.0, cut=True)


def _end_of_record(text: bytes, last: int) -> int:
    """The last line end outside of quotes; ``last``, the end of the last line, where quotes make no sense."""
    end, odd = last, text.count(b'"', 0, last) % 2
    while odd and last - end < TORN:
        line = text.rfind(b"\n", 0, end - 1) + 1
        odd ^= text.count(b'"', line, end) % 2
        end = line
    return end if not odd and last - end < TORN else last


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

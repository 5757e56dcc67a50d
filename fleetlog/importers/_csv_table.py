"""A text log in blocks of whole lines; a block as an Arrow table, line by line where rows are broken."""

import codecs
import csv
import io
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pv

from fleetlog.core.arrays import Ints
from fleetlog.errors import FormatError
from fleetlog.importers import _units
from fleetlog.importers._open import HEAD, ReadReport, open_bytes
from fleetlog.importers._profile import Fields
from fleetlog.importers.base import GEOGRAPHIC, Reject

SIZE = LONGEST = 8 << 20  # Bytes in a block, and in a line at most
TORN = 1 << 20  # Bytes of a quoted cell of several lines that the end of a block would tear apart
_LONE = re.compile(rb"\r(?!\n)")
_SEPARATORS = bytes.maketrans(b";\t|", b",,,")


@dataclass(frozen=True)
class Block:
    """Whole lines from number ``first`` (from 1); ``cut``: the last one lacks its line end. ``report`` is of
    the file up to here: threads may read the next blocks before this one has its turn."""

    text: bytes
    first: int
    progress: float
    report: ReadReport
    cut: bool = False

    def lines(self, rows: int) -> Ints:
        """Numbers of the lines that are not blank: all, where they are as many as the ``rows`` read."""
        if rows == count_of(b"\n", self.text) + (not self.text.endswith(b"\n")):
            return np.arange(self.first, self.first + rows)
        raw = np.frombuffer(self.text + b"\n", np.uint8)
        ends = np.flatnonzero(raw == ord("\n"))
        size = np.diff(ends, prepend=-1) - 1
        blank = (size == 0) | ((size == 1) & (raw[ends - 1] == ord("\r")))
        return np.asarray(self.first + np.flatnonzero(~blank), dtype=np.int64)

    def texts(self, numbers: list[int]) -> list[str]:
        """The text of some lines, by their numbers."""
        lines = self.text.decode("utf-8", "replace").split("\n")
        return [lines[n - self.first].rstrip("\r") for n in numbers]


def count_of(byte: bytes, text: bytes, end: int = -1) -> int:
    """How often a byte comes in a text: where it is frequent, in a quarter of the time of ``bytes.count``."""
    return int(np.count_nonzero(np.frombuffer(text, np.uint8, end) == byte[0]))


def guess_encoding(head: bytes) -> str:
    """``utf-8-sig``, ``utf-16`` or ``utf-8`` where the bytes say so, else ``cp1252``, which fits all."""
    if head.startswith(codecs.BOM_UTF8):
        return "utf-8-sig"
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    if len(head) > 3 and head[1::2].count(0) > max(0.4 * len(head[1::2]), 2 * head[::2].count(0)):
        return "utf-16-le"
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8"


def blocks(path: Path, encoding: str) -> Iterator[Block]:
    """The file, block by block; carriage returns alone end lines too (:func:`with_line_feeds`)."""
    report = ReadReport(path)
    stream, share = open_bytes(path, report)
    decoder = codecs.getincrementaldecoder(encoding)(errors="replace") if encoding != "utf-8" else None
    rest, first, ended = b"", 1, False
    with stream:
        while not ended:
            data, ended = stream.read(SIZE), not stream.peek(1)
            data = decoder.decode(data, ended).encode("utf-8", "replace") if decoder else data
            report.tally(data.count(b"\0"), "NUL byte", "left out: devices fill cells and gaps with them")
            text = rest + data.replace(b"\0", b"")
            # A carriage return at the very end may be half of a line end.
            half = b"\r" if text.endswith(b"\r") and not ended else b""
            text = with_line_feeds(text.removesuffix(half), report) + half
            last = text.rfind(b"\n") + 1
            end = last if ended else _end_of_record(text, last)
            if end:
                yield Block(text[:end], first, share(), deepcopy(report))
                first += count_of(b"\n", text, end)
            rest = text[end:]
            if len(text) - last > LONGEST:
                what, place = f"the line is longer than {LONGEST >> 20} MB", first + rest.count(b"\n")
                raise FormatError(what, where=path, place=f"line {place}", do="check the format")
        if rest:
            yield Block(rest, first, 1.0, report, cut=True)


def _end_of_record(text: bytes, last: int) -> int:
    """The last line end outside of quotes; ``last``, the end of the last line, where quotes make no sense."""
    end, odd = last, b'"' in text and count_of(b'"', text, last) % 2
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
    whole is told by the usual number of separators in a line."""
    raw = np.frombuffer(text + b" ", np.uint8)
    if (raw[np.flatnonzero(raw == ord("\r")) + 1] == ord("\n")).all():
        return text
    if b"\n" not in text:
        return text.replace(b"\r", b"\n")
    pieces = _LONE.split(text.replace(b"\r\n", b"\n"))
    counts = Counter(_separators(line) for piece in pieces for line in piece.split(b"\n") if line.strip())
    usual = counts.most_common(1)[0][0] if counts else 0
    out, stray = [pieces[0]], 0
    for piece in pieces[1:]:
        before, after = out[-1].rpartition(b"\n")[2], piece.partition(b"\n")[0]
        first, second = _separators(before), _separators(after)
        rows = before.strip() and after.strip() and not before.startswith(b"#") and not after.startswith(b"#")
        torn = bool(rows) and first + second <= usual and (first < usual or second == 0)
        stray += torn
        out[-1:] = [out[-1] + b" " + piece] if torn else [out[-1], piece]
    if stray:
        report.note(f"carriage returns inside of rows are read as blanks ({stray} in one block)")
    if len(out) > 1:
        report.note("some lines end with a carriage return alone")
    return b"\n".join(out)


def _separators(line: bytes) -> int:
    return line.translate(_SEPARATORS).count(b",")


NULLS = ["", *_units.MISSING_WORDS]


def _as_cp1252(error: Any) -> tuple[str, int]:
    return error.object[error.start : error.end].decode("cp1252", "replace"), error.end


codecs.register_error("fleetlog.cp1252", _as_cp1252)


class TableReader:
    """Blocks of a file to tables with the columns of ``fields``; :meth:`decide` comes first."""

    def __init__(self, fields: Fields, delimiter: str, decimal: str) -> None:
        self.fields, self.delimiter, self.decimal = fields, delimiter, decimal
        sentinels = [*fields.profile.sentinels, *(s for c in fields.columns.values() for s in c.sentinels)]
        self.nulls = NULLS + [s for s in sentinels if isinstance(s, str)]
        self.angles: set[str] = set()  # Columns of latitude and longitude that hold text
        self._types: dict[str, Any] = {}
        self._known: dict[int, pa.Table] = {}  # Of the block that the types are from, by its first line

    def decide(self, block: Block) -> None:
        """Types of the columns, from the first block: from its head, where all of it can be read as that."""
        fields, text, kinds = self.fields, self._as_utf8(block), pa.types
        for sample in (text[: text.rfind(b"\n", 0, HEAD) + 1], text):
            try:
                inferred = self._arrow(sample, None).schema
            except pa.ArrowInvalid:
                inferred = self._arrow(self._one_by_one(block)[0], None).schema
            figures = {f.name for f in inferred if kinds.is_floating(f.type) or kinds.is_integer(f.type)}
            self.angles = {s.column for t, s in fields.columns.items() if t in GEOGRAPHIC} - figures
            figures |= {s.column for t, s in fields.columns.items() if t in _units.KINDS} - self.angles
            figures -= {s.column for t, s in fields.columns.items() if t not in _units.KINDS}
            figures -= {*fields.time, fields.vehicle}
            self._types = {n: pa.float64() if n in figures else pa.string() for n in fields.names}
            if sample is text or not any(kinds.is_null(f.type) for f in inferred):
                with suppress(pa.ArrowInvalid):
                    self._known[block.first] = self._arrow(text, self._types)
                    return

    def read(self, block: Block) -> tuple[pa.Table, Ints, list[Reject]]:
        """The table of a block, the line of every row, and the lines with too many or too few fields."""
        table = self._known.pop(block.first, None) or self._whole(self._as_utf8(block))
        lines = block.lines(0 if table is None else len(table))
        rejects: list[Reject] = []
        if table is None or len(table) != len(lines):
            text, numbers, rejects = self._one_by_one(block)
            table, lines = self._whole(text), np.array(numbers, dtype=np.int64)
            assert table is not None
        return table, lines, rejects

    def _as_utf8(self, block: Block) -> bytes:
        try:
            block.text.decode("utf-8")
        except UnicodeDecodeError as error:
            line = block.first + block.text.count(b"\n", 0, error.start)
            block.report.note(f"line {line} is not UTF-8; what is not is read as cp1252")
            return block.text.decode("utf-8", "fleetlog.cp1252").encode("utf-8", "replace")
        return block.text

    def _whole(self, text: bytes) -> pa.Table | None:
        """The rows that are whole: typed, or else as text; None where the quotes make no sense."""
        for kinds in (self._types, dict.fromkeys(self._types, pa.string())):
            with suppress(pa.ArrowInvalid):
                return self._arrow(text, kinds)
        return None

    def _arrow(self, text: bytes, types: dict[str, Any] | None) -> pa.Table:
        read = pv.ReadOptions(use_threads=False, column_names=self.fields.names, block_size=len(text) + 1024)
        parse = pv.ParseOptions(delimiter=self.delimiter, invalid_row_handler=lambda _: "skip")
        convert = pv.ConvertOptions(
            column_types=types, null_values=self.nulls, strings_can_be_null=True,
            decimal_point=self.decimal, timestamp_parsers=["-"], check_utf8=False,
        )  # fmt: skip
        return pv.read_csv(pa.BufferReader(text or b"\n"), read, parse, convert)

    def _one_by_one(self, block: Block) -> tuple[bytes, list[int], list[Reject]]:
        """The rows that are whole, quoted anew, with their lines, and what is refused."""
        out, names = io.StringIO(), self.fields.names
        writer = csv.writer(out, delimiter=self.delimiter, lineterminator="\n")
        numbers: list[int] = []
        rejects: list[Reject] = []
        lines = self._as_utf8(block).decode("utf-8", "replace").replace("\r\n", "\n").split("\n")
        for at, line, cells in self._records(lines, block):
            more = len(cells) - len(names)
            if more == 1 and line.endswith(self.delimiter):
                cells.pop()
            elif more == -1 and names[-1] == f"column_{len(names)}" and not block.cut:
                cells.append("")
            if len(cells) == len(names):
                numbers.append(at)
                writer.writerow(cells)
                if more:
                    what = "an empty field more or less at their end"
                    block.report.note(f"some rows have {what}: taken all the same")
                continue
            reason = f"the line has {'fewer' if more < 0 else 'more'} fields than the header"
            if block.cut and more < 0 and at == block.first + len(lines) - 1:
                reason = "the line is cut off"
                whole = f"{len(numbers) + len(rejects)} lines before it in its block are whole"
                block.report.damaged(f"the last line ({at}) is cut off; {whole}")
            rejects.append(Reject(at, reason, line))
        return out.getvalue().encode(), numbers, rejects

    def _records(self, lines: list[str], block: Block) -> Iterator[tuple[int, str, list[str]]]:
        """Number, text and cells of every record; a quote that swallows whole rows is passed over."""
        delimiter, at, closed = self.delimiter, 0, True
        while at < len(lines):
            line, number, end = lines[at], block.first + at, at + 1
            cells = cells_of(line, delimiter)
            if line.count('"') % 2:
                end = next((k + 1 for k in range(end, len(lines)) if lines[k].count('"') % 2), at)
                whole = [row.count(delimiter) >= max(len(self.fields.names) - 1, 2) for row in lines[at:end]]
                if end > at and not any(a and b for a, b in pairwise(whole)):
                    cells = cells_of("\n".join(lines[at:end]), delimiter)
                else:
                    if closed:
                        what = f"quotation marks from line {number} on are not closed"
                        block.report.damaged(f"{what}: read line by line")
                    cells, end, closed = line.replace('"', "").split(delimiter), at + 1, False
            if line:
                yield number, line, cells
            at = end

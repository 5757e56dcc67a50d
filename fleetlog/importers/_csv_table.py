"""The text of a block to an Arrow table: fast where rows are whole, else line by line."""

import codecs
import csv
import io
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pv

from fleetlog.core.arrays import Ints
from fleetlog.importers._csv_blocks import Block, cells_of
from fleetlog.importers._fields import Fields
from fleetlog.importers._units import KINDS
from fleetlog.importers.base import GEOGRAPHIC, Reject

NULLS = ["", "NA", "N/A", "NaN", "nan", "null", "NULL", "None", "-", "#N/A"]


def _as_cp1252(error: UnicodeError) -> tuple[str, int]:
    assert isinstance(error, UnicodeDecodeError)
    return error.object[error.start : error.end].decode("cp1252", "replace"), error.end


codecs.register_error("fleetlog.cp1252", _as_cp1252)


class TableReader:
    """Blocks of a file to tables with the columns of ``fields``; :meth:`decide` comes first."""

    def __init__(self, fields: Fields, delimiter: str, decimal: str) -> None:
        self.fields, self.report = fields, fields.report
        self.delimiter, self.decimal = delimiter, decimal
        sentinels = [*fields.profile.sentinels, *(s for c in fields.columns.values() for s in c.sentinels)]
        self.nulls = NULLS + [s for s in sentinels if isinstance(s, str)]
        self.angles: set[str] = set()  # Columns of latitude and longitude that hold text
        self._types: dict[str, Any] = {}

    def decide(self, block: Block) -> None:
        """Types of the columns, from the first block."""
        fields = self.fields
        try:
            inferred = self._arrow(self._as_utf8(block), None).schema
        except pa.ArrowInvalid:
            inferred = self._arrow(self._one_by_one(block)[0], None).schema
        figures = {f.name for f in inferred if pa.types.is_floating(f.type) or pa.types.is_integer(f.type)}
        self.angles = {s.column for t, s in fields.columns.items() if t in GEOGRAPHIC} - figures
        figures |= {s.column for t, s in fields.columns.items() if t in KINDS} - self.angles
        figures -= {s.column for t, s in fields.columns.items() if t not in KINDS}
        figures -= {*fields.time, fields.vehicle}
        self._types = {name: pa.float64() if name in figures else pa.string() for name in fields.names}

    def read(self, block: Block) -> tuple[pa.Table, Ints, list[Reject]]:
        """The table of a block, the line of every row, and the lines with too many or too few fields."""
        table, lines = self._whole(self._as_utf8(block)), block.lines()
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
            self.report.note(f"line {line} is not UTF-8; what is not is read as cp1252")
            return block.text.decode("utf-8", "fleetlog.cp1252").encode("utf-8", "replace")
        return block.text

    def _whole(self, text: bytes) -> pa.Table | None:
        """The rows that are whole: typed, or else as text; None where the quotes make no sense."""
        for kinds in (self._types, dict.fromkeys(self._types, pa.string())):
            try:
                return self._arrow(text, kinds)
            except pa.ArrowInvalid:
                continue
        return None

    def _arrow(self, text: bytes, types: dict[str, Any] | None) -> pa.Table:
        read = pv.ReadOptions(use_threads=False, column_names=self.fields.names, block_size=len(text) + 1024)
        parse = pv.ParseOptions(delimiter=self.delimiter, invalid_row_handler=lambda _: "skip")
        convert = pv.ConvertOptions(
            column_types=types, null_values=self.nulls, strings_can_be_null=True,
            decimal_point=self.decimal, timestamp_parsers=["-"], check_utf8=False,
        )  # fmt: skip
        return pv.read_csv(io.BytesIO(text or b"\n"), read, parse, convert)

    def _one_by_one(self, block: Block) -> tuple[bytes, list[int], list[Reject]]:
        """The rows that are whole, quoted anew, with their lines, and what is refused."""
        out, names = io.StringIO(), self.fields.names
        writer = csv.writer(out, delimiter=self.delimiter, lineterminator="\n")
        numbers: list[int] = []
        rejects: list[Reject] = []
        lines = self._as_utf8(block).decode("utf-8", "replace").replace("\r\n", "\n").split("\n")
        for at, line, cells in self._records(lines, block.first):
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
                    self.report.note(f"some rows have {what}: taken all the same")
                continue
            reason = f"the line has {'fewer' if more < 0 else 'more'} fields than the header"
            if block.cut and more < 0 and at == block.first + len(lines) - 1:
                reason = "the line is cut off"
                whole = f"{len(numbers) + len(rejects)} lines before it in its block are whole"
                self.report.damaged(f"the last line ({at}) is cut off; {whole}")
            rejects.append(Reject(at, reason, line))
        return out.getvalue().encode(), numbers, rejects

    def _records(self, lines: list[str], first: int) -> Iterator[tuple[int, str, list[str]]]:
        """Number, text and cells of every record; a quote that swallows whole rows is passed over."""
        delimiter, at, closed = self.delimiter, 0, True
        while at < len(lines):
            line, number, end = lines[at], first + at, at + 1
            cells = cells_of(line, delimiter)
            if line.count('"') % 2:
                end = next((k + 1 for k in range(end, len(lines)) if lines[k].count('"') % 2), at)
                whole = [row.count(delimiter) >= max(len(self.fields.names) - 1, 2) for row in lines[at:end]]
                if end > at and not any(a and b for a, b in pairwise(whole)):
                    cells = cells_of("\n".join(lines[at:end]), delimiter)
                else:
                    if closed:
                        what = f"quotation marks from line {number} on are not closed"
                        self.report.damaged(f"{what}: read line by line")
                    cells, end, closed = line.replace('"', "").split(delimiter), at + 1, False
            if line:
                yield number, line, cells
            at = end

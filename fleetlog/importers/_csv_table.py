"""The text of a block to an Arrow table: fast where rows are whole, else line by line."""

import codecs
import csv
import io
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pv

from fleetlog.core.trajectory import Ints
from fleetlog.importers._csv_blocks import Block, cells_of
from fleetlog.importers._csv_layout import Layout
from fleetlog.importers._report import ReadReport
from fleetlog.importers._units import KINDS
from fleetlog.importers.base import GEOGRAPHIC, Reject

NULLS = ["", "NA", "N/A", "NaN", "nan", "null", "NULL", "None", "-", "#N/A"]


def _as_cp1252(error: UnicodeError) -> tuple[str, int]:
    assert isinstance(error, UnicodeDecodeError)
    return error.object[error.start : error.end].decode("cp1252", "replace"), error.end


codecs.register_error("fleetlog.cp1252", _as_cp1252)


class TableReader:
    """Blocks of a file to tables with the columns of ``layout``; :meth:`decide` comes first."""

    def __init__(self, layout: Layout, report: ReadReport) -> None:
        self.layout, self.report = layout, report
        sources = layout.fields.columns.values()
        sentinels = [*layout.fields.profile.sentinels, *(s for source in sources for s in source.sentinels)]
        self.missing = [s for s in sentinels if isinstance(s, str)]
        self.angles: set[str] = set()
        """Columns of latitude and longitude that hold text."""
        self._types: dict[str, Any] = {}

    def decide(self, block: Block) -> None:
        """Types of the columns, from the first block."""
        text, fields = self._as_utf8(block), self.layout.fields
        try:
            inferred = self._arrow(text, None)[0].schema
        except pa.ArrowInvalid:
            inferred = self._arrow(self._one_by_one(text), None)[0].schema
        figures = {f.name for f in inferred if pa.types.is_floating(f.type) or pa.types.is_integer(f.type)}
        places = {s.column for t, s in fields.columns.items() if t in GEOGRAPHIC}
        self.angles = places - figures
        figures |= {s.column for t, s in fields.columns.items() if t in KINDS} - self.angles
        written = {
            *fields.time,
            fields.vehicle,
            *(s.column for t, s in fields.columns.items() if t not in KINDS),
        }
        kinds = {True: pa.float64(), False: pa.string()}
        self._types = {name: kinds[name in figures - written] for name in self.layout.names}

    def read(self, block: Block) -> tuple[pa.Table, Ints, list[Reject]]:
        """The table of a block, the line of every row, and the lines with too many or too few fields."""
        text, lines = self._as_utf8(block), block.lines()
        found = self._whole(text)
        if found is not None and len(lines) != found[0].num_rows + len(found[1]):
            starts = _records(block, self.layout)
            lines = starts if len(starts) == found[0].num_rows + len(found[1]) else lines
            found = found if lines is starts else None
        if found is None:
            where = f"lines {lines[0]} to {lines[-1]}"
            self.report.damaged(f"quotation marks in {where} are not closed: read line by line")
            text = self._one_by_one(text)
            found = self._whole(text)
            assert found is not None
        if len(lines) == len(block.lines()) and (mended := self._mended(text, block, lines, found[1])):
            found = self._whole(mended) or found
        table, ragged = found
        keep = np.ones(len(lines), bool)
        keep[[row.number - 1 for row in ragged]] = False
        return table, lines[keep], [self._refused(row, lines, block.cut) for row in ragged]

    def _refused(self, row: Any, lines: Ints, cut: bool) -> Reject:
        at, short = row.number - 1, row.actual_columns < row.expected_columns
        reason = f"the line has {'fewer' if short else 'more'} fields than the header"
        if cut and short and at == len(lines) - 1:
            reason = "the line is cut off"
            whole = f"{at} lines before it in its block are whole"
            self.report.damaged(f"the last line ({lines[at]}) is cut off; {whole}")
        return Reject(int(lines[at]), reason, row.text)

    def _as_utf8(self, block: Block) -> bytes:
        try:
            block.text.decode("utf-8")
        except UnicodeDecodeError as error:
            line = block.first + block.text.count(b"\n", 0, error.start)
            self.report.note(f"line {line} is not UTF-8; what is not is read as cp1252")
            return block.text.decode("utf-8", "fleetlog.cp1252").encode("utf-8", "replace")
        return block.text

    def _whole(self, text: bytes) -> tuple[pa.Table, list[Any]] | None:
        """The table and the ragged rows: typed, or else as text; None where the quotes make no sense."""
        for kinds in (self._types, dict.fromkeys(self._types, pa.string())):
            try:
                return self._arrow(text, kinds)
            except pa.ArrowInvalid:
                continue
        return None

    def _arrow(self, text: bytes, types: dict[str, Any] | None) -> tuple[pa.Table, list[Any]]:
        ragged: list[Any] = []

        def skip(row: Any) -> str:
            ragged.append(row)
            return "skip"

        parse = pv.ParseOptions(delimiter=self.layout.delimiter, invalid_row_handler=skip)
        convert = pv.ConvertOptions(
            column_types=types, null_values=NULLS + self.missing, strings_can_be_null=True,
            decimal_point=self.layout.decimal, timestamp_parsers=["-"], check_utf8=False,
        )  # fmt: skip
        options = pv.ReadOptions(
            use_threads=False, column_names=self.layout.names, block_size=len(text) + 1024, skip_rows=0
        )
        source = io.BytesIO(text)
        return pv.read_csv(source, read_options=options, parse_options=parse, convert_options=convert), ragged

    def _one_by_one(self, text: bytes) -> bytes:
        """Every line a row of its own, quoted anew."""
        out, delimiter = io.StringIO(), self.layout.delimiter
        writer = csv.writer(out, delimiter=delimiter, lineterminator="\n")
        for line in text.decode("utf-8", "replace").replace("\r\n", "\n").split("\n"):
            odd = line.count('"') % 2
            cells = line.replace('"', "").split(delimiter) if odd else cells_of(line, delimiter)
            writer.writerow(cells if line.strip() else [])
        return out.getvalue().encode()

    def _mended(self, text: bytes, block: Block, lines: Ints, ragged: list[Any]) -> bytes | None:
        """The text, mended where rows are ragged by an empty last field only; None where none is."""
        delimiter, last = self.layout.delimiter, self.layout.names[-1]
        pieces = text.split(b"\n") if ragged else []
        mended = 0
        for row in ragged:
            at, more = int(lines[row.number - 1]) - block.first, row.actual_columns - row.expected_columns
            bare = pieces[at].rstrip(b"\r")
            if more == 1 and bare.endswith(delimiter.encode()):
                pieces[at], mended = bare[:-1], mended + 1
            elif more == -1 and last == f"column_{len(self.layout.names)}" and not block.cut:
                pieces[at], mended = bare + delimiter.encode(), mended + 1
        if mended:
            self.report.note("some rows have an empty field more or less at their end: taken all the same")
        return b"\n".join(pieces) if mended else None


def _records(block: Block, layout: Layout) -> Ints:
    """First lines of records whose cells span several; every line where quotes swallow whole rows."""
    raw = np.frombuffer(block.text, np.uint8)
    ends = np.flatnonzero(raw == 10)
    quotes = np.searchsorted(np.flatnonzero(raw == 34), ends)
    lines = block.lines()
    inner = np.isin(lines, block.first + 1 + np.flatnonzero(quotes % 2))
    pieces, mark = block.text.split(b"\n"), layout.delimiter.encode()
    for at in (lines[inner] - block.first).tolist():
        if min(pieces[at - 1].count(mark), pieces[at].count(mark)) >= max(len(layout.names) - 1, 2):
            return lines
    return np.asarray(lines[~inner], dtype=np.int64)

"""Delimited text: CSV, TSV and relatives, plain or packed (.gz, .zst), any encoding, bounded memory.

The file is read in blocks of whole lines.  A block goes through the fast reader of Arrow with the columns
typed; a block with a cell that does not fit its type is read again as text and every cell judged by itself.
"""

from collections.abc import Iterator
from pathlib import Path

from fleetlog.errors import FormatError
from fleetlog.importers._csv_blocks import Block, blocks, cells_of, guess_encoding, rows_of
from fleetlog.importers._csv_layout import DELIMITERS, find_decimal, find_delimiter, fit_header, lay_out
from fleetlog.importers._csv_table import TableReader
from fleetlog.importers._open import ReadReport, head_of
from fleetlog.importers._profile import Profile
from fleetlog.importers._rows import finite
from fleetlog.importers._table_rows import TableRows
from fleetlog.importers.base import Importer, RawBatch, ReadOptions

SAMPLE = 100  # Rows that tell how many fields a row has
_OTHERS = ("{", "[", "<", "$", "!", "%PDF", "\\")


def sniff(path: Path, head: bytes) -> bool:
    """Text whose first lines have a separator."""
    text = head.decode(guess_encoding(head), "replace")
    if not text.strip() or "\x00" in text or text.lstrip().startswith(_OTHERS):
        return False
    if sum(c < " " and c not in "\t\r\n" for c in text[:4096]) > 0.01 * min(len(text), 4096):
        return False
    rows = (s for s in text.splitlines()[:60] if s.strip() and not s.startswith(("#", "sep=")))
    lines = [line for line in rows if any(d in line for d in DELIMITERS)][:20]
    return bool(lines) and len(cells_of(lines[0], find_delimiter(lines))) > 1


def read(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """Rows of a delimited file; the number of a row is that of its line."""
    profile, report = options.profile or Profile(), options.report
    encoding = _encoding(path, profile, report)
    rows: TableRows | None = None
    for block in blocks(path, encoding, report):
        if rows is None:
            reader, block = _begin(block, path, profile, report)
            if reader.fields.vehicle is None and options.vehicle is None:
                named = f"every row is of vehicle {options.name!r}, after the file's name"
                report.note(f"no column of vehicle ids: {named}")
            rows = TableRows(reader.fields, options.name, reader.angles, reader.decimal)
        if block.text:
            table, lines, rejects = reader.read(block)
            yield rows.batch(table, lines, block.texts, rejects, block.progress)
    if rows is None:
        raise FormatError("the file is empty", where=path, do="give a log with rows")
    rows.clock.close()


def _encoding(path: Path, profile: Profile, report: ReadReport) -> str:
    if profile.encoding:
        return "utf-8" if profile.encoding.lower() in ("utf-8", "utf8") else profile.encoding
    encoding = guess_encoding(head_of(path))
    if encoding not in ("utf-8", "utf-8-sig"):
        report.note(f"the text is not UTF-8; read as {encoding}")
    return encoding


def _begin(block: Block, path: Path, profile: Profile, report: ReadReport) -> tuple[TableReader, Block]:
    """A reader of the columns that the first lines name, and the block without those."""
    lines = block.text.decode("utf-8", "replace").replace("\r\n", "\n").split("\n")
    comment = profile.comment or "#"
    skip, declared = profile.skip_lines, None
    while skip < len(lines) and (not lines[skip].strip() or lines[skip].startswith((comment, "sep="))):
        declared = lines[skip][4:5] if lines[skip].startswith("sep=") else declared
        skip += 1
    if skip >= len(lines):
        raise FormatError("the file has no rows", where=path, do="give a log with rows")
    delimiter = profile.delimiter or declared or find_delimiter(lines[skip : skip + 20])
    names = list(profile.names)
    if not names:
        names = cells_of(lines[skip], delimiter)
        _check_header(names, path, skip + 1)
        skip += 1
        names = fit_header(names, rows_of(lines[skip : skip + SAMPLE], delimiter), report)
    decimal = profile.decimal or find_decimal(lines[skip : skip + 20], delimiter, report)
    reader = TableReader(lay_out(names, profile, report), delimiter, decimal)
    text = block.text
    for _ in range(skip):
        text = text[text.find(b"\n") + 1 :] if b"\n" in text else b""
    block = Block(text, block.first + skip, block.progress, block.cut)
    reader.decide(block)
    return reader, block


def _check_header(names: list[str], path: Path, line: int) -> None:
    if len(names) < 2:
        what = f"one column only ({names[0][:60]!r})"
        do = "state the delimiter in a profile (--profile FILE.toml), or skip_lines where this is no header"
        raise FormatError(what, where=path, place=f"line {line}", do=do)
    if sum(finite(name) == finite(name) for name in names) > len(names) // 3:
        do = 'name the columns in a profile: names = ["vehicle_id", ...]'
        what = "no header line, the first line holds figures"
        raise FormatError(what, where=path, place=f"line {line}", do=do)


IMPORTER = Importer("csv", (".csv", ".tsv", ".txt", ".tab"), sniff, read, rank=9)

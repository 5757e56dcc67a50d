"""Delimited text: CSV, TSV and relatives, plain or packed (.gz, .zst), any encoding, bounded memory.

The file is read in blocks of whole lines.  A block goes through the fast reader of Arrow with the columns
typed; one with a cell that does not fit its type is read again as text, every cell judged by itself."""

import re
from collections import Counter
from collections.abc import Iterator
from io import BytesIO
from itertools import chain, islice
from pathlib import Path

from fleetlog import engines
from fleetlog.core.words import count
from fleetlog.errors import FormatError, InputError, nearest
from fleetlog.importers._csv_table import Block, TableReader, blocks, cells_of, guess_encoding, rows_of
from fleetlog.importers._open import ReadReport, head_of
from fleetlog.importers._profile import Fields, Profile, fields_of
from fleetlog.importers._rows import finite
from fleetlog.importers._table_rows import TableRows
from fleetlog.importers._units import KINDS, find_unit, normal, recognise
from fleetlog.importers.base import Importer, RawBatch, ReadOptions

Cells = list[str]
DELIMITERS = ",;\t|"
_COMMA, _POINT = re.compile(r"[+-]?\d*,\d+"), re.compile(r"[+-]?\d*\.\d+")
_QUOTED = re.compile(r"[+-]?\d*,(?!\d{3}$)\d+")  # Before three digits it could set thousands apart
DATES = ("date", "day", "datum", "fecha")
CLOCKS = ("time", "time_of_day", "clock", "uhrzeit", "zeit", "heure", "hora")
BYTE_COST = 2e-8  # To read a byte of a log, which may be packed, about [s]
SAMPLE = 100  # Rows that tell how many fields a row has
_OTHERS = ("{", "[", "<", "$", "!", "%PDF", "PK\x03", "\\")


def sniff(path: Path, head: bytes) -> bool:
    """Text whose first lines have a separator."""
    text = head.decode(guess_encoding(head), "replace").replace("\x00", "")
    if not text.strip() or text.lstrip().startswith(_OTHERS):
        return False
    if sum(c < " " and c not in "\t\r\n" for c in text[:4096]) > 0.01 * min(len(text), 4096):
        return False
    rows = (s for s in text.splitlines()[:60] if s.strip() and not s.startswith(("#", "sep=")))
    lines = [line for line in rows if any(d in line for d in DELIMITERS)][:20]
    return bool(lines) and len(cells_of(lines[0], find_delimiter(lines))) > 1


def read(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """Rows of a delimited file; the number of a row is that of its line."""
    profile, report = options.profile or Profile(), options.report
    source = blocks(path, _encoding(path, profile, report))
    if (first := next(source, None)) is None:
        raise FormatError("the file is empty", where=path, do="give a log with rows")
    report.take(first.report)
    reader, block = _begin(first, path, profile, report)
    report.take(block.report)
    if reader.fields.vehicle is None and options.vehicle is None:
        named = f"every row is of vehicle {options.name!r}, after the file's name"
        others = ", ".join(map(repr, reader.fields.kept[:5])) or "others"
        report.note(f"no column of vehicle ids: {named} (a profile says if {others} is it: vehicle_id = ...)")
    rows = TableRows(reader.fields, options.name, reader.angles, reader.decimal)
    parts, cost = chain([block] if block.text else [], source), BYTE_COST * path.stat().st_size
    for block, table, lines, rejects in engines.current().stream(lambda b: (b, *reader.read(b)), parts, cost):
        report.take(block.report)
        yield rows.batch(table, lines, block.texts, rejects, block.progress)
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
    every = (line.decode("utf-8", "replace").rstrip("\r\n") for line in BytesIO(block.text))
    skip, declared, comment, above = profile.skip_lines, None, profile.comment or "#", ""
    for line in islice(every, skip, None):
        if line.strip() and not line.startswith((comment, "sep=")):
            break
        declared = line[4:5] if line.startswith("sep=") else declared
        above = line.removeprefix(comment)
        skip += 1
    else:
        raise FormatError("the file has no rows", where=path, do="give a log with rows")
    lines = [line, *islice(every, SAMPLE)]
    split = [i for i, line in enumerate(lines) if any(d in line for d in profile.delimiter or DELIMITERS)]
    if split[:1] > [0]:  # titles have no separator
        report.note(f"{count(split[0], 'line')} above the header left out: {lines[0].strip()[:60]!r}")
        lines, skip = lines[split[0] :], skip + split[0]
    delimiter = profile.delimiter or declared or find_delimiter(lines[:20])
    if not (names := list(profile.names)):
        said, skip = cells_of(above, delimiter), skip + 1
        names = fit_header(cells_of(lines.pop(0), delimiter), rows_of(lines, delimiter), report, skip, said)
        skip -= names is said  # the comment is skipped as it is
        if lines and (told := with_units(names, cells_of(lines[0], delimiter), profile)):
            report.note(f"line {skip + 1} holds units: {lines.pop(0)[:60]!r}")
            names, skip = told, skip + 1
    decimal = profile.decimal or find_decimal(lines[:20], delimiter, report)
    reader = TableReader(lay_out(names, profile, report), delimiter, decimal)
    text = b"".join(block.text.split(b"\n", skip)[skip:])
    block = Block(text, block.first + skip, block.progress, block.report, block.cut)
    reader.decide(block)
    return reader, block


def with_units(names: Cells, below: Cells, profile: Profile) -> Cells | None:
    """The names, each with its unit in brackets, where the line ``below`` them holds units; else None."""
    units, out, told = [cell.strip(" -[]()") for cell in below], [*names], False
    if len(units) != len(names) or any(finite(u) == finite(u) for u in units if u != "1"):
        return None
    own = {*profile.time, *(s.column for s in profile.columns.values())}
    for i, (name, unit) in enumerate(zip(names, units, strict=True)):
        if not unit or name.strip() in own or (meaning := recognise(name)) is None:
            continue
        kind, full = KINDS.get(meaning.column, ""), f"{name} [{unit}]"
        told |= unit != "1" and find_unit(unit, kind) is not None
        # What is no unit says nothing of a place, a time, a name.
        if recognise(full) or (meaning.unit is None and kind not in ("", "degrees")):
            out[i] = full
    return out if told else None


def find_delimiter(lines: list[str]) -> str:
    """The separator that splits the header line, and most of the other lines into as many fields as that."""

    def worth(delimiter: str) -> tuple[float, int]:
        counts = [len(row) for row in rows_of(lines, delimiter)]
        fields = counts[0] if counts else 1
        return (counts.count(fields) / len(counts) if fields > 1 else 0.0), fields

    return max(DELIMITERS, key=worth)


def find_decimal(lines: list[str], delimiter: str, report: ReadReport) -> str:
    """The decimal comma where another character separates cells and no figure has a point; noted."""
    cells = [cell.strip() for row in rows_of(lines, delimiter) for cell in row]
    pattern = _QUOTED if delimiter == "," else _COMMA
    commas = any(pattern.fullmatch(cell) for cell in cells)
    if not commas or any(_POINT.fullmatch(cell) for cell in cells):
        return "."
    report.note("figures have a decimal comma")
    return ","


def unique(names: list[str], report: ReadReport) -> list[str]:
    """Names without a name get their number, names that come again a suffix."""
    out: list[str] = []
    for i, raw in enumerate(names):
        name = raw.strip() or f"column_{i + 1}"
        if name in out:
            again = next(n for k in range(2, len(names) + 2) if (n := f"{name}_{k}") not in (*out, *names))
            report.note(f"the header has {name!r} more than once; the later one is called {again!r}")
            name = again
        out.append(name)
    return out


def fit_header(names: Cells, rows: list[Cells], report: ReadReport, line: int, above: Cells) -> Cells:
    """The header of a ``line``, a name longer or shorter where most rows have one field more or less; the
    comment ``above`` where the line is one of figures, and it names as many."""
    if len(names) < 2:
        what = f"one column only ({names[0][:60]!r})"
        do = "state the delimiter in a profile (--profile FILE.toml), or skip_lines where this is no header"
        raise FormatError(what, where=report.path, place=f"line {line}", do=do)
    if sum(finite(name) == finite(name) for name in names) > len(names) // 3:
        if len(above) == len(names):
            report.note(f"the header is the comment before line {line}")
            return above
        do = 'name the columns in a profile: names = ["vehicle_id", ...]'
        what = "no header line, the first line holds figures"
        raise FormatError(what, where=report.path, place=f"line {line}", do=do)
    usual = Counter(len(row) for row in rows).most_common(1)
    fields = usual[0][0] if usual else len(names)
    if fields == len(names) + 1:
        report.note(f"the rows have a field more than the header has names: it is called 'column_{fields}'")
        return [*names, ""]
    if fields == len(names) - 1 and not names[-1].strip():
        report.note("the header ends with a separator that the rows do not have")
        return names[:-1]
    return names


def lay_out(names: list[str], profile: Profile, report: ReadReport) -> Fields:
    """Decide what every column is; an error where there is no time, or nothing at all that is known."""
    names = unique(names, report)
    wanted = [(source.column, f"columns.{target}") for target, source in profile.columns.items()]
    for name, place in [*wanted, *((name, "time.column") for name in profile.time)]:
        if name not in names:
            what, do = f"the log has no column {name!r}", nearest(name, names)
            raise InputError(what, where=profile.path, place=place, do=do)
    fields = fields_of(names, profile, report, _split_time(names, profile, report))
    seen = ", ".join(names[:12]) + (" ..." if len(names) > 12 else "")
    if not fields.time:
        do = "name it in a profile (--profile FILE.toml): [time] column = ..."
        raise FormatError(f"no time among the columns ({seen})", where=report.path, do=do)
    if not fields.columns.keys() & KINDS.keys():
        what = f"no known column besides the time ({seen})"
        raise FormatError(what, where=report.path, do="map the columns in a profile (--profile FILE.toml)")
    return fields


def _split_time(names: list[str], profile: Profile, report: ReadReport) -> tuple[str, ...]:
    """A date and a time of day in two columns; nothing where the time is known otherwise."""
    free = [n for n in names if n not in {s.column for s in profile.columns.values()}]
    plain = {normal(n): n for n in free}
    date, clock = (next((plain[n] for n in names if n in plain), None) for names in (DATES, CLOCKS))
    if profile.time or not date or not clock or "timestamp" in (n.strip() for n in free):
        return ()
    report.recognised[date], report.recognised[clock] = "timestamp (date)", "timestamp (time of day)"
    return date, clock


IMPORTER = Importer("csv", (".csv", ".tsv", ".txt", ".tab"), sniff, read, rank=9)

"""CSV with the contract's column names, read back without a profile; .gz and .zst are packed."""

import csv
import io
from collections.abc import Iterable
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pcsv

from fleetlog.exporters.base import Selection

FORMULA = r"^([=@\t\r]|[+-][\pL\pN_.:-]*[^\pL\pN_.:-])"
_PACKING = {".gz": "gzip", ".zst": "zstd"}


def write(selection: Selection, path: Path) -> None:
    """Times in ISO 8601 UTC, empty cells for null, every digit of a double."""
    schema = selection.schema()
    write_tables(selection, path, schema, selection.tables(schema))


def write_tables(selection: Selection, path: Path, schema: pa.Schema, tables: Iterable[pa.Table]) -> None:
    """Tables of one schema, one below the other."""
    times = {f.name for f in schema if pa.types.is_timestamp(f.type)}
    text = pa.schema([f.with_type(pa.string()) if f.name in times else f for f in schema])
    packing = _PACKING.get(selection.target.suffix.lower())
    options = pcsv.WriteOptions(quoting_style="needed", include_header=False)
    # Quoted only where a name needs it; Arrow would quote every one.
    header = io.StringIO()
    csv.writer(header, lineterminator="\n").writerow(schema.names)
    with pa.output_stream(str(path), compression=packing) as sink:
        sink.write(header.getvalue().encode())
        with pcsv.CSVWriter(sink, text, write_options=options) as writer:
            for table in tables:
                for i, field in enumerate(text):
                    if field.name in times:
                        iso = pc.strftime(table.column(i), format="%Y-%m-%dT%H:%M:%SZ")
                        table = table.set_column(i, field, iso)
                    elif pa.types.is_string(field.type):
                        table = table.set_column(i, field, defused(table.column(i)))
                writer.write_table(table)


def defused(texts: pa.ChunkedArray) -> pa.ChunkedArray:
    """An apostrophe before every text that a spreadsheet would run as a formula. Names such as ``-e012``, a
    road driven against its digitised direction, stay as they are: a sign before letters, digits and
    ``_ . : -`` calls nothing."""
    return pc.replace_substring_regex(texts, pattern=FORMULA, replacement=r"'\1")

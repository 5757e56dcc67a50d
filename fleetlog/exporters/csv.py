"""CSV with the contract's column names, read back without a profile; .gz and .zst are packed."""

import csv
import io
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pcsv

from fleetlog.exporters.base import Selection

FORMULA = r"^([=@\t\r]|[+-][\pL\pN_.:-]*[^\pL\pN_.:-])"
_PACKING = {".gz": "gzip", ".zst": "zstd"}


def write(selection: Selection, path: Path, table: pa.Table | None = None) -> None:
    """Times in ISO 8601 UTC, empty cells for null, every digit of a double; the rows, or those of a table."""
    schema = selection.schema() if table is None else table.schema
    text = pa.schema([f.with_type(pa.string()) if pa.types.is_timestamp(f.type) else f for f in schema])
    packing = _PACKING.get(selection.target.suffix.lower())
    options = pcsv.WriteOptions(quoting_style="needed", include_header=False)
    # Quoted only where a name needs it; Arrow would quote every one.
    header = io.StringIO()
    csv.writer(header, lineterminator="\n").writerow(schema.names)
    with pa.output_stream(str(path), compression=packing) as sink:
        sink.write(header.getvalue().encode())
        with pcsv.CSVWriter(sink, text, write_options=options) as writer:
            for rows in selection.tables(schema) if table is None else [table]:
                for i, field in enumerate(text):
                    if pa.types.is_string(field.type):
                        cell, time = rows.column(i), pa.types.is_timestamp(rows.schema.types[i])
                        cell = pc.strftime(cell, format="%Y-%m-%dT%H:%M:%SZ") if time else cell
                        rows = rows.set_column(i, field, defused(cell))
                writer.write_table(rows)


def defused(texts: pa.ChunkedArray) -> pa.ChunkedArray:
    """An apostrophe before every text that a spreadsheet would run as a formula. Names such as ``-e012``, a
    road driven against its digitised direction, stay as they are: a sign before letters, digits and
    ``_ . : -`` calls nothing."""
    return pc.replace_substring_regex(texts, pattern=FORMULA, replacement=r"'\1")

"""Parquet tables, read by column names as a CSV is; GeoParquet's points; parts of a dataset."""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fleetlog.core.arrays import Floats
from fleetlog.core.trajectory import Labels, own_array
from fleetlog.errors import FormatError
from fleetlog.importers._open import refuse_packed
from fleetlog.importers._profile import Source, fields_of
from fleetlog.importers._table_rows import TableRows
from fleetlog.importers.base import GEOGRAPHIC, LOCAL, Importer, RawBatch, ReadOptions, holding, renamed
from fleetlog.importers.csv import unique

BATCH, _OF_FIGURES = 1 << 17, ("null", "boolean", "decimal", "floating", "integer")
_FIGURES = [getattr(pa.types, f"is_{kind}") for kind in _OF_FIGURES]
_TIMES = [getattr(pa.types, f"is_{kind}") for kind in ("timestamp", "date", "integer", "floating")]
GROUP_LIMIT = 1 << 32  # Unpacked bytes of a row group that are believed
CELLS, CELLS_PER_BYTE = 200_000_000, 2_000  # Values that a file may state: any, or for each byte of it


def read(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """All rows, batch by batch."""
    refuse_packed(path)
    try:
        # Text is read as dictionaries: one that comes again takes no memory again.
        texts = [f.name for f in pq.read_schema(path) if f.type in (pa.string(), pa.large_string())]
        file = pq.ParquetFile(path, memory_map=False, read_dictionary=texts)
    except (OSError, ValueError, pa.ArrowException) as error:
        what = "is cut off or damaged: the description at its end cannot be read"
        raise FormatError(what, where=path, do=f"write it again ({str(error)[:80]})") from None
    with file:
        about = file.metadata
        # Repeated values take next to no room: what a file states is held against its size.
        cells = about.num_rows * about.num_columns
        widest = max((about.row_group(g).total_byte_size for g in range(about.num_row_groups)), default=0)
        if cells > max(CELLS, CELLS_PER_BYTE * path.stat().st_size) or widest > GROUP_LIMIT:
            size = f"{about.num_rows:,} rows of {about.num_columns:,} columns"
            what = f"states {size} in groups of {widest >> 20:,} MB"
            raise FormatError(what, where=path, do="write it again in smaller row groups")
        reader = _Reader(file, path, options)
        for group in range(file.num_row_groups):
            rows = file.metadata.row_group(group).num_rows
            try:
                for batch in file.iter_batches(BATCH, row_groups=[group]):
                    yield reader.batch(batch)
            except (OSError, pa.ArrowException, MemoryError) as error:
                options.report.damaged(f"row group {group} ({rows} rows) cannot be read: {str(error)[:120]}")
        if options.report.damage and not reader.done:
            raise options.report.nothing("no row can be read", "write it again")


class _Reader:
    """The batches of one file; columns go by their place, for names may come twice."""

    def __init__(self, file: Any, path: Path, options: ReadOptions) -> None:
        self.done, self.total = 0, max(file.metadata.num_rows, 1)
        schema = file.schema_arrow
        names = [n.encode("utf-8", "surrogateescape").decode("utf-8", "replace") for n in schema.names]
        self.names = unique(names, options.report)
        kinds = dict(zip(self.names, schema.types, strict=True))
        plain = [n for n, t in kinds.items() if not pa.types.is_nested(t) and not pa.types.is_binary(t)]
        self.fields = fields = fields_of(plain, options.profile, options.report)
        fields.time = fields.time[:1]
        if options.vehicle is not None:
            fields.vehicle = None
        self.geometry = not fields.columns.keys() & {"latitude", "x"} and "geometry" in kinds
        if self.geometry:
            self.pair = GEOGRAPHIC if fields.profile.crs is None else LOCAL[::-1]
            fields.columns |= {name: Source(name) for name in self.pair}
        has_place = any({*pair} <= fields.columns.keys() for pair in (GEOGRAPHIC, LOCAL))
        wanted = (("a position (latitude, longitude or x, y)", has_place), ("a time", fields.time))
        if missing := [what for what, there in wanted if not there]:
            what = f"no column is {' or '.join(missing)} (columns: {', '.join(self.names[:20])})"
            raise FormatError(what, where=path, do="map them with --profile")
        folder = next((p for p in path.parts if p.startswith("vehicle_id=")), None)
        name = unquote(folder.partition("=")[2]) if folder and options.vehicle is None else options.name
        self.rows = TableRows(fields, name, {s.column for n, s in fields.columns.items() if n in GEOGRAPHIC})

    def batch(self, batch: pa.RecordBatch) -> RawBatch:
        """The rows of a batch."""
        batch, fields = batch.rename_columns(self.names), self.fields
        columns = {n: _plain(batch.column(n)) for n in fields.names if n not in fields.time}
        for name in fields.time:
            stamps = batch.column(name)
            timed = any(test(stamps.type) for test in _TIMES)
            columns[name] = stamps if timed else _plain(stamps).cast(pa.string())
        if self.geometry:
            columns |= dict(zip(self.pair[::-1], _points(batch.column("geometry")), strict=True))
        if fields.vehicle is not None:
            columns[fields.vehicle] = _named(columns[fields.vehicle], self.rows.vehicle)
        table, first = pa.table(columns), self.done + 1
        self.done += len(batch)

        def texts(numbers: list[int]) -> list[str]:
            shown = table.select([f.name for f in table.schema if not pa.types.is_temporal(f.type)])
            rows = shown.take([n - first for n in numbers]).to_pylist()
            return [" ".join(f"{name}={value}" for name, value in row.items()) for row in rows]

        return self.rows.batch(table, np.arange(first, self.done + 1), texts, [], self.done / self.total)


def _plain(array: pa.Array) -> pa.Array:
    """Figures or a dictionary of texts; text that is no UTF-8 keeps what of it is."""
    kind = array.type
    if any(test(kind) for test in _FIGURES):
        return array.cast(pa.float64(), safe=False)
    if not pa.types.is_dictionary(kind):
        array = array.dictionary_encode()
    names = array.dictionary
    if pa.types.is_string(names.type) or pa.types.is_large_string(names.type):
        names = names.cast(pa.large_binary())
    told = (v.decode("utf-8", "replace") if isinstance(v, bytes) else v for v in names.to_pylist())
    texts = [None if v is None else str(v) for v in told]
    codes = np.asarray(array.indices.fill_null(-1).to_numpy(zero_copy_only=False), dtype=np.int32)
    if codes.max(initial=-1) >= len(texts):
        raise pa.ArrowInvalid("a text that its dictionary does not have")
    return own_array(renamed(Labels(codes, ()), texts))  # equal texts become one


def _named(vehicles: pa.Array, default: str) -> pa.Array:
    """Names of vehicles, which may be figures, the default where there is none."""
    if pa.types.is_floating(vehicles.type):
        found = [default if v is None or v != v else f"{v:.17g}" for v in vehicles.to_pylist()]
        return pa.array(found).dictionary_encode()
    return vehicles.cast(pa.string()).fill_null(default).dictionary_encode()


def _points(array: pa.Array) -> tuple[Floats, Floats]:
    """(N,) x and y of WKB points; NaN for anything else.  OGC 06-103r4, section 8.2."""
    if pa.types.is_struct(array.type):  # GeoArrow
        return tuple(array.field(n).to_numpy(zero_copy_only=False) for n in LOCAL)
    x, y = np.full(len(array), np.nan), np.full(len(array), np.nan)
    for i, wkb in enumerate(array.to_pylist()):
        if isinstance(wkb, bytes) and len(wkb) >= 21 and wkb[0] in (0, 1):
            kind, a, b = struct.unpack_from(("<" if wkb[0] else ">") + "Idd", wkb, 1)
            if kind % 1000 == 1:
                x[i], y[i] = a, b
    return x, y


IMPORTER = Importer("parquet", (".parquet", ".pq", ".geoparquet"), holding(b"PAR1", first=4), read)

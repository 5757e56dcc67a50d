"""Parquet tables, read by their column names as a CSV is; GeoParquet's points; parts of a partitioned dataset."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.trajectory import Labels, Values
from fleetlog.errors import FormatError
from fleetlog.importers._bounded import refuse_packed
from fleetlog.importers._fields import Fields, epoch_unit, fields_of
from fleetlog.importers._open import plain_stem
from fleetlog.importers.base import Importer, RawBatch, ReadOptions, Reject

if TYPE_CHECKING:
    import pyarrow as pa

BATCH = 1 << 17
GROUP_LIMIT = 1 << 32
"""Unpacked bytes of a row group that are believed."""


def sniff(path: Path, head: bytes) -> bool:
    """Whether it begins with Parquet's magic bytes."""
    return head.startswith(b"PAR1")


def read(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """All rows, batch by batch."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    refuse_packed(path)
    try:
        file = pq.ParquetFile(path, memory_map=False)
    except (OSError, pa.ArrowException) as error:
        what = "is cut off or damaged: the description at its end cannot be read"
        raise FormatError(what, where=path, do=f"write it again ({str(error)[:80]})") from None
    with file:
        fields = _fields(file.schema_arrow, path, options)
        done = 0
        for group in range(file.num_row_groups):
            rows = file.metadata.row_group(group).num_rows
            if file.metadata.row_group(group).total_byte_size > GROUP_LIMIT:
                options.report.damaged(f"row group {group} states more than {GROUP_LIMIT >> 30} GB: left out")
                continue
            try:
                for batch in file.iter_batches(BATCH, row_groups=[group]):
                    yield _batch(batch, fields, path, options, done, file.metadata.num_rows)
                    done += len(batch)
            except (OSError, pa.ArrowException, MemoryError) as error:
                options.report.damaged(f"row group {group} ({rows} rows) cannot be read: {str(error)[:120]}")
        if options.report.damage and not done:
            raise FormatError(
                f"no row can be read; {options.report.damage[0]}", where=path, do="write it again"
            )


def _fields(schema: pa.Schema, path: Path, options: ReadOptions) -> Fields:
    import pyarrow as pa

    plain = [f.name for f in schema if not pa.types.is_nested(f.type) and not pa.types.is_binary(f.type)]
    fields = fields_of(plain, options.profile, options.report)
    place = fields.columns.keys()
    has_place = {"latitude", "longitude"} <= place or {"x", "y"} <= place or "geometry" in schema.names
    missing = [
        what
        for what, there in (("a position (latitude, longitude or x, y)", has_place), ("a time", fields.time))
        if not there
    ]
    if missing:
        have = ", ".join(schema.names[:20])
        raise FormatError(
            f"no column is {' or '.join(missing)} (columns: {have})", where=path, do="map them with --profile"
        )
    return fields


def _batch(
    batch: pa.RecordBatch, fields: Fields, path: Path, options: ReadOptions, done: int, total: int
) -> RawBatch:
    columns: dict[str, Values] = {}
    assert fields.time is not None
    time, good = _times(batch.column(fields.time), fields, options)
    for name, field in fields.columns.items():
        values = _values(batch.column(field.source))
        columns[name] = values if isinstance(values, Labels) else field.values(values)
    for name in fields.kept:
        columns[name] = _values(batch.column(name))
    if not {"latitude", "x"} & columns.keys():
        columns["longitude"], columns["latitude"] = _points(batch.column("geometry"))
    record = np.arange(done + 1, done + len(batch) + 1)
    rejects = [Reject(int(record[i]), "row without a time", "") for i in np.flatnonzero(~good)]
    share = (done + len(batch)) / max(total, 1)
    vehicle = _vehicle(batch, fields, path, options)
    return RawBatch(
        vehicle[good], time[good], {k: v[good] for k, v in columns.items()}, record[good], rejects, share
    )


def _times(
    array: pa.Array, fields: Fields, options: ReadOptions
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """(N,) microseconds, and where they are known."""
    import pandas as pd
    import pyarrow as pa

    if pa.types.is_dictionary(array.type):
        array = array.dictionary_decode()
    if pa.types.is_timestamp(array.type) or pa.types.is_date(array.type):
        known = ~np.asarray(array.is_null())
        stamps = array.cast(pa.timestamp("us"), safe=False) if array.type != pa.timestamp("us") else array
        return stamps.cast(pa.int64()).fill_null(0).to_numpy(zero_copy_only=False), known
    if pa.types.is_integer(array.type) or pa.types.is_floating(array.type):
        numbers = array.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)
        fields.epoch = fields.epoch or epoch_unit(numbers, options.report, str(fields.time))
        factor = {"s": 1e6, "ms": 1e3, "us": 1.0, "ns": 1e-3}[fields.epoch]
        known = np.isfinite(numbers) & (np.abs(numbers) * factor < 1 << 62)
        if pa.types.is_integer(array.type) and factor >= 1.0:
            whole = array.fill_null(0).to_numpy(zero_copy_only=False).astype(np.int64)
            return np.where(known, whole, 0) * int(factor), known
        return np.round(np.where(known, numbers, 0.0) * factor).astype(np.int64), known
    parsed = pd.to_datetime(
        pd.Series(array.to_pylist(), dtype=object), utc=True, format="ISO8601", errors="coerce"
    )
    stamps = parsed.to_numpy(dtype="datetime64[us]")
    return stamps.astype(np.int64), ~np.isnat(stamps)


def _values(array: pa.Array) -> Values:
    import pyarrow as pa

    kind = array.type
    if (
        pa.types.is_boolean(kind)
        or pa.types.is_integer(kind)
        or pa.types.is_floating(kind)
        or pa.types.is_decimal(kind)
    ):
        return np.asarray(
            array.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False), dtype=np.float64
        )
    if pa.types.is_null(kind):
        return np.full(len(array), np.nan)
    return Labels.of([None if v is None else str(v) for v in array.to_pylist()])


def _points(array: pa.Array) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(N,) x and y of WKB points; NaN for anything else.  OGC 06-103r4, section 8.2."""
    x, y = np.full(len(array), np.nan), np.full(len(array), np.nan)
    for i, wkb in enumerate(array.to_pylist()):
        if isinstance(wkb, bytes) and len(wkb) >= 21 and wkb[0] in (0, 1):
            order = "<" if wkb[0] else ">"
            kind, a, b = struct.unpack_from(order + "Idd", wkb, 1)
            if kind % 1000 == 1:
                x[i], y[i] = a, b
    return x, y


def _vehicle(batch: pa.RecordBatch, fields: Fields, path: Path, options: ReadOptions) -> Labels:
    if options.vehicle is None and fields.vehicle is not None:
        values: Any = batch.column(fields.vehicle).to_pylist()
        return Labels.of([plain_stem(path) if v is None else str(v) for v in values])
    folder = next((p for p in path.parts if p.startswith("vehicle_id=")), None)
    name = options.vehicle or (unquote(folder.partition("=")[2]) if folder else plain_stem(path))
    return Labels(np.zeros(len(batch), np.int32), (name,))


IMPORTER = Importer("parquet", (".parquet", ".pq", ".geoparquet"), sniff, read)

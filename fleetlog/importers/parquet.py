"""Parquet tables, read by column names as a CSV is; GeoParquet's points; parts of a dataset."""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from fleetlog.core.trajectory import Labels, Values
from fleetlog.errors import FormatError
from fleetlog.importers._csv_cells import Mask, degrees, numbers
from fleetlog.importers._csv_clock import Clock
from fleetlog.importers._csv_layout import unique
from fleetlog.importers._fields import fields_of
from fleetlog.importers._names import EPOCH_UNITS
from fleetlog.importers._open import plain_stem, refuse_packed
from fleetlog.importers._profile import Profile, Source
from fleetlog.importers._times import NONE, from_counts
from fleetlog.importers._units import KINDS
from fleetlog.importers.base import GEOGRAPHIC, LOCAL, Importer, RawBatch, ReadOptions, Reject, holding

BATCH = 1 << 17
Bad = dict[str, tuple[Mask, Labels]]
"""Which cells of a column are no numbers, and what is written there."""
_FIGURES = (pa.types.is_boolean, pa.types.is_decimal, pa.types.is_floating, pa.types.is_integer)
GROUP_LIMIT = 1 << 32
"""Unpacked bytes of a row group that are believed."""
CELLS, CELLS_PER_BYTE = 200_000_000, 2_000
"""Values that a file may state: so many in any file, and so many for each of its bytes."""


def read(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """All rows, batch by batch."""
    refuse_packed(path)
    try:
        file = pq.ParquetFile(path, memory_map=False, read_dictionary=_text_columns(path))
    except (OSError, ValueError, pa.ArrowException) as error:
        what = "is cut off or damaged: the description at its end cannot be read"
        raise FormatError(what, where=path, do=f"write it again ({str(error)[:80]})") from None
    with file:
        _check_size(file.metadata, path)
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


def _text_columns(path: Path) -> list[str]:
    """Columns of text, which are read as dictionaries: a text that comes again takes no memory again."""
    schema = pq.read_schema(path)
    return [f.name for f in schema if pa.types.is_string(f.type) or pa.types.is_large_string(f.type)]


def _check_size(about: Any, path: Path) -> None:
    """Repeated values take next to no room: what a file states is held against its size."""
    cells = about.num_rows * about.num_columns
    widest = max((about.row_group(g).total_byte_size for g in range(about.num_row_groups)), default=0)
    if cells > max(CELLS, CELLS_PER_BYTE * path.stat().st_size) or widest > GROUP_LIMIT:
        size = f"{about.num_rows:,} rows of {about.num_columns:,} columns"
        what = f"states {size} in groups of {widest >> 20:,} MB"
        raise FormatError(what, where=path, do="write it again in smaller row groups")


class _Reader:
    """The batches of one file; columns go by their place, for names may come twice."""

    def __init__(self, file: Any, path: Path, options: ReadOptions) -> None:
        self.path, self.options, self.done = path, options, 0
        self.total = max(file.metadata.num_rows, 1)
        schema = file.schema_arrow
        names = [_text(n.encode("utf-8", "surrogateescape")) for n in schema.names]
        self.names = unique(names, options.report)
        kinds = dict(zip(self.names, schema.types, strict=True))
        plain = [n for n, t in kinds.items() if not pa.types.is_nested(t) and not pa.types.is_binary(t)]
        self.fields = fields_of(plain, options.profile, options.report)
        self._check(kinds)
        profile = options.profile or Profile()
        self.clock = Clock(self.fields.time[:1], self.fields.epoch, path, profile, options.report)

    def _check(self, kinds: dict[str, Any]) -> None:
        place = self.fields.columns.keys()
        has_place = {"latitude", "longitude"} <= place or {"x", "y"} <= place or "geometry" in kinds
        wanted = (("a position (latitude, longitude or x, y)", has_place), ("a time", self.fields.time))
        missing = [what for what, there in wanted if not there]
        if missing:
            what = f"no column is {' or '.join(missing)} (columns: {', '.join(self.names[:20])})"
            raise FormatError(what, where=self.path, do="map them with --profile")

    def batch(self, batch: pa.RecordBatch) -> RawBatch:
        """The rows of a batch; those without a time, or with a text for a position, are refused."""
        batch = batch.rename_columns(self.names)
        columns: dict[str, Values] = {}
        bad: Bad = {}
        for name, field in self.fields.columns.items():
            columns[name] = self._quantity(batch.column(field.column), name, field, bad)
        for name in self.fields.kept:
            columns[name] = _values(batch.column(name))
        if not {"latitude", "x"} & columns.keys():
            columns["longitude"], columns["latitude"] = _points(batch.column("geometry"))
        record = np.arange(self.done + 1, self.done + len(batch) + 1)
        self.done += len(batch)
        vehicle = self._vehicle(batch)
        time = self._times(batch, vehicle)
        good = time != NONE
        rejects = [Reject(n, "row without a time", "") for n in record[~good].tolist()]
        for name, (mask, written) in bad.items():
            whole = name in (*GEOGRAPHIC, *LOCAL)
            at = np.flatnonzero(mask & good).tolist()
            texts = written[at].strings()
            what = f"{name} is not a number"
            numbered = zip(record[at].tolist(), texts, strict=True)
            rejects += [Reject(n, what, str(text)[:400], whole) for n, text in numbered]
            good[at if whole else []] = False
        kept: dict[str, Values] = {k: v[good] for k, v in columns.items()}
        return RawBatch(vehicle[good], time[good], kept, record[good], rejects, self.done / self.total)

    def _quantity(self, array: pa.Array, name: str, field: Source, bad: Bad) -> Values:
        """A known column in SI; numbers may be written as text."""
        values = _values(array)
        if name not in KINDS:
            return values
        if isinstance(values, Labels):
            read = degrees if name in GEOGRAPHIC else numbers
            figures, wrong = read(pa.array(values.names, pa.string()))
            code = values.codes
            if wrong.any():
                bad[name] = np.append(wrong, False)[code], values
            values = np.append(figures, np.nan)[code]
        return field.to_si(field.known(np.asarray(values, float)))

    def _times(self, batch: pa.RecordBatch, vehicle: Labels) -> NDArray[np.int64]:
        """(N,) microseconds UTC; ``NONE`` where they are not known."""
        array = batch.column(self.fields.time[0])
        if pa.types.is_date(array.type):
            array = array.cast(pa.timestamp("s") if pa.types.is_date32(array.type) else pa.timestamp("ms"))
        kind = array.type
        if pa.types.is_timestamp(kind):
            time = _counted(array.cast(pa.int64()), kind.unit)
            return time if kind.tz else self.clock.to_utc(time, time != NONE, vehicle)
        if pa.types.is_integer(kind) or pa.types.is_floating(kind):
            if self.clock.style not in EPOCH_UNITS:
                figures = array.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)
                self.clock.style = self.clock.decide_count(figures)
            return _counted(array, self.clock.style, self.clock.profile.origin)
        texts = _values(array)
        cells = pa.array(texts.strings() if isinstance(texts, Labels) else [None] * len(array), pa.string())
        return self.clock.times(pa.table({self.fields.time[0]: cells}), vehicle)

    def _vehicle(self, batch: pa.RecordBatch) -> Labels:
        folder = next((p for p in self.path.parts if p.startswith("vehicle_id=")), None)
        default = unquote(folder.partition("=")[2]) if folder else plain_stem(self.path)
        if self.options.vehicle is not None or self.fields.vehicle is None:
            return Labels(np.zeros(len(batch), np.int32), (self.options.vehicle or default,))
        values = _values(batch.column(self.fields.vehicle))
        if isinstance(values, Labels):
            return Labels.of([default if v is None else v for v in values.strings()])
        return Labels.of([default if v != v else f"{v:.17g}" for v in values.tolist()])


def _counted(array: pa.Array, unit: str, origin: int = 0) -> NDArray[np.int64]:
    null = np.asarray(array.is_null())
    whole = pa.types.is_integer(array.type)
    filled = array.fill_null(0)
    values = filled.cast(pa.int64() if whole else pa.float64(), safe=False).to_numpy(zero_copy_only=False)
    return np.where(null, NONE, from_counts(values, unit, origin))


def _values(array: pa.Array) -> Values:
    """(N,) figures, NaN for null, or labels; text that is no UTF-8 keeps what of it is."""
    kind = array.type
    if pa.types.is_null(kind):
        return np.full(len(array), np.nan)
    if any(test(kind) for test in _FIGURES):
        return np.asarray(array.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False), np.float64)
    if not pa.types.is_dictionary(kind):
        array = array.dictionary_encode()
    names = array.dictionary
    if pa.types.is_string(names.type) or pa.types.is_large_string(names.type):
        texts = [None if v is None else _text(v) for v in names.cast(pa.large_binary()).to_pylist()]
    else:
        texts = [None if v is None else str(v) for v in names.to_pylist()]
    codes = np.asarray(array.indices.fill_null(-1).to_numpy(zero_copy_only=False), dtype=np.int32)
    if codes.max(initial=-1) >= len(texts):
        raise pa.ArrowInvalid("a text that its dictionary does not have")
    order = Labels.of(texts)
    return Labels(np.append(order.codes, np.int32(-1))[codes], order.names)


def _text(raw: bytes) -> str:
    return raw.decode("utf-8", "replace")


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


IMPORTER = Importer("parquet", (".parquet", ".pq", ".geoparquet"), holding(b"PAR1", first=4), read)

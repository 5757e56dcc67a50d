"""The checked table of one vehicle's motion, as arrays."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from fleetlog.core import columns as cols
from fleetlog.core.arrays import Array, DataFrame, Floats, Index, Ints, Mask
from fleetlog.errors import DataError
from fleetlog.registry import extra

if TYPE_CHECKING:
    import geopandas as gpd

    from fleetlog.core.site import Frame


@dataclass(frozen=True)
class Labels:
    """A column of repeated strings: ``names[codes[i]]``, and code -1 for null."""

    codes: Index
    names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.codes)

    def __getitem__(self, index: Any) -> "Labels":
        return Labels(self.codes[index], self.names)

    def strings(self) -> list[str | None]:
        """The values, one by one; for small tables and tests."""
        return [self.names[c] if c >= 0 else None for c in self.codes]

    def recode(self, order: Mapping[str, int]) -> Index:
        """Codes in another numbering, as a network's edge indices; -1 for null and for unknown names."""
        return np.array([order.get(n, -1) for n in self.names] + [-1], dtype=np.int32)[self.codes]

    @classmethod
    def of(cls, values: Any) -> "Labels":
        """From any sequence of strings, None meaning null."""
        import pandas as pd

        codes, names = pd.factorize(np.asarray(values, dtype=object), use_na_sentinel=True)
        return cls(codes.astype(np.int32), tuple(str(n) for n in names))


Values = Floats | Ints | Labels | Array
_TEXTS = (pa.types.is_string, pa.types.is_large_string, pa.types.is_dictionary)


@dataclass(frozen=True)
class Trajectory:
    """One vehicle, one stretch of time.

    vehicle_id : str
    time : (N,) int64, microseconds since 1970-01-01 UTC, strictly increasing.
    columns : by the names of :mod:`fleetlog.core.columns` (without vehicle_id and timestamp) or a log's own
        further names.  Floats are float64 with NaN for null; ``trip_id`` is int64 with -1 for null; labels
        are :class:`Labels`.  A column that is wholly unknown is simply absent."""

    vehicle_id: str
    time: Ints
    columns: dict[str, Values] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.time)

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def __getitem__(self, index: slice | Array) -> "Trajectory":
        """The rows of a slice, a boolean mask or an index array."""
        return Trajectory(self.vehicle_id, self.time[index], {k: v[index] for k, v in self.columns.items()})

    def floats(self, name: str) -> Floats:
        """A float column; all NaN where the log has none."""
        values = self.columns.get(name)
        return np.full(len(self), np.nan) if values is None else np.asarray(values, dtype=np.float64)

    def has(self, name: str) -> bool:
        """Whether the column is there with at least one known value."""
        if (values := self.columns.get(name)) is None:
            return False
        if isinstance(values, Labels):
            return bool((values.codes >= 0).any())
        if name == "trip_id":
            return bool((values >= 0).any())
        return values.dtype.kind not in "f" or bool(np.isfinite(values).any())

    def labels(self, name: str) -> Labels:
        """A label column; all null where the log has none."""
        values = self.columns.get(name)
        return values if isinstance(values, Labels) else Labels(np.full(len(self), -1, np.int32), ())

    def trip_ids(self) -> Ints:
        """(N,) trip of every row, -1 where unknown."""
        values = self.columns.get("trip_id")
        return np.full(len(self), -1, np.int64) if values is None else np.asarray(values, dtype=np.int64)

    def seconds(self, origin: int | None = None) -> Floats:
        """(N,) seconds since ``origin`` (microseconds; the first row by default)."""
        first = self.time[:1] if origin is None else origin
        return np.asarray((self.time - first) * 1e-6, dtype=np.float64)

    def with_columns(self, **new: Values) -> "Trajectory":
        """A copy with columns added or replaced."""
        return Trajectory(self.vehicle_id, self.time, {**self.columns, **new})

    def without(self, *names: str) -> "Trajectory":
        """A copy without some columns."""
        kept = {name: values for name, values in self.columns.items() if name not in names}
        return Trajectory(self.vehicle_id, self.time, kept)

    def to_pandas(self) -> DataFrame:
        """The rows as a DataFrame: ``vehicle_id``, ``timestamp`` (UTC), then every known column."""
        unknown = set(cols.NAMES) - {"vehicle_id", "timestamp", *self.columns}
        frame: DataFrame = to_arrow(self).drop_columns([*unknown]).to_pandas()
        return frame

    def to_geopandas(self, frame: "Frame | None" = None) -> "gpd.GeoDataFrame":
        """The rows as points: WGS 84 where ``frame`` (a site's) is given, else metres without a system."""
        geopandas = extra("geopandas", "geo", "a GeoDataFrame needs geopandas")
        x, y = self.floats("x"), self.floats("y")
        system = None if frame is None else "EPSG:4326"
        if frame is not None:
            y, x = frame.to_geographic(x, y)
        return geopandas.GeoDataFrame(self.to_pandas(), geometry=geopandas.points_from_xy(x, y, crs=system))

    def check(self) -> None:
        """Raise :class:`DataError` unless lengths agree and time increases strictly."""
        for name, values in self.columns.items():
            if len(values) != len(self):
                what = f"column {name} has {len(values)} rows, time has {len(self)}"
                raise DataError(f"vehicle {self.vehicle_id}: {what}")
        if len(self) > 1 and not bool((np.diff(self.time) > 0).all()):
            row = int(np.argmax(np.diff(self.time) <= 0)) + 1
            raise DataError(f"vehicle {self.vehicle_id}: time does not increase at row {row}")


def to_arrow(trajectory: Trajectory, *, part: bool = False) -> pa.Table:
    """The trajectory as an Arrow table; a ``part`` of a dataset leaves the column ``vehicle_id`` out."""
    schema = cols.SCHEMA.remove(0) if part else cols.SCHEMA
    arrays = [_arrow_array(trajectory, cols.BY_NAME[f.name], f.type) for f in schema]
    for name in sorted(set(trajectory.columns) - set(cols.NAMES)):
        arrays.append(own_array(trajectory.columns[name]))
        metadata = {"unit": "", "meaning": "kept from the log"}
        schema = schema.append(pa.field(name, arrays[-1].type, metadata=metadata))
    return pa.Table.from_arrays(arrays, schema=schema)


def _arrow_array(t: Trajectory, column: cols.Column, kind: pa.DataType) -> pa.Array:
    if column.name == "vehicle_id":
        return pa.repeat(pa.scalar(t.vehicle_id, kind), len(t)) if len(t) else pa.array([], kind)
    if column.name == "timestamp":
        return pa.array(t.time, pa.int64()).view(kind)
    if (values := t.columns.get(column.name)) is None:
        return pa.nulls(len(t), kind)
    if column.kind == "int64":
        return _with_nulls(ints := np.asarray(values, dtype=np.int64), ints < 0)
    if column.kind == "double":
        values = np.asarray(values, dtype=np.float64)
    return own_array(values)


def own_array(values: Values) -> pa.Array:
    """Labels as a dictionary; NaN is null."""
    if not isinstance(values, Labels):
        return pa.array(values, from_pandas=True)
    indices = _with_nulls(values.codes, values.codes < 0)
    return pa.DictionaryArray.from_arrays(indices, pa.array(list(values.names), pa.string()))


def _with_nulls(values: Array, unknown: Mask) -> pa.Array:
    # Without a mask nothing is copied.
    return pa.array(values, mask=unknown) if unknown.any() else pa.array(values)


def from_arrow(table: pa.Table, vehicle_id: str) -> Trajectory:
    """The trajectory in an Arrow table of one vehicle; columns that are wholly null are left out."""
    time = table.column("timestamp").cast(pa.timestamp("us", tz="UTC")).cast(pa.int64()).to_numpy()
    columns: dict[str, Values] = {}
    for name in table.column_names:
        chunk = table.column(name)
        if name in ("vehicle_id", "timestamp", "date") or (len(chunk) and chunk.null_count == len(chunk)):
            continue
        columns[name] = _numpy_values(chunk, name)
    return Trajectory(vehicle_id, np.asarray(time, dtype=np.int64), columns)


def _numpy_values(chunk: pa.ChunkedArray, name: str) -> Values:
    if any(is_text(chunk.type) for is_text in _TEXTS):
        return labels_of(chunk)
    if name == "trip_id":
        return np.asarray(chunk.fill_null(-1).to_numpy(), dtype=np.int64)
    if pa.types.is_floating(chunk.type) or pa.types.is_integer(chunk.type):
        return np.asarray(chunk.cast(pa.float64()).to_numpy(), dtype=np.float64)
    return np.asarray(chunk.to_numpy())


def labels_of(chunk: pa.ChunkedArray) -> Labels:
    """A column of any kind as labels."""
    array = chunk.dictionary_encode().unify_dictionaries().combine_chunks()
    codes = np.asarray(array.indices.fill_null(-1), dtype=np.int32)
    return Labels(codes, tuple(str(n) for n in array.dictionary.to_pylist()))


def concatenate(pieces: Sequence[Trajectory]) -> Trajectory:
    """Pieces of one vehicle as one, in the given order; a column missing in a piece is null there."""
    if len(pieces) == 1:
        return pieces[0]
    columns = {n: _joined(n, pieces) for n in dict.fromkeys(n for p in pieces for n in p.columns)}
    return Trajectory(pieces[0].vehicle_id, np.concatenate([p.time for p in pieces]), columns)


def _joined(name: str, pieces: Sequence[Trajectory]) -> Values:
    values = [p.columns.get(name) for p in pieces]
    if any(isinstance(v, Labels) for v in values):
        labels = [as_labels(v, len(p)) for v, p in zip(values, pieces, strict=True)]
        order = {n: i for i, n in enumerate(dict.fromkeys(n for piece in labels for n in piece.names))}
        return Labels(np.concatenate([piece.recode(order) for piece in labels]), tuple(order))
    null = -1 if name == "trip_id" else np.nan
    given = zip(values, pieces, strict=True)
    return np.concatenate([np.full(len(p), null) if v is None else v for v, p in given])


def as_labels(values: Values | None, n: int) -> Labels:
    """Labels as they are, null where there is no column, figures as text."""
    if isinstance(values, Labels):
        return values
    if values is None:
        return Labels(np.full(n, -1, np.int32), ())
    return Labels.of([None if v != v else f"{v:g}" for v in values.tolist()])

"""Tasks, activities and reservations of a simulation, as tables beside the trajectories.

``dataset.json`` names those that a dataset has under ``tables``; an import has no such key."""

import tomllib
from collections import Counter, defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fleetlog.core.arrays import Array, DataFrame, Floats, Ints
from fleetlog.core.columns import ARROW, Column, schema_of
from fleetlog.core.trajectory import Labels, own_array
from fleetlog.store.dataset import Dataset, undamaged

Name = Literal["tasks", "activities", "reservations", "ways", "bays"]


class Lines(NamedTuple):
    """One coordinate of polylines: all points one behind the other [m], and (N,) points of each line."""

    values: Floats
    lengths: Ints


Columns = Mapping[str, Array | Labels | Lines]
"""Of some rows: numbers, times [us] and -1 for null, labels, or polylines."""
KINDS = ARROW | {"label": pa.string()}
KEPT = 1 << 17  # Rows of a table that are kept before they are written

_TEXT = tomllib.loads(Path(__file__).with_name("events.toml").read_text(encoding="utf-8"))
TABLES: dict[Name, tuple[Column, ...]] = {
    table: tuple(Column(name, *column) for name, column in columns.items())
    for table, columns in _TEXT["tables"].items()
}
ACTIVITIES: dict[str, str] = _TEXT["activities"]
WAYS: dict[str, str] = _TEXT["ways"]


class Tables:
    """The tables of one dataset, being written in its folder; a table is a file from its first rows on."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._rows: Counter[Name] = Counter()
        self._kept: dict[Name, list[pa.Table]] = defaultdict(list)
        self._writers: dict[Name, Any] = {}

    def add(self, name: Name, columns: Columns) -> None:
        """Append rows; they are written when enough have come together."""
        arrays = [_array(columns[c.name], c.kind) for c in TABLES[name]]
        self._kept[name].append(pa.Table.from_arrays(arrays, schema=schema_of(TABLES[name], KINDS)))
        self._rows[name] += len(arrays[0])
        if sum(map(len, self._kept[name])) >= KEPT:
            self._write(name)

    def _write(self, name: Name) -> None:
        table = pa.concat_tables(self._kept.pop(name))
        if name not in self._writers:
            file = self.folder / f"{name}.parquet"
            self._writers[name] = pq.ParquetWriter(file, table.schema, compression="zstd")
        self._writers[name].write_table(table.combine_chunks())

    def close(self) -> dict[str, dict[str, Any]]:
        """Write what is kept; file and rows of every table, for the description of the dataset."""
        for name in [*self._kept]:
            self._write(name)
        for writer in self._writers.values():
            writer.close()
        return {name: {"file": f"{name}.parquet", "rows": n} for name, n in self._rows.items()}


def _array(values: Array | Labels | Lines, kind: str) -> pa.Array:
    if isinstance(values, Labels):
        return own_array(values).dictionary_decode()
    if isinstance(values, Lines):
        ends = np.concatenate([[0], np.cumsum(values.lengths)]).astype(np.int32)
        return pa.ListArray.from_arrays(ends, values.values)
    if kind == "double":
        return pa.array(values, pa.float64())
    whole = pa.array(values, pa.int64(), mask=values < 0)
    return whole.cast(ARROW[kind]) if kind == "time" else whole


def read_table(dataset: Dataset, name: Name, *, compact: bool = False) -> DataFrame | None:
    """A table of a dataset, None where it has none; ``compact`` has texts as categories."""
    if (entry := (dataset.meta.get("tables") or {}).get(name)) is None:
        return None
    path = dataset.path / str(entry["file"])
    labels = [c.name for c in TABLES[name] if c.kind == "label"] if compact else []
    with undamaged(path), path.open("rb") as stream:
        return pq.read_table(stream, read_dictionary=labels).to_pandas()  # type: ignore[no-any-return]

"""Tasks, activities and reservations of a simulation, as tables beside the trajectories.

``dataset.json`` names those that a dataset has under ``tables``; an import has no such key."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from fleetlog.core.arrays import Floats, Ints
from fleetlog.core.columns import ARROW, Column
from fleetlog.core.trajectory import Labels
from fleetlog.errors import InputError
from fleetlog.store.dataset import Dataset

if TYPE_CHECKING:
    import pandas as pd

Name = Literal["tasks", "activities", "reservations", "ways", "bays"]


class Lines(NamedTuple):
    """One coordinate of polylines: all points one behind the other [m], and (N,) points of each line."""

    values: Floats
    lengths: Ints


Columns = Mapping[str, NDArray[Any] | Labels | Lines]
"""Of some rows: numbers, times [us] and -1 for null, labels, or polylines."""
KEPT = 1 << 17  # Rows of a table that are kept before they are written

TABLES: dict[Name, tuple[Column, ...]] = {
    "tasks": (
        Column("task", "int64", "", "number, in the order in which tasks were given"),
        Column("vehicle_id", "label", "", "truck that does it or did it; null while nobody does"),
        Column("from_place", "label", "", "where the load is fetched"),
        Column("to_place", "label", "", "where it is set down; null where that was not decided yet"),
        Column("payload", "double", "kg", "the load"),
        Column("earliest", "time", "", "from when on it may be done"),
        Column("assigned", "time", "", "when the truck took it; null: not yet"),
        Column("picked", "time", "", "when the load was on and the forks were down again; null: not yet"),
        Column("dropped", "time", "", "when it was set down and the forks were down again; null: not yet"),
        Column("status", "label", "", "at the end: waiting, assigned, loaded, done, later or left out"),
    ),
    "activities": (
        Column("vehicle_id", "label", "", "the truck"),
        Column("start", "time", "", "of a stretch in which it does one thing"),
        Column("end", "time", "", "the start of its next stretch, or the end of the simulation"),
        Column("activity", "label", "", "see below"),
        Column("place", "label", "", "where it stands in a bay; on the road, where it drives to"),
        Column("task", "int64", "", "number of the task that it has; null: none"),
    ),
    "reservations": (
        Column("vehicle_id", "label", "", "who alone may be on a piece of the road"),
        Column("start", "time", "", "first second in which it was reserved"),
        Column("end", "time", "", "first second in which it was not any more, or the end of the simulation"),
        Column("way", "int64", "", "the piece: a row of ways"),
    ),
    "ways": (
        Column("way", "int64", "", "number of a piece of the road that was ever reserved"),
        Column("kind", "label", "", "see below"),
        Column("edge_id", "label", "", "directed road edge that it lies on; of a turn, where it comes from"),
        Column("to_edge", "label", "", "of a turn, the edge that it leads to"),
        Column("place", "label", "", "of the way into a bay, the place"),
        Column("x", "line", "m", "its middle line, east, in the site frame"),
        Column("y", "line", "m", "north"),
        Column("z", "line", "m", "up"),
    ),
    "bays": (
        Column("place", "label", "", "place of the site, or one drawn along its roads"),
        Column("kind", "label", "", "pick, drop, park or charge"),
        Column("x", "double", "m", "where a truck stands in the bay, east, in the site frame"),
        Column("y", "double", "m", "north"),
        Column("z", "double", "m", "up"),
        Column("heading", "double", "rad", "of the truck, counter-clockwise from east"),
    ),
}

ACTIVITIES: dict[str, str] = {
    "drive_empty": "is on its way without a load",
    "drive_laden": "is on its way with a load",
    "wait": "stands although it wants to go on: others are in its way, on the road or before its bay",
    "wait_place": "stands in a bay until the place is free that it has to go to, or that its next task needs",
    "pick": "takes a load up",
    "drop": "sets a load down",
    "charge": "charges",
    "wait_charger": "has to charge, and waits for a charger to be free",
    "park": "has nothing to do",
    "battery_empty": "stands with an empty battery",
}
WAYS: dict[str, str] = {
    "aisle": "a lane on which nobody can be passed: a single-lane aisle, or one too short to wait on",
    "turn": "across a junction, from one lane to another",
    "exit": "the last metres of a lane, before a junction",
    "entry": "the first metres of a lane, behind a junction",
    "bay": "between the road and a bay",
}


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
        self._kept[name].append(pa.Table.from_arrays(arrays, schema=_schema(name)))
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


def _schema(name: Name) -> pa.Schema:
    kinds = ARROW | {"label": pa.string()}
    return pa.schema(
        pa.field(c.name, kinds[c.kind], metadata={"unit": c.unit, "meaning": c.meaning}) for c in TABLES[name]
    )


def _array(values: NDArray[Any] | Labels | Lines, kind: str) -> pa.Array:
    if isinstance(values, Labels):
        names = pa.array([*values.names, None], pa.string())
        return names.take(pa.array(np.where(values.codes < 0, len(values.names), values.codes)))
    if isinstance(values, Lines):
        ends = np.concatenate([[0], np.cumsum(values.lengths)]).astype(np.int32)
        return pa.ListArray.from_arrays(ends, values.values)
    if kind == "double":
        return pa.array(values, pa.float64())
    whole = pa.array(values, pa.int64(), mask=values < 0)
    return whole.cast(ARROW[kind]) if kind == "time" else whole


def read_table(dataset: Dataset, name: Name, *, compact: bool = False) -> pd.DataFrame | None:
    """A table of a dataset, None where it has none; ``compact`` has texts as categories."""
    entry = (dataset.meta.get("tables") or {}).get(name)
    if entry is None:
        return None
    path = dataset.path / str(entry["file"])
    labels = [c.name for c in TABLES[name] if c.kind == "label"] if compact else []
    try:
        return pq.read_table(path, read_dictionary=labels).to_pandas()  # type: ignore[no-any-return]
    except (OSError, pa.ArrowInvalid) as error:
        raise InputError(f"damaged: {error}", where=path, do="simulate again") from None

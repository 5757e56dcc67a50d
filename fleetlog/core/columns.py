"""Every column of a trajectory, of which schema, checks and documentation are made."""

import tomllib
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

HIVE_NULL = "__HIVE_DEFAULT_PARTITION__"
"""The name of a partition that Hive, and every reader of its layout, takes for null."""


@dataclass(frozen=True, slots=True)
class Column:
    """One column of the trajectory table. ``kind`` is one of ``string``, ``label`` (dictionary-encoded
    string), ``time``, ``double`` and ``int64``; ``low`` and ``high`` bound what a value can be (None: no
    bound), in the column's unit."""

    name: str
    kind: str
    unit: str
    meaning: str
    low: float | None = None
    high: float | None = None


_TEXT = tomllib.loads(Path(__file__).with_name("columns.toml").read_text(encoding="utf-8"))
COLUMNS: tuple[Column, ...] = tuple(Column(name, *column) for name, column in _TEXT.items())
BY_NAME: dict[str, Column] = {c.name: c for c in COLUMNS}
NAMES: tuple[str, ...] = tuple(BY_NAME)
ARROW: dict[str, pa.DataType] = {
    "string": pa.string(), "label": pa.dictionary(pa.int32(), pa.string()), "time": pa.timestamp("us", "UTC"),
    "double": pa.float64(), "int64": pa.int64(), "line": pa.list_(pa.float64()),
}  # fmt: skip


def schema_of(
    columns: Iterable[Column], kinds: Mapping[str, pa.DataType] = ARROW, required: Collection[str] = ()
) -> pa.Schema:
    """The schema of some columns, with unit and meaning of each; the ``required`` ones have no nulls."""
    told = ((c, {"unit": c.unit, "meaning": c.meaning}) for c in columns)
    return pa.schema(pa.field(c.name, kinds[c.kind], c.name not in required, m) for c, m in told)


SCHEMA: pa.Schema = schema_of(COLUMNS, required=("vehicle_id", "timestamp"))
"""Of the columns that every dataset has, in the order of the contract."""

"""Every column of a trajectory, of which schema, checks and documentation are made."""

from dataclasses import dataclass

import pyarrow as pa

HIVE_NULL = "__HIVE_DEFAULT_PARTITION__"
"""The name of a partition that Hive, and every reader of its layout, takes for null."""
PI = 3.1415927


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


COLUMNS: tuple[Column, ...] = (
    Column("vehicle_id", "string", "", "identity of the vehicle; partition key"),
    Column("timestamp", "time", "", "UTC, strictly increasing within a vehicle"),
    Column("x", "double", "m", "cleaned position, east, in the site frame"),
    Column("y", "double", "m", "cleaned position, north, in the site frame"),
    Column("z", "double", "m", "cleaned position, up, in the site frame"),
    Column("heading", "double", "rad", "direction of motion, counter-clockwise from east", -PI, PI),
    Column("speed", "double", "m/s", "along the path", 0.0, 60.0),
    Column("edge_id", "label", "", "directed road edge; null where no road fits"),
    Column("edge_offset", "double", "m", "along the directed edge from its start", 0.0),
    Column("lateral_offset", "double", "m", "measured position left (+) or right (-) of the edge"),
    Column("trip_id", "int64", "", "counts up within a vehicle"),
    Column("payload", "double", "kg", "load on the forks", 0.0, 100_000.0),
    Column("fork_height", "double", "m", "height of the forks above the floor", -0.5, 30.0),
    Column("battery_power", "double", "W", "at the battery terminals, > 0 when discharging", -1e6, 1e6),
    Column("battery_voltage", "double", "V", "at the battery terminals", 0.0, 2000.0),
    Column("battery_current", "double", "A", "> 0 when discharging", -5000.0, 5000.0),
    Column("soc", "double", "1", "state of charge", 0.0, 1.0),
    Column("ambient_temperature", "double", "degC", "of the air around the vehicle", -60.0, 80.0),
)
BY_NAME: dict[str, Column] = {c.name: c for c in COLUMNS}
NAMES: tuple[str, ...] = tuple(BY_NAME)
ARROW: dict[str, pa.DataType] = {
    "string": pa.string(),
    "label": pa.dictionary(pa.int32(), pa.string()),
    "time": pa.timestamp("us", tz="UTC"),
    "double": pa.float64(),
    "int64": pa.int64(),
    "line": pa.list_(pa.float64()),
}
SCHEMA: pa.Schema = pa.schema(
    pa.field(
        c.name, ARROW[c.kind], nullable=c.name not in ("vehicle_id", "timestamp"),
        metadata={"unit": c.unit, "meaning": c.meaning},
    )
    for c in COLUMNS
)  # fmt: skip
"""Of the columns that every dataset has, in the order of the contract."""
PART_SCHEMA: pa.Schema = SCHEMA.remove(0)  # The same of a Parquet part, whose folder names the vehicle

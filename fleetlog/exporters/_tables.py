"""Arrow tables of a selection under one schema, for the formats that are tables."""

from collections.abc import Iterator

import pyarrow as pa
import pyarrow.parquet as pq

from fleetlog.core.columns import SCHEMA
from fleetlog.core.trajectory import to_arrow
from fleetlog.exporters.base import Selection


def union_schema(selection: Selection) -> pa.Schema:
    """The contract's columns, then every further one of any part, from the files' descriptions only."""
    fields = {f.name: _plain(f) for f in SCHEMA}
    for vehicle in selection.vehicles:
        for part in selection.dataset.parts(vehicle):
            for f in pq.read_schema(part):
                if f.name not in fields or pa.types.is_null(fields[f.name].type):
                    fields[f.name] = _plain(f)
    return pa.schema([f for f in fields.values() if f.name != "date"])


def _plain(field: pa.Field) -> pa.Field:
    """Labels as plain strings: dictionaries differ from part to part."""
    return field.with_type(pa.string()) if pa.types.is_dictionary(field.type) else field


def tables(selection: Selection, schema: pa.Schema) -> Iterator[pa.Table]:
    """One table per vehicle and day, all of ``schema``."""
    for trajectory in selection.days():
        table = to_arrow(trajectory)
        for field in schema:
            if field.name not in table.column_names:
                table = table.append_column(field, pa.nulls(len(table), field.type))
        yield table.select(schema.names).cast(schema, safe=False)

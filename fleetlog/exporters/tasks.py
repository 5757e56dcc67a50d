"""Tasks of a simulation as CSV, a row a task, as ``fleetlog simulate --tasks`` reads them."""

from pathlib import Path

import pyarrow as pa

from fleetlog.core.columns import schema_of
from fleetlog.errors import DataError
from fleetlog.exporters.base import Selection
from fleetlog.exporters.csv import write_tables
from fleetlog.store.events import KINDS, TABLES, read_table


def write(selection: Selection, path: Path) -> None:
    """The columns of ``tasks.parquet``; of chosen vehicles only what they did."""
    dataset, schema = selection.dataset, schema_of(TABLES["tasks"], KINDS)
    if (tasks := read_table(dataset, "tasks")) is None:
        do = "export what fleetlog simulate made of a fleet; an import, --same-mission and --cycle have none"
        raise DataError("the dataset has no tasks", where=dataset.path, do=do)
    if len(selection.vehicles) < len(dataset.vehicles):
        tasks = tasks[tasks["vehicle_id"].isin(selection.vehicles)]
    selection.counts["rows"] = len(tasks)
    table = pa.Table.from_pandas(tasks, schema=schema, preserve_index=False)
    write_tables(selection, path, schema, [table])

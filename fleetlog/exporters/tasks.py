"""Tasks of a simulation as CSV, a row a task, as ``fleetlog simulate --tasks`` reads them."""

from pathlib import Path

import pyarrow as pa

from fleetlog.core.columns import schema_of
from fleetlog.errors import DataError
from fleetlog.exporters import csv
from fleetlog.exporters.base import Selection
from fleetlog.store.events import KINDS, TABLES, read_table


def write(selection: Selection, path: Path) -> None:
    """The columns of ``tasks.parquet``; of chosen vehicles only what they did."""
    if (tasks := read_table(selection.dataset, "tasks")) is None:
        do = "export what fleetlog simulate made of a fleet; no other dataset has tasks"
        raise DataError("the dataset has no tasks", where=selection.dataset.path, do=do)
    if len(selection.vehicles) < len(selection.dataset.vehicles):
        tasks = tasks[tasks["vehicle_id"].isin(selection.vehicles)]
    selection.counts["rows"], schema = len(tasks), schema_of(TABLES["tasks"], KINDS)
    csv.write(selection, path, pa.Table.from_pandas(tasks, schema, preserve_index=False))

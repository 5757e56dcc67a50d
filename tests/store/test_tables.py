"""The tables beside the trajectories: written with the dataset, read back, and said plainly where they are at fault."""

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from fleetlog.core.site import Site
from fleetlog.core.trajectory import Labels, Trajectory
from fleetlog.errors import InputError
from fleetlog.store import Dataset, DatasetWriter, events


def write(path, pieces):
    with DatasetWriter.create(path, "simulated", Site("yard")) as writer:
        writer.write(Trajectory("a", np.arange(3) * 1_000_000, {"x": np.zeros(3), "y": np.zeros(3)}))
        for n in pieces:
            writer.tables.add("reservations", {
                "vehicle_id": Labels(np.arange(n, dtype=np.int32) % 2 - 1, ("a",)), "way": np.arange(n) - 1,
                "start": 1_000_000 * np.arange(n), "end": 1_000_000 * np.arange(n) + 5,
            })  # fmt: skip
    return Dataset(path)


def test_rows_come_back_in_order_whatever_the_pieces(tmp_path, monkeypatch):
    monkeypatch.setattr(events, "KEPT", 7)
    dataset = write(tmp_path / "d", [3, 9, 0, 2])
    assert dataset.meta["tables"] == {"reservations": {"file": "reservations.parquet", "rows": 14}}
    table = events.read_table(dataset, "reservations")
    assert table.columns.tolist() == [c.name for c in events.TABLES["reservations"]]
    assert table.start.dt.second.tolist() == [*range(3), *range(9), *range(2)]
    # Minus one is null.
    assert table.way.isna().sum() == 3 and table.vehicle_id.isna().tolist() == [
        k % 2 == 0 for n in (3, 9, 2) for k in range(n)
    ]
    assert events.read_table(dataset, "tasks") is None
    compact = events.read_table(dataset, "reservations", compact=True)
    pd.testing.assert_series_equal(compact.vehicle_id.astype(object), table.vehicle_id.astype(object))
    meta = pq.read_schema(tmp_path / "d" / "reservations.parquet").field("way").metadata
    assert meta[b"meaning"] == b"the piece: a row of ways"


def test_a_table_at_fault_is_one_line(tmp_path):
    dataset = write(tmp_path / "d", [2])
    path = tmp_path / "d" / "reservations.parquet"
    path.write_bytes(path.read_bytes()[:40])
    with pytest.raises(InputError, match="damaged"):
        events.read_table(dataset, "reservations")
    path.unlink()
    with pytest.raises(InputError, match="make the dataset again"):
        events.read_table(dataset, "reservations")


def test_a_dataset_without_tables_does_not_name_any(tmp_path):
    dataset = write(tmp_path / "d", [])
    assert "tables" not in dataset.meta
    assert not list((tmp_path / "d").glob("res*"))

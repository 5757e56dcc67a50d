"""How rows get from the fleet to files: in turns, by several threads, whole or not at all."""

import numpy as np
import pytest
from simulated_sites import TRUCK, grid

from fleetlog.errors import DataError
from fleetlog.simulate import record
from fleetlog.simulate.engine import Settings, simulate
from fleetlog.store import DatasetWriter


def files(outcome):
    root = outcome.dataset.path
    return {
        str(p.relative_to(root)): p.read_bytes()
        for p in sorted(root.rglob("*.parquet"))
        if p.is_file()
    }  # fmt: skip


@pytest.mark.parametrize("workers", [1, 3])
def test_the_number_of_threads_changes_no_byte(simulated, monkeypatch, workers):
    monkeypatch.setattr(record, "ROWS", 20_000)
    run = lambda: simulated(grid(5, 5), 24, 120.0, seed=3)
    monkeypatch.setattr(record.os, "cpu_count", lambda: 2)
    two = files(run())
    monkeypatch.setattr(record.os, "cpu_count", lambda: workers)
    assert files(run()) == two


def test_rows_written_in_turns_are_those_written_at_once(simulated, monkeypatch):
    whole = simulated(grid(5, 5), 40, 180.0, seed=4)
    assert all(len(list(p.glob("*"))) == 1 for p in whole.dataset.path.glob("trajectories/*/*"))
    monkeypatch.setattr(record, "ROWS", 20_000)
    turns = simulated(grid(5, 5), 40, 180.0, seed=4)
    assert all(len(list(p.glob("*"))) > 2 for p in turns.dataset.path.glob("trajectories/*/*"))
    assert turns.summary.rows == whole.summary.rows == 40 * 1800
    for a, b in zip(whole.tracks, turns.tracks, strict=True):
        assert a.vehicle_id == b.vehicle_id and (a.time == b.time).all()
        assert set(a.columns) == set(b.columns)
        for name in a.columns.keys() - {"edge_id"}:
            np.testing.assert_array_equal(a.columns[name], b.columns[name])
        assert a.labels("edge_id").strings() == b.labels("edge_id").strings()
    trips = [outcome.dataset.trips for outcome in (whole, turns)]
    for name in trips[0]:
        if trips[0][name].dtype.kind == "f":
            np.testing.assert_allclose(trips[0][name], trips[1][name], rtol=1e-9, atol=1e-9)
        else:
            assert (trips[0][name] == trips[1][name]).all()


def test_a_fault_in_writing_ends_the_run_and_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(record, "ROWS", 4_000)

    def full(*_arguments):
        raise DataError("no space left")

    monkeypatch.setattr(DatasetWriter, "write_together", full)
    with (
        pytest.raises(DataError, match="no space left"),
        DatasetWriter.create(tmp_path / "sim", "simulated", grid()) as writer,
    ):
        simulate(grid(), TRUCK, writer, Settings(vehicles=4, duration=600.0, interval=0.1))
    assert not list(tmp_path.iterdir())

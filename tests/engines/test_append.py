"""A day that is added to a dataset: like the whole imported at once, atomically, and nothing old written again."""

import numpy as np
import pytest

from fleetlog import engines
from fleetlog.analysis.heatmap import heatmap
from fleetlog.errors import DataError, OutputError
from fleetlog.ingest.pipeline import import_logs
from fleetlog.store import Dataset, DatasetWriter


@pytest.fixture(scope="module")
def days(tmp_path_factory, logs):
    """The logs of each day in a folder of its own."""
    folder = tmp_path_factory.mktemp("days")
    for date in ("2026-03-02", "2026-03-03"):
        (folder / date).mkdir()
        for log in logs.iterdir():
            head, *rows = log.read_text().splitlines()
            mine = [r for r in rows if f",{date}T" in r]
            (folder / date / log.name).write_text("\n".join([head, *mine]) + "\n")
    return folder


def first_day(days, site, target):
    with DatasetWriter.create(target, "recorded", site) as writer:
        import_logs([days / "2026-03-02"], site, writer)
    return Dataset(target)


def add(days, target, date="2026-03-03"):
    with DatasetWriter.append(target) as writer:
        import_logs([days / date], writer.site, writer)
    return Dataset(target)


def test_a_day_is_added(days, site, tmp_path):
    old = first_day(days, site, tmp_path / "d")
    parts = {p: p.stat().st_ino for d in old.vehicle_days for p in old.parts(*d)}
    new = add(days, tmp_path / "d")
    assert (
        new.dates == ["2026-03-02", "2026-03-03"]
        and new.rows == sum(new.meta["vehicles"].values()) > old.rows
    )
    assert {p: p.stat().st_ino for p in parts} == parts, "no row was written again"
    for vehicle in new.vehicles:
        t = new.read(vehicle)
        assert len(t) == new.meta["vehicles"][vehicle] and (np.diff(t.time) > 0).all()
        assert (np.diff(t.trip_ids()) >= 0).all()
        own = new.trips[new.trips.vehicle_id == vehicle]
        assert own.rows.sum() == len(t) and own.trip_id.is_unique
    assert (new.meta["start"], new.meta["end"]) == (old.meta["start"], new.meta["summary"]["end"])
    assert new.meta["summary"]["rows"] == new.rows and len(new.meta["provenance"]["appended"]) == 1
    assert new.meta["summary"]["rows_rejected"] == 1 and (new.path / "rejected.parquet").exists()


def test_the_same_bytes_with_workers(days, site, tmp_path):
    for name, workers in (("one", 1), ("two", 2)):
        with engines.using(workers):
            first_day(days, site, tmp_path / name)
            add(days, tmp_path / name)
    one, two = ({p.relative_to(f): p.read_bytes() for p in f.rglob("*") if p.is_file()} for f in
                (tmp_path / "one", tmp_path / "two"))  # fmt: skip
    assert one == two


def test_a_failure_leaves_the_older_dataset(days, site, tmp_path):
    first_day(days, site, tmp_path / "d")
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    with pytest.raises(DataError, match="not later"):
        add(days, tmp_path / "d", "2026-03-02")
    with pytest.raises(KeyboardInterrupt), DatasetWriter.append(tmp_path / "d") as writer:
        import_logs([days / "2026-03-03"], writer.site, writer)
        raise KeyboardInterrupt
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before


def test_only_recordings_grow(fleet):
    with pytest.raises(DataError, match="simulated"), DatasetWriter.append(fleet.path):
        pass


def test_a_folder_of_other_files_is_left_alone(days, site, tmp_path):
    first_day(days, site, tmp_path / "d")
    (tmp_path / "d" / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"notes\.txt"):
        add(days, tmp_path / "d")


def test_one_more_day_costs_one_day(days, site, tmp_path, monkeypatch):
    from fleetlog.store import days as partials

    monkeypatch.setattr(partials, "FROM_ROWS", 0)
    old = first_day(days, site, tmp_path / "d")
    heatmap(old)
    reads = []
    read = Dataset.read
    monkeypatch.setattr(Dataset, "read", lambda *a, **k: reads.append(a[2]) or read(*a, **k))
    new = add(days, tmp_path / "d")
    kept = heatmap(new)
    assert set(reads) == {"2026-03-03"}, "the first day is not read again"
    (new.path / ".partials").rename(tmp_path / "gone")
    monkeypatch.setattr(partials, "FROM_ROWS", 1 << 60)
    again = heatmap(Dataset(tmp_path / "d"))
    assert kept.summary == again.summary
    assert all(kept.tables[n].equals(again.tables[n]) for n in again.tables)

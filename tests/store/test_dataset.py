"""Datasets on disk: what is written is read, whole or not at all, and in the layout that other tools read."""

import json
from itertools import pairwise

import numpy as np
import pyarrow.dataset as pads
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetlog.core.columns import COLUMNS
from fleetlog.core.site import Site
from fleetlog.core.trajectory import Labels, Trajectory, from_arrow, to_arrow
from fleetlog.errors import DataError, InputError, OutputError
from fleetlog.store import Dataset, DatasetWriter

T0 = 1_772_431_200_000_000


def drive(vehicle="T 1/ä", n=500, seed=0, t0=T0, step=1_000_000):
    rng = np.random.default_rng(seed)
    speed = np.clip(np.sin(np.arange(n) / 15) * 3, 0, None)
    return Trajectory(
        vehicle,
        t0 + step * np.arange(n, dtype=np.int64),
        {
            "x": np.cumsum(speed), "y": rng.normal(size=n), "speed": speed,
            "soc": np.where(rng.random(n) < 0.2, np.nan, np.linspace(0.9, 0.8, n)),
            "edge_id": Labels(rng.integers(-1, 2, n).astype(np.int32), ("a", "-a")),
            "battery_power": np.full(n, 1000.0), "driver": Labels.of(["x", None] * (n // 2)), "oil": rng.normal(size=n),
        },
    )  # fmt: skip


def same(a: Trajectory, b: Trajectory) -> None:
    # A column that is wholly unknown is absent once read.
    assert np.array_equal(a.time, b.time) and {c for c in a.columns if a.has(c)} == set(b.columns)
    for name in b.columns:
        values = a.columns[name]
        if isinstance(values, Labels):
            assert values.strings() == b.labels(name).strings()
        else:
            assert np.array_equal(values, b.columns[name], equal_nan=values.dtype.kind == "f"), name


@given(st.integers(0, 40), st.integers(0, 99))
def test_arrow_and_back(n, seed):
    t = drive(n=2 * n, seed=seed)
    if len(t):
        same(t, from_arrow(to_arrow(t), t.vehicle_id))


@settings(max_examples=15, deadline=None)
@given(st.lists(st.integers(1, 499), max_size=4))
def test_pieces_make_no_difference(tmp_path_factory, cuts):
    from fleetlog.store.trips import trip_ids

    t = drive(t0=T0 + 60_000_000_000)  # crosses midnight
    t = t.with_columns(trip_id=trip_ids(t))
    path = tmp_path_factory.mktemp("d")
    for name, edges in (("one", [0, 500]), ("many", sorted({0, 500, *cuts}))):
        with DatasetWriter.create(path / name, "recorded", Site()) as w:
            for a, b in pairwise(edges):
                w.write(t[a:b])
    one, many = Dataset(path / "one"), Dataset(path / "many")
    same(one.read(t.vehicle_id), many.read(t.vehicle_id))
    a, b = one.trips, many.trips
    assert (
        list(a.trip_id) == list(b.trip_id) and list(a.start) == list(b.start) and list(a.end) == list(b.end)
    )
    assert a.rows.sum() == b.rows.sum() == 500


def test_layout_is_hive_and_units_are_in_the_fields(tmp_path):
    with DatasetWriter.create(tmp_path / "d", "recorded", Site()) as w:
        w.write(drive("T1"))
        w.write(drive("T2", seed=1))
    table = pads.dataset(tmp_path / "d" / "trajectories", partitioning="hive").to_table()
    assert set(table["vehicle_id"].to_pylist()) == {"T1", "T2"} and table.num_rows == 1000
    for column in COLUMNS:
        if column.name != "vehicle_id":
            assert table.schema.field(column.name).metadata[b"unit"].decode() == column.unit
    assert str(table.schema.field("timestamp").type) == "timestamp[us, tz=UTC]"
    meta = json.loads((tmp_path / "d" / "dataset.json").read_text())
    assert (
        meta["format_version"] == 1
        and meta["rows"] == 1000
        and meta["start"].startswith("2026-03-02T06:00:00")
    )
    assert {"kind", "site", "vehicles", "start", "end", "rows", "columns", "provenance"} <= set(meta)


def test_unknown_is_null_not_zero(tmp_path):
    with DatasetWriter.create(tmp_path / "d", "recorded", Site()) as w:
        w.write(drive("T1"))
    table = pads.dataset(tmp_path / "d" / "trajectories").to_table()
    assert table["payload"].null_count == 500 and table["soc"].null_count > 0


def test_an_error_leaves_nothing(tmp_path):
    with pytest.raises(DataError), DatasetWriter.create(tmp_path / "d", "recorded", Site()) as w:
        w.write(drive())
        w.write(drive())
    assert list(tmp_path.iterdir()) == []


def test_no_overwriting_without_being_told(tmp_path):
    for seed, overwrite in ((0, False), (1, True)):
        with DatasetWriter.create(tmp_path / "d", "recorded", Site(), overwrite=overwrite) as w:
            w.write(drive(n=10 + seed, seed=seed) if not seed else drive(n=20))
    assert Dataset(tmp_path / "d").rows == 20
    with (
        pytest.raises(OutputError, match="--overwrite"),
        DatasetWriter.create(tmp_path / "d", "recorded", Site()) as w,
    ):
        w.write(drive())
    assert Dataset(tmp_path / "d").rows == 20
    with (
        pytest.raises(DataError),
        DatasetWriter.create(tmp_path / "d", "recorded", Site(), overwrite=True) as w,
    ):
        raise DataError("stopped in the middle")
    assert Dataset(tmp_path / "d").rows == 20 and len(list(tmp_path.iterdir())) == 1


def test_leftovers_of_killed_runs_are_cleared(tmp_path):
    (tmp_path / ".d.partial/new").mkdir(parents=True)
    (tmp_path / ".d.partial/lock").touch()
    with DatasetWriter.create(tmp_path / "d", "recorded", Site()) as w:
        w.write(drive())
    assert [p.name for p in tmp_path.iterdir()] == ["d"]


def test_what_is_no_dataset_says_so(tmp_path):
    for path in (tmp_path, tmp_path / "none"):
        with pytest.raises(InputError, match="dataset"):
            Dataset(path)


def test_trips_cover_all_rows_and_energy():
    from fleetlog.store.trips import trip_ids, trip_pieces, trips_of

    t = drive()
    t = t.with_columns(trip_id=trip_ids(t))
    trips = trips_of([trip_pieces(t)])
    assert len(trips) > 3 and trips.rows.sum() == len(t)
    between = (np.diff(t.trip_ids()) != 0).sum()
    assert trips.energy.sum() == pytest.approx(1000.0 * (len(t) - 1 - between))


@given(
    st.lists(st.integers(1, 59), max_size=4, unique=True), st.sampled_from(["", "battery_power", "payload"])
)
@settings(max_examples=20, deadline=None)
def test_trips_do_not_depend_on_the_pieces_they_are_written_in(cuts, unknown):
    from fleetlog.store.trips import trip_pieces, trips_of

    rng = np.random.default_rng(5)
    n = 60
    columns = {
        name: rng.uniform(0.0, 3.0, n) for name in ("x", "y", "speed", "battery_power", "payload", "soc")
    }
    columns.pop(unknown, None)
    columns["trip_id"] = np.repeat([0, 1, 2], 20)
    rows = Trajectory("T1", np.cumsum(rng.integers(1, 90, n)) * 1_000_000, columns)
    ends = [0, *sorted(cuts), n]
    pieces = [trip_pieces(rows[a:b]) for a, b in pairwise(ends)]
    whole, merged = trips_of([trip_pieces(rows)]), trips_of(pieces)
    assert list(whole) == list(merged)
    for name in whole:
        if whole[name].dtype.kind == "f":
            np.testing.assert_allclose(merged[name], whole[name], rtol=1e-9, err_msg=name)
        else:
            assert (merged[name] == whole[name]).all(), name


@pytest.mark.parametrize("how", ["shuffled", "twice", "parts exchanged"])
def test_rows_out_of_order_are_named_in_one_line(tmp_path, how):
    with DatasetWriter.create(tmp_path / "d", "recorded", Site()) as writer:
        writer.write(drive("t", n=40))
        writer.write(drive("t", n=40, t0=T0 + 40_000_000))
    first, second = sorted((tmp_path / "d" / "trajectories").rglob("*.parquet"))
    table = pq.ParquetFile(first).read()
    if how == "shuffled":
        pq.write_table(table.take([0, 1, 3, 2, *range(4, 40)]), first)
        place = "part-00000.parquet, row 4"
    elif how == "twice":
        pq.write_table(table.take([0, 1, 2, 2, *range(3, 40)]), first)
        place = "part-00000.parquet, row 4"
    else:
        first.rename(tmp_path / "other")
        second.rename(first)
        (tmp_path / "other").rename(second)
        place = "part-00001.parquet, row 1"
    for read in (lambda d, v, day: d.read(v, day), lambda d, v, day: list(d.pieces(v, day, rows=7))):
        dataset = Dataset(tmp_path / "d")
        with pytest.raises(InputError, match=f"{place}: a row is not later") as caught:
            read(dataset, *dataset.vehicle_days[0])
        assert "sort by timestamp" in caught.value.line() and "\n" not in caught.value.line()


def test_joined_pieces_cover_every_interval_once(tmp_path):
    from fleetlog.store.trips import trip_ids

    t = drive(n=2000, t0=T0 + 18 * 3_600_000_000 - 700_000_000)
    t = t.with_columns(trip_id=trip_ids(t))
    gone = t[np.r_[0:900, 1500:2000]]  # A silence, too
    with DatasetWriter.create(tmp_path / "d", "recorded", Site("s")) as w:
        w.write(gone)
        w.write(drive("other", n=50))
    d = Dataset(tmp_path / "d")
    days = d.vehicle_days
    pieces = [
        p for v, day in days if v == t.vehicle_id for p in d.pieces(v, day, ("trip_id",), 100, joined=True)
    ]
    assert len(pieces) > 5
    ends = [(a, b) for p in pieces for a, b in pairwise(p.time.tolist())]
    assert ends == list(pairwise(gone.time.tolist()))

"""Laws of the import: counts add up, order and splitting change nothing, what comes back is what went out."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fleetlog import engines
from fleetlog.core.network import Edge, build_network
from fleetlog.core.site import Frame, Site
from fleetlog.core.trajectory import Labels
from fleetlog.errors import DataError
from fleetlog.importers import _csv_table
from fleetlog.ingest import rows as spill
from fleetlog.ingest import stretch
from fleetlog.ingest.pipeline import import_logs
from fleetlog.ingest.summary import ImportSummary
from fleetlog.store import Dataset, DatasetWriter

FRAME = Frame(49.9769, 9.1513)
START = int(np.datetime64("2026-03-02T23:53:00", "us").astype(np.int64))


def block() -> Site:
    """Two-way roads around a block of 200 m by 100 m."""
    corners = [(0.0, 0.0), (200.0, 0.0), (200.0, 100.0), (0.0, 100.0)]
    edges = []
    for i in range(4):
        a, b = corners[i], corners[(i + 1) % 4]
        points = np.array([[*a, 0.0], [*b, 0.0]])
        edges += [Edge(f"r{i}", f"n{i}", f"n{(i + 1) % 4}", points, f"r{i}")]
        edges += [Edge(f"-r{i}", f"n{(i + 1) % 4}", f"n{i}", points[::-1].copy(), f"r{i}")]
    return Site("block", FRAME, build_network(edges))


def log(vehicles: int = 2, seconds: int = 900, step: float = 2.0, seed: int = 0) -> pd.DataFrame:
    """Trucks round the block with stops of half a minute; position in degrees, speed, power."""
    rng = np.random.default_rng(seed)
    frames = []
    for v in range(vehicles):
        t = np.arange(0.0, seconds, step) + 0.1 * v
        phase = (t + 40 * v) % 150
        gone = (t + 40 * v) // 150 * 240 + np.minimum(phase, 120) * 2.0
        s = gone % 600
        x = np.interp(s, [0, 200, 300, 500, 600], [0, 200, 200, 0, 0]) + rng.normal(0, 0.2, len(t))
        y = np.interp(s, [0, 200, 300, 500, 600], [0, 0, 100, 100, 0]) + rng.normal(0, 0.2, len(t))
        latitude, longitude = FRAME.to_geographic(x, y)
        frames.append(pd.DataFrame({
            "vehicle_id": f"T{v}", "timestamp": [f"{np.datetime64(START + int(1e6 * k), 'us')}Z" for k in t],
            "latitude": latitude, "longitude": longitude, "speed": np.where(phase < 120, 2.0, 0.0),
            "battery_power": np.round(rng.normal(1500, 100, len(t)), 1), "Mode": np.where(phase < 120, "go", "stop"),
        }))  # fmt: skip
    return pd.concat(frames).sort_values("timestamp", kind="stable", ignore_index=True)


def run(
    paths: list[Path], out: Path, site: Site | None = None, **options: Any
) -> tuple[Dataset, ImportSummary]:
    with DatasetWriter.create(out, "recorded", site or Site()) as writer:
        summary = import_logs(paths, site, writer, **options)
    return Dataset(out), summary


def save(table: pd.DataFrame, path: Path) -> Path:
    table.to_csv(path, index=False)
    return path


def same(a: Dataset, b: Dataset) -> None:
    assert a.vehicles == b.vehicles and a.rows == b.rows
    for vehicle in a.vehicles:
        p, q = a.read(vehicle), b.read(vehicle)
        assert np.array_equal(p.time, q.time)
        assert set(p.columns) == set(q.columns)
        for name, values in p.columns.items():
            other = q.columns[name]
            if isinstance(values, Labels):
                assert isinstance(other, Labels) and values.strings() == other.strings(), name
            else:
                assert np.array_equal(values, other, equal_nan=True), name
    pd.testing.assert_frame_equal(a.trips, b.trips)


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return log()


@pytest.fixture(scope="module")
def whole(table: pd.DataFrame, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("whole")
    return run([save(table, folder / "log.csv")], folder / "out", block())[0]


def test_nothing_is_lost_of_a_clean_log(table: pd.DataFrame, whole: Dataset) -> None:
    assert whole.rows == len(table)
    assert not (whole.path / "rejected.parquet").exists()
    assert whole.meta["summary"]["matched"] == 1.0
    t = whole.read("T0")
    x, y = FRAME.to_local(table.latitude[table.vehicle_id == "T0"], table.longitude[table.vehicle_id == "T0"])
    assert np.allclose(t.floats("x"), x, atol=1e-6) and np.allclose(t.floats("y"), y, atol=1e-6)
    assert t.labels("Mode").strings()[0] == "go"
    assert (np.diff(t.trip_ids()) >= 0).all() and t.trip_ids()[-1] >= 4
    assert whole.dates == ["2026-03-02", "2026-03-03"]


def test_splitting_into_files_and_their_order_change_nothing(
    table: pd.DataFrame, whole: Dataset, tmp_path: Path
) -> None:
    cuts = [0, 17, 333, 340, 700, len(table)]
    files = [
        save(table[a:b], tmp_path / f"{len(cuts) - i}.csv")
        for i, (a, b) in enumerate(itertools.pairwise(cuts))
    ]
    same(whole, run(files[::-1], tmp_path / "out", block())[0])


def test_small_stretches_change_nothing(
    table: pd.DataFrame, whole: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Memory bounds: rows set down at once, taken up again in small pieces."""
    fine = run([save(table, tmp_path / "log.csv")], tmp_path / "one", block())[0]
    same(whole, fine)
    monkeypatch.setattr(spill, "BUDGET", 5000)
    monkeypatch.setattr(spill, "WINDOW_ROWS", 120)
    monkeypatch.setattr(stretch, "WINDOW_ROWS", 10_000)
    pieces = run([save(table, tmp_path / "log.csv")], tmp_path / "two", None)[0]
    without_map = run([save(table, tmp_path / "log.csv")], tmp_path / "three", None)[0]
    same(pieces, without_map)
    assert pieces.read("T0").trip_ids().tolist() == whole.read("T0").trip_ids().tolist()
    assert np.array_equal(pieces.read("T1").floats("speed"), whole.read("T1").floats("speed"))


def test_rows_that_come_late_are_sorted_in(table: pd.DataFrame, whole: Dataset, tmp_path: Path) -> None:
    """Order within the window of a minute does not matter."""
    rng = np.random.default_rng(3)
    order = np.argsort(np.arange(len(table)) + rng.uniform(0, 20, len(table)), kind="stable")
    same(whole, run([save(table.iloc[order], tmp_path / "log.csv")], tmp_path / "out", block())[0])


def test_what_comes_back_is_what_went_out(whole: Dataset, tmp_path: Path) -> None:
    """Writing the dataset out as CSV and importing that changes nothing, edges and trips among it."""
    rows = []
    for vehicle in whole.vehicles:
        t = whole.read(vehicle)
        columns = {n: v.strings() if isinstance(v, Labels) else v for n, v in t.columns.items()}
        rows.append(
            pd.DataFrame(
                {
                    "vehicle_id": vehicle,
                    "timestamp": [f"{np.datetime64(int(k), 'us')}Z" for k in t.time],
                    **columns,
                }
            )
        )
    again, summary = run([save(pd.concat(rows), tmp_path / "log.csv")], tmp_path / "out", block())
    same(whole, again)
    assert not summary.derived and not summary.damaged


DAMAGE = [
    "fine",
    "duplicate",
    "same time",
    "back",
    "jump",
    "nowhere",
    "off",
    "text",
    "ragged",
    "value",
    "no id",
    "no fix",
]


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.sampled_from(DAMAGE), min_size=1, max_size=60), st.booleans())
def test_every_row_is_in_the_dataset_or_refused(
    tmp_path_factory: pytest.TempPathFactory, damage: list[str], with_map: bool
) -> None:
    folder = tmp_path_factory.mktemp("x")
    lines = ["vehicle_id,timestamp,latitude,longitude,soc"]
    t = START

    def line(vehicle: str, time: int, latitude: Any, longitude: Any, soc: Any = 0.5) -> str:
        return f"{vehicle},{np.datetime64(time, 'us')}Z,{latitude},{longitude},{soc}"

    for what in ["fine"] * 12 + damage:
        t += 1_000_000
        good = line("A", t, 49.9769, 9.1513 + (t - START) * 1e-11)
        lines.append({
            "fine": good, "duplicate": lines[-1], "same time": line("A", t - 1_000_000, 49.9769, 9.15131, 0.4),
            "back": line("A", t - 86_400_000_000, 49.9769, 9.1513), "jump": line("A", t, 49.99, 9.1513),
            "nowhere": line("A", t, 0, 0), "off": line("A", t, 149.9, 9.1), "text": line("A", t, "here", 9.1),
            "ragged": good + ",7", "value": line("A", t, 49.9769, 9.1513, 1.7), "no id": line("", t, 49.9769, 9.1513),
            "no fix": line("A", t, "", ""),
        }[what])  # fmt: skip
    path = folder / "log.csv"
    path.write_text("\n".join(lines) + "\n")
    dataset, summary = run([path], folder / "out", block() if with_map else None)
    kept = dataset.path / "rejected.parquet"
    refused = (
        pd.read_parquet(kept) if kept.exists() else pd.DataFrame({"kind": [], "record": [], "reason": []})
    )
    rows = refused[refused.kind == "row"]
    assert summary.rows_read == len(lines) - 1 == dataset.rows + len(rows)
    assert sum(len(dataset.read(v)) for v in dataset.vehicles) == dataset.rows == summary.rows
    assert not rows.record.duplicated().any()
    assert summary.rejected == rows.reason.value_counts().to_dict()
    assert summary.rejected_values == refused[refused.kind == "value"].reason.value_counts().to_dict()
    assert summary.exit_status == (3 if len(refused) else 0)
    lost = set(rows.record)
    expected = {14 + i for i, what in enumerate(damage) if what in ("off", "text", "ragged", "no id")}
    assert expected <= lost
    fine = {14 + i for i, what in enumerate(damage) if what in ("no fix", "nowhere")}
    # a row that repeats the line before it may have been damaged itself
    assert not {
        r for r in fine if rows[rows.record == r].reason.isin(["impossible jump of the position"]).any()
    }


def both(table: pd.DataFrame, shift: float) -> pd.DataFrame:
    x, y = FRAME.to_local(table.latitude, table.longitude)
    return table.assign(x=x + shift, y=y)


def test_a_log_with_both_kinds_of_position(table: pd.DataFrame, whole: Dataset, tmp_path: Path) -> None:
    """Local positions that agree are the dataset's own; those in another frame are kept beside the geographic ones."""
    agree, _ = run([save(both(table, 0.0), tmp_path / "log.csv")], tmp_path / "a", block())
    assert np.allclose(agree.read("T0").floats("x"), whole.read("T0").floats("x"), atol=1e-6)
    other, _ = run([save(both(table, 5e5), tmp_path / "log.csv")], tmp_path / "b", block())
    t = other.read("T0")
    assert np.allclose(t.floats("x"), whole.read("T0").floats("x"), atol=1e-6)
    assert np.allclose(t.floats("x_log"), whole.read("T0").floats("x") + 5e5, atol=1e-5)
    local = Site("block", None, block().network)
    placed, summary = run([save(both(table, 0.0), tmp_path / "log.csv")], tmp_path / "c", local)
    assert (
        np.allclose(placed.read("T0").floats("x"), whole.read("T0").floats("x"), atol=1e-6)
        and summary.matched == 1.0
    )
    with pytest.raises(DataError, match="does not say where on earth"):
        run([save(table, tmp_path / "log.csv")], tmp_path / "d", local)


def test_every_file_has_the_same_columns(table: pd.DataFrame, tmp_path: Path) -> None:
    """Databases read the parts together, although one truck's log has columns that the other's has not."""
    import pyarrow.parquet as pq

    first, second = (table[table.vehicle_id == v] for v in ("T0", "T1"))
    a = save(first.assign(word="w", figure=1.5, mixed=2.0), tmp_path / "a.csv")
    b = save(second.drop(columns="Mode").assign(mixed="m"), tmp_path / "b.csv")
    dataset, _ = run([a, b], tmp_path / "out")
    schemas = [pq.read_schema(p) for v in dataset.vehicles for p in dataset.parts(v)]
    assert len(schemas) == 4 and all(s.equals(schemas[0]) for s in schemas)
    assert dataset.read("T0").labels("mixed").strings()[0] == "2"
    assert dataset.read("T1").floats("payload").size and "word" not in dataset.read("T1")


def test_a_log_that_threads_read_makes_the_same_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Late rows, a clock that runs backwards for a moment and broken lines among them."""
    monkeypatch.setattr(_csv_table, "SIZE", 2000)
    lines = log().to_csv(index=False).splitlines()
    lines[300:300] = ["T0,no time", *lines[10:12]]
    lines[500], lines[520] = lines[520], lines[500]
    (tmp_path / "log.csv").write_text("\n".join(lines))
    made = {}
    for workers in (1, 3):
        out = tmp_path / str(workers)
        with engines.using(workers), DatasetWriter.create(out, "recorded", block()) as writer:
            summary = import_logs([tmp_path / "log.csv"], block(), writer)
        made[workers] = {p.relative_to(out): p.read_bytes() for p in out.rglob("*") if p.is_file()}
    assert len(summary.rejected) > 1
    assert made[1] == made[3]

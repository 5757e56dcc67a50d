"""What the contract says of a dataset: files, columns, units, null for unknown, layout, edges, provenance."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from .conftest import HEAD, Run, ask, drive, log

UNITS = {
    "x": "m", "y": "m", "z": "m", "heading": "rad", "speed": "m/s", "edge_offset": "m", "lateral_offset": "m",
    "payload": "kg", "fork_height": "m", "battery_power": "W", "battery_voltage": "V", "battery_current": "A",
    "soc": "1", "ambient_temperature": "degC",
}  # fmt: skip


def test_the_files_columns_and_units_of_the_contract(run: Run, tmp_path: Path, road: Path) -> None:
    source = log(tmp_path / "log.csv", drive("a") + drive("b"))
    assert run("import", source, "--site", road, "-o", "out").status == 0
    out = tmp_path / "out"
    names = {p.name for p in out.iterdir()}
    assert {
        "dataset.json",
        "trajectories",
        "trips.parquet",
        "recording.rrd",
    } <= names and "rejected.parquet" not in names
    parts = sorted((out / "trajectories").rglob("*.parquet"))
    shape = r"date=\d{4}-\d\d-\d\d/vehicle_id=[ab]/part-\d+\.parquet"
    assert len(parts) == 2
    assert all(re.fullmatch(shape, str(p.relative_to(out / "trajectories").as_posix())) for p in parts)
    schema = pq.read_schema(parts[0])
    for name, unit in UNITS.items():
        field = schema.field(name)
        assert field.type == pa.float64() and field.metadata[b"unit"] == unit.encode(), name
    assert schema.field("timestamp").type == pa.timestamp("us", "UTC")
    assert schema.field("trip_id").type == pa.int64()
    assert pa.types.is_string(schema.field("edge_id").type) or pa.types.is_dictionary(
        schema.field("edge_id").type
    )

    about = json.loads((out / "dataset.json").read_text())
    keys = {"format_version", "kind", "site", "vehicles", "start", "end", "rows", "columns", "provenance"}
    assert keys <= about.keys() and about["kind"] == "recorded" and about["rows"] == 60
    made = about["provenance"]
    assert made["command"].startswith("fleetlog import") and made["version"] and "seed" in made
    assert made["inputs"][0]["sha256"] == hashlib.sha256(source.read_bytes()).hexdigest()


def test_unknown_is_null_and_never_zero(run: Run, tmp_path: Path) -> None:
    rows = [[*r, "" if i % 2 else 0, "x" if i % 3 == 0 else ""] for i, r in enumerate(drive())]
    log(tmp_path / "log.csv", rows, HEAD.strip() + ",payload,Meldung\n")
    assert run("import", "log.csv", "-o", "out", "--no-recording").status == 0
    out = tmp_path / "out"
    unknown = "z, soc, battery_power, battery_voltage, battery_current, fork_height, ambient_temperature, edge_id, edge_offset, lateral_offset"
    assert ask(out, unknown, "group by all") == [(None,) * 10]
    assert ask(out, "count(payload), max(payload), count(Meldung)") == [(15, 0.0, 10)]


def test_duckdb_and_polars_read_the_folder_as_it_is(run: Run, tmp_path: Path) -> None:
    pl = pytest.importorskip("polars")
    ids = {"Stapler Ä/1", "../../evil", "日本", "a b=c%", "."}
    log(tmp_path / "lög ß.csv", [r for v in sorted(ids) for r in drive(v, 10)])
    assert run("import", "lög ß.csv", "-o", "öut put", "--no-recording").status == 0
    out = tmp_path / "öut put"
    assert {v for (v,) in ask(out, "distinct vehicle_id")} == ids
    assert (
        set(pl.read_parquet(out / "trajectories" / "**" / "*.parquet", hive_partitioning=True)["vehicle_id"])
        == ids
    )
    assert {p.name for p in tmp_path.iterdir()} == {"lög ß.csv", "öut put"}  # no id leads out of the folder


@pytest.mark.parametrize(("step", "edge", "heading"), [(1e-5, "r", 0.0), (-1e-5, "-r", 3.1416)])
def test_an_edge_is_named_by_its_direction(
    run: Run, tmp_path: Path, road: Path, step: float, edge: str, heading: float
) -> None:
    log(tmp_path / "log.csv", drive(east=step, longitude=9.1505))
    assert run("import", "log.csv", "--site", road, "-o", "out", "--no-recording").status == 0
    assert ask(tmp_path / "out", "distinct edge_id") == [(edge,)]
    ((grows, turn),) = ask(
        tmp_path / "out",
        "max_by(edge_offset, timestamp) - min_by(edge_offset, timestamp), median(abs(heading))",
    )
    assert grows == pytest.approx(29 * 0.7174, rel=0.01) and turn == pytest.approx(heading, abs=0.01)


def test_times_increase_whatever_the_clock_did(run: Run, tmp_path: Path) -> None:
    rows = drive(rows=40)
    back = [[v, t, a, f"{float(o) + 1e-4:.9f}"] for v, t, a, o in rows[5:35]]
    earlier = drive(rows=100, start="2026-03-02T03:00:00")
    log(tmp_path / "log.csv", rows + back + earlier + rows[:3])
    done = run("import", "log.csv", "-o", "out", "--no-recording", "--json")
    assert done.status == 3
    inner = "epoch_us(timestamp) - lag(epoch_us(timestamp)) over (partition by vehicle_id order by filename, file_row_number) as d"
    files = f"read_parquet('{tmp_path}/out/trajectories/**/*.parquet', filename = true, file_row_number = true, hive_partitioning = true)"
    import duckdb

    assert duckdb.sql(f"select min(d) > 0 from (select {inner} from {files})").fetchall() == [(True,)]
    said = done.json
    assert said["rows_read"] == said["rows"] + said["rows_rejected"] + said["rows_joined"] == 173
    rejected = pq.read_table(tmp_path / "out" / "rejected.parquet")
    assert rejected.num_rows == said["rows_rejected"] == sum(said["rejected"].values())


def test_local_metres_and_a_frame_that_is_not_known(run: Run, tmp_path: Path) -> None:
    rows = [[v, t, i * 0.5, 10] for i, (v, t, _, _) in enumerate(drive())]
    log(tmp_path / "log.csv", rows, "vehicle_id,timestamp,x,y\n")
    assert run("import", "log.csv", "-o", "out", "--no-recording").status == 0
    assert ask(tmp_path / "out", "min(x), max(x), min(y), max(y)") == [(0.0, 14.5, 10.0, 10.0)]
    assert json.loads((tmp_path / "out" / "dataset.json").read_text())["site"]["frame"] is None


def test_slow_fast_and_single_rows(run: Run, tmp_path: Path) -> None:
    log(
        tmp_path / "log.csv",
        drive("slow", 50, 10.0, east=1e-4) + drive("fast", 1000, 0.02, east=4e-7) + drive("one", 1),
    )
    assert run("import", "log.csv", "-o", "out").status == 0
    speeds = dict(ask(tmp_path / "out", "vehicle_id, avg(speed)", "group by 1"))
    assert speeds["slow"] == pytest.approx(0.7174, rel=0.01) and speeds["fast"] == pytest.approx(
        1.4348, rel=0.01
    )
    assert speeds["one"] is None


def test_steady_rounds_are_no_stuck_sensor(run: Run, tmp_path: Path) -> None:
    """A truck with a governor drives the same round for an hour at the same speed, and is back where it was each time."""
    import math

    rows = [
        [*r[:2], 20 * math.cos(i * 0.1), 20 * math.sin(i * 0.1), 2.0] for i, r in enumerate(drive(rows=3600))
    ]
    log(tmp_path / "log.csv", rows, "vehicle_id,timestamp,x,y,speed\n")
    done = run("import", "log.csv", "-o", "out", "--no-recording")
    assert done.status == 0 and "stuck" not in done.out
    assert ask(tmp_path / "out", "min(speed), max(speed)") == [(2.0, 2.0)]


def test_two_hundred_vehicles(run: Run, tmp_path: Path) -> None:
    log(tmp_path / "log.csv", [r for i in range(200) for r in drive(f"T{i:03d}", 5)])
    assert run("import", "log.csv", "-o", "out", "--no-recording").status == 0
    assert ask(tmp_path / "out", "count(distinct vehicle_id), count(*)") == [(200, 1000)]

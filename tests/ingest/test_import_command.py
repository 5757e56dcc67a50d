"""``fleetlog import`` as a person meets it: exit statuses, one clear line, nothing half done."""

from __future__ import annotations

import gzip
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from fleetlog.store import Dataset

SAMPLE = Path(__file__).parents[2] / "sample_data"
HEADER = "vehicle_id,timestamp,latitude,longitude\n"


def fleetlog(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "fleetlog", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def rows(count: int, start: int = 0) -> str:
    return "".join(
        f"A,2026-03-02T{5 + i // 3600:02d}:{i // 60 % 60:02d}:{i % 60:02d}Z,{49.9769 + 1e-5 * (i % 4000):.6f},9.1513\n"
        for i in range(start, start + count)
    )


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "log.csv"
    path.write_text(HEADER + rows(120))
    return path


def test_without_a_map(log: Path, tmp_path: Path) -> None:
    done = fleetlog("import", log, "-o", tmp_path / "out", "--no-recording")
    assert (done.returncode, done.stderr) == (0, "")
    dataset = Dataset(tmp_path / "out")
    assert dataset.rows == 120 and dataset.site.frame is not None
    assert not dataset.read("A").has("edge_id")
    assert np.abs(dataset.read("A").floats("x")).max() < 100.0
    assert "derived: heading, speed" in done.stdout


@pytest.mark.parametrize("sign", [1, -1])
def test_a_battery_that_driving_charges_is_told(tmp_path: Path, sign: int) -> None:
    head, *body = (HEADER + rows(120)).splitlines()
    # Standing it is charged: that is no wrong sign.
    power = [(900 if i < 60 else -9000) * sign for i in range(120)]
    lines = [f"{r},{1.1 if i < 60 else 0},{p}" for i, (r, p) in enumerate(zip(body, power, strict=True))]
    (tmp_path / "log.csv").write_text("\n".join([f"{head},speed,battery_power", *lines]))
    done = fleetlog("import", tmp_path / "log.csv", "-o", tmp_path / "out", "--no-recording")
    told = "battery power of A is negative while driving" in done.stdout
    assert done.returncode == 0 and told == (sign < 0)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({}, None),
        ({"power": 0.001}, "as if it were in kW"),
        ({"place": 1000.0, "no speed": True}, "may be in mm"),
        ({"place": 1000.0}, "m/s, they in mm"),
        ({"turn": True}, "as if it were clockwise from north"),
        ({"globe": np.pi / 180}, "if they are radians"),
        ({"day": "2006-07-17"}, "GPS weeks rolled over"),
    ],
)
def test_units_and_clocks_that_cannot_be_meant_are_asked_for(
    tmp_path: Path, wrong: dict[str, Any], said: str | None
) -> None:
    lines = ["vehicle_id,timestamp,x,y,speed,heading,battery_power"]
    if "globe" in wrong:
        lines = [lines[0].replace("x,y", "longitude,latitude")]
    day, scale, heading = wrong.get("day", "2026-03-02"), wrong.get("place", 1.0), 0.7
    for i in range(300):
        x, y = 2.0 * i * np.cos(heading) * scale, 2.0 * i * np.sin(heading) * scale
        if "globe" in wrong:
            x, y = (wrong["globe"] * v for v in (9.15 + 1e-5 * x, 49.97 + 1e-5 * y))
        angle = np.pi / 2 - heading if "turn" in wrong else heading
        cells = [
            f"{x:.9f}",
            f"{y:.9f}",
            "" if "no speed" in wrong else 2.0,
            f"{angle:.4f}",
            3000.0 * wrong.get("power", 1.0),
        ]
        lines.append(f"A,{day}T05:{i // 60:02d}:{i % 60:02d}Z," + ",".join(map(str, cells)))
    (tmp_path / "log.csv").write_text("\n".join(lines))
    out = fleetlog("import", tmp_path / "log.csv", "-o", tmp_path / "out", "--no-recording").stdout
    phrases = ("as if it were", "may be in mm", "radians", "rolled over")
    assert any(p in out for p in phrases) == (said is not None), out
    assert said is None or said in out


def test_json_is_one_object_and_provenance_is_kept(log: Path, tmp_path: Path) -> None:
    done = fleetlog("import", log, "-o", tmp_path / "out", "--no-recording", "--json")
    summary = json.loads(done.stdout)
    assert summary["rows"] == summary["rows_read"] == 120 and summary["vehicles"] == {"A": 120}
    meta = Dataset(tmp_path / "out").meta
    assert (
        meta["provenance"]["inputs"][0]["file"] == "log.csv"
        and len(meta["provenance"]["inputs"][0]["sha256"]) == 64
    )
    assert meta["summary"]["rows"] == 120


def test_rejected_rows_are_status_3_and_kept(log: Path, tmp_path: Path) -> None:
    log.write_text(HEADER + rows(60) + "A,2026-03-02T05:01:00Z,49.9,9.1,7\n" + rows(60, 60))
    done = fleetlog("import", log, "-o", tmp_path / "out", "--no-recording")
    assert done.returncode == 3
    kept = pq.read_table(tmp_path / "out" / "rejected.parquet").to_pylist()
    assert kept == [{"file": "log.csv", "record": 62, "kind": "row", "reason": "the line has more fields than the header",
                     "text": "A,2026-03-02T05:01:00Z,49.9,9.1,7"}]  # fmt: skip
    assert str(tmp_path / "out" / "rejected.parquet") in done.stdout


def test_a_truncated_log_gives_what_is_whole(log: Path, tmp_path: Path) -> None:
    packed = gzip.compress((HEADER + rows(5000)).encode())
    path = tmp_path / "cut.csv.gz"
    path.write_bytes(packed[: len(packed) * 3 // 4])
    done = fleetlog("import", path, "-o", tmp_path / "out", "--no-recording")
    assert done.returncode == 3 and "cut off" in done.stdout
    assert 1000 < Dataset(tmp_path / "out").rows < 5000


NOT_LOGS = {
    "empty": (b"", "empty"),
    "header only": (HEADER.encode(), "has a header and no rows"),
    "binary": (bytes(range(256)) * 200, "no log format fits"),
    "no position": (b"vehicle_id,timestamp,soc\nA,2026-03-02T05:00:00Z,0.5\n", "no position and no speed"),
    "no time": (b"vehicle_id,latitude,longitude\nA,49,9\n", "no time"),
    "all refused": (HEADER.encode() + b"A,soon,49,9\nA,2026-03-02T05:00:00Z,here,9\n", "no usable row"),
}


@pytest.mark.parametrize("kind", NOT_LOGS)
def test_what_is_no_log_is_refused_in_one_line(tmp_path: Path, kind: str) -> None:
    content, word = NOT_LOGS[kind]
    path = tmp_path / "log.csv"
    path.write_bytes(content)
    done = fleetlog("import", path, "-o", tmp_path / "out")
    assert done.returncode == 1 and done.stdout == ""
    assert word in done.stderr and "log.csv" in done.stderr and done.stderr.count("\n") == 1
    assert [p.name for p in tmp_path.iterdir()] == ["log.csv"]


def test_a_workbook_is_to_be_saved_as_csv(tmp_path: Path) -> None:
    path = tmp_path / "log.xlsx"
    path.write_bytes(bytes(range(256)))
    assert "save its sheet as CSV" in fleetlog("import", path, "-o", tmp_path / "out").stderr


def test_a_log_of_another_place_is_refused(shared_data: Path, log: Path, tmp_path: Path) -> None:
    site = shared_data / "blind" / "aux" / "site.toml"
    log.write_text(HEADER + rows(100).replace(",49.", ",48."))
    done = fleetlog("import", log, "--site", site, "-o", tmp_path / "out")
    assert done.returncode == 1 and "km from the map" in done.stderr
    log.write_text("vehicle_id,timestamp,longitude,latitude\n" + rows(100))
    done = fleetlog("import", log, "--site", site, "-o", tmp_path / "out")
    assert done.returncode == 1 and "exchanged" in done.stderr
    assert not (tmp_path / "out").exists()


def test_usage(log: Path, tmp_path: Path) -> None:
    assert fleetlog("import", log).returncode == 2
    assert fleetlog("import").returncode == 2
    missing = fleetlog("import", tmp_path / "none.csv", "-o", tmp_path / "out")
    assert missing.returncode == 1 and "no such file" in missing.stderr
    wrong = fleetlog("import", log, "--format", "cvs", "-o", tmp_path / "out")
    assert wrong.returncode == 2 and "csv" in wrong.stderr


def test_an_older_dataset_is_left_alone(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine").write_text("x")
    assert fleetlog("import", log, "-o", out, "--no-recording").returncode == 1
    assert (out / "mine").exists()
    again = fleetlog("import", log, "-o", out, "--no-recording", "--overwrite")
    assert again.returncode == 1 and "not made by fleetlog" in again.stderr and (out / "mine").exists()
    (out / "mine").unlink()
    for _ in range(2):
        assert fleetlog("import", log, "-o", out, "--no-recording", "--overwrite").returncode == 0
    assert Dataset(out).rows == 120


def test_dry_run_writes_nothing(log: Path, tmp_path: Path) -> None:
    log.write_text(
        "id;time;lat;lon;speed_kmh\n"
        + "".join(f"A;2026-03-02T05:00:{i:02d}Z;49.9;9.1;{36 + i}\n" for i in range(20))
    )
    done = fleetlog("import", log, "--dry-run")
    assert done.returncode == 0 and "speed_kmh is speed, from km/h" in done.stdout
    lines = done.stdout.splitlines()
    table = lines[next(i for i, text in enumerate(lines) if "vehicle_id" in text and "latitude" in text) :]
    assert table[1].split() == ["A", "2026-03-02T05:00:00.000000Z", "49.9", "9.1", "10"] and len(table) == 6
    assert [p.name for p in tmp_path.iterdir()] == ["log.csv"]


def test_folders_patterns_and_damaged_companions(tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    logs.mkdir()
    for i in range(3):
        (logs / f"T{i}.csv").write_text(
            "timestamp,x,y\n" + "".join(f"2026-03-02T05:00:{k:02d}Z,{k},{i}\n" for k in range(30))
        )
    (logs / "readme.md").write_text("no log")
    done = fleetlog("import", logs, "-o", tmp_path / "a", "--no-recording")
    assert done.returncode == 0 and Dataset(tmp_path / "a").vehicles == ["T0", "T1", "T2"]
    assert fleetlog("import", str(logs / "T[01].csv"), "-o", tmp_path / "b", "--no-recording").returncode == 0
    assert Dataset(tmp_path / "b").vehicles == ["T0", "T1"]
    (logs / "T9.csv").write_bytes(bytes(range(256)) * 50)
    done = fleetlog("import", logs / "T0.csv", logs / "T9.csv", "-o", tmp_path / "c", "--no-recording")
    assert done.returncode == 3 and "T9.csv" in done.stdout and Dataset(tmp_path / "c").vehicles == ["T0"]


def big(path: Path, count: int) -> Path:
    path.write_text(HEADER + rows(count))
    return path


def test_interrupted(tmp_path: Path) -> None:
    path = big(tmp_path / "log.csv", 60_000)
    command = [
        sys.executable,
        "-m",
        "fleetlog",
        "import",
        str(path),
        "-o",
        str(tmp_path / "out"),
        "--no-recording",
    ]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while not list(tmp_path.glob(".out.partial*")) and time.monotonic() < deadline:
        time.sleep(0.005)
    process.send_signal(signal.SIGINT)
    # -2 is death by the signal itself, which a shell reports as 130 too: CPython ends so after an interrupt within exec().
    assert process.wait(60) in (130, -2)
    assert [p.name for p in tmp_path.iterdir()] == ["log.csv"]


@pytest.mark.slow
def test_killed_at_ten_moments(tmp_path: Path) -> None:
    """A killed import leaves nothing that looks finished; the next run gives the same bytes."""
    path = big(tmp_path / "log.csv", 68_000)
    command = [sys.executable, "-m", "fleetlog", "import", str(path), "--no-recording", "-o"]
    begin = time.monotonic()
    subprocess.run([*command, str(tmp_path / "whole")], check=True, capture_output=True)
    took = time.monotonic() - begin
    out = tmp_path / "out"
    for moment in np.random.default_rng(5).uniform(0.1, 0.98, 10) * took:
        process = subprocess.Popen([*command, str(out)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        time.sleep(float(moment))
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        if out.exists():  # killed after its end, while the interpreter shut down: then it is whole
            same_bytes(out, tmp_path / "whole")
            shutil.rmtree(out)
    subprocess.run([*command, str(out)], check=True, capture_output=True)
    assert not list(tmp_path.glob(".*partial*"))
    same_bytes(out, tmp_path / "whole")


def same_bytes(a: Path, b: Path) -> None:
    files = sorted(p.relative_to(a) for p in a.rglob("*.parquet"))
    assert files == sorted(p.relative_to(b) for p in b.rglob("*.parquet")) and files
    for name in files:
        assert (a / name).read_bytes() == (b / name).read_bytes(), name


@pytest.mark.parametrize("with_site", [True, False])
def test_a_log_without_positions_is_taken_and_says_what_cannot_be_asked(
    tmp_path: Path, with_site: bool
) -> None:
    """Speed, power and charge by time: every row comes back, nothing is matched, energy is told."""
    t = np.arange(600)
    speed = np.clip(np.minimum((t % 60) * 0.5, (55 - t % 60) * 0.5), 0.0, 2.5)
    lines = [
        f"A,2026-03-02T05:{s // 60:02d}:{s % 60:02d}Z,{v:.2f},{400 + 900 * v:.0f},{0.9 - 1e-5 * s:.5f}"
        for s, v in zip(t.tolist(), speed.tolist(), strict=True)
    ]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["vehicle_id,timestamp,speed,battery_power,soc", *lines]) + "\n")
    site = ["--site", SAMPLE / "site.toml"] if with_site else []
    done = fleetlog("import", path, *site, "-o", tmp_path / "out", "--no-recording")
    assert done.returncode == 0 and "no positions of A" in done.stdout
    found = Dataset(tmp_path / "out").read("A", "2026-03-02")
    assert len(found) == 600 and not found.has("x") and not found.has("edge_id")
    assert np.allclose(found.floats("speed"), np.round(speed, 2))
    done = fleetlog(
        "analyze", "energy", tmp_path / "out", "--truck", SAMPLE / "truck.toml", "-o", tmp_path / "e"
    )
    assert done.returncode == 0
    recorded = sum(400 + 900 * v for v in speed) / 3.6e6
    assert f"{recorded:.2f} kWh measured" in done.stdout
    heat = fleetlog("analyze", "heatmap", tmp_path / "out", "-o", tmp_path / "h")
    assert (
        heat.returncode == 1 and "import logs with positions" in heat.stderr and heat.stderr.count("\n") == 1
    )
    trips = fleetlog("analyze", "trips", tmp_path / "out", "-o", tmp_path / "t")
    assert trips.returncode == 0 and (tmp_path / "t" / "trips.png").is_file()


def driven(rows: int, blank: dict[str, set[int]]) -> list[str]:
    """A straight drive at 3 m/s, a row a second; some cells of each column are blank."""
    table = {
        "x": [3.0 * s for s in range(rows)], "y": [0.0] * rows, "speed": [3.0] * rows,
        "battery_voltage": [48.0] * rows, "battery_current": [30.0] * rows, "battery_power": [1440.0] * rows,
    }  # fmt: skip
    out = [f"vehicle_id,timestamp,{','.join(table)}"]
    for s in range(rows):
        cells = ["" if s in blank.get(name, ()) else str(values[s]) for name, values in table.items()]
        out.append(f" A,2026-03-02T05:{s // 60:02d}:{s % 60:02d}Z,{','.join(cells)}")
    return out


@pytest.mark.parametrize(
    ("blank", "filled", "unknown"),
    [
        ({}, {}, 0),
        ({"x": {*range(20, 40)}, "y": {*range(20, 40)}}, {"x": 20}, 0),
        ({"x": {*range(20, 90)}, "y": {*range(20, 90)}}, {}, 70),
        ({"speed": {*range(1, 100)}}, {"speed": 99}, 0),
        ({"battery_power": {5, 6, 50}}, {"battery_power": 3}, 0),
        ({"speed": {7}}, {"speed": 1}, 0),
    ],
    ids=["none", "short gap", "long gap", "speed", "power", "one"],
)
def test_values_that_a_log_lacks_are_counted_where_they_are_made(
    tmp_path: Path, blank: dict[str, set[int]], filled: dict[str, int], unknown: int
) -> None:
    path = tmp_path / "log.csv"
    path.write_text("\n".join(driven(100, blank)) + "\n")
    done = fleetlog("import", path, "-o", tmp_path / "out", "--no-recording", "--json")
    summary = json.loads(done.stdout)
    assert summary["filled"] == filled and summary["derived"] == ["heading"]
    told = [note for note in summary["notes"] if "unknown in the log, or rejected" in note]
    assert [int(note.split()[0]) for note in told] == list(filled.values())
    assert all(note.startswith("1 speed comes from") for note in told if note.split()[0] == "1")
    assert int(np.isnan(Dataset(tmp_path / "out").read("A").floats("x")).sum()) == unknown
    assert "blanks about vehicle ids are left out, as of ' A'" in summary["files"][0]["notes"]


def test_positions_in_two_frames_are_said(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    lines = [f"A,2026-03-02T05:00:{s:02d}Z,{49.98 + 1e-5 * s},9.15,{1.1 * s},0" for s in range(60)]
    path.write_text("\n".join(["vehicle_id,timestamp,latitude,longitude,x,y", *lines]) + "\n")
    done = fleetlog("import", path, "-o", tmp_path / "out", "--no-recording")
    assert "60 rows have latitude and longitude" in done.stdout and "x_log, y_log" in done.stdout
    assert Dataset(tmp_path / "out").read("A").floats("x_log").tolist() == pytest.approx(1.1 * np.arange(60))


def test_what_was_read_is_named(log: Path, tmp_path: Path) -> None:
    """An import reads the site and its map beside the log, a mission driven again the dataset."""
    fleetlog("import", log, "--site", SAMPLE / "site.toml", "-o", tmp_path / "out", "--no-recording")
    again = tmp_path / "again"
    fleetlog("simulate", "--like", tmp_path / "out", "--truck", SAMPLE / "truck.toml", "--same-mission",
             "--no-recording", "-o", again)  # fmt: skip
    named = [
        {f["file"]: f["sha256"] for f in Dataset(d).meta["provenance"]["inputs"]}
        for d in (tmp_path / "out", again)
    ]
    assert set(named[0]) == {"log.csv", "site.toml", "roads.geojson"}
    assert named[0]["roads.geojson"] == hashlib.sha256((SAMPLE / "roads.geojson").read_bytes()).hexdigest()
    assert set(named[1]) == {"truck.toml", "out/dataset.json"}


def test_a_whole_file_without_positions_is_not_damaged(log: Path, shared_data: Path, tmp_path: Path) -> None:
    talk = shared_data / "logs" / "mcap" / "talker.mcap"
    done = fleetlog("import", log, talk, "-o", tmp_path / "out", "--no-recording", "--json")
    files = {f["file"]: f for f in json.loads(done.stdout)["files"]}
    assert done.returncode == 0 and not files["talker.mcap"]["damage"]
    assert "carries a position" in files["talker.mcap"]["notes"][0]


def test_rows_that_are_there_are_not_added_again(log: Path, tmp_path: Path) -> None:
    fleetlog("import", log, "-o", tmp_path / "out", "--no-recording")
    done = fleetlog("import", log, "-o", tmp_path / "out", "--append")
    assert done.returncode == 1 and done.stderr.count("\n") == 1
    assert str(tmp_path / "out") in done.stderr and "leave out the logs of that time" in done.stderr

"""What the contract says of commands: statuses, where messages go, whole output or none, and what is said of bad input."""

from __future__ import annotations

import gzip
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from .conftest import HEAD, Run, ask, drive, log, process


def test_json_is_one_object_and_nothing_else(run: Run, tmp_path: Path, road: Path) -> None:
    log(tmp_path / "log.csv", drive())
    done = run("import", "log.csv", "--site", road, "-o", "out", "--no-recording", "--json")
    assert done.status == 0 and done.json["rows"] == 30 and "1 road read" in done.err
    for path in ("out", "log.csv", road):
        assert run("info", path, "--json").json["kind"] in ("dataset", "log", "map")
    shown = run("import", "log.csv", "--dry-run", "--json")
    assert shown.status == 0 and len(shown.json["rows"]["log.csv"]) == 5


@pytest.mark.parametrize(
    ("arguments", "status", "says"),
    [
        (["import"], 2, "LOG"),
        (["import", "log.csv"], 2, "-o"),
        (["import", "log.csv", "-o", "q", "--bogus"], 2, "--bogus"),
        (["import", "log.csv", "-o", "q", "--format", "cvs"], 2, "csv"),
        (["import", "log.csv", "-o", "q", "--site", "nope"], 1, "nope"),
        (["import", "nope.csv", "-o", "q"], 1, "no such file"),
        (["import", "empty.csv", "-o", "q"], 1, "the file is empty; give a log with rows"),
        (["import", "header.csv", "-o", "q"], 1, "has a header and no rows"),
        (["import", "folder", "-o", "q"], 1, "no log in it"),
        (["import", "log.csv", "--site", "log.csv", "-o", "q"], 1, "not a map"),
        (["import", "log.csv", "--profile", "semicolon.toml", "-o", "q"], 1, "delimiter"),
        (["import", "log.csv", "--profile", "broken.toml", "-o", "q"], 1, "TOML"),
        (["info", "empty.csv"], 1, "empty"),
        (["info", "empty.toml"], 1, "docs/reference/truck.md or docs/maps.md"),
        (["simulate", "--experiment", "empty.toml", "-o", "q"], 1, "empty.toml: holds no setting"),
        (["info", "folder"], 1, "dry-run"),
    ],
)
def test_one_line_says_what_is_wrong(
    run: Run, tmp_path: Path, arguments: list[str], status: int, says: str
) -> None:
    log(tmp_path / "log.csv", drive())
    log(tmp_path / "header.csv", [])
    (tmp_path / "empty.csv").touch()
    (tmp_path / "empty.toml").touch()
    (tmp_path / "folder").mkdir()
    (tmp_path / "semicolon.toml").write_text('delimiter = ";"\n')
    (tmp_path / "broken.toml").write_text("[time\n")
    done = run(*arguments)
    assert done.status == status and says in done.err and not done.out
    assert status == 2 or len(done.err.splitlines()) == 1
    assert not (tmp_path / "q").exists()


def test_exchanged_coordinates_are_kilometres_from_the_map(run: Run, tmp_path: Path, road: Path) -> None:
    log(tmp_path / "log.csv", [[v, t, o, a] for v, t, a, o in drive()])
    done = run("import", "log.csv", "--site", road, "-o", "out")
    assert done.status == 1 and "km from the map" in done.err and "exchanged" in done.err
    assert not (tmp_path / "out").exists()


def test_refused_rows_are_kept_and_said(run: Run, tmp_path: Path) -> None:
    rows = drive(rows=40)
    for i, bad in enumerate(("inf", "1e400", "1e308", "north")):
        rows[10 + i][2] = bad
    rows[20][0] = ""
    log(tmp_path / "log.csv", rows)
    done = run("import", "log.csv", "-o", "out", "--no-recording")
    assert done.status == 3 and "rejected.parquet" in done.out and "rejected rows: 5" in done.out
    kept = pq.read_table(tmp_path / "out" / "rejected.parquet").to_pylist()
    assert sorted(r["record"] for r in kept) == [12, 13, 14, 15, 22]
    assert ask(tmp_path / "out", "count(*), bool_and(isfinite(x))") == [(35, True)]


def test_overwrite_replaces_an_older_output_and_nothing_else(run: Run, tmp_path: Path) -> None:
    log(tmp_path / "log.csv", drive())
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "notes.txt").write_text("kept")
    assert run("import", "log.csv", "-o", "mine", "--overwrite").status == 1
    assert (mine / "notes.txt").read_text() == "kept"
    assert run("import", "log.csv", "-o", "log.csv", "--overwrite").status == 1

    assert run("import", "log.csv", "-o", "out", "--no-recording").status == 0
    assert "--overwrite" in run("import", "log.csv", "-o", "out").err
    log(tmp_path / "out" / "inside.csv", drive())
    done = run("import", "out/inside.csv", "-o", "out", "--overwrite")
    assert done.status == 1 and (tmp_path / "out" / "inside.csv").exists()
    stranger = run("import", "log.csv", "-o", "out", "--overwrite")
    assert (
        stranger.status == 1 and "inside.csv" in stranger.err and (tmp_path / "out" / "inside.csv").exists()
    )
    (tmp_path / "out" / "inside.csv").unlink()
    assert run("export", "out", "--to", "csv", "-o", "mine", "--overwrite").status == 1 and mine.is_dir()
    log(tmp_path / "log.csv", drive(rows=7))
    assert run("import", "log.csv", "-o", "out", "--overwrite", "--no-recording").status == 0
    assert ask(tmp_path / "out", "count(*)") == [(7,)]
    assert not list(tmp_path.glob(".*"))


def test_folders_patterns_and_packed_files(run: Run, tmp_path: Path) -> None:
    import zstandard

    for name in ("A", "B", "C", "D"):
        (tmp_path / "logs" / name).mkdir(parents=True)
    plain = [log(tmp_path / "logs" / n / "log.csv", drive(n, 10)) for n in "ABCD"]
    (tmp_path / "logs" / "C" / "log.csv.gz").write_bytes(gzip.compress(plain[2].read_bytes()))
    (tmp_path / "logs" / "D" / "log.csv.zst").write_bytes(zstandard.compress(plain[3].read_bytes()))
    plain[2].unlink()
    plain[3].unlink()
    shown = run("import", "logs", "--dry-run")
    assert shown.status == 0 and all(f"  {n} " in shown.out for n in "ABCD")
    assert run("import", "logs", "-o", "out", "--no-recording").status == 0
    assert ask(tmp_path / "out", "vehicle_id, count(*)", "group by 1 order by 1") == [(n, 10) for n in "ABCD"]
    assert run("import", "logs/*/log.csv", "-o", "two", "--no-recording", "--json").json["rows"] == 20


def test_one_unreadable_log_of_a_folder_is_told_of(run: Run, tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    log(tmp_path / "logs" / "good.csv", drive())
    (tmp_path / "logs" / "summary.csv").write_text("trip,mean\n1,2\n")
    for more in (["--dry-run"], ["-o", "out", "--no-recording"]):
        done = run("import", "logs", *more)
        assert done.status == 3 and "summary.csv" in done.out and "no time among the columns" in done.out


def test_decimal_commas_are_said_aloud(run: Run, tmp_path: Path) -> None:
    rows = [f"a;{t};49,97;{o.replace('.', ',')};1,5\n" for _, t, _, o in drive()]
    (tmp_path / "log.csv").write_text("vehicle_id;timestamp;latitude;longitude;speed\n" + "".join(rows))
    done = run("import", "log.csv", "-o", "out", "--no-recording")
    assert done.status == 0 and "decimal comma" in done.out
    assert ask(tmp_path / "out", "min(speed), round(max(x) - min(x), 1)") == [(1.5, 20.8)]


def test_zones_mixed_and_an_hour_that_comes_twice(run: Run, tmp_path: Path) -> None:
    rows = drive(rows=20)
    rows[3][1] = "2026-03-02T06:00:03+01:00"
    log(tmp_path / "log.csv", rows)
    assert run("import", "log.csv", "-o", "out", "--no-recording").status == 0
    assert ask(tmp_path / "out", "count(*), epoch(max(timestamp) - min(timestamp))") == [(20, 19.0)]

    hours = [*range(30, 60), *range(0, 60), *range(0, 30)]  # 01:30 to 02:59, then 02:00 to 02:29 again
    clock = [f"25.10.2026 0{1 if i < 30 else 2}:{m:02d}:00" for i, m in enumerate(hours)]
    log(tmp_path / "autumn.csv", [["a", t, 49.97, 9.15 + i * 1e-5] for i, t in enumerate(clock)])
    (tmp_path / "p.toml").write_text(
        '[time]\ncolumn = "timestamp"\nformat = "%d.%m.%Y %H:%M:%S"\nzone = "Europe/Berlin"\n'
    )
    done = run("import", "autumn.csv", "--profile", "p.toml", "-o", "autumn", "--no-recording")
    assert done.status == 0 and "comes twice" in done.out
    assert ask(tmp_path / "autumn", "count(*), epoch(max(timestamp) - min(timestamp))") == [(120, 119 * 60.0)]


def test_without_standard_input_and_with_a_full_disk_behind_standard_output(run: Run, tmp_path: Path) -> None:
    log(tmp_path / "log.csv", drive())
    closed = process(
        "import", "log.csv", "-o", "out", "--no-recording", cwd=tmp_path, stdin=subprocess.DEVNULL
    )
    assert closed.communicate()[1] == "" and closed.returncode == 0
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    with Path("/dev/full").open("w") as full:
        done = process("info", "log.csv", cwd=tmp_path, stdout=full)
        assert "fleetlog: standard output: No space left" in done.communicate()[1] and done.returncode == 1


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
@pytest.mark.parametrize(("name", "status"), [("SIGINT", 130), ("SIGKILL", -9)])
def test_stopped_half_way_leaves_nothing_that_looks_finished(tmp_path: Path, name: str, status: int) -> None:
    rows = "".join(",".join(r) + "\n" for r in drive(rows=2000, every=0.1, east=1e-7))
    source = tmp_path / "log.csv"
    source.write_text(HEAD + rows * 200)
    run_ = process("import", source, "-o", tmp_path / "out")
    deadline = time.monotonic() + 20
    while not list(tmp_path.glob(".out.partial*")) and time.monotonic() < deadline:
        time.sleep(0.01)
    run_.send_signal(getattr(signal, name))
    said = run_.communicate()[1]
    assert run_.returncode == status and not (tmp_path / "out").exists()
    if name == "SIGINT":
        assert said.splitlines()[-1] == "fleetlog: interrupted; nothing was written" and not list(
            tmp_path.glob(".*")
        )
    source.write_text(HEAD + rows)
    again = process("import", source, "-o", tmp_path / "out", "--no-recording")
    again.communicate()
    assert again.returncode == 0 and not list(tmp_path.glob(".*"))  # what the killed run left is gone


@pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() == 0, reason="the superuser may write everywhere"
)
def test_a_folder_that_is_read_only(run: Run, tmp_path: Path) -> None:
    log(tmp_path / "log.csv", drive())
    (tmp_path / "closed").mkdir(mode=0o555)
    done = run("import", "log.csv", "-o", "closed/out")
    assert done.status == 1 and "Permission denied" in done.err and len(done.err.splitlines()) == 1


def test_info_knows_every_kind_of_file(run: Run, shared_data: Path, tmp_path: Path) -> None:
    kinds = {
        "blind/grade/roads.geojson": "map", "blind/grade/site.toml": "site", "blind/grade/truck.toml": "truck",
        "blind/grade/recorded.csv.gz": "log", "maps/e6mini.xodr": "map", "logs/nmea/bt451.log": "log",
        "mapmatch/osmnx_drive_graph.graphml": "map", "tripviewer": "nothing", "SOURCES.md": "nothing",
    }  # fmt: skip
    for name, kind in kinds.items():
        done = run("info", shared_data / name, "--json")
        assert (done.status, json.loads(done.out or '{"kind": "nothing"}')["kind"]) == (
            int(kind == "nothing"),
            kind,
        )
    log(tmp_path / "log.csv", drive())
    assert run("import", "log.csv", "-o", "out").status == 0
    assert run("info", "out/recording.rrd", "--json").json["kind"] == "recording"
    shown = run("info", "out").out
    assert {"rows 30", "vehicles a 30", "trips 1", "days 1"} <= {
        " ".join(line.split()) for line in shown.splitlines()
    }


@pytest.mark.parametrize("name", ["aux", "clock", "cornering", "grade", "none", "surface"])
def test_the_recorded_plants_come_in_whole(run: Run, shared_data: Path, tmp_path: Path, name: str) -> None:
    folder = shared_data / "blind" / name
    done = run(
        "import",
        folder / "recorded.csv.gz",
        "--site",
        folder / "site.toml",
        "-o",
        "out",
        "--no-recording",
        "--json",
    )
    said = done.json
    assert done.status == 0 and said["rows"] == said["rows_read"] > 40_000 and said["matched"] > 0.99

"""What the corpus cannot say with one file: other kinds of files, profiles, folders, sites, and faults of our own."""

from __future__ import annotations

import os
import re
import socket
import struct
import tracemalloc
from dataclasses import replace
from pathlib import Path

import judge
import pyarrow.parquet as pq
import pytest
import seeds
from click.testing import CliRunner

from fleetlog.cli.main import cli
from fleetlog.core.truck import load_truck
from fleetlog.errors import FleetlogError, InputError, OutputError
from fleetlog.importers import mcap as mcap_importer
from fleetlog.importers._open import FREE, open_bytes
from fleetlog.importers._profile import load_profile
from fleetlog.importers.base import importers
from fleetlog.ingest.files import find_logs
from fleetlog.listening import listening, unheard
from fleetlog.physics.model import load_physics
from fleetlog.roads import load_site


def put(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


# --------------------------------------------------------------------------- only regular files


@pytest.mark.parametrize("what", ["pipe", "device", "socket"])
@pytest.mark.parametrize("suffix", ["toml", "csv", "xodr", "mcap"])
def test_only_regular_files_are_opened(what: str, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"a.{suffix}"
    if what == "pipe":
        os.mkfifo(path)
    elif what == "device":
        path.symlink_to("/dev/zero")
    else:
        server = socket.socket(socket.AF_UNIX)
        os.chdir(tmp_path)  # the name of a socket must be short
        server.bind(path.name)
    readers = (
        [load_truck, load_profile, load_site] if suffix == "toml" else [load_site] if suffix == "xodr" else []
    )
    for reader in readers:
        with pytest.raises(InputError, match=r"a pipe|a device|a socket|No such device"):
            reader(path)
    if suffix == "toml":
        with pytest.raises(InputError):
            load_physics(path, load_truck("counterbalance-2.5t"))
    for importer in importers().values() if suffix in ("csv", "mcap") else ():
        out = judge.read(path, importer=importer)
        assert out.status == 1 and ("not a regular file" in out.text or "No such device" in out.text), (
            importer.name,
            out.text,
        )


# --------------------------------------------------------------------------- bounds


@pytest.mark.parametrize("suffix", ["gz", "zst", "bz2"])
def test_a_bomb_takes_little_memory(suffix: str, tmp_path: Path) -> None:
    import bz2
    import gzip

    import zstandard

    pack = {"gz": gzip.compress, "zst": zstandard.ZstdCompressor().compress, "bz2": bz2.compress}[suffix]
    path = put(tmp_path / f"a.csv.{suffix}", pack(bytes(FREE // 2)) * 3)
    stream, _ = open_bytes(path)
    tracemalloc.start()
    with stream, pytest.raises(FleetlogError, match="unpacks to more than"):
        while stream.read(1 << 20):
            pass
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert path.stat().st_size < FREE / 250 and peak < 70 << 20


# --------------------------------------------------------------------------- rows are counted


def test_a_chunk_that_is_not_taken_for_one_is_found_by_its_index(tmp_path: Path) -> None:
    whole = seeds.mcap()
    at = seeds.chunks(whole)[3]
    out = judge.imported(put(tmp_path / "a.mcap", whole[:at] + b"\x07" + whole[at + 1 :]), tmp_path)
    assert (out.status, out.rows) == (3, seeds.ROWS)


def test_messages_that_the_statistics_count_and_nobody_finds_are_said(tmp_path: Path) -> None:
    whole = seeds.mcap()
    at = seeds.chunks(whole)[3]
    # A message record inside of a chunk becomes one of a kind of the writer's own.
    inner = whole.index(b'{"latitude"', at) - 22 - 9
    assert struct.unpack_from("<B", whole, inner) == (5,)
    out = judge.read(put(tmp_path / "a.mcap", whole[:inner] + b"\xc8" + whole[inner + 1 :]))
    assert (out.status, out.rows) == (3, seeds.ROWS - 1)
    assert "1 message that the file counts is not in it" in out.text


def test_ros2_metadata_counts(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    put(bag / "a.mcap", seeds.mcap())
    about = "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  message_count: {}\n"
    for stated, status in ((seeds.ROWS, 0), (seeds.ROWS + 5, 3)):
        (bag / "metadata.yaml").write_text(about.format(stated))
        out = judge.imported(bag, tmp_path)
        assert (out.status, out.rows) == (status, seeds.ROWS)
    assert "40 of the 45 messages" in out.text


NAMES = ["_file", "_record", "_channel", "_stuck", "_held", "_File", "date", "Speed_log", "VEHICLE_ID"]


def test_columns_with_names_of_ours_survive(tmp_path: Path) -> None:
    lines = seeds.csv().decode().split("\n")
    rows = [
        f"{line},{','.join(str(k + i) for k in range(len(NAMES)))}"
        for i, line in enumerate(lines[1:])
        if line
    ]
    path = put(tmp_path / "a.csv", "\n".join([f"{lines[0]},{','.join(NAMES)}", *rows, ""]).encode())
    out = judge.imported(path, tmp_path)
    assert (out.status, out.rows) == (0, seeds.ROWS)
    part = next((tmp_path / "out").glob("trajectories/*/vehicle_id=T0/*.parquet"))
    table = pq.ParquetFile(part).read().to_pydict()
    for k, name in enumerate(NAMES):
        found = [n for n in table if n in (name, f"{name}_log") and table[n][0] == float(k)]
        assert found, (name, sorted(table))


# --------------------------------------------------------------------------- nothing is made up


OF_DAY = b"vehicle_id,time,x,y\n" + b"".join(b"A,23:59:%02d,%d,0\n" % (i, i) for i in range(30))


def test_a_time_of_day_has_no_date_until_it_is_given_one(tmp_path: Path) -> None:
    path = put(tmp_path / "a.csv", OF_DAY)
    out = judge.read(path)
    assert out.status == 1 and "without a date" in out.text
    for style in ("", 'format = "%H:%M:%S"\n'):
        profile = put(tmp_path / "p.toml", f'[time]\ncolumn = "time"\n{style}'.encode())
        assert judge.read(path, profile).status == 1
        profile.write_text(f'[time]\ncolumn = "time"\n{style}origin = "2026-03-02"\nzone = "Europe/Berlin"\n')
        out = judge.imported(path, tmp_path, profile=profile)
        assert out.status == 0 and "2026-03-02 22:59:00" in out.text, out.text


@pytest.mark.parametrize("header", ["time [s]", "timestamp_ms", "time"])
@pytest.mark.parametrize("suffix", ["csv", "parquet", "geojson"])
def test_a_count_from_an_unknown_start_is_no_date(header: str, suffix: str, tmp_path: Path) -> None:
    """Seconds since the logger was switched on are not seconds since 1970, whatever the column is called."""

    def log(first: float) -> bytes:
        times = [first + i for i in range(40)]
        if suffix == "csv":
            return f"vehicle_id,{header},x,y\n".encode() + b"".join(
                b"A,%.1f,%d,0\n" % (t, t % 97) for t in times
            )
        if suffix == "parquet":
            return seeds.parquet(timestamp=None, **{header: times})
        points = [seeds.feature(i, **{header: t}) for i, t in enumerate(times)]
        for point in points:
            del point["properties"]["timestamp"]
        return seeds.collection(points)

    path = put(tmp_path / f"a.{suffix}", log(0.0))
    out = judge.read(path)
    assert out.status == 1 and re.search("unknown start|without a time", out.text), out.text
    unit = "ms" if "ms" in header else "s"
    profile = put(tmp_path / "p.toml", f'[time]\nformat = "{unit}"\norigin = 2026-03-02T05:00:00Z\n'.encode())
    assert judge.read(path, profile).rows == 40
    since = put(path, log(seeds.START * (1e3 if unit == "ms" else 1.0)))
    assert judge.read(since).rows == 40


def test_a_format_that_counts_from_1970_says_where_it_cannot_be_so(tmp_path: Path) -> None:
    """Trajectories and simulations begin at zero: the count is kept, and said to be no date."""
    put(tmp_path / "times.txt", b"".join(b"%.6e\n" % (0.1 * i) for i in range(40)))
    early = {
        "a.tum": b"".join(b"%d.5 %d 2 0 0 0 0 1\n" % (i, i) for i in range(40)),
        "a.fcd.xml": seeds.LOGS["sumo-fcd"][1]().replace(b"fleetlog-epoch", b"no epoch"),
        "00.txt": b"".join(b"1 0 0 %d 0 1 0 2 0 0 1 0\n" % i for i in range(40)),
    }
    for name, data in early.items():
        out = judge.read(put(tmp_path / name, data))
        assert out.rows == 40 and "unknown start, placed at 1970" in out.text, (name, out.text)
    assert "unknown start" not in judge.read(put(tmp_path / "b.tum", seeds.tum())).text
    assert "unknown start" not in judge.read(put(tmp_path / "b.csv", seeds.csv())).text


def test_midnight_is_the_next_day(tmp_path: Path) -> None:
    clock = [b"23:59:%02d" % (50 + i) if i < 10 else b"00:00:%02d" % (i - 10) for i in range(20)]
    rows = b"".join(b"A,%s,%d,0\n" % (time, i) for i, time in enumerate(clock))
    profile = put(tmp_path / "p.toml", b"[time]\norigin = 2026-03-02\n")
    out = judge.imported(put(tmp_path / "a.csv", b"vehicle_id,time,x,y\n" + rows), tmp_path, profile=profile)
    assert (out.status, out.rows) == (0, 20) and "2026-03-03 00:00:09" in out.text


@pytest.mark.parametrize("name", ["csv", "parquet", "geojson", "tum", "sumo-fcd"])
def test_a_count_begins_at_the_origin(name: str, tmp_path: Path) -> None:
    suffix, make = seeds.LOGS[name]
    data = {
        "csv": lambda: b"vehicle_id,time,x,y\n" + b"".join(b"A,%d.5,%d,0\n" % (i, i) for i in range(40)),
        "parquet": lambda: seeds.parquet(timestamp=[float(i) for i in range(40)]),
        "geojson": lambda: seeds.collection([seeds.feature(i, timestamp=float(i)) for i in range(40)]),
        "tum": lambda: b"".join(b"%d.5 %d 2 0 0 0 0 1\n" % (i, i) for i in range(40)),
        "sumo-fcd": lambda: make().replace(b"fleetlog-epoch", b"no epoch"),
    }[name]()
    profile = put(tmp_path / "p.toml", b'[time]\nformat = "s"\norigin = "2026-03-02T05:00:00Z"\n')
    if name == "csv":
        profile = put(
            tmp_path / "p.toml", b'[time]\ncolumn = "time"\nformat = "s"\norigin = "2026-03-02T05:00:00Z"\n'
        )
    out = judge.imported(put(tmp_path / f"a.{suffix}", data), tmp_path, profile=profile)
    assert (
        out.status == 0
        and "2026-03-02 05:00:00" in out.text
        and "1970" not in out.text.replace("from 1970", "")
    ), out.text


def test_dates_take_no_origin(tmp_path: Path) -> None:
    profile = put(tmp_path / "p.toml", b'[time]\norigin = "2026-03-02"\n')
    out = judge.read(put(tmp_path / "a.csv", seeds.csv()), profile)
    assert out.status == 1 and "p.toml, time.origin: the times have dates of their own" in out.text


@pytest.mark.parametrize("name", ["csv", "parquet", "geojson", "gpx", "vda5050"])
def test_a_profile_withholds_what_it_does_not_name(name: str, tmp_path: Path) -> None:
    suffix, make = seeds.LOGS[name]
    path = put(tmp_path / f"a.{suffix}", make())
    kept = judge.read(path).columns
    profile = put(tmp_path / "p.toml", b"keep = false\n")
    withheld = judge.read(path, profile).columns
    assert withheld <= {
        "x",
        "y",
        "z",
        "latitude",
        "longitude",
        "heading",
        "speed",
        "soc",
        "payload",
        "battery_voltage",
    }
    assert withheld <= kept and (withheld < kept or name == "gpx")
    out = judge.imported(
        put(tmp_path / "b.csv", seeds.csv().replace(b"n7\n", b"secret,1\n")), tmp_path, profile=profile
    )
    assert out.status == 3
    assert "secret" not in str(pq.read_table(tmp_path / "out" / "rejected.parquet").to_pydict())


# --------------------------------------------------------------------------- site and log


def degrees(x: str, y: str) -> bytes:
    return f"vehicle_id,timestamp,{x},{y},speed\n".encode() + b"".join(
        f"A,{seeds.iso(i)},{9.1501 + i * 1e-5:.6f},49.97000,1.0\n".encode() for i in range(60)
    )


def test_degrees_in_columns_called_x_and_y_are_noticed(tmp_path: Path) -> None:
    path = put(tmp_path / "a.csv", degrees("x", "y"))
    out = judge.imported(path, tmp_path)
    assert out.status == 0 and "look like degrees" in out.text
    site = put(tmp_path / "map.geojson", seeds.MAPS["map.geojson"])
    out = judge.imported(path, tmp_path, site)
    assert out.status == 1 and 'longitude = "x", latitude = "y"' in out.text
    assert "degrees" not in judge.imported(put(tmp_path / "a.csv", seeds.csv()), tmp_path).text


def test_a_map_on_which_no_row_lies_is_an_error(tmp_path: Path) -> None:
    site = put(tmp_path / "map.geojson", seeds.MAPS["map.geojson"])
    near = judge.imported(put(tmp_path / "a.csv", degrees("longitude", "latitude")), tmp_path, site)
    assert near.status == 0 and near.rows == 60
    away = degrees("longitude", "latitude").replace(b"49.97000", b"49.98000")
    out = judge.imported(put(tmp_path / "b.csv", away), tmp_path, site)
    assert out.status == 1 and "0.0 % of the 60 rows" in out.text
    assert not (tmp_path / "out").exists()


def test_speed_limits_of_lif_2(tmp_path: Path) -> None:
    site, _ = load_site(put(tmp_path / "map.json", seeds.MAPS["map.json"]))
    assert site.roads().speed_limit.tolist() == [1.5, 1.0]


# --------------------------------------------------------------------------- one file of many


def broken(kind: type[Exception], after: int):
    """An importer whose reader fails after some batches."""

    def read(path, options):
        batches = mcap_importer.IMPORTER.read(path, options)
        for _ in range(after):
            yield next(batches)
        raise kind("nobody thought of this")

    return replace(mcap_importer.IMPORTER, read=read)


@pytest.mark.parametrize("kind", [KeyError, RecursionError, MemoryError, UnicodeError, AssertionError])
@pytest.mark.parametrize("after", [0, 1])
def test_a_fault_in_a_reader_is_damage_of_one_file(
    kind, after: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    logs = tmp_path / "logs"
    logs.mkdir()
    put(logs / "a.csv", seeds.csv())
    put(logs / "b.mcap", seeds.mcap())
    put(logs / "c.csv", seeds.csv().replace(b"\nT", b"\nS"))
    monkeypatch.setitem(importers(), "mcap", broken(kind, after))
    out = judge.imported(logs, tmp_path)
    assert (out.status, out.rows) == (3, 80 + 40 * after)
    assert "b.mcap" in out.text and ("please report it" in out.text or "memory" in out.text)
    alone = judge.imported(logs / "b.mcap", tmp_path)
    assert alone.status == (3 if after else 1) and "b.mcap" in alone.text


def test_a_folder_with_every_kind_of_broken_file(tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    logs.mkdir()
    for name, (suffix, make) in seeds.LOGS.items():
        put(logs / f"{name.replace(' ', '-')}.{suffix}", make()[: len(make()) // 2])
    put(logs / "good.csv", seeds.csv())
    put(logs / "unreadable.csv", b"\xff" * 100)
    out = judge.imported(logs, tmp_path)
    assert out.status == 3 and out.rows > seeds.ROWS and "a fault" not in out.text


def test_a_refused_row_is_kept_as_text(tmp_path: Path) -> None:
    stamps = [*range(seeds.START, seeds.START + 39), 10**10]
    path = put(tmp_path / "a.parquet", seeds.parquet(timestamp=[float(s) for s in stamps]))
    out = judge.imported(path, tmp_path)
    assert (out.status, out.rows) == (3, 39)
    (text,) = pq.read_table(tmp_path / "out" / "rejected.parquet").to_pydict()["text"]
    assert "x=19.5" in text and "note=n39" in text


def test_half_a_surrogate_pair_in_a_refused_record_ends_no_import(tmp_path: Path) -> None:
    data = seeds.vda().replace(b"2026-03-02T05:00:05Z", b"2026\\ud800-03-02T05:00:05Z")
    out = judge.imported(put(tmp_path / "a.jsonl", data), tmp_path)
    assert (out.status, out.rows) == (3, seeds.ROWS - 1)
    (text,) = pq.read_table(tmp_path / "out" / "rejected.parquet").to_pydict()["text"]
    assert text == "2026\ufffd-03-02T05:00:05Z"


def test_outputs_among_the_logs_are_not_read_again(tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    logs.mkdir()
    put(logs / "a.csv", seeds.csv())
    (logs / ".dead.partial" / "new").mkdir(parents=True)
    put(logs / ".dead.partial" / "new" / "b.csv", seeds.csv().replace(b"\nT", b"\nS"))
    for _ in range(2):
        out = judge.imported(logs, logs)
        assert (out.status, out.rows) == (0, seeds.ROWS), out.text
    assert [log.path.name for log in find_logs([logs / "*"])] == ["a.csv"]
    assert judge.imported(logs / "out", tmp_path).rows == seeds.ROWS


def test_files_of_a_folder_that_are_no_logs_are_named(tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    folder.mkdir()
    for name, data in (("good.csv", seeds.csv()), ("bad.csv", b"\x1b\x07" * 40), ("empty.csv", b"")):
        put(folder / name, data)
    said: list[str] = []
    with listening(unheard, said.append):
        assert judge.imported(folder, tmp_path).status == 0
    assert said == [f"{folder}: 2 files skipped, as their format does not fit: bad.csv, empty.csv"]


def test_what_a_pattern_matches_is_an_input(tmp_path: Path) -> None:
    assert judge.imported(put(tmp_path / "a.csv", seeds.csv()), tmp_path).status == 0
    words = ["import", str(tmp_path / "out" / "trajectories" / "*" / "*" / "*.parquet")]
    done = CliRunner().invoke(cli, [*words, "-o", str(tmp_path / "out"), "--overwrite", "--no-recording"])
    assert isinstance(done.exception, OutputError) and "this run reads" in str(done.exception)


def test_a_first_position_that_is_none_on_earth_sets_no_frame(tmp_path: Path) -> None:
    data = degrees("longitude", "latitude").replace(b",49.97000,", b",1e43,", 1)
    out = judge.imported(put(tmp_path / "a.csv", data), tmp_path)
    assert (out.status, out.rows) == (3, 59), out.text

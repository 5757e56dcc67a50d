"""What is said and written: no escapes, no formulas, no NaN in JSON, no unknown that becomes zero."""

from __future__ import annotations

import csv
import json
import math
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

import fleetlog
from fleetlog.analysis.heatmap import heatmap
from fleetlog.analysis.stops import stops
from fleetlog.analysis.trips import trips
from fleetlog.api.answer import Answer
from fleetlog.cli.main import cli, printable
from fleetlog.core.network import Edge, build_network
from fleetlog.core.result import Grid, Result
from fleetlog.core.site import Site
from fleetlog.core.trajectory import Labels, Trajectory
from fleetlog.discovery.report.finding import ChannelFit, Verdict
from fleetlog.errors import DataError, FleetlogError, InputError, OutputError
from fleetlog.exporters.base import export_dataset
from fleetlog.exporters.csv import defused
from fleetlog.store import Dataset, DatasetWriter
from fleetlog.store.documents import json_text
from fleetlog.store.results import file_name
from fleetlog.verbs.diagnose import unjudged
from fleetlog.view.stream import check_whole, open_stream, verbatim

NAMES = [
    "AGV/1",
    "\x1b[31mred\x07",
    "=cmd|'/c calc'!A0",
    "$x^$ a",
    "..",
    "a\\b",
    "x" * 60,
    "ü 7",
    "__x",
    "![p](http://h/p)",
]


def dataset(folder: Path, names: list[str], power: float | None = None, rows: int = 40) -> Dataset:
    """Trucks side by side along x, one a name, at 1 m/s."""
    time, there = np.arange(rows, dtype=np.int64) * 1_000_000, np.arange(rows, dtype=float)
    with DatasetWriter.create(folder, "recorded", Site()) as writer:
        for k, name in enumerate(names):
            columns = {
                "x": there,
                "y": np.full(rows, float(k)),
                "speed": np.ones(rows),
                "trip_id": np.zeros(rows, np.int64),
            }
            if power is not None:
                columns["battery_power"] = np.full(rows, power)
            writer.write(Trajectory(name, time, columns))
    return Dataset(folder)


@given(st.text(st.characters(codec=None, categories=None), max_size=30))
def test_nothing_that_is_said_moves_a_terminal(text: str) -> None:
    said = printable(text)
    assert not any(ord(c) < 32 or 127 <= ord(c) < 160 or c in "\u202e\u2066\u200f\u2028" for c in said)
    said.encode("utf-8")
    plain = "Größe 7 – 5 µm, 東京"
    assert printable(plain) == plain


@pytest.mark.filterwarnings("ignore:Glyph")
def test_names_of_vehicles_reach_neither_terminal_nor_other_folders(tmp_path: Path) -> None:
    path = dataset(tmp_path / "d", NAMES, power=1000.0).path
    (tmp_path / "inner").mkdir()
    for words in (
        ["info", str(path)], ["analyze", "trips", str(path), "-o", str(tmp_path / "inner" / "t")],
        ["analyze", "heatmap", str(path), "--by", "vehicle", "-o", str(tmp_path / "inner" / "h")],
    ):  # fmt: skip
        done = CliRunner().invoke(cli, words)
        assert done.exit_code == 0, (words, done.exception)
        assert "\x1b" not in done.output and "\x07" not in done.output
    rasters = list((tmp_path / "inner" / "h").glob("*.tif"))
    assert len(rasters) == len(NAMES)
    assert {p.name for p in tmp_path.iterdir()} == {"d", "inner"}
    assert {p.name for p in (tmp_path / "inner").iterdir()} == {"t", "h"}


@given(st.sets(st.text(st.characters(codec="utf-8"), min_size=1, max_size=20), min_size=2, max_size=5))
def test_file_names_are_one_for_one_and_stay_in_their_folder(names: set[str]) -> None:
    files = {file_name(n) for n in names}
    assert len(files) == len(names)
    assert all("/" not in f and "\\" not in f and "\x00" not in f and not f.startswith(".") for f in files)


def test_the_name_that_hive_takes_for_null_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="__HIVE_DEFAULT_PARTITION__"):
        dataset(tmp_path / "d", ["__HIVE_DEFAULT_PARTITION__"])
    assert not (tmp_path / "d").exists()


def test_cells_of_a_csv_are_no_formulas_and_roads_keep_their_names(tmp_path: Path) -> None:
    bad = ["=1+1", "@SUM(A1)", "+1+1", "-1+cmd|' /C calc'!A0", "\t=1", "\r=1", "-2+3", "+49 170"]
    good = ["-e012", "-road:1:2", "-Straße_7", "+x", "-", "a=1", "", "Tom's", None]
    assert defused(pa.chunked_array([bad])).to_pylist() == [f"'{t}" for t in bad]
    assert defused(pa.chunked_array([good])).to_pylist() == good
    export_dataset(dataset(tmp_path / "d", ["=1+1", "T1"]), "csv", tmp_path / "d.csv")
    with (tmp_path / "d.csv").open(newline="", encoding="utf-8") as stream:
        assert {row["vehicle_id"] for row in csv.DictReader(stream)} == {"'=1+1", "T1"}


def test_a_name_is_no_markup() -> None:
    assert verbatim("![p](http://h)<b>*x*</b>\n# T `c`") == r"\!\[p\](http://h)\<b\>\*x\*\</b\> \# T \`c\`"


LEAVES = st.floats() | st.none() | st.text(max_size=5)


@given(
    st.recursive(
        LEAVES, lambda s: st.lists(s, max_size=4) | st.dictionaries(st.text(max_size=3), s, max_size=3)
    )
)
def test_json_has_no_nan_and_no_infinity(value: object) -> None:
    def refuse(name: str) -> None:
        raise AssertionError(name)

    json.loads(json_text(value), parse_constant=refuse)


def test_unknown_energy_is_null_and_not_zero(tmp_path: Path) -> None:
    unknown, known = dataset(tmp_path / "a", ["T1"]), dataset(tmp_path / "b", ["T1"], power=3600.0)
    result = heatmap(unknown, quantity="energy")
    assert result.summary["energy_kwh"] is None and "energy unknown" in result.lines[1]
    assert result.tables["cells"]["energy"].isna().all()
    assert all(not np.isfinite(s.values).any() for s in result.shapes if isinstance(s, Grid))
    Answer.of(result, Site()).save(tmp_path / "out")
    result = heatmap(known, quantity="energy")
    assert result.summary["energy_kwh"] == pytest.approx(3600.0 * 39 / 3.6e6)
    assert result.summary["energy_known_share"] == pytest.approx(1.0)


def test_a_gate_stays_shut_for_what_was_not_judged() -> None:
    soc = ChannelFit("soc", "nrmse", 0.1, 0.1, 0.1)
    speed, power = replace(soc, name="speed", floor=math.nan), replace(soc, name="battery_power", after=None)
    assert Verdict([soc], [], []).passes and not Verdict([soc, speed], [], []).passes
    assert unjudged(Verdict([soc], [], []), ["soc"]) == []
    assert unjudged(Verdict([soc], [], []), ["soc", "speed"]) == ["speed"]
    assert unjudged(Verdict([soc, speed, power], [], []), []) == ["speed", "battery_power"]


@pytest.mark.parametrize(
    "words",
    [
        "simulate --truck T --soc 60", "simulate --truck T --soc nan", "simulate --truck T --seed -5",
        "simulate --truck T --vehicles 1000000000", "simulate --truck T --vehicles -1", "simulate --truck T --rate inf",
        "simulate --truck T --step 0", "simulate --truck T --temperature nan", "simulate --truck T --duration 1000000h",
        "simulate", "export .", "calibrate .", "diagnose .", "analyze energy .", f"simulate --truck T --vehicles {10**400}",
        "simulate --truck T --charge-below 30", "simulate --truck T --chemistry gold", "simulate --truck T --cycle x", "simulate --truck T --runs 0", "simulate --truck T --workers 1e9", "analyze density . --threshold nan",
        "analyze density . --step 0", "analyze heatmap . --cell 0", "analyze heatmap . --cell inf", "analyze stops . --min-visits 0",
        "analyze trips . --min-distance nan", "analyze chargers . -k 0", "analyze chargers . --radius nan", "analyze nothing .",
        "diagnose . --truck T --channels smell", "diagnose . --truck T --terms magic", "diagnose . --truck T --without smell", "export . --to cvs", "import x --rate nan",
    ],
)  # fmt: skip
def test_numbers_and_choices_out_of_bounds_are_wrong_usage(words: str, tmp_path: Path) -> None:
    data = dataset(tmp_path / "d", ["T1"]).path
    done = CliRunner().invoke(
        cli, [str(data) if w == "." else w for w in words.split()] + ["-o", str(tmp_path / "out")]
    )
    assert done.exit_code == 2, done.exception
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["a\0b", "\ud800"])
def test_what_cannot_be_a_name_is_said_to_be_none(name: str) -> None:
    with pytest.raises(FleetlogError, match="is no name of a file"):
        fleetlog.info(name)


def test_analyses_of_nearly_nothing_answer(tmp_path: Path) -> None:
    data = dataset(tmp_path / "d", ["T1"]).path
    for words in (["stops"], ["trips"], ["heatmap"], ["energy", "--truck", "counterbalance-2.5t"]):
        done = CliRunner().invoke(
            cli, ["analyze", words[0], str(data), *words[1:], "-o", str(tmp_path / words[0])]
        )
        assert done.exit_code == 0, (words, done.exception)
        assert not re.search(r"\bnan\b|(?<!\+)-0\.0+\b", done.output)
        assert "NaN" not in (tmp_path / words[0] / f"{words[0]}.json").read_text()


@pytest.mark.parametrize(
    "words",
    [
        "analyze trips D -o D", "analyze heatmap D -o D/new", "diagnose D --truck T -o D", "export D --to csv -o D/dataset.json",
        "simulate --like D --truck T -o D", "simulate --like D --truck T --vehicles 1..2 -o D", "import D -o D",
        "calibrate D --truck T -o D/truck.toml", "view D --beside D --save D/recording.rrd",
        "report D -o D/dataset.json", "report D --truck T --tables D -o D.html", "learn D -o D", "view D --screenshot D/new.png",
    ],
)  # fmt: skip
def test_no_command_writes_over_what_it_reads(words: str, tmp_path: Path) -> None:
    data = dataset(tmp_path / "d", ["T1"], power=1000.0).path
    before = {p: p.read_bytes() for p in data.rglob("*") if p.is_file()}
    given = [w.replace("D", str(data), 1) if w[0] == "D" else w for w in words.split()]
    given = ["counterbalance-2.5t" if w == "T" else w for w in given]
    done = CliRunner().invoke(cli, [*given, "--overwrite"])
    assert isinstance(done.exception, OutputError) and "this run reads" in str(done.exception)
    assert {p: p.read_bytes() for p in data.rglob("*") if p.is_file()} == before


def test_too_little_to_diagnose_is_said_and_shuts_the_gate(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = str(dataset(tmp_path / "d", ["T1"], power=1000.0, rows=200).path)
    words = ["diagnose", data, "--truck", "counterbalance-2.5t", "--gate", "-o", str(tmp_path / "out")]
    assert cli.main(words, standalone_mode=False) == 1
    assert "not judged" in capsys.readouterr().out
    json.loads((tmp_path / "out" / "diagnosis.json").read_text(), parse_constant=lambda n: pytest.fail(n))


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_an_answer_that_cannot_be_printed_is_an_error_that_says_so(tmp_path: Path) -> None:
    data = dataset(tmp_path / "d", ["T1"]).path
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(
            [sys.executable, "-m", "fleetlog", "info", str(data)],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
        )
    assert done.returncode == 1 and done.stderr == "fleetlog: standard output: No space left on device\n"


def test_a_row_of_a_wrong_century_fills_no_memory(tmp_path: Path) -> None:
    """A logger that jumps to 2261 for its last row: one clear line, no grid of two hundred years."""
    time = np.append(np.arange(119, dtype=np.int64) * 1_000_000, 9_190_000_000_000_000)
    columns = {"x": np.minimum(np.arange(120.0), 118.0), "y": np.zeros(120), "speed": np.ones(120)}
    trip = np.append(np.zeros(119, np.int64), 1)
    edge = Labels.of(["r"] * 120)
    site = Site(network=build_network([Edge("r", "a", "b", np.array([[0.0, 0, 0], [200.0, 0, 0]]), "r")]))
    with DatasetWriter.create(tmp_path / "d", "recorded", site) as writer:
        writer.write(
            Trajectory("T1", time, {**columns, "trip_id": trip, "edge_id": edge, "edge_offset": columns["x"]})
        )
    data = str(tmp_path / "d")
    # Density goes through the hours that have rows, and no others.
    done = CliRunner().invoke(cli, ["analyze", "density", data, "-o", str(tmp_path / "density")])
    assert done.exit_code == 0, done.output
    for words in (
        ["report", data],
        ["simulate", "--like", data, "--truck", "counterbalance-2.5t", "--same-mission", "--no-recording"],
    ):
        done = CliRunner().invoke(cli, [*words, "-o", str(tmp_path / "out")])
        assert isinstance(done.exception, DataError), done.exception
        assert "wrong time" in str(done.exception)


def test_an_unknown_payload_is_not_an_empty_one(tmp_path: Path) -> None:
    data = dataset(tmp_path / "d", ["T1"])
    assert trips(data).summary["laden_share"] is None
    assert stops(data).summary["loads_carried"] is None and "unknown" in stops(data).lines[1]


def test_fields_of_a_model_stay_in_its_folder(tmp_path: Path) -> None:
    from fleetlog.core.truck import load_truck
    from fleetlog.physics.model import load_physics

    model = tmp_path / "m" / "model.toml"
    model.parent.mkdir()
    for place in ("../x.parquet", "/etc/passwd", "fields/../../x.parquet"):
        model.write_text(f'format_version = 1\n[term.grade]\nfield = "{place}"\n')
        with pytest.raises(InputError, match="outside"):
            load_physics(model, load_truck("counterbalance-2.5t"))


def test_a_recording_is_whole_or_an_error(tmp_path: Path) -> None:
    import rerun as rr

    out = tmp_path / "r.rrd"
    with open_stream(out, "r") as stream:
        stream.rows("/a", np.arange(70_000), rr.Scalars, scalars=np.sin(np.arange(70_000)))
    whole = out.read_bytes()
    check_whole(out)
    for broken in (whole[:-1], whole[: len(whole) // 2], b"", whole[:100] + whole[200:], whole + b"x"):
        out.write_bytes(broken)
        with pytest.raises(OutputError, match="not written"):
            check_whole(out)
    with Path("/dev/full").open("wb") as full, pytest.MonkeyPatch.context() as patch:
        opened = Path.open
        patch.setattr(
            Path, "open", lambda p, mode="r", *a, **k: full if mode == "wb" else opened(p, mode, *a, **k)
        )
        with (
            pytest.raises(OutputError, match="No space left"),
            open_stream(tmp_path / "f.rrd", "f") as stream,
        ):
            stream.rows("/a", np.arange(70_000), rr.Scalars, scalars=np.zeros(70_000))
    assert not (tmp_path / "f.rrd").exists() and not list(tmp_path.glob(".f*"))


def test_results_with_strange_names_are_written(tmp_path: Path) -> None:
    grid = Grid("a/b$c^$", np.ones((2, 2)), 0.0, 0.0, 1.0, "l")
    result = Result("r", {"x": math.nan}, shapes=[grid], lines=["![p](http://h)"])
    Answer.of(result, Site("$s^$")).save(tmp_path / "r")
    assert json.loads((tmp_path / "r" / "r.json").read_text())["x"] is None
    assert (tmp_path / "r" / "a%2Fb$c^$.tif").is_file()

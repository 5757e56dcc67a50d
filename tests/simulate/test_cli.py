"""The command: exit status, one line for a fault, JSON, nothing left behind."""

import json

import pytest
from click.testing import CliRunner

from fleetlog.cli.main import load_verb
from fleetlog.errors import FleetlogError
from fleetlog.store import Dataset
from fleetlog.store.events import read_table
from fleetlog.verbs.info import describe


@pytest.fixture
def sample(project_root):
    folder = project_root / "sample_data"
    return ["--site", str(folder / "site.toml"), "--truck", str(folder / "truck.toml")]


def run(*arguments):
    return CliRunner().invoke(load_verb("simulate"), [str(a) for a in arguments])


def test_a_fleet_on_the_sample_plant(sample, tmp_path):
    out = tmp_path / "sim"
    done = run(
        *sample, "--vehicles", 3, "--duration", "5m", "--seed", 1, "--json", "--no-recording", "-o", out
    )
    assert done.exit_code == 0, done.output
    summary = json.loads(done.stdout)
    data = Dataset(out)
    assert summary["rows"] == data.rows == 3 * 300
    assert data.kind == "simulated"
    assert data.meta["provenance"]["seed"] == 1
    read = {f["file"]: len(f["sha256"]) for f in data.meta["provenance"]["inputs"]}
    assert read == {"site.toml": 64, "truck.toml": 64, "roads.geojson": 64}
    assert data.meta["provenance"]["truck"]["length"] == 3.2
    told = describe(out)
    assert told["tasks"]["all"] == summary["tasks_given"]
    assert told["tasks"].get("done", 0) == summary["tasks_done"]
    assert told["charging_visits"] == summary["charges"]
    assert sum(told["activity_hours"].values()) == pytest.approx(3 * 5 / 60, abs=1e-3)
    again = run(*sample, "--vehicles", 3, "--duration", "5m", "--no-recording", "-o", out)
    assert isinstance(again.exception, FleetlogError)
    assert "--overwrite" in str(again.exception)


def test_like_and_same_mission_and_cycle(sample, tmp_path):
    first = tmp_path / "first"
    assert run(*sample, "--vehicles", 3, "--duration", "15m", "--no-recording", "-o", first).exit_code == 0
    like = run(
        *sample, "--like", first, "--duration", "5m", "--no-recording", "--json", "-o", tmp_path / "like"
    )
    assert like.exit_code == 0, like.output
    assert Dataset(tmp_path / "like").meta["start"][:13] == Dataset(first).meta["start"][:13]
    same = run(
        *sample, "--like", first, "--same-mission", "--no-recording", "--json", "-o", tmp_path / "same"
    )
    assert same.exit_code == 0, same.output
    assert 0.9 < json.loads(same.stdout)["distance_ratio"] < 1.1
    cycle = run(
        "--cycle",
        "vdi2198",
        *sample[2:],
        "--duration",
        "10m",
        "--no-recording",
        "--json",
        "-o",
        tmp_path / "vdi",
    )
    assert cycle.exit_code == 0, cycle.output
    used = Dataset(tmp_path / "vdi").trips.energy.sum() / 3600.0
    assert used == pytest.approx(json.loads(cycle.stdout)["mean_power_w"] / 6.0, rel=0.01)


def test_the_cycle_agrees_with_the_energy_worked_out_by_hand(tmp_path):
    # 4.60 kWh/h for a 3575 kg truck with 2 t, from a calculation of its own; it counts rotating masses (1.1) and 3 m/s.
    truck = tmp_path / "truck.toml"
    truck.write_text(
        "[chassis]\nmass = 3575\nrated_load = 2000\n[drive]\nefficiency = 0.72\nregeneration = 0.55\nmax_acceleration = 0.8\n"
        "max_deceleration = 0.8\n[lift]\nefficiency = 0.62\n[auxiliary]\npower = 250\n[battery]\ncapacity_wh = 19400\n"
    )
    done = run(
        "--cycle",
        "vdi2198",
        "--truck",
        truck,
        "--duration",
        "2m",
        "--no-recording",
        "--json",
        "-o",
        tmp_path / "vdi",
    )
    assert done.exit_code == 0, done.output
    # Without the rotating masses a tenth of what acceleration costs beyond regeneration is missing: some 2 to 3 Wh of 77.
    assert json.loads(done.stdout)["mean_power_w"] == pytest.approx(4600.0, rel=0.05)


def test_places_cut_off_by_closed_roads_are_left_out_and_named(sample, tmp_path):
    gates = ["gate-0", "gate-1", "gate-2"]
    closed = [word for gate in gates for word in ("--close", gate)]
    few = [*sample, "--vehicles", 3, "--duration", "2m", "--no-recording"]
    alone = run(*few, *closed, "--json", "-o", tmp_path / "alone")
    assert alone.exit_code == 0, alone.output
    told = [n for n in json.loads(alone.stdout)["notes"] if "cannot be reached from the others" in n]
    assert len(told) == 1 and "'rack-2'" in told[0] and "'dock-1'" in told[0] and "'line-1'" not in told[0]
    both = run(*few, "--vary", f"close={'+'.join(gates)}", "--json", "-o", tmp_path / "both")
    assert both.exit_code == 0, both.output
    open_site, cut = json.loads(both.stdout)["variants"]
    assert open_site["left_out"] == "" and cut["left_out"] == told[0] and cut["possible"] == 1


@pytest.mark.parametrize(
    "mode, idle",
    [
        (["--same-mission", "--like", "DATA"], [["--vehicles", 3], ["--duration", "5m"], ["--tasks", "DATA"], ["--policy", "threshold"]]),
        (["--cycle", "vdi2198"], [["--vehicles", 5], ["--site", "DATA"], ["--like", "DATA"], ["--temperature", 3]]),
    ],
)  # fmt: skip
def test_options_without_a_use_are_wrong_usage(sample, tmp_path, mode, idle):
    for option in idle:
        done = run(*sample[2:], *mode, *option, "-o", tmp_path / "x")
        assert done.exit_code == 2 and f"{option[0]} does not go with {mode[0]}" in done.output


def test_tasks_of_places_that_are_left_out_make_status_3(sample, tmp_path):
    """Some of the data that were given are not used."""
    (file := tmp_path / "tasks.csv").write_text("from,to,earliest\ndock-1,rack-1,0\ngoods-out-1,line-1,0\n")
    few = [*sample, "--tasks", file, "--vehicles", 2, "--duration", "2m", "--no-recording", "-q", "-o"]
    gates = [word for k in range(3) for word in ("--close", f"gate-{k}")]
    for name, closed, status in (("all", [], 0), ("cut", gates, 3)):
        words = [str(w) for w in (*few, tmp_path / name, *closed)]
        done = CliRunner().invoke(load_verb("simulate"), words, standalone_mode=False)
        assert done.return_value == status and ("tasks.parquet" in done.stderr) == (status == 3)
        kept = read_table(Dataset(tmp_path / name), "tasks")
        assert kept.to_place[kept.status == "left out"].tolist() == ["rack-1"] * (status == 3)


@pytest.mark.parametrize(
    "arguments, told",
    [
        (["--vehicles", 0], "vehicles"),
        (["--vehicles", 5000], "more than the site can hold"),
        (["--without", "gravity"], "gravity"),
        (["--rate", 3.0], "--rate"),
        (["--physics", "nothing"], "does not exist"),
        (["--duration", "soon"], "not a duration"),
    ],
)
def test_faults_are_one_line(sample, tmp_path, arguments, told):
    done = run(*sample, "--duration", "1m", "--no-recording", "-o", tmp_path / "x", *arguments)
    assert done.exit_code != 0
    text = str(done.exception) if isinstance(done.exception, FleetlogError) else done.output
    assert told in text
    assert not (tmp_path / "x").exists()

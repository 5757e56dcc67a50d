"""Experiments: values and variants, the same tasks in each, the same answer whoever runs them."""

import json
import re

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from scipy import stats
from simulated_sites import TRUCK, grid, place

from fleetlog import engines
from fleetlog.cli.main import load_verb
from fleetlog.core.arguments import factor
from fleetlog.core.result import half_width
from fleetlog.errors import DataError, InputError, OutputError
from fleetlog.simulate import scenario as module
from fleetlog.simulate.engine import Settings
from fleetlog.simulate.scenario import Scenario, experiment, variants
from fleetlog.store import Dataset, DatasetWriter
from fleetlog.store.events import read_table

PLACES = [
    place(0, "pick", 15, 3), place(1, "pick", 15, 30), place(0, "drop", 45, 3), place(1, "drop", 45, 57),
    place(0, "charge", 33, 45, power=60000.0), place(1, "charge", 33, 15, power=60000.0),
]  # fmt: skip


def base(vehicles=3, seed=0, seconds=600.0, **settings):
    return Scenario(grid(places=PLACES), TRUCK, Settings(vehicles, seconds, seed=seed, **settings))


@pytest.mark.parametrize(
    "text, values",
    [
        ("vehicles=6..9", ("6", "7", "8", "9")),
        ("vehicles=2..10..4,3", ("2", "6", "10", "3")),
        ("policy=opportunity,threshold", ("opportunity", "threshold")),
        ("close=e1,none,e2", ("none", "e1", "e2")),
    ],
)
def test_values_of_a_factor(text, values):
    assert factor(text).values == values


@pytest.mark.parametrize(
    "text, told",
    [("plugs", "NAME=VALUES"), ("plugs=4..2", "empty range"), ("plugs=0", "from 1 to"), ("plug=2", "did you mean"),
     ("pick0=many", "from 1 to"), ("plugs=1..99999", "more than 10,000"), ("vehicles=1..1000000000", "from 1 to"),
     ("plugs=²", "from 1 to"), ("vehicles=" + "9" * 5000, "from 1 to"), ("close=nowhere", "no edge"), ("policy=never", "unknown charging policy")],
)  # fmt: skip
def test_what_cannot_be_varied_is_one_line(text, told):
    with pytest.raises(Exception) as error:
        variants(base(), [factor(text)])
    assert told in str(error.value) and "\n" not in str(error.value)


def test_variants_change_what_they_say_and_nothing_else():
    made = variants(base(), [factor("plugs=1..5"), factor("close=e01h")])
    assert len(made) == 10
    for values, scenario in made:
        plugs = sum(p.plugs for p in scenario.site.places if p.kind == "charge")
        assert plugs == int(values["plugs"])
        assert ("e01h" in scenario.site.network.index) == (values["close"] == "none")
        assert [p for p in scenario.site.places if p.kind != "charge"] == PLACES[:4]
        assert scenario.demand is made[0][1].demand


def tasks_of(folder, scenario):
    with DatasetWriter.create(folder, "simulated", scenario.site) as writer:
        scenario.write(writer)
    table = read_table(Dataset(folder), "tasks")
    return table.payload.to_numpy()


def test_fleets_of_any_size_draw_the_same_tasks(tmp_path):
    loads = [
        tasks_of(tmp_path / f"{k}", s) for k, (_, s) in enumerate(variants(base(), [factor("vehicles=1,4")]))
    ]
    few = min(map(len, loads))
    assert few >= 3 and len(loads[1]) > len(loads[0])
    np.testing.assert_array_equal(np.sort(loads[0][:few]), np.sort(loads[1][:few]))
    other = tasks_of(tmp_path / "other", base(seed=1))
    assert not np.array_equal(other[:few], loads[0][:few])


def test_runs_are_independent_of_who_does_them_and_of_the_others():
    factors = [factor("vehicles=2,4")]
    alone = experiment([base(seed=1)], factors)
    with engines.using(2):
        both = experiment([base(seed=0), base(seed=1)], factors)
    mine = both.tables["runs"].query("seed == 1").reset_index(drop=True)
    pd.testing.assert_frame_equal(mine, alone.tables["runs"])
    assert (mine.tasks_done > 0).all() and mine.tasks_done.is_monotonic_increasing


def test_intervals_are_those_of_student_and_changes_are_taken_seed_by_seed():
    result = experiment([base(seed=k) for k in range(3)], [factor("vehicles=2,3")])
    runs, table = result.tables["runs"], result.tables["variants"]
    rate = {n: runs[runs.variant == n].tasks_per_h.to_numpy() for n in (0, 1)}
    low, high = stats.t.interval(0.95, 2, rate[0].mean(), stats.sem(rate[0]))
    assert table.tasks_per_h_ci[0] == pytest.approx((high - low) / 2)
    assert table.tasks_per_h_change[1] == pytest.approx((rate[1] - rate[0]).mean())
    assert table.tasks_per_h_change_ci[1] == pytest.approx(half_width(rate[1] - rate[0]))


def test_what_the_runs_do_not_tell_from_the_best_is_taken_seed_by_seed(monkeypatch):
    # Four seeds of a very different demand: variant 1 always does two tasks fewer, variant 2 as many on average.
    less = {"2": (0, 0, 0, 0), "3": (2, 2, 2, 2), "4": (3, -3, 2, -1)}

    def measured(outcome):
        lost = less[str(outcome.vehicles)][outcome.seed]
        return {**real(outcome.summary), "tasks_per_h": 100.0 * (1 + outcome.seed) - lost}

    class Run:
        def __init__(self, scenario):
            self.summary, settings = scenario.run(), scenario.settings
            self.vehicles, self.seed = settings.vehicles, settings.seed

    real = module._measured
    monkeypatch.setattr(module, "attempt", Run)
    monkeypatch.setattr(module, "_measured", measured)
    line = experiment([base(seed=k, seconds=60.0) for k in range(4)], [factor("vehicles=2,3,4")]).lines[-1]
    assert (
        line
        == "Most tasks are done with vehicles = 2: 250.0 per hour. The runs do not tell it from vehicles = 4."
    )


def test_shares_are_ratios_in_tables_and_per_cent_for_people():
    result = experiment([base(8)], [factor("vehicles=2,12")])
    for table in result.tables.values():
        shares = table[[c for c in table if "_share" in c and not c.endswith("_ci")]]
        assert len(shares.columns) and shares.abs().to_numpy().max() <= 1.0
    share = result.tables["variants"].waiting_share.iloc[-1]
    assert share > 0.001 and f"{100.0 * share:.1f} %" in result.lines[-2]
    (drawn,) = (s for s in result.shapes if s.name == "waiting_share")
    assert drawn.y_label.endswith("[%]") and drawn.curves[""][-1].tolist() == pytest.approx([100.0 * share])


def test_energy_of_no_task_is_no_number():
    result = experiment([base(seed=k, seconds=10.0) for k in range(2)], [factor("vehicles=2,3")])
    assert not result.tables["runs"].tasks_done.any() and result.tables["runs"].energy_kwh.all()
    assert result.tables["variants"].energy_per_task_wh.isna().all()
    head, *cells = (re.split(r"  +", line) for line in result.lines)
    assert all(row[head.index("Wh/task")] == "-" for row in cells if len(row) == len(head))


def test_an_impossible_variant_is_told_and_the_others_run():
    result = experiment([base()], [factor("vehicles=2,900")])
    table = result.tables["variants"]
    assert table.possible.tolist() == [1, 0]
    assert "more than the site can hold" in table.bottleneck[1]
    with pytest.raises(DataError, match="no run is possible"):
        experiment([base()], [factor("vehicles=900")])


@pytest.fixture
def plan(tmp_path, project_root):
    """An experiment's file beside a copy of the sample plant's roads."""
    for name in ("site.toml", "roads.geojson", "truck.toml"):
        (tmp_path / name).write_text((project_root / "sample_data" / name).read_text())
    (tmp_path / "plan.toml").write_text(
        'site = "site.toml"\ntruck = "truck.toml"\nduration = "5m"\nvehicles = "2..3"\nruns = 2\n'
        '[vary]\npolicy = ["opportunity", "threshold"]\n'
    )
    return tmp_path


def call(*args):
    return CliRunner().invoke(load_verb("simulate"), [str(a) for a in args])


def test_an_experiment_from_a_file(plan):
    outcome = call("--experiment", plan / "plan.toml", "-o", plan / "out", "--runs", 1, "--json", "-q")
    assert outcome.exit_code == 0, outcome.output
    summary = json.loads(outcome.stdout)
    assert summary["factors"] == {"vehicles": ["2", "3"], "policy": ["opportunity", "threshold"]}
    assert summary["seeds"] == [0] and len(summary["variants"]) == 4
    written = {f.name for f in (plan / "out").iterdir()}
    assert written >= {"experiment.json", "experiment.png", "report.html", "runs.parquet", "recording.rrd"}
    again = ("--experiment", plan / "plan.toml", "-o", plan / "out", "--runs", 1, "-q", "--overwrite")
    assert call(*again, "--no-recording").exit_code == 0
    assert {f.name for f in (plan / "out").iterdir()} == written - {"recording.rrd"}


@pytest.mark.parametrize(
    "arguments, told",
    [
        (("--runs", "0"), "must be at least 1"),
        (("--vary", "vehicles=3..4"), "varied twice"),
        (("--vehicles", "3..x"), "not a whole number"),
        (("--vehicles", "14..6"), "empty range"),
        (("--vary", "plugs=1..20000"), "more than 10,000"),
        (("--vary", "plugs=0..2"), "from 1 to"),
        (("--vary", "foo=1"), "neither a setting nor a place"),
        (("--vary", "policy=sometimes"), "unknown charging policy"),
        (("--vary", "plugs"), "NAME=VALUES"),
        (("--vary", "close=nowhere"), "no edge"),
        (("--rate", "0"), "must be over 0"),
        (("--step", "5"), "at most 0.25"),
        (("--duration", "0s"), "over 0 s"),
        (("--cycle", "vdi2198"), "does not go with --cycle"),
    ],
)
def test_wrong_usage_is_one_line(plan, arguments, told):
    outcome = call("--experiment", plan / "plan.toml", "-o", plan / "out", *arguments)
    assert outcome.exit_code == 2 and told in outcome.output
    assert not (plan / "out").exists()


@pytest.mark.parametrize(
    "text, told",
    [
        ('vehicle = "2..3"', "did you mean 'vehicles'"), ("vary = 5", "vary: is not a table"),
        ("soc = nan", "not a finite number"), ("duration = [1]", "takes one value"), ("site = []", "takes one value"), ("rate = {}", "not a number"),
        ("policy = 5", "not one of"), ("seed = -1", "at least 0"), ("runs = 1e9", "not"),
        ('vehicles = "14..6"', "empty range"), ("rate = 0", "must be over 0"), ("step = 5", "at most 0.25"), ('duration = "0s"', "over 0 s"),
        ("[vary]\nplugs = []", "NAME=VALUES"), ('[vary]\nplugs = "2..1"', "empty range"),
    ],
)  # fmt: skip
def test_a_wrong_file_is_one_line(plan, text, told):
    (plan / "bad.toml").write_text(text + "\n")
    outcome = call("--truck", "counterbalance-2.5t", "--experiment", plan / "bad.toml", "-o", plan / "bad")
    error = outcome.exception
    assert type(error) is InputError and told in str(error) and "bad.toml" in str(error)


@pytest.mark.parametrize(
    "line", ["plugs = [0]", "foo = [1]", 'policy = ["sometimes"]', 'close = ["nowhere"]', "vehicles = [3]"]
)
def test_what_a_file_varies_in_vain_is_a_fault_of_that_file_and_of_no_option(plan, line):
    (plan / "bad.toml").write_text(
        (plan / "plan.toml").read_text().replace('policy = ["opportunity", "threshold"]', line)
    )
    outcome = call("--experiment", plan / "bad.toml", "-o", plan / "bad")
    assert type(outcome.exception) is InputError and "bad.toml" in str(outcome.exception)
    given = call("--experiment", plan / "bad.toml", "-o", plan / "bad", "--vary", "plugs=0")
    assert given.exit_code == 2 and "--vary" in given.output


@pytest.mark.parametrize("data", [b"a = [", b"\xff", b"a = " + b"9" * 5000])
def test_a_file_that_is_no_toml_is_one_line(plan, data):
    (plan / "bad.toml").write_bytes(data)
    outcome = call("--truck", "counterbalance-2.5t", "--experiment", plan / "bad.toml", "-o", plan / "bad")
    assert isinstance(outcome.exception, InputError) and "TOML" in str(outcome.exception)


@pytest.mark.parametrize(
    "text, told", [("site = 5", "not exist"), ("site = 'site.toml'\nclose = 5", "no edge '5'")]
)
def test_what_a_file_names_must_be_there(plan, text, told):
    (plan / "bad.toml").write_text(f"truck = 'counterbalance-2.5t'\n{text}\n")
    outcome = call("--experiment", plan / "bad.toml", "-o", plan / "bad")
    assert isinstance(outcome.exception, InputError) and told in str(outcome.exception)


def test_the_place_of_an_experiment_is_checked_before_the_work(plan, monkeypatch):
    (plan / "out").mkdir()
    monkeypatch.setattr("fleetlog.simulate.scenario.attempt", None)
    outcome = call("--experiment", plan / "plan.toml", "-o", plan / "out")
    assert isinstance(outcome.exception, OutputError) and "already there" in str(outcome.exception)

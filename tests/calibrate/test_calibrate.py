"""Calibration: closed formulas, recovery within stated intervals, and what a protocol cannot tell."""

from __future__ import annotations

import dataclasses
import json
import tomllib

import numpy as np
import pytest
from click.testing import CliRunner

from fleetlog.calibrate.fit import UNKNOWNS, Fit, fit
from fleetlog.calibrate.observe import Run, of_motion, of_runs, read_runs, together
from fleetlog.calibrate.report import blind_line, lines, summary, truck_toml
from fleetlog.cli.main import load_verb
from fleetlog.core.motion import Motion
from fleetlog.core.truck import Truck, load_truck, truck_from_dict
from fleetlog.errors import InputError
from fleetlog.physics.cycles import Piece, legs, run
from fleetlog.physics.power import Physics, battery_power

TRUCK = load_truck("three-wheel-2t")
NAN = float("nan")

# The protocols of physics section 3.4: the cycle alone, six kinds of run on a flat floor, and those with a coast-down.
CYCLE = [Run("cycle", "vdi2198", repeats=60, payload=2000)]
FLAT = [
    Run("idle", "idle", duration=600),
    Run("lift laden", "lift", repeats=20, payload=2000, height=2),
    Run("lift empty", "lift", repeats=20, height=2),
    Run("long run", "drive", repeats=20, length=100, speed=3),
    Run("shuttle fast", "stop_and_go", repeats=60, length=20, speed=3),
    Run("shuttle slow", "stop_and_go", repeats=60, length=20, speed=1.5),
]
COAST = [Run("coast-down", "coast_down", speed=3.0, duration=NAN)]
RAMP = [
    Run("up", "ramp", repeats=10, length=20, speed=1.5, grade=0.08),
    Run("down", "ramp", repeats=10, length=20, speed=1.5, grade=-0.08),
]
LOWER = [Run("lower laden", "lower", repeats=20, payload=2000, height=2)]
STEADY = [
    Run("steady", "steady", repeats=5, length=200, speed=v, payload=p) for v in (1.5, 4.0) for p in (0, 2000)
]
WHOLE = FLAT + COAST + RAMP + LOWER + STEADY


def predicted(run: Run, truck: Truck, physics: Physics | None = None) -> float:
    """What the model says of one run."""
    return float(of_runs([run], truck).predict(physics or Physics(truck))[0])


def measured(runs: list[Run], truth: Truck, rng: np.random.Generator | None = None) -> list[Run]:
    """The runs as a truck would give them, with 1 % of noise where there is a generator."""
    out = []
    for r in runs:
        value = predicted(r, truth)
        sigma = max(0.01 * abs(value), 0.01 if r.kind == "coast_down" else 0.5)
        value += 0.0 if rng is None else rng.normal() * sigma
        key = "duration" if r.kind == "coast_down" else "energy"
        out.append(dataclasses.replace(r, **{key: value}, sigma=sigma))
    return out


def fitted(runs: list[Run], truth: Truck, rng: np.random.Generator | None = None) -> Fit:
    return fit(of_runs(measured(runs, truth, rng), TRUCK), Physics(TRUCK))


def drawn(rng: np.random.Generator) -> Truck:
    """A truck drawn from the prior."""
    truth = TRUCK
    for u in UNKNOWNS:
        low, high = u.in_file["low"], u.in_file["high"]
        while True:
            value = TRUCK.value(u.key) + rng.normal() * u.deviation(TRUCK)
            if low <= value <= high:
                break
        truth = truth.with_value(u.key, value)
    return truth


def status(found: Fit) -> dict[str, str]:
    return {e.unknown.key: e.status for e in found.estimates}


def test_a_coast_down_takes_the_time_of_the_closed_formula() -> None:
    rolling = TRUCK.with_value("resistance.drag_area", 0.0)
    run = Run("", "coast_down", speed=3.0, end_speed=1.0)
    assert predicted(run, rolling) == pytest.approx(2.0 / (0.015 * 9.81), rel=1e-9)
    # With drag: t = m / sqrt(F c) (atan(v0 sqrt(c / F)) - atan(v1 sqrt(c / F))), F = f m g, c = rho c_d A / 2.
    force, c = 0.015 * 9.81 * 3575.0, 0.6 * 3.5
    k = np.sqrt(c / force)
    closed = 3575.0 / np.sqrt(force * c) * (np.arctan(3.0 * k) - np.arctan(k))
    assert predicted(run, TRUCK) == pytest.approx(closed, rel=1e-5)
    # Rotating parts make it longer in proportion.
    heavier = Physics(TRUCK, {"rotational_inertia": {"factor": 1.1}})
    assert predicted(run, TRUCK, heavier) == pytest.approx(1.1 * closed, rel=1e-5)


def test_energy_of_a_run_is_that_of_the_closed_formula() -> None:
    truck = TRUCK.with_value("resistance.drag_area", 0.0)
    drive, g = truck.drive, 9.81
    run = Run("", "drive", repeats=3, length=40, speed=3, payload=1000, acceleration=0.7, deceleration=0.9)
    m, v = 4575.0, 3.0
    kinetic, roll = 0.5 * m * v**2, 0.015 * m * g
    stop = v**2 / 1.8
    up = (kinetic + roll * (40.0 - stop)) / drive.efficiency
    back = (kinetic - roll * stop) * drive.regeneration
    seconds = v / 0.7 + v / 0.9 + (40.0 - v**2 / 1.4 - stop) / v
    expected = 3 * (up - back + 250.0 * seconds) / 3600.0
    assert predicted(run, truck) == pytest.approx(expected, rel=1e-5)


def test_the_cycle_alone_fits_nothing() -> None:
    found = fitted(CYCLE, TRUCK.with_value("resistance.rolling", 0.02))
    assert "fitted" not in status(found).values()
    assert any("none: these runs determine no single number" in line for line in lines(found))
    assert all(p["value"] is None for p in summary(found)["parameters"])


def test_flat_floor_runs_cannot_tell_rolling_from_drive_efficiency() -> None:
    truth = TRUCK.with_value("resistance.rolling", 0.02).with_value("drive.efficiency", 0.78)
    found = fitted(FLAT, truth)
    state = status(found)
    assert {"drive.efficiency", "drive.regeneration", "resistance.rolling"}.isdisjoint(
        k for k, s in state.items() if s == "fitted"
    )
    said = " ".join(map(blind_line, found.blind))
    assert "rolling coefficient" in said and "cannot tell drive efficiency from" in said
    assert "add a coast-down" in said
    # What they do carry is their quotient (section 3.4: energies on a flat floor depend on f / eta only).
    quotient = next(c for c in found.combinations if c.powers[0][0].key == "resistance.rolling")
    assert {u.key: p for u, p in quotient.powers}["drive.efficiency"] == pytest.approx(-1.0, abs=0.05)
    assert quotient.value == pytest.approx(0.02 / 0.78, rel=0.02)


@pytest.mark.parametrize("more", [COAST, RAMP], ids=["coast-down", "ramp"])
def test_a_coast_down_or_a_ramp_tells_them_apart(more: list[Run]) -> None:
    truth = TRUCK.with_value("resistance.rolling", 0.02).with_value("drive.efficiency", 0.78)
    found = fitted(FLAT + more, truth)
    state = status(found)
    assert state["drive.efficiency"] == state["resistance.rolling"] == "fitted"
    by_key = {e.unknown.key: e for e in found.estimates}
    assert by_key["resistance.rolling"].low <= 0.02 <= by_key["resistance.rolling"].high
    assert by_key["drive.efficiency"].low <= 0.78 <= by_key["drive.efficiency"].high


def test_what_no_run_touches_keeps_its_prior_exactly() -> None:
    found = fitted(FLAT, TRUCK.with_value("lift.recuperation", 0.3))
    held = {e.unknown.key: e for e in found.estimates}["lift.recuperation"]
    assert held.status == "held" and held.value == TRUCK.lift.recuperation
    assert any(
        "say nothing about lowering recuperation: add lowering runs" in blind_line(b) for b in found.blind
    )
    assert "lift.recuperation" not in {
        p["key"] for p in summary(found)["parameters"] if p["value"] is not None
    }


def test_runs_that_disagree_with_the_model_widen_the_intervals() -> None:
    runs = measured(WHOLE, TRUCK, np.random.default_rng(3))
    calm = fit(of_runs(runs, TRUCK), Physics(TRUCK))
    wild = [dataclasses.replace(r, energy=r.energy * (1.1 if i % 2 else 0.9)) for i, r in enumerate(runs)]
    torn = fit(of_runs(wild, TRUCK), Physics(TRUCK))
    assert torn.spread_factor > 3.0 * calm.spread_factor
    width = [f.estimates[7].high - f.estimates[7].low for f in (calm, torn)]
    assert width[1] > 2.0 * width[0]


@pytest.mark.slow
def test_hidden_trucks_lie_within_the_stated_intervals_in_95_of_100_draws() -> None:
    rng = np.random.default_rng(20260302)
    together_ok, each = 0, {u.key: 0 for u in UNKNOWNS}
    for _ in range(100):
        truth = drawn(rng)
        found = fitted(WHOLE, truth, rng)
        inside = {e.unknown.key: e.low <= truth.value(e.unknown.key) <= e.high for e in found.estimates}
        together_ok += all(inside.values())
        for key, ok in inside.items():
            each[key] += ok
    assert together_ok >= 95, (together_ok, each)


def test_a_recording_with_power_is_a_measurement_too() -> None:
    truth = TRUCK.with_value("resistance.rolling", 0.022).with_value("auxiliary.power", 400.0)
    rng = np.random.default_rng(5)
    pieces: list[Piece] = []
    for _ in range(60):
        pieces += [Piece(20.0), *run(float(rng.uniform(20, 80)), float(rng.uniform(1, 4)), 0.7, 0.8)]
    motion = legs(pieces, payload=0.0, dt=0.2)
    power = battery_power(motion, Physics(truth)) + rng.normal(0, 300.0, len(motion))
    found = fit(of_motion(motion.replaced(power=power), Physics(TRUCK)), Physics(TRUCK))
    by_key = {e.unknown.key: e for e in found.estimates}
    for key, value in (("resistance.rolling", 0.022), ("auxiliary.power", 400.0), ("drive.efficiency", 0.72)):
        assert by_key[key].status == "fitted", key
        assert by_key[key].low <= value <= by_key[key].high, key
    assert by_key["lift.efficiency"].status == "held"


def test_windows_do_not_cross_trips_and_hold_all_energy() -> None:
    motion = Motion.of(100, power=1000.0, trip=np.arange(100) // 37)
    seen = of_motion(motion, Physics(TRUCK))
    assert seen.measured.sum() == pytest.approx(100 * 1000.0 / 3600.0)
    assert len(seen) == 7
    assert len(together([seen, of_runs(measured(CYCLE, TRUCK), TRUCK)])) == 8


TABLE = """# measured at the dock
run,kind,repeats,payload,height,length,speed,duration,energy
idle,idle,,,,,,600,42.1
laden lifts,lift,20,2000,2,,,,420
coast,coast_down,,,,,3,19.5,
"""


def test_the_command_writes_a_truck_file_and_says_what_is_not_known(tmp_path) -> None:
    table, out = tmp_path / "runs.csv", tmp_path / "fitted.toml"
    table.write_text(TABLE)
    args = [str(table), "--truck", "three-wheel-2t", "-o", str(out)]
    answer = CliRunner().invoke(load_verb("calibrate"), [*args, "--json"])
    assert answer.exit_code == 0, answer.output
    said = json.loads(answer.stdout)
    parameters = {p["key"]: p for p in said["parameters"]}
    assert parameters["auxiliary.power"]["status"] == "fitted"
    assert parameters["auxiliary.power"]["low"] < 42.1 * 6 < parameters["auxiliary.power"]["high"]
    assert parameters["drive.efficiency"]["value"] is None
    truck = truck_from_dict(tomllib.loads(out.read_text()))
    assert truck.drive.efficiency == TRUCK.drive.efficiency
    assert truck.auxiliary.power == pytest.approx(parameters["auxiliary.power"]["value"], rel=1e-5)
    assert "not carried by these runs" in out.read_text()


def test_a_fitted_truck_reads_back() -> None:
    found = fitted(WHOLE, drawn(np.random.default_rng(1)))
    again = truck_from_dict(tomllib.loads(truck_toml(found)))
    for e in found.estimates:
        assert again.value(e.unknown.key) == pytest.approx(e.value, rel=1e-5)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("run,kind,energi\na,idle,1\n", "did you mean 'energy'"),
        ("run,kind\na,ilde\n", "did you mean 'idle'"),
        ("run,kind,energy,duration\na,idle,1,\n", "row 1: a run of kind idle needs 'duration'"),
        ("run,kind,energy,duration\na,idle,x,60\n", "row 1, energy: 'x' is not a number"),
        ("run,kind\n", "has no run"),
        ("run,kind,speed,duration\na,coast_down,3,0\n", "row 1, duration: 0 must be over 0"),
        ("run,kind,speed,length,energy\na,drive,0,10,5\n", "row 1, speed: 0 must be over 0"),
        ("run,kind,speed,end_speed,duration\na,coast_down,2,3,9\n", "the end speed is not below the speed"),
        ("run,kind,energy,duration,payload\na,idle,5,60,-3\n", "row 1, payload: -3 must be at least 0"),
        ("run,kind,energy,duration\na,idle,inf,60\n", "row 1, energy: inf is not a finite number"),
    ],
)
def test_a_fault_in_a_table_is_one_clear_line(tmp_path, text: str, said: str) -> None:
    (tmp_path / "runs.csv").write_text(text)
    with pytest.raises(InputError, match=said):
        read_runs(tmp_path / "runs.csv")

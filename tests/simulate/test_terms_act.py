"""Every built-in term that acts on force, power or speed acts in every mode of the simulator."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import Outcome
from laws import overlaps
from simulated_sites import PLACES, TRUCK, grid

import fleetlog
from fleetlog.physics.field import mirrored, stretches
from fleetlog.physics.power import Physics, all_terms
from fleetlog.physics.term import Parameter, Term
from fleetlog.simulate.engine import Settings, simulate
from fleetlog.store import DatasetWriter

AIR = replace(TRUCK, resistance=replace(TRUCK.resistance, drag_area=4.0))
"""Wind needs a drag area to act on."""
SITE = grid(3, 3, places=PLACES)
NETWORK = SITE.roads()
MODES = {
    "free": dict(site=SITE, vehicles=3, duration="5m"),
    "shared out": dict(like=True, vehicles=2, duration="5m"),
    "like": dict(like=True, duration="5m"),
    "same mission": dict(like=True, same_mission=True),
    "together": dict(like=True, same_mission=True, together=True),
}


def along(value, odd=False, kept=0.0):
    """A value on every road but at its ends, in one direction of each the opposite where it is ``odd``."""
    edges = np.flatnonzero(NETWORK.reverse > np.arange(len(NETWORK))) if odd else np.arange(len(NETWORK))
    low, high = np.full(len(edges), kept), NETWORK.length[edges] - kept
    field = stretches(NETWORK, edges, low, high, np.full(len(edges), value))
    return mirrored(field, NETWORK, True) if odd else field


def energy(rows):
    return sum(t.floats("battery_power").sum() for t in rows)


def used(rows):
    """Charge that driving took."""
    return sum(-np.minimum(np.diff(t.floats("soc")), 0.0).sum() for t in rows)


def speeds(rows):
    return np.concatenate([t.floats("speed") for t in rows])


def pace(rows):
    return speeds(rows)[speeds(rows) > 0.3].mean()


def laden_pace(rows):
    return np.concatenate([t.floats("speed")[t.floats("payload") > 1.0] for t in rows]).max()


def changes(rows, sign):
    step = np.concatenate([sign * np.diff(t.floats("speed")) for t in rows])
    return np.quantile(step[step > 0.0], 0.9)


def in_turns(rows):
    """Lowest speed on the way, half a dozen metres before and after each change of road."""
    out = []
    for t in rows:
        edge, speed = t.labels("edge_id").codes, t.floats("speed")
        for k in np.flatnonzero((np.diff(edge) != 0) & (speed[1:] > 0.5)):
            out.append(speed[max(k - 1, 0) : k + 3].min())
    return np.mean(out)


def stands_on_the_way(rows):
    """Rows in the middle of a lane at rest."""
    found = 0
    for t in rows:
        inside = np.abs(t.floats("edge_offset") - 15.0) < 0.5
        found += int((inside & (t.floats("speed") == 0.0) & (np.abs(t.floats("lateral_offset")) < 1.5)).sum())
    return found


CASES = {
    # What is changed, what it is seen in, and by which factor that changes at least.
    "acceleration_limit": ({"acceleration": 0.2}, lambda rows: changes(rows, 1.0), 0.7),
    "aerodynamic_drag": ({"drag_area": 15.0}, energy, 1.01),
    "auxiliary_load": ({"power": 1200.0}, energy, 1.2),
    "battery_capacity": ({"capacity_wh": 15000.0}, used, 1.8),
    "battery_resistance": ({"resistance": 0.1}, used, 1.01),
    "brake_drag": ({"brake_force": 400.0}, energy, 1.1),
    "braking": ({"deceleration": 0.3}, lambda rows: changes(rows, -1.0), 0.7),
    "copper_loss": ({"k": 1e-4}, energy, 1.02),
    "cornering_resistance": ({"k": 0.5}, energy, 1.02),
    "cornering_speed": ({"lateral_acceleration": 0.3}, in_turns, 0.9),
    "driven_speed": ({"share": 0.6}, lambda rows: speeds(rows).max(), 0.65),
    "drivetrain_efficiency": ({"efficiency": 0.5}, energy, 1.2),
    "enabled_load": ({"power": 1000.0, "hold": 8.0}, energy, 1.2),
    "grade": (along(0.05, odd=True), energy, 1.05),
    "inertia": (None, energy, 0.97),
    "laden_speed": ({"factor": 0.5}, laden_pace, 0.6),
    "lift_efficiency": ({"efficiency": 0.2}, energy, 1.02),
    "mass": ({"mass": 6500.0}, energy, 1.1),
    "payload": ({"factor": 3.0}, energy, 1.1),
    "regeneration": ({"regeneration": 0.0}, energy, 1.01),
    "rolling_resistance": ({"coefficient": 0.04}, energy, 1.2),
    "rotational_inertia": ({"factor": 1.5}, energy, 1.03),
    "speed_zone": (along(0.5), lambda rows: speeds(rows).max(), 0.6),
    "surface_resistance": (along(3.0), energy, 1.2),
    "thermal_load": ({"cooling": 100.0, "threshold": 10.0}, energy, 1.2),
    "viscous_drag": ({"coefficient": 150.0}, energy, 1.1),
    "waiting": (along(6.0, kept=12.0), stands_on_the_way, None),
    "wind": ({"wind_east": 12.0}, energy, 1.01),
}  # fmt: skip


def simulated(mode, physics, recording):
    given = {**MODES[mode], **({"like": recording} if "like" in MODES[mode] else {})}
    done = fleetlog.simulate(
        truck=AIR, physics=physics, seed=1, shadow=False, recording=False, **given
    ).dataset
    return [done.read(v) for v in done.vehicles]


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Half an hour that tells places, loads and drivers."""
    folder = tmp_path_factory.mktemp("recorded") / "log"
    fleetlog.simulate(
        site=SITE, truck=AIR, vehicles=3, duration="30m", seed=2, shadow=False, recording=False, output=folder
    )
    return folder


@pytest.fixture(scope="module")
def nominal(recording):
    return {mode: simulated(mode, Physics(AIR), recording) for mode in MODES}


def test_every_term_is_looked_at():
    acting = {n for n, t in all_terms().items() if t.acts not in ("traffic", "sensor")}
    assert acting == set(CASES)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("term", CASES)
def test_a_term_acts_in_every_mode(term, mode, recording, nominal):
    change, measure, factor = CASES[term]
    if change is None:
        physics = Physics(AIR, off=frozenset([term]))
    elif isinstance(change, dict):
        physics = Physics(AIR, values={term: change})
    else:
        physics = Physics(AIR, fields={term: change})
    before, after = measure(nominal[mode]), measure(simulated(mode, physics, recording))
    if factor is None:
        assert before == 0 < after
    elif factor > 1.0:
        assert after > factor * before
    else:
        assert after < factor * before


@pytest.mark.parametrize("mode", MODES)
def test_a_term_of_ones_own_that_waits_does_what_the_built_in_one_does(mode, recording, monkeypatch):
    own = Term("gate", "wait", "a gate opens slowly", (Parameter("delay", "s", 0.0, 60.0),), field=True)
    monkeypatch.setitem(all_terms(), own.name, own)
    by_name = {name: along(6.0, kept=12.0) for name in ("waiting", "gate")}
    built_in, mine = (simulated(mode, Physics(AIR, fields={n: f}), recording) for n, f in by_name.items())
    for a, b in zip(built_in, mine, strict=True):
        assert (a.floats("speed") == b.floats("speed")).all() and (a.floats("x") == b.floats("x")).all()
    # Where both act trucks stand for the one and for the other; where one is off, for the other.
    both = simulated(mode, Physics(AIR, fields=by_name), recording)
    assert stands_on_the_way(both) > 1.2 * stands_on_the_way(mine) > 0
    left = simulated(mode, Physics(AIR, fields=by_name, off=frozenset(["waiting"])), recording)
    assert all((a.floats("x") == b.floats("x")).all() for a, b in zip(left, mine, strict=True))


def test_a_load_that_outlasts_motion_is_the_same_wherever_batches_end():
    physics = Physics(AIR, values={"enabled_load": {"power": 1000.0, "hold": 8.0}})
    for plain, held in zip(
        simulated("free", Physics(AIR), None), simulated("free", physics, None), strict=True
    ):
        more = held.floats("battery_power") - plain.floats("battery_power")
        row, moves = np.arange(len(plain)), plain.floats("speed") > 0.0
        since = row - np.maximum.accumulate(np.where(moves, row, -99))
        # A row is the mean over a second: those in which it is switched off have a part of it.
        assert more[since <= 6] == pytest.approx(1000.0, abs=0.02)
        assert more[since >= 10] == pytest.approx(0.0, abs=0.02)
        assert ((since > 3) & (since <= 6)).any()


def test_waits_by_the_term_last_as_long_as_it_says_and_nobody_is_run_into(tmp_path):
    with DatasetWriter.create(tmp_path / "run", "simulated", SITE) as writer:
        physics = Physics(TRUCK, fields={"waiting": along(6.0, kept=12.0)})
        summary = simulate(SITE, TRUCK, writer, Settings(4, 600.0, interval=0.1), physics=physics)
    fleet = Outcome(tmp_path / "run", summary)
    assert summary.count.deadlocks == 0 and not overlaps(fleet)
    lasted = []
    for t in fleet.tracks:
        on_road = np.abs(t.floats("lateral_offset")) < 1.2
        at_mark = on_road & (np.abs(t.floats("edge_offset") - 15.0) < 0.3) & (t.floats("speed") == 0.0)
        begin = np.flatnonzero(np.diff(at_mark.astype(int), prepend=0) == 1)
        end = np.flatnonzero(np.diff(at_mark.astype(int), append=0) == -1)
        lasted += [(b - a + 1) * 0.1 for a, b in zip(begin, end, strict=True) if b + 1 < len(t)]
        # Whoever drives past the mark has stood there.
        passed = np.flatnonzero(on_road[1:] & (np.diff(t.floats("edge_offset")) > 0.0) & (t.floats("edge_offset")[1:] > 15.3)
                                & (t.floats("edge_offset")[:-1] <= 15.3))  # fmt: skip
        assert all(at_mark[max(k - 40, 0) : k + 1].any() for k in passed)
    assert len(lasted) > 10 and lasted == pytest.approx([6.0] * len(lasted), abs=0.25)

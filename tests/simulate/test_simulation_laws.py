"""Laws of every simulation, over seeds and small random sites."""

from dataclasses import replace

import numpy as np
import pytest
from laws import keeps_the_laws, steps
from simulated_sites import TRUCK, aisle, crossing, grid, place

from fleetlog.core.motion import Motion
from fleetlog.physics.power import Own, Physics, battery_power, cell_power, ledger
from fleetlog.simulate.engine import Settings
from fleetlog.simulate.tasks import Demand, Task

CASES = [(f"grid-{seed}", lambda s=seed: grid(4, 4, seed=s), 16) for seed in range(6)]
CASES += [
    ("crossing", crossing, 8),
    ("aisle", aisle, 8),
    ("even grid", grid, 16),
    ("left", lambda: grid(traffic="left"), 10),
]


@pytest.mark.parametrize("make, trucks", [c[1:] for c in CASES], ids=[c[0] for c in CASES])
def test_every_simulation_keeps_the_laws(make, trucks, simulated):
    site = make()
    sim = simulated(site, trucks, 400.0, seed=trucks)
    keeps_the_laws(sim, site.network)
    assert sum(steps(t).sum() for t in sim.tracks) > 100.0 * trucks
    s = sim.summary
    assert s.count.tasks_given == s.count.tasks_done + s.unfinished
    assert s.count.tasks_done > 0
    assert s.unfinished <= trucks


def test_energy_is_the_sum_of_its_terms_and_agrees_with_the_charge(simulated):
    sim = simulated(grid(), 6, 600.0, seed=3)
    truck, dt = TRUCK, 0.1
    for t in sim.tracks:
        power, soc = t.floats("battery_power"), t.floats("soc")
        used = (soc[0] - soc[-1]) * truck.battery.capacity_wh
        assert used == pytest.approx((cell_power(power, truck)[:-1] * dt).sum() / 3600.0, abs=0.01)
        speed = t.floats("speed")
        middle = 0.5 * (speed[:-1] + speed[1:])
        motion = Motion.of(
            len(middle), speed=middle, acceleration=np.diff(speed) / dt, payload=t.floats("payload")[:-1],
            lift_speed=np.diff(t.floats("fork_height")) / dt, dt=dt,
        )  # fmt: skip
        terms = ledger(motion, Physics(truck))
        again = sum(terms.values())
        for trip in np.unique(t.trip_ids()):
            mine = t.trip_ids()[:-1] == trip
            assert again[mine].sum() * dt == pytest.approx(power[:-1][mine].sum() * dt, rel=0.01, abs=500.0)


def test_rows_of_any_rate_carry_the_same_energy(simulated):
    fine, coarse = (simulated(grid(), 4, 300.0, seed=5, interval=i) for i in (0.1, 1.0))
    a = fine.array("battery_power").sum(axis=1) * 0.1
    b = coarse.array("battery_power").sum(axis=1) * 1.0
    np.testing.assert_allclose(a, b, rtol=1e-6)


def test_same_seed_same_bytes(simulated):
    def files(outcome):
        root = outcome.dataset.path
        return {
            str(p.relative_to(root)): p.read_bytes()
            for p in sorted(root.rglob("*"))
            if p.is_file() and p.name != "dataset.json"
        }

    a, b, c = (simulated(grid(seed=1), 5, 120.0, seed=s, interval=1.0) for s in (9, 9, 10))
    assert files(a) == files(b)
    assert files(a) != files(c)


def test_a_mirrored_site_has_a_mirrored_fleet(simulated):
    right = simulated(grid(seed=2), 8, 300.0, seed=4)
    left = simulated(grid(seed=2, mirror=True, traffic="left"), 8, 300.0, seed=4)
    np.testing.assert_allclose(left.array("x"), right.array("x"), atol=0.01)
    np.testing.assert_allclose(left.array("y"), -right.array("y"), atol=0.01)


def given_site():
    places = [
        place(1, "pick", 15, 3),
        place(1, "drop", 45, 33),
        place(1, "park", 15, 33),
        place(2, "park", 45, 3),
    ]
    return grid(3, 3, places=[*places, place(1, "charge", 33, 45, power=60000.0)])


def test_nobody_drives_on_a_closed_road(simulated):
    free, site = simulated(grid(3, 3), 6, 600.0, seed=2, interval=1.0), grid(3, 3)
    driven = {e for t in free.tracks for e in t.labels("edge_id").strings()}
    assert driven & {"e01h", "-e01h"}
    site = replace(site, network=site.network.without(["e01h"]))
    outcome = simulated(site, 6, 600.0, seed=2, interval=1.0)
    assert not {e for t in outcome.tracks for e in t.labels("edge_id").strings()} & {"e01h", "-e01h"}
    assert outcome.summary.count.tasks_done > 0


def test_given_tasks_are_done_with_their_loads(simulated):
    tasks = [Task(None, "pick1", "drop1", 800.0, 20.0 * i, (20.0, 20.0), (1.2, 2.4)) for i in range(6)]
    sim = simulated(given_site(), 2, 1500.0, demand=Demand(tasks, endless=False))
    assert sim.summary.count.tasks_done == 6
    changes = np.diff(sim.array("payload"), axis=1)
    assert (changes > 700).sum() == (changes < -700).sum() == 6
    assert sim.array("fork_height").max() == pytest.approx(2.4, abs=0.05)


def test_trucks_charge_and_an_empty_one_is_reported(simulated):
    site = given_site()
    sim = simulated(site, 2, 1800.0, soc=0.31, interval=1.0)
    assert sim.summary.count.charges >= 1
    assert sim.array("battery_power").min() < -10000.0
    assert sim.array("soc")[:, -1].max() > 0.5
    dry = simulated(grid(), 2, 900.0, soc=0.005, interval=1.0)
    assert sorted(dry.summary.count.empty) == ["T1", "T2"]
    assert (dry.array("speed")[:, -1] == 0.0).all()
    assert (dry.array("battery_power")[:, -1] == 0.0).all()


def test_a_term_can_be_added_and_switched_off(simulated):
    plain = simulated(grid(), 2, 120.0, interval=1.0)
    more = simulated(
        grid(), 2, 120.0, interval=1.0, physics=Physics(TRUCK, {"auxiliary_load": {"power": 900.0}})
    )
    less = simulated(
        grid(), 2, 120.0, interval=1.0, physics=Physics(TRUCK, off=frozenset({"auxiliary_load"}))
    )
    np.testing.assert_allclose(more.array("battery_power") - plain.array("battery_power"), 500.0, atol=0.02)
    np.testing.assert_allclose(plain.array("battery_power") - less.array("battery_power"), 400.0, atol=0.02)


def test_a_truck_and_an_hour_have_values_of_their_own(simulated):
    plain = simulated(grid(), 3, 120.0, interval=1.0)
    begin = Settings().start * 1e-6
    own = (
        Own({"auxiliary_load": {"power": 900.0}}, ("T2",)),
        Own({"auxiliary_load": {"power": 700.0}}, ("T3", "T9"), begin=begin + 60.0),
    )
    of_its_own = simulated(grid(), 3, 120.0, interval=1.0, physics=Physics(TRUCK, own=own))
    more = of_its_own.array("battery_power") - plain.array("battery_power")
    np.testing.assert_array_equal(of_its_own.array("x"), plain.array("x"))
    np.testing.assert_allclose(more[0], 0.0, atol=0.02)
    np.testing.assert_allclose(more[1], 500.0, atol=0.02)
    np.testing.assert_allclose(more[2, :59], 0.0, atol=0.02)
    np.testing.assert_allclose(more[2, 61:], 300.0, atol=0.02)
    note = "the model has values of its own for T9, which this fleet lacks"
    assert sorted(of_its_own.summary.notes) == sorted([*plain.summary.notes, note])


def test_a_truck_drives_by_the_speed_of_its_own(simulated):
    slow = Own({"driven_speed": {"share": 0.5}}, ("T2",))
    sim = simulated(grid(), 2, 300.0, interval=1.0, physics=Physics(TRUCK, own=(slow,)))
    fastest = sim.array("speed").max(axis=1)
    assert fastest[1] < 0.6 * fastest[0]


def test_power_at_rest_is_auxiliary_only():
    still = Motion.of(3)
    np.testing.assert_allclose(battery_power(still, Physics(TRUCK)), TRUCK.auxiliary.power)

"""What limits a fleet: known from how the case was built, and what one more of it brings."""

from dataclasses import replace

import pytest
from simulated_sites import TRUCK, grid, place

from fleetlog.core.truck import truck_from_dict
from fleetlog.errors import InputError
from fleetlog.simulate.engine import Settings
from fleetlog.simulate.scenario import Scenario, one_more
from fleetlog.simulate.tasks import Demand, Task

PLACES = [
    *(place(k, "pick", 15, 3 + 27 * k) for k in range(3)), *(place(k, "drop", 45, 3 + 27 * k) for k in range(3)),
]  # fmt: skip
SMALL = truck_from_dict({"chassis": {"mass": 4400.0}, "battery": {"capacity_wh": 2000.0}})


def scenario(places, vehicles, demand=None, truck=TRUCK, hours=1.0, **settings):
    return Scenario(
        grid(places=places),
        truck,
        Settings(vehicles, 3600.0 * hours, **settings),
        demand or Demand(pause=1.0),
    )


def steady(seconds, spacing, dwell=20.0):
    times = range(0, int(seconds), spacing)
    return Demand(
        [
            Task(None, f"pick{k % 3}", f"drop{(k + k // 3) % 3}", 500.0, float(t), (dwell, dwell), (0.3, 0.3))
            for k, t in enumerate(times)
        ],
        endless=False,
    )


def charging(plugs):
    return [*PLACES, place(0, "charge", 30, 45, power=2000.0, plugs=plugs)]


CASES = {
    "trucks": (scenario(PLACES, 2), None),
    "pick places": (scenario([PLACES[0], *PLACES[3:]], 8), "pick0"),
    "drop places": (scenario(PLACES[:4], 8), "drop0"),
    "chargers": (scenario(charging(1), 8, truck=SMALL, soc=0.35), "charge0"),
}


@pytest.mark.parametrize("kind", CASES)
def test_the_bottleneck_is_named_and_one_more_of_it_helps(kind):
    case, name = CASES[kind]
    summary = case.run()
    found = summary.limits.bottleneck
    assert (found.kind, found.name) == (kind, name)
    assert found.utilisation > 0.8
    more = one_more(case, summary)
    assert more["statement"].startswith("one more")
    if kind == "chargers":
        assert more["waiting_s"] < summary.waiting_s
    else:
        assert more["tasks_done"] > summary.count.tasks_done


def test_nothing_limits_a_fleet_that_does_what_is_asked_of_it():
    case = scenario(PLACES, 4, steady(3600, 180))
    summary = case.run()
    assert summary.limits.bottleneck is None
    assert one_more(case, summary) == {}
    assert any("none" in line for line in summary.lines())


def test_more_tasks_than_the_fleet_can_do_wait_longer_and_one_more_truck_shortens_that():
    case = scenario(PLACES, 2, steady(3600, 30))
    summary = case.run()
    assert summary.limits.bottleneck.kind == "trucks"
    assert summary.limits.task_wait_s["mean"] > 300.0
    assert one_more(case, summary)["task_wait_s"] < summary.limits.task_wait_s["mean"]


def test_trucks_that_cannot_begin_for_want_of_a_free_place_wait():
    """Ten trucks and one pick place: at most one works there, one is on its way off; the others wait, in the sum too."""
    case = scenario([PLACES[0], *PLACES[3:]], 10)
    summary = case.run()
    waiting = summary.limits.waiting_s
    assert waiting["pick places"] > 0.4 * 10 * 3600.0
    assert summary.waiting_s == pytest.approx(sum(waiting.values()))
    tasks = [Task(None, "pick0", "drop0", 1.0 + k, 0.0) for k in range(200)]
    given = replace(case, demand=Demand(tasks, endless=False)).run()
    assert given.limits.waiting_s["pick places"] > 0.3 * 10 * 3600.0


def test_a_single_task_keeps_no_more_than_one_truck_waiting():
    places = [PLACES[0], *PLACES[3:]]
    held = Task("T1", "pick0", "drop0", 500.0, 0.0, (1500.0, 20.0), (0.3, 0.3))
    wanted = Task(None, "pick0", "drop1", 500.0, 60.0, (20.0, 20.0), (0.3, 0.3))
    summary = scenario(places, 6, Demand([held, wanted], endless=False), hours=0.5).run()
    assert 1000.0 < summary.limits.waiting_s["pick places"] < 1800.0


@pytest.mark.parametrize("tasks", [[("T1", 500.0, 0.0)] * 30, [(None, 1500.0, 0.0)] * 60])
def test_tasks_that_only_a_part_of_the_fleet_can_do_are_short_of_trucks(tasks):
    """All for one truck, or heavy ones for the only strong one: the others stand, and the fleet is no match."""
    weak = replace(TRUCK, chassis=replace(TRUCK.chassis, rated_load=1000.0))
    given = [Task(who, "pick0", "drop0", load + k, at) for k, (who, load, at) in enumerate(tasks)]
    case = scenario(PLACES, 4, Demand(given, endless=False), (TRUCK, weak, weak, weak))
    found = case.run().limits.bottleneck
    assert (found.kind, found.name) == ("trucks", tasks[0][0])


def test_breaks_do_not_hide_that_trucks_are_short():
    case = scenario(PLACES, 2, steady(3600, 30))
    breaks = [(6.0 * 3600.0, 6.0 * 3600.0 + 900.0)]
    rested = replace(case, site=replace(case.site, breaks=tuple(breaks))).run()
    assert rested.limits.bottleneck.kind == "trucks"
    assert rested.limits.bottleneck.utilisation > 0.95


def test_what_one_more_brings_is_told_of_what_holds_others_up():
    """Many pick places fill up because there is one place to drop: more of them bring nothing."""
    case = scenario([PLACES[0], PLACES[1], PLACES[3]], 10)
    summary = case.run()
    more = one_more(case, summary)
    assert "drop place at drop0" in more["statement"]
    assert more["tasks_done"] > 1.02 * summary.count.tasks_done


def test_endless_tasks_leave_no_time_to_charge_before_it_is_needed():
    """More plugs never cost tasks: between two tasks a truck has seconds, and goes on."""
    done = [scenario(charging(n), 8, truck=SMALL, soc=0.6, hours=2.0).run().count for n in (1, 4)]
    assert done[1].tasks_done > 0.98 * done[0].tasks_done


def test_who_has_to_charge_takes_the_place_of_who_has_enough():
    """One plug for two trucks that are both nearly empty: neither keeps it beyond what is worth while."""
    case = scenario(charging(1), 2, steady(6 * 3600, 120), SMALL, hours=6.0, soc=0.31)
    summary = case.run()
    assert summary.count.charges >= 4
    assert not summary.count.empty


def test_a_load_that_no_truck_can_carry_is_an_error():
    heavy = Demand([Task("T2", "pick0", "drop0", 1500.0, 0.0)], endless=False)
    weak = replace(TRUCK, chassis=replace(TRUCK.chassis, rated_load=1000.0))
    with pytest.raises(InputError, match="more than the 1000 kg that T2 carries"):
        scenario(PLACES, 2, heavy, (TRUCK, weak)).run()

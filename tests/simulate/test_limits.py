"""What limits a fleet: known from how the case was built, and what one more of it brings."""

from dataclasses import replace

import pytest
from simulated_sites import TRUCK, grid, place

from fleetlog.core.truck import truck_from_dict
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

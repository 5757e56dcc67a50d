"""Mixed fleets, breaks, people who cross, a limit of power for the site: what operations add to roads and tasks."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from laws import overlaps
from simulated_sites import TRUCK, grid, place

from fleetlog.core.site import Site, Zone, site_from_dict, site_to_dict
from fleetlog.core.truck import load_truck
from fleetlog.errors import DataError, SiteError, TruckError
from fleetlog.roads.load import load_site
from fleetlog.simulate.demand import like
from fleetlog.simulate.state import Trucks
from fleetlog.simulate.tasks import Demand, Task
from fleetlog.simulate.world import Crossings
from fleetlog.store.events import read_table
from fleetlog.store.results import write_site

PLACES = [
    place(1, "pick", 15, 3),
    place(1, "drop", 45, 33),
    place(2, "pick", 33, 45),
    place(2, "drop", 3, 45),
]
SMALL = replace(
    TRUCK, name="small", chassis=replace(TRUCK.chassis, mass=2500.0, rated_load=800.0, length=2.0),
    drive=replace(TRUCK.drive, max_speed=1.5, max_acceleration=0.3, max_deceleration=0.4),
)  # fmt: skip


def mixed(count):
    return replace(TRUCK, others=((SMALL, count),))


def test_every_truck_keeps_its_own_limits_and_all_stay_apart(simulated):
    fleet = simulated(grid(3, 3, places=PLACES), 6, 400.0, truck=mixed(3), seed=1)
    assert not overlaps(fleet)
    speed = fleet.array("speed")
    up = np.diff(speed, axis=1).max(axis=1) / 0.1
    assert (speed[:3].max(axis=1) > 2.5).all() and (speed[3:].max(axis=1) <= 1.5 + 1e-3).all()
    assert (up[:3] > 0.5).all() and (up[3:] <= 0.3 + 0.02).all()
    assert fleet.array("payload")[3:].max() <= 800.0 < fleet.array("payload")[:3].max()
    assert fleet.summary.count.deadlocks == 0


def test_who_cannot_carry_a_load_leaves_it_to_others(simulated):
    pick, drop = (next(p.id for p in PLACES if p.kind == kind) for kind in ("pick", "drop"))
    tasks = [Task(None, pick, drop, load, 30.0 * k) for k, load in enumerate((1500.0, 500.0) * 6)]
    site = grid(3, 3, places=PLACES)
    done = simulated(site, 3, 2400.0, truck=mixed(2), interval=1.0, demand=Demand(tasks, endless=False))
    table = read_table(done.dataset, "tasks")
    assert (table.status == "done").all()
    assert set(table.vehicle_id[table.payload > 800.0]) == {"T1"}
    assert set(table.vehicle_id[table.payload <= 800.0]) & {"T2", "T3"}


def test_a_truck_file_brings_others_beside_it(tmp_path):
    (tmp_path / "small.toml").write_text('name = "small"\n[chassis]\nmass = 2000.0\n')
    file = tmp_path / "fleet.toml"
    file.write_text('[chassis]\nmass = 4000.0\n[[fleet]]\ntruck = "small.toml"\ncount = 2\n')
    trucks = Trucks.given(load_truck(file), 5)
    assert [trucks[v].chassis.mass for v in range(5)] == [4000.0] * 3 + [2000.0] * 2
    with pytest.raises(DataError, match="more than the vehicles"):
        Trucks.given(load_truck(file), 1)
    for wrong in (
        'truck = "none.toml"\ncount = 1',
        'truck = "small.toml"',
        'truck = "fleet.toml"\ncount = 1',
    ):
        file.write_text(f"[chassis]\nmass = 4000.0\n[[fleet]]\n{wrong}\n")
        with pytest.raises(TruckError):
            load_truck(file)


def test_on_breaks_trucks_finish_what_they_carry_and_take_no_task(simulated):
    start = 1_767_592_800_000_000  # 06:00 UTC
    site = replace(grid(3, 3, places=PLACES), breaks=((6.25 * 3600.0, 6.5 * 3600.0),))
    fleet = simulated(site, 4, 2700.0, interval=1.0, start=start)
    taken = read_table(fleet.dataset, "tasks").assigned.dropna()
    taken = (taken - pd.Timestamp(start, unit="us", tz="UTC")).dt.total_seconds()
    assert not ((taken > 901.0) & (taken < 1799.0)).any()
    assert (taken <= 901.0).any() and (taken >= 1799.0).any()
    resting = fleet.array("speed")[:, 1300:1790]
    assert resting.max() < 0.05 and (fleet.array("payload")[:, 1300:1790] == 0.0).all()


def test_trucks_wait_for_people_who_cross_and_never_drive_through_them(simulated):
    zone = Zone(
        "walk",
        np.array([[10.0, 28.0], [20.0, 28.0], [20.0, 32.0], [10.0, 32.0]]),
        closed_every=25.0,
        closed_for=20.0,
    )
    site = grid(3, 3, places=PLACES)
    free, crossed = (simulated(replace(site, zones=z), 5, 1200.0, seed=3) for z in ((), (zone,)))
    assert crossed.summary.limits.waiting_s["traffic"] > free.summary.limits.waiting_s["traffic"] + 30.0
    inside = zone.contains(crossed.array("x").ravel(), crossed.array("y").ravel())
    assert inside.any(), "trucks still pass when nobody crosses"
    assert not overlaps(crossed)
    assert crossed.summary.count.deadlocks == 0


def test_a_zone_is_open_for_a_mean_time_between_crossings_of_one_length():
    square = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
    zone = Zone("walk", square, closed_every=120.0, closed_for=10.0)
    crossings, closed, seen = Crossings(Site(zones=(zone,)), np.ones((1, 1)), seed=1), np.zeros(1, bool), []
    for second in range(400_000):
        crossings.tick(float(second), closed)
        seen.append(closed[0])
    lasted = np.diff(np.flatnonzero(np.diff(np.array(seen, int))))
    assert not seen[0] and np.median(lasted[::2]) == 10
    assert np.mean(seen) == pytest.approx(10.0 / 130.0, rel=0.05)


def test_chargers_together_keep_to_the_limit_of_the_site(simulated):
    chargers = [place(1, "charge", 45, 3), place(2, "charge", 15, 57), place(3, "charge", 3, 15)]
    site = replace(grid(3, 3, places=(*PLACES, *chargers)), power_limit=9000.0)
    fleet = simulated(site, 4, 3600.0, interval=1.0, soc=0.25)
    power = fleet.array("battery_power")
    total = np.where(power < 0.0, TRUCK.auxiliary.power - power, 0.0).sum(axis=0)
    assert total.max() <= 9000.0 * 1.02
    assert total.max() > 8500.0, "the limit is used"


SWAPPED = place(1, "charge", 45, 3, swap=180.0)
SMALL_BATTERY = replace(TRUCK, battery=replace(TRUCK.battery, capacity_wh=3000.0))


def test_a_battery_is_swapped_in_its_time_and_only_when_it_has_to_be(simulated):
    fleet = simulated(
        grid(3, 3, places=(*PLACES, SWAPPED)), 3, 3600.0, truck=SMALL_BATTERY, interval=1.0, soc=0.4
    )
    soc, power, speed = (fleet.array(name) for name in ("soc", "battery_power", "speed"))
    done = read_table(fleet.dataset, "activities")
    visits = done[done.activity == "charge"]
    lasted = (visits.end - visits.start).dt.total_seconds()
    whole = visits.end < done.end.max()
    assert fleet.summary.count.charges == len(visits) >= 2 and whole.any()
    assert lasted[whole].tolist() == pytest.approx([180.0] * int(whole.sum()), abs=1.0)
    leaps = np.argwhere(np.diff(soc, axis=1) > 0.01)
    # Nothing is charged between two leaps, each to a full battery, at rest and from below the policy's limit.
    assert len(leaps) == int(whole.sum()) and (power[speed == 0.0] >= 0.0).all()
    assert all(soc[v, k] < 0.3 < 0.99 < soc[v, k + 1] and speed[v, k] == 0.0 for v, k in leaps)
    brought = sum(1.0 - soc[v, k] for v, k in leaps) * 3000.0
    assert fleet.summary.charged_wh == pytest.approx(brought, rel=0.01)


def test_opportunity_charging_is_for_chargers_and_not_for_swaps(simulated):
    charger = place(2, "charge", 15, 57)
    tasks = Demand([Task(None, "pick1", "drop1", 500.0, 60.0 * k) for k in range(3)], endless=False)
    swapped, charged = (
        simulated(grid(3, 3, places=(*PLACES, p)), 2, 1800.0, interval=1.0, soc=0.6, demand=tasks)
        for p in (SWAPPED, charger)
    )
    assert swapped.summary.count.charges == 0 < charged.summary.count.charges


def test_swaps_are_learned_from_a_recording(simulated):
    fleet = simulated(
        grid(3, 3, places=(*PLACES, SWAPPED)), 3, 7200.0, truck=SMALL_BATTERY, interval=1.0, soc=0.4
    )
    bare = replace(fleet.dataset.site, places=())
    site, _, _ = like(fleet.dataset, bare, SMALL_BATTERY, 3, 0, 60.0, 0)
    found = [p for p in site.places if p.kind == "charge"]
    assert len(found) == 1 and found[0].swap == pytest.approx(180.0, abs=10.0)
    assert np.hypot(found[0].x - 45.0, found[0].y - 3.0) < 8.0


def test_operations_are_kept_with_a_site(tmp_path):
    zone = Zone("walk", np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0]]), closed_every=60.0, closed_for=8.0)
    site = replace(
        grid(2, 2), zones=(zone,), breaks=((32400.0, 34200.0),), power_limit=40000.0, places=(SWAPPED,)
    )
    write_site(site, tmp_path)
    for back in (load_site(tmp_path)[0], site_from_dict(site_to_dict(site))):
        assert back.breaks == site.breaks and back.power_limit == site.power_limit
        assert back.places[0].swap == 180.0
        assert (back.zones[0].closed_every, back.zones[0].closed_for) == (60.0, 8.0)
    file = tmp_path / "site.toml"
    for wrong in (
        '[[break]]\nfrom = "9h"\nuntil = "10:00"',
        '[[break]]\nfrom = "09:00"',
        "[power]\nlimit = -1.0",
    ):
        file.write_text(wrong)
        with pytest.raises(SiteError):
            load_site(tmp_path)


def test_what_has_no_effect_in_a_site_is_an_error_that_names_its_key(tmp_path):
    (file := tmp_path / "site.toml").write_text("")
    pick = '[[place]]\nid = "p"\nkind = "pick"\nx = 0.0\ny = 0.0\n'
    zone = "[[zone]]\npolygon = [[0, 0], [4, 0], [4, 4]]\n"
    for idle, key in (
        (f"{pick}swap = 60.0", "place[0].swap"),
        (f"{pick}power = 60.0", "place[0].power"),
        (f"{pick.replace('pick', 'charge')}swap = 60.0\npower = 60.0", "place[0].power"),
        (f"{zone}closed_for = 5.0", "zone[0].closed_for"),
        ('[[break]]\nfrom = "06:20"\nuntil = "06:20"', "break[0].until"),
    ):
        file.write_text(idle)
        with pytest.raises(SiteError) as error:
            load_site(file)
        assert key in str(error.value) and "site.toml" in str(error.value)
    file.write_text(f"{zone}closed_every = 60.0")
    assert load_site(file)[0].zones[0].closed_for == 10.0


def test_a_break_may_last_past_midnight():
    site = replace(grid(2, 2), breaks=((22.0 * 3600.0, 6.0 * 3600.0),))
    assert [site.on_break(h * 3600.0) for h in (21.9, 22.1, 2.0, 5.9, 6.1)] == [
        False,
        True,
        True,
        True,
        False,
    ]

"""Nobody waits for ever: few bays, a fleet as large as they hold, and work for an hour."""

from dataclasses import replace

import numpy as np
import pytest
from laws import corners, overlap
from simulated_sites import TRUCK, aisle, grid, place

from fleetlog.core.site import Place
from fleetlog.simulate.doors import Stand
from fleetlog.simulate.junctions import GAP
from fleetlog.simulate.kernels import gates, lanes
from fleetlog.simulate.kernels.gates import ask
from fleetlog.simulate.kernels.traffic import advance
from fleetlog.simulate.state import HAIR, Mode, Trucks, limits_of, new_fleet, new_log
from fleetlog.simulate.tasks import Demand, Task
from fleetlog.simulate.world import build_world

PATIENCE = 300.0


def few_bays(drops):
    """A dock of two bays, some drops, and no parking but what the simulator draws."""
    docks = [place(i, "pick", 15, 3 + 24 * i) for i in range(2)]
    return grid(3, 3, places=[*docks, *(place(i, "drop", 45, 3 + 15 * i) for i in range(drops))])


def longest_stand(outcome, rows):
    """Longest time [s] that any truck stands on end in the marked (V, N) rows of one second each."""
    still = (outcome.array("speed") < 0.01) & rows
    longest = run = np.zeros(still.shape[0])
    for k in range(still.shape[1]):
        run = np.where(still[:, k], run + 1, 0)
        longest = np.maximum(longest, run)
    return longest.max()


@pytest.mark.parametrize("trucks, drops", [(4, 1), (8, 2), (12, 3)])
def test_all_tasks_are_done_where_bays_are_few(simulated, trucks, drops):
    tasks = [
        Task(None, f"pick{i % 2}", f"drop{i % drops}", 500.0, 20.0 * i, (15.0, 15.0), (0.3, 0.3))
        for i in range(40)
    ]
    sim = simulated(few_bays(drops), trucks, 3600.0, interval=1.0, demand=Demand(tasks, endless=False))
    count = sim.summary.count
    assert (count.tasks_given, count.tasks_done, sim.summary.unfinished) == (40, 40, 0)
    assert longest_stand(sim, sim.array("payload") > 0) < PATIENCE


def test_a_task_for_one_truck_is_done_though_another_stands_idle_at_its_source(simulated):
    for holder in ("T1", "T2"):
        tasks = [
            Task(holder, "pick0", "pick1", 500.0, 0.0, (15.0, 15.0), (0.3, 0.3)),
            Task("T2" if holder == "T1" else "T1", "pick1", "drop0", 500.0, 1.0, (15.0, 15.0), (0.3, 0.3)),
        ]
        sim = simulated(few_bays(1), 2, 900.0, interval=1.0, demand=Demand(tasks, endless=False))
        assert sim.summary.count.tasks_done == 2


@pytest.mark.parametrize("drops", [1, 2])
def test_endless_tasks_go_on_where_all_drops_are_taken(simulated, drops):
    sim = simulated(few_bays(drops), 8, 3600.0, interval=1.0)
    done = np.diff(sim.array("payload"), axis=1) < 0
    last = np.flatnonzero(done.any(axis=0))
    assert last[0] < 600 and np.diff(last).max() < PATIENCE and last[-1] > 3600 - PATIENCE
    assert sim.summary.unfinished <= 8


@pytest.mark.parametrize("seed", [1, 2])
def test_a_full_site_keeps_moving(simulated, seed):
    """Sixty trucks on three by three crossings, as many as there are bays for."""
    sim = simulated(grid(3, 3), 60, 3600.0, seed=seed, interval=1.0)
    assert longest_stand(sim, np.ones(sim.array("speed").shape, dtype=bool)) < PATIENCE
    done = np.diff(sim.array("payload"), axis=1) < 0
    quarters = [q.sum() for q in np.array_split(done.any(axis=0), 4)]
    assert min(quarters) > 0.5 * max(quarters)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_single_lane_aisle_keeps_moving(simulated, seed):
    """Ten trucks, and all that lies apart is reached through one lane that is driven in both directions."""
    sim = simulated(aisle(), 10, 3600.0, seed=seed, interval=1.0)
    assert longest_stand(sim, np.ones(sim.array("speed").shape, dtype=bool)) < PATIENCE
    assert sim.summary.count.tasks_done > 50


@pytest.mark.parametrize("site, seed", [(1, 1), (2, 0), (2, 1)])
def test_narrow_roads_with_too_many_trucks_keep_moving(simulated, site, seed):
    """Forty-five trucks where most roads have room for one direction at a time: slow, but nobody stands for ever."""
    sim = simulated(grid(4, 4, 34.0, seed=site, width=2.2), 45, 3600.0, seed=seed, interval=1.0)
    assert sim.summary.longest_wait_s < 720.0
    done = np.diff(sim.array("payload"), axis=1) < 0
    assert min(q.sum() for q in np.array_split(done.any(axis=0), 4)) >= 10


@pytest.mark.parametrize("trucks", [60, 240])
def test_bays_that_lie_close_have_doors_to_both_lanes(trucks):
    """Else who comes from the other side would have to drive round a block."""
    doors = [len(of_bay) for of_bay in build_world(grid(4, 4, 60.0), TRUCK, trucks).ways.of_bay]
    assert np.mean(np.array(doors) == 2) > 0.9


def test_more_trucks_do_more_in_all_and_nobody_waits_for_one_another(simulated):
    """Up to a quarter of the cells full, on one site; rows are not looked at."""
    runs = [simulated(grid(4, 4, 60.0), n, 600.0, seed=1, interval=10.0, room=180) for n in (60, 120, 180)]
    done = [sim.summary.count.tasks_done for sim in runs]
    assert done[0] < done[1] < done[2]
    assert not any(sim.summary.count.deadlocks for sim in runs)


def test_who_comes_to_a_queue_takes_another_way():
    world = build_world(grid(3, 3, 60.0), TRUCK, 5)
    network, ways = world.track.network, world.ways
    lane, far = (
        network.index["e00h"],
        next(b for b, bay in enumerate(world.bays) if bay.door.lane == network.index["e11v"]),
    )
    free = ways.onward(lane, 5.0, far)
    lost = np.zeros(len(network))
    lost[free.pieces[2]] = 60.0
    ways.lose(lost)
    assert ways.rest(free.pieces, 5.0, free.door) > free.cost + 50.0
    assert free.pieces[2] not in ways.onward(lane, 5.0, far).pieces
    ways.lose(np.zeros(len(network)))
    assert ways.onward(lane, 5.0, far).pieces.tolist() == free.pieces.tolist()


def test_who_crosses_a_lane_asks_for_both_lanes_or_for_neither():
    """Two that wait across from each other, with one lane each, would hold up each other's queues for ever."""
    world = build_world(grid(3, 3, 60.0), TRUCK, 5)
    roads, kinds = world.roads, Trucks.given(TRUCK, 2)
    x = limits_of([TRUCK], kinds.of, TRUCK.chassis.length, GAP)
    fleet = new_fleet(2, len(roads.clear), len(roads.length), len(roads.conflict_first) - 1, 16)
    door = int(np.flatnonzero(roads.door_crosses >= 0)[0])
    lanes = [roads.door_lane[door], roads.door_crosses[door]]
    fleet.mode[:], fleet.door[:], fleet.asks[lanes[1]] = Mode.WANTS_OUT, door, 1
    ask.py_func(roads, fleet, 0, x, True, 0.0)
    assert fleet.asks[lanes].tolist() == [-1, 1]
    fleet.asks[lanes[1]] = -1
    ask.py_func(roads, fleet, 0, x, True, 0.0)
    assert fleet.asks[lanes].tolist() == [0, 0]


def test_who_comes_out_asks_nobody_while_somebody_stands_in_its_way_but_not_for_ever():
    world = build_world(grid(3, 3, 60.0), TRUCK, 5)
    roads, kinds = world.roads, Trucks.given(TRUCK, 2)
    x = limits_of([TRUCK], kinds.of, TRUCK.chassis.length, GAP)
    door = int(np.flatnonzero(roads.door_crosses >= 0)[0])
    lanes, ground = (
        [roads.door_lane[door], roads.door_crosses[door]],
        (roads.door_at[door], roads.door_low[door] + 1.0),
    )
    for lane, at in zip(lanes, ground, strict=True):
        for where, pace, waited, asks in [
            (0.0, 0.0, 20.0, -1),
            (0.0, 1.0, 20.0, 0),
            (9.0, 0.0, 20.0, 0),
            (0.0, 0.0, 40.0, 0),
        ]:
            fleet = new_fleet(2, len(roads.clear), len(roads.length), len(roads.conflict_first) - 1, 16)
            fleet.mode[:], fleet.door[0], fleet.waits[0] = (Mode.WANTS_OUT, Mode.DRIVING), door, 0.0
            fleet.piece[1], fleet.tail[lane], fleet.s[1], fleet.v[1] = lane, 1, at + where, pace
            ask.py_func(roads, fleet, 0, x, True, waited)
            assert fleet.asks[lanes].tolist() == [asks, asks]


def test_several_trucks_cross_a_lane_each_at_its_own_place(monkeypatch):
    """Each is in the way until it is over, whichever is over first."""
    world = build_world(grid(3, 3, 60.0), TRUCK, 5)
    roads = world.roads
    fleet = new_fleet(3, len(roads.clear), len(roads.length), len(roads.conflict_first) - 1, 16)
    lane = int(roads.door_crosses[roads.door_crosses >= 0][0])
    fleet.door[:] = np.resize(np.flatnonzero(roads.door_crosses == lane), 3)
    monkeypatch.setattr(gates, "asks_no_more", gates.asks_no_more.py_func)
    for v in range(3):
        gates.take_spur.py_func(roads, fleet, v)
    left = [0, 1, 2]
    for v in (1, 2, 0):
        lanes.drop.py_func(fleet.crossed, fleet.beside, v, lane)
        left.remove(v)
        u, found = fleet.crossed[lane], []
        while u >= 0:
            found, u = [*found, int(u)], fleet.beside[u]
        assert sorted(found) == left


def heeded(fleet, roads, v, lane):
    return lanes.heeded.py_func(roads, fleet, v, lane)


def test_who_stands_in_the_way_of_an_older_one_does_not_stop_for_a_younger():
    """Trucks 0 and 1 wait before closed lanes; 2 stands before the door of 0, and wants onto the lane of 1."""
    world = build_world(grid(3, 3, 60.0), TRUCK, 5)
    roads = world.roads
    fleet = new_fleet(3, len(roads.clear), len(roads.length), len(roads.conflict_first) - 1, 16)
    here, there = np.flatnonzero(roads.capacity > 2)[:2].tolist()
    fleet.asks[[here, there]], fleet.ask_at[[here, there]] = (0, 1), 20.0
    fleet.mode[2], fleet.piece[2], fleet.s[2] = Mode.DRIVING, here, 25.0
    fleet.waits[:2] = 10.0, 20.0
    assert heeded(fleet, roads, 2, there) == -1, "0 has waited for longer"
    fleet.waits[:2] = 20.0, 10.0
    assert heeded(fleet, roads, 2, there) == 1
    fleet.waits[:2], fleet.s[2] = (10.0, 20.0), 15.0
    assert heeded(fleet, roads, 2, there) == 1, "it does not stand in the way of 0"
    assert heeded(fleet, roads, 2, here) == 0 and heeded(fleet, roads, 0, here) == -1


@pytest.mark.parametrize("trucks, seed, sharp, seconds", [(180, 2, False, 400.0), (240, 3, True, 1200.0)])
def test_trucks_that_ask_one_another_to_stop_form_no_ring(simulated, trucks, seed, sharp, seconds):
    """Both fleets stood in a ring on the way."""
    quick = dict(max_acceleration=3.0, max_deceleration=3.0, max_lateral_acceleration=6.0, max_power=2e5)
    truck = replace(TRUCK, drive=replace(TRUCK.drive, **quick)) if sharp else TRUCK
    given = dict(seed=seed, truck=truck, interval=10.0, soc=1.0, room=340, demand=Demand(pause=1e-6))
    sim = simulated(grid(4, 4, 60.0), trucks, seconds, **given)
    assert sim.summary.count.deadlocks == 0 and sim.summary.longest_wait_s < 120.0


def test_lanes_beside_a_bay_are_kept_as_long_as_the_footprint_is_over_them():
    """Laid out for every door anew, footprints at every 5 cm: none meets those on a lane given back."""
    world = build_world(grid(3, 3, 60.0), TRUCK, 20)
    roads, track = world.roads, world.track
    for d in range(0, len(world.doors), len(world.doors) // 12):
        door = world.doors[d]
        at = np.linspace(0.0, door.length, len(door.path))
        every = np.arange(0.0, door.length, 0.05)
        spur = corners(*(np.interp(every, at, np.unwrap(c)) for c in door.path.T[:3]))
        for lane, low, high in (
            (door.lane, 0.0, roads.door_off[d]),
            (door.crosses, roads.door_onto[d], roads.door_over[d]),
        ):
            if lane < 0:
                continue
            rows = slice(track.first[lane], track.first[lane + 1])
            near = np.hypot(track.x[rows] - door.path[0, 0], track.y[rows] - door.path[0, 1]) < 12.0
            others = corners(*(c[rows][near] for c in (track.x, track.y, track.heading)))
            meets = np.array([any(overlap(box, other) for other in others) for box in spur])
            assert meets.any() and not meets[(every < low) | (every > high)].any()
            assert high - low < meets.sum() * 0.05 + 1.5, "but not much longer"


def test_who_has_turned_off_a_lane_is_in_nobodys_way_there(monkeypatch):
    world = build_world(grid(3, 3, 60.0), TRUCK, 5)
    roads, pieces = world.roads, len(world.roads.length)
    fleet = new_fleet(1, len(roads.clear), pieces, len(roads.conflict_first) - 1, 16)
    door = int(np.flatnonzero(roads.door_crosses >= 0)[0])
    lane, crosses = roads.door_lane[door], roads.door_crosses[door]
    fleet.mode[0], fleet.door[0], fleet.piece[0] = Mode.ENTERING, door, lane
    fleet.tail[lane], fleet.on[lane], fleet.crossed[crosses], fleet.v[0] = 0, 1, 0, 1.0
    fleet.crosses[0] = True
    for name in ("drop", "is_safe_lane", "release"):
        monkeypatch.setattr(lanes, name, getattr(lanes, name).py_func)
    found = []
    for at in (0.0, 0.5 * (roads.door_off[door] + roads.door_over[door]), roads.door_length[door]):
        fleet.spur[0] = at
        lanes.end_spur.py_func(roads, fleet, 0)
        found.append((int(fleet.tail[lane]), int(fleet.on[lane]), int(fleet.crossed[crosses])))
    assert found == [(0, 1, 0), (-1, 0, 0), (-1, 0, -1)]


def test_who_turns_into_its_bay_does_not_wait_for_one_that_comes_behind_it(monkeypatch):
    """That one waits for it: neither would ever move."""
    for name in ("is_safe_lane", "resource", "holds"):
        monkeypatch.setattr(lanes, name, getattr(lanes, name).py_func)
    world = build_world(aisle(), TRUCK, 10)
    roads, pieces, count = world.roads, len(world.roads.length), len(world.roads.clear)
    spurs = pieces + 2 * count
    found = 0
    for door, lane in enumerate(roads.door_lane.tolist()):
        ground = roads.conflicts[roads.conflict_first[spurs + door] : roads.conflict_first[spurs + door + 1]]
        for piece in ground[(ground < pieces) & (ground != lane)].tolist():
            for target, free in ((lane, True), (lane + 1, False)):
                fleet = new_fleet(2, count, pieces, len(roads.conflict_first) - 1, 16)
                fleet.mode[:], fleet.piece[:], fleet.door[0] = Mode.DRIVING, (lane, piece), door
                fleet.route[1, :2], fleet.held_to[1], fleet.held[piece] = (piece, target), 1, 1
                found += 1
                assert lanes.is_free.py_func(roads, fleet, 0, spurs + door, True) == free
                assert not lanes.is_free.py_func(roads, fleet, 0, spurs + door, False)
    assert found


@pytest.mark.parametrize("stands_there", [False, True])
def test_who_comes_out_before_a_junction_is_ahead_of_who_came_near_it_in_the_same_round(stands_there):
    """Truck 1 asks for the junction as 0 comes out before it; if it had it, both would stand for ever."""
    lane, (x, y) = grid(3, 3, 60.0).network.index["e00h"], (60.0, 0.0)
    site = grid(3, 3, 60.0, places=[Place("there", "drop", x, y), Place("far", "drop", 63.0, 100.0)])
    world = build_world(site, TRUCK, 2, stands={"there": Stand(x, y, 0.0, False)})
    there, far = (next(b for b, bay in enumerate(world.bays) if bay.place.id == n) for n in ("there", "far"))
    roads, limits = world.roads, limits_of([TRUCK], np.zeros(2, int), TRUCK.chassis.length, GAP)
    fleet = new_fleet(2, len(roads.clear), len(roads.length), len(roads.conflict_first) - 1, 16)
    # As close behind as it may be for 0 to come out at all.
    speed, out = 5.0, world.ways.between(there, far)
    door = out.out
    at = roads.door_at[door] - TRUCK.chassis.length - GAP
    at -= speed**2 / (2.0 * limits.plan[1]) + HAIR * speed + 0.01
    for v, way in enumerate((out, world.ways.onward(lane, at, far))):
        fleet.route[v, : len(way.pieces)], fleet.last[v] = way.pieces, len(way.pieces) - 1
        fleet.goal[v] = way.door
    fleet.mode[:] = Mode.WANTS_OUT if stands_there else Mode.PARKED, Mode.DRIVING
    fleet.door[:] = door, fleet.goal[1]
    fleet.spur[0], fleet.waits[0] = roads.door_length[door], -1.0
    fleet.piece[1], fleet.s[1], fleet.v[1], fleet.tail[lane], fleet.on[lane] = lane, at, speed, 1, 1
    log = new_log(2, 600)
    advance(roads, fleet, limits, log, 0, 1, 0, 0.1)
    assert (fleet.held_to[1] > 0) == (not stands_there)
    assert fleet.mode[0] == (Mode.LEAVING if stands_there else Mode.PARKED)
    advance(roads, fleet, limits, log, 1, 599, 1, 0.1)
    assert fleet.at[1] == fleet.last[1] and (fleet.at[0] == fleet.last[0] or not stands_there)


def test_who_stands_at_the_only_spot_of_a_short_lane_has_come_there():
    """A hair short of it, it would keep its reservation, and could never ask for the next."""
    site = grid(3, 3, 60.0, places=[Place("far", "drop", 63.0, 100.0)])
    world, lane = build_world(site, TRUCK, 1), site.network.index["e00h"]
    roads, limits = world.roads, limits_of([TRUCK], np.zeros(1, int), TRUCK.chassis.length, GAP)
    fleet = new_fleet(1, len(roads.clear), len(roads.length), len(roads.conflict_first) - 1, 16)
    roads.clear[lane] = roads.stop[lane] + 1e-3
    far = next(b for b, bay in enumerate(world.bays) if bay.place.id == "far")
    way = world.ways.onward(lane, roads.stop[lane] - 2.0, far)
    fleet.route[0, : len(way.pieces)], fleet.last[0] = way.pieces, len(way.pieces) - 1
    fleet.mode[0], fleet.piece[0], fleet.s[0] = Mode.DRIVING, lane, roads.stop[lane] - 2.0
    fleet.door[0] = fleet.goal[0] = way.door
    fleet.tail[lane], fleet.on[lane], fleet.held_from[0], fleet.held_to[0] = 0, 1, 0, 0
    fleet.held[:] = 1  # Others hold all that it needs next
    log = new_log(1, 400)
    advance(roads, fleet, limits, log, 0, 200, 0, 0.1)
    assert fleet.v[0] == 0.0 and fleet.held_to[0] < 0
    fleet.held[:] = 0
    advance(roads, fleet, limits, log, 200, 200, 200, 0.1)
    assert fleet.at[0] > 0

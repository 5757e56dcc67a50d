"""A simulated fleet that goes on as a recorded one did: its ways, its drivers, its places."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from laws import overlaps
from scipy.stats import ks_2samp
from simulated_sites import PLACES, TRUCK, crossing, grid

from fleetlog.core.site import Place
from fleetlog.simulate.demand import Itineraries, at_places, delays, like, recorded_drivers
from fleetlog.simulate.doors import Stand, recorded_stands
from fleetlog.simulate.engine import Settings, simulate
from fleetlog.simulate.places import Stands, clusters
from fleetlog.simulate.tasks import Visit
from fleetlog.simulate.ways import recorded_turns, with_turns
from fleetlog.simulate.world import build_world
from fleetlog.store import Dataset, DatasetWriter


@pytest.fixture
def recording(simulated):
    return simulated(grid(3, 3, places=PLACES), 3, 2400.0, seed=2, interval=1.0)


def days(trucks=4, each=40, seed=3):
    """Visits of trucks that go round places as they like, loads taken up at P and set down at D."""
    rng, visits = np.random.default_rng(seed), []
    for _ in range(trucks):
        for k in range(each):
            kind, load = ("P", 100.0) if k % 2 == 0 else ("D", -100.0)
            follows = len(visits) + 1 if k + 1 < each else -1
            visits.append(Visit(f"{kind}{rng.integers(4)}", 60.0 * k, 20.0, 1.0, load, follows))
    return visits


def test_every_recorded_trip_is_drawn_about_equally_often_and_no_other():
    visits = days()
    pairs = Counter((a.place, visits[a.next].place) for a in visits if a.next >= 0)
    draws = Itineraries(visits, 3, seed=1, start=0.0)
    for v in range(3):
        draws.first(v, lambda place: True)
    drawn = Counter()
    for k in range(3000):
        before = visits[draws.of[k % 3]]
        after = draws.next(k % 3, 0.0, lambda place: True)
        assert (after.taken < 0.0) == (before.taken > 0.0), "who has a load sets it down next"
        drawn[before.place, after.place] += 1
    assert set(drawn) <= set(pairs)
    share = np.array([[drawn[p] / 3000.0, n / pairs.total()] for p, n in pairs.items()])
    assert np.abs(share[:, 0] - share[:, 1]).max() < 0.02


def test_only_open_places_are_drawn_and_the_same_seed_draws_the_same():
    visits = days()
    one, two = (Itineraries(visits, 1, seed=5, start=0.0) for _ in range(2))
    for draws in (one, two):
        draws.first(0, lambda place: True)
    open_to_day = [one.next(0, 0.0, lambda place: place != "D1") for _ in range(50)]
    assert all(v is None or v.place != "D1" for v in open_to_day)
    assert open_to_day == [two.next(0, 0.0, lambda place: place != "D1") for _ in range(50)]
    assert one.next(0, 0.0, lambda place: False) is None


def test_visits_without_a_place_are_left_out_and_nothing_follows_them():
    visits = days(1, 6)
    kept = at_places(visits, {v.place for v in visits} - {visits[2].place})
    assert all(v.place != visits[2].place for v in kept)
    for v in kept:
        assert v.next == -1 or (kept[v.next].begin, v.begin) == (v.begin + 60.0, kept[v.next].begin - 60.0)
    assert sum(v.next == -1 for v in kept) >= 2


def again(recording, tmp_path, seed, trucks=TRUCK):
    data = recording.dataset
    site, demand, _ = like(data, data.site, TRUCK, 3, 0, 2400.0, seed, same=True)
    with DatasetWriter.create(tmp_path / f"again{seed}", "simulated", site) as writer:
        summary = simulate(site, trucks, writer, Settings(3, 2400.0, seed=seed), demand)
    return Dataset(tmp_path / f"again{seed}"), summary


def test_trips_are_like_the_recorded_ones_in_distribution(recording, tmp_path):
    trips = recording.dataset.trips
    trips = trips[trips.distance > 10.0]
    runs = [again(recording, tmp_path, seed) for seed in range(2)]
    others = [d.trips[d.trips.distance > 10.0] for d, _ in runs]
    for name in ("distance", "driving_time"):
        both = np.concatenate([o[name] for o in others])
        # Two such samples of one distribution are this far apart in one case of twenty.
        chance = 1.36 * np.sqrt(1.0 / len(trips) + 1.0 / len(both))
        assert ks_2samp(trips[name], both).statistic < chance, name
    for _, summary in runs:
        assert summary.count.tasks_done == pytest.approx(recording.summary.count.tasks_done, rel=0.15)
        assert summary.count.deadlocks == 0


def test_a_driver_is_found_again(simulated):
    slow = replace(TRUCK, drive=replace(TRUCK.drive, speed_factor=0.8, max_acceleration=0.4))
    fleet = simulated(grid(3, 3, 60.0, places=PLACES), 2, 2400.0, truck=(TRUCK, slow), interval=1.0)
    found, notes = recorded_drivers(fleet.dataset, TRUCK)
    assert len(notes) == 1 and "reaction times of drivers" in notes[0], "two trucks hardly ever queue"
    for truck, told in zip((TRUCK, slow), found, strict=True):
        assert told.drive.speed_factor == pytest.approx(truck.drive.speed_factor, abs=0.03)
        assert told.drive.max_acceleration == pytest.approx(truck.drive.max_acceleration, rel=0.25)
    assert found[1].drive.max_acceleration < 0.8 * found[0].drive.max_acceleration


def quick(reaction):
    return replace(TRUCK, drive=replace(TRUCK.drive, reaction=reaction))


def test_reaction_times_are_found_again(simulated):
    """Two kinds of drivers queue before a crossing."""
    fleet = simulated(crossing(120.0), 40, 3600.0, truck=(quick(0.5), quick(2.0)), interval=1.0, seed=1)
    late = delays(fleet.dataset, TRUCK.chassis.length)
    assert all(len(mine) >= 10 for mine in late)
    for kind, reaction in enumerate((0.5, 2.0)):
        each = [np.median(mine) for mine in late[kind::2]]
        assert np.median(each) == pytest.approx(reaction, abs=0.25)
    found, notes = recorded_drivers(fleet.dataset, TRUCK)
    told = [t.drive.reaction for t in found]
    # Sixteen kinds of drivers are told apart, so some of these are means of both.
    assert not notes and np.mean(told) == pytest.approx(1.25, abs=0.4) and max(told) - min(told) > 0.5


def test_drivers_who_react_late_keep_farther_behind_and_let_fewer_through(simulated):
    done, gaps = [], []
    for reaction in (0.0, 2.0):
        fleet = simulated(crossing(120.0), 40, 1800.0, truck=quick(reaction), interval=0.1, seed=1)
        assert not overlaps(fleet) and fleet.summary.count.deadlocks == 0
        done.append(fleet.summary.count.tasks_done)
        gaps.append(headway(fleet))
    assert done[1] < 0.97 * done[0]
    # Behind who drives as fast, the time between the two grows by the reaction time.
    assert gaps[1] - gaps[0] == pytest.approx(2.0, abs=0.4)


def headway(fleet):
    """Seconds by which the closest tenth of trucks at full speed on one road follow another, bumper to bumper."""
    x, y, h, v = (fleet.array(name) for name in ("x", "y", "heading", "speed"))
    found = []
    for a in range(len(x)):
        for b in range(len(x)):
            ahead = (x[b] - x[a]) * np.cos(h[a]) + (y[b] - y[a]) * np.sin(h[a])
            aside = np.abs((y[b] - y[a]) * np.cos(h[a]) - (x[b] - x[a]) * np.sin(h[a]))
            steady = (v[a] > 2.9) & (v[b] > 2.9) & (np.cos(h[a] - h[b]) > 0.99) & (aside < 0.5)
            found.append((ahead / np.maximum(v[a], 0.1))[steady & (ahead > 0.0) & (ahead < 25.0)])
    return np.quantile(np.concatenate(found), 0.1)


def test_turning_round_is_allowed_where_it_was_recorded(recording):
    network = recording.dataset.site.roads()
    assert recorded_turns(recording.dataset, network) == [], "this fleet turned round in its bays alone"
    edge = int(np.flatnonzero(network.reverse >= 0)[0])
    more = with_turns(network, [(edge, int(network.reverse[edge]))])
    assert int(network.reverse[edge]) in more.successors(edge)
    assert len(more.next_edges) == len(network.next_edges) + 1
    assert all(set(network.successors(i)) <= set(more.successors(i)) for i in range(len(network)))


def test_trucks_take_the_ways_that_were_recorded(simulated):
    """A road that was closed while it was recorded is open now, and would be quicker."""
    whole = grid(3, 3, places=PLACES)
    data = simulated(replace(whole, network=whole.roads().without(["e10v"])), 3, 2400.0, seed=2, interval=1.0)
    site, demand, _ = like(data.dataset, whole, TRUCK, 3, 0, 2400.0, 1, same=True)
    forgotten = replace(demand, visits=tuple(replace(visit, way=()) for visit in demand.visits))
    runs = [simulated(site, 3, 2400.0, seed=1, interval=1.0, demand=d) for d in (demand, forgotten)]
    share = [
        np.mean([np.isin(t.labels("edge_id").strings(), ("e10v", "-e10v")) for t in r.tracks]) for r in runs
    ]
    assert share[1] > 0.005
    assert share[0] < 0.1 * share[1]


def test_who_was_seen_to_turn_round_at_a_crossing_may_leave_either_way():
    """A place right at the end of a lane: there is no room beside it for a half turn, but a little before."""
    network, doors = grid(3, 3).network, []
    x, y, _ = network.position(np.array([0]), network.length[:1])[0]
    heading = float(network.heading(np.array([0]), network.length[:1])[0])
    for turns in (False, True):
        stands = {"there": Stand(float(x), float(y), heading, turns)}
        site = grid(3, 3, places=[Place("there", "drop", float(x), float(y))])
        world = build_world(site, TRUCK, 2, stands=stands)
        at = next(b for b, bay in enumerate(world.bays) if bay.place.id == "there")
        doors.append(len(world.ways.of_bay[at]))
    assert doors == [1, 2]


def test_a_place_is_where_a_load_changed_once_and_one_for_each_direction():
    x = np.array([10.0, 10.0, 10.0, 10.0, 50.0, 90.0])
    into, load = np.array([0.0, 0.1, np.pi, np.pi, 0.0, 0.0]), np.array([0.0, 0, 0, 0, 0, 500.0])
    start, zero = np.arange(6) * 100_000_000, np.zeros(6)
    stands = Stands(zero.astype(int), start, start + 20_000_000, x, zero, zero, load, zero, zero, into, into)
    assert clusters(stands).tolist() == [0, 0, 0, 0, -1, -1]
    found = clusters(stands, loads=True)
    assert found.tolist() == [0, 0, 0, 0, -1, 1], "a stop without a load is none"
    site = grid(3, 3, places=[Place("a", "drop", 10.0, 0.0), Place("b", "pick", 90.0, 0.0)])
    site, cluster, names, along = recorded_stands(site, stands, found, ["a", "b"])
    assert [names[k] for k in cluster[cluster >= 0]] == ["a", "a", "a.2", "a.2", "b"]
    assert {p.id for p in site.places} == {*along} == {"a", "a.2", "b"}
    assert np.cos(along["a"].heading - along["a.2"].heading) < -0.9

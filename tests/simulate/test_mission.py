"""A recording driven again, and places mined from one."""

import numpy as np
import pytest
from simulated_sites import PLACES, TRUCK, grid

import fleetlog
from fleetlog.analysis.density import density
from fleetlog.analysis.near_misses import near_misses
from fleetlog.core.trajectory import Trajectory
from fleetlog.errors import DataError
from fleetlog.simulate.demand import carried, like
from fleetlog.simulate.mission import replay
from fleetlog.simulate.places import clusters, find_stands, mined_site, place_table
from fleetlog.simulate.retrace import charging_power
from fleetlog.store import Dataset, DatasetWriter


@pytest.fixture
def recording(simulated):
    return simulated(grid(3, 3, places=PLACES), 3, 1200.0, seed=2, interval=1.0)


def test_the_same_mission_is_comparable_trip_by_trip(recording, tmp_path):
    with DatasetWriter.create(tmp_path / "again", "simulated", recording.dataset.site) as writer:
        summary = replay(recording.dataset, TRUCK, writer)
    again = Dataset(tmp_path / "again")
    both = recording.dataset.trips.merge(again.trips, on=["vehicle_id", "trip_id"], suffixes=("", "_again"))
    both = both[both.distance > 20.0]
    assert len(both) > 20
    ratio = both.distance_again / both.distance
    assert ratio.median() == pytest.approx(1.0, abs=0.08)
    assert both.distance_again.sum() == pytest.approx(both.distance.sum(), rel=0.1)
    assert (both.start_again - both.start).dt.total_seconds().abs().median() < 5.0
    assert summary.own_path == 0
    for vehicle in again.vehicles:
        t = again.read(vehicle)
        assert (np.diff(t.time) > 0).all()
        assert (t.floats("speed") <= 3.0 + 1e-6).all()
        assert (np.abs(t.floats("heading")) <= 3.14160).all()


def test_a_mission_driven_again_invents_no_load_and_no_traffic(recording, tmp_path):
    data = recording.dataset
    with DatasetWriter.create(tmp_path / "log", "recorded", data.site) as writer:
        for vehicle in data.vehicles:
            t, left_out = (
                data.read(vehicle),
                ("payload", "fork_height") if vehicle == data.vehicles[0] else (),
            )
            writer.write(
                Trajectory(vehicle, t.time, {k: v for k, v in t.columns.items() if k not in left_out})
            )
    alone, together = (
        fleetlog.simulate(
            like=tmp_path / "log", truck=TRUCK, same_mission=True, together=way, recording=False
        ).dataset
        for way in (False, True)
    )
    for again in (alone, together):
        loads = [again.read(vehicle, None, ["payload"]).has("payload") for vehicle in again.vehicles]
        assert loads == [False, True, True]
    assert near_misses(alone).summary["near_misses"] is None
    assert near_misses(together).summary["near_misses"] is not None
    with pytest.raises(DataError, match="by itself"):
        density(alone)
    assert density(together).summary["hours"] > 0.0


def test_mined_places_are_where_the_trucks_stood(recording):
    stands = find_stands(recording.dataset)
    cluster = clusters(stands)
    table = place_table(stands, cluster)
    assert set(table.kind) >= {"pick", "drop"}
    spots = np.array([[p.x, p.y] for p in PLACES])
    for row in table.itertuples():
        if row.kind in ("pick", "drop"):
            assert np.hypot(*(spots - [row.x, row.y]).T).min() < 8.0
    _, names = mined_site(recording.dataset.site, table)
    tasks = carried(stands, cluster, names)
    done = recording.summary.count.tasks_done
    assert done - 3 <= len(tasks) <= done + 3


def test_demand_like_a_recording_has_its_volume(recording):
    site, demand, notes = like(recording.dataset, recording.dataset.site, TRUCK, 6, 0, 24 * 3600.0, 1)
    stands = find_stands(recording.dataset)
    known = carried(stands, clusters(stands), mined_site(site, place_table(stands, clusters(stands)))[1])
    expected = len(known) * 3.0 * 24.0 * 2.0
    assert len(demand.given) == pytest.approx(expected, rel=0.1)
    assert {t.payload for t in demand.given} <= {min(t.payload, TRUCK.chassis.rated_load) for t in known}
    assert notes and not demand.visits


def test_charging_is_taken_over_from_a_state_of_charge_alone() -> None:
    time, soc = np.arange(6) * 10_000_000, np.array([0.5, 0.49, 0.49, 0.5, 0.51, 0.51])
    gauge = Trajectory("T", time, {"soc": soc})
    watts = 0.02 * 10_000.0 * 3600.0 / 20.0
    assert charging_power(gauge, 10_000.0) == pytest.approx(
        [0.0, -watts * 2 / 3, -watts * 2 / 3, -watts * 2 / 3, 0, 0]
    )
    metered = Trajectory("T", time, {"soc": soc, "battery_power": np.full(6, 900.0)})
    assert charging_power(metered, 10_000.0) == pytest.approx(np.full(6, 900.0))
    assert not charging_power(Trajectory("T", time, {"soc": 0.9 - 0.001 * np.arange(6)}), 10_000.0).any()

"""The density analysis end to end: conservation, invariance, and a place that must be found."""

import numpy as np
import pytest

from fleetlog.analysis.density import density
from fleetlog.core.trajectory import Labels, Trajectory
from fleetlog.errors import DataError
from fleetlog.store import Dataset, DatasetWriter
from fleetlog.store.trips import trip_ids

from .conftest import T0, grid_site, write


def test_halving_the_step_keeps_the_vehicle_seconds(fleet):
    a = density(fleet, step=1.0).summary["clusters"]["moving_only"]["critical_vehicle_seconds"]
    b = density(fleet, step=0.5).summary["clusters"]["moving_only"]["critical_vehicle_seconds"]
    assert a > 100 and b == pytest.approx(a, rel=0.05)


def test_raising_the_threshold_never_shrinks_the_largest_cluster(fleet):
    largest = [density(fleet, threshold=t).summary["clusters"]["all"]["largest"] for t in (3, 8, 20, 60, 500)]
    assert largest == sorted(largest) and largest[-1] == 6


def test_standing_trucks_are_told_apart(fleet):
    s = density(fleet).summary["clusters"]
    assert s["all"]["critical_vehicle_seconds"] > s["moving_only"]["critical_vehicle_seconds"]


def test_episodes_agree_with_their_rows(fleet):
    r = density(fleet)
    e = r.tables["episodes"]
    assert len(e) and (e.duration >= 5).all() and (e.vehicles >= 2).all() and (e.min_mean_speed < 1.4).all()
    assert (e.delay <= e.vehicle_seconds + 1e-9).all()
    assert 0.8 * e.delay.sum() - 1e-9 <= r.places["areas"].delay.sum() <= e.delay.sum() + 1e-9
    assert r.tables["tasks"].delay.sum() == pytest.approx(e.delay.sum())
    assert (r.places["areas"].delay_low <= r.places["areas"].delay_high).all()


def queue(path, centre_edge="e10x"):
    """Four trucks creep one behind the other on one road; two drive freely elsewhere."""
    site = grid_site()
    n = site.roads()
    t = np.arange(600.0)
    with DatasetWriter.create(path, "recorded", site) as w:
        for k in range(6):
            jam = k < 4
            e = n.edge(centre_edge if jam else f"e0{k - 4}y")
            v = np.full(600, 0.25 if jam else 2.5)
            s = (18 - 4.5 * k) + 0.002 * t if jam else (2.5 * t) % 20
            xy = n.position(np.full(600, e, np.int32), s)
            tr = Trajectory(
                f"T{k}", T0 + (t * 1e6).astype(np.int64),
                {"x": xy[:, 0], "y": xy[:, 1], "speed": v, "edge_id": Labels(np.full(600, e, np.int32), n.edge_ids), "edge_offset": s},
            )  # fmt: skip
            w.write(tr.with_columns(trip_id=trip_ids(tr)))
    return Dataset(path)


def test_a_queue_is_found_where_it_stands(tmp_path):
    r = density(queue(tmp_path / "q"), threshold=10)
    top = r.places["areas"].iloc[0]
    assert (
        (top.x, top.y) == (pytest.approx(30, abs=4), pytest.approx(0, abs=1))
        and top.roads == "e10x"
        and top.vehicles == 4
    )
    # One long stop of single trucks must not count as several days' evidence: the interval is by trucks.
    assert top.delay_low < top.delay < top.delay_high
    assert len(r.tables["episodes"]) == 1 and r.tables["episodes"].duration[0] >= 595


def test_without_roads_it_says_what_to_do(tmp_path):
    from fleetlog.core.site import Site

    with DatasetWriter.create(tmp_path / "d", "recorded", Site()) as w:
        w.write(Trajectory("T", np.arange(5) * 1_000_000, {"x": np.zeros(5), "y": np.zeros(5)}))
    with pytest.raises(DataError, match="--site"):
        density(Dataset(tmp_path / "d"))


def test_the_same_twice(fleet, tmp_path):
    again = write(tmp_path / "d", range(6), 1800)
    assert density(fleet).summary == density(again).summary

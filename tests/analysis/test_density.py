"""The density analysis end to end: conservation, invariance, and a place that must be found."""

from dataclasses import replace

import numpy as np
import pytest

from fleetlog.analysis.clusters.steps import standing_by
from fleetlog.analysis.density import density
from fleetlog.analysis.trips import trips
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


def queue(path, centre_edge="e10x", start=T0, seconds=600, every=1.0, halt=False):
    """Four trucks creep one behind the other on one road; two drive freely elsewhere."""
    site = grid_site()
    n = site.roads()
    t = np.arange(0.0, seconds, every)
    rows = len(t)
    with DatasetWriter.create(path, "recorded", site) as w:
        for k in range(6):
            jam = k < 4
            e = n.edge(centre_edge if jam else f"e0{k - 4}y")
            v = np.full(rows, 0.25 if jam else 2.5)
            if halt and jam:  # they set out, stand, and move on at last: never arrived in between
                v = np.where((t < 20) | (t > seconds - 20), 0.25, 0.0)
            s = (18 - 4.5 * k) + 0.002 * t if jam else (2.5 * t) % 20
            xy = n.position(np.full(rows, e, np.int32), s)
            tr = Trajectory(
                f"T{k}", start + (t * 1e6).astype(np.int64),
                {"x": xy[:, 0], "y": xy[:, 1], "speed": v, "edge_id": Labels(np.full(rows, e, np.int32), n.edge_ids), "edge_offset": s},
            )  # fmt: skip
            # A stop on the way is not the end of a trip, however long.
            w.write(tr.with_columns(trip_id=np.ones(rows, np.int64) if halt else trip_ids(tr)))
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


@pytest.mark.parametrize("halt", [False, True])
@pytest.mark.parametrize("every", [1.0, 7.0])
def test_an_episode_goes_on_past_midnight(tmp_path, halt, every):
    midnight = T0 // 86_400_000_000 * 86_400_000_000
    r = density(queue(tmp_path / "q", start=midnight - 300_000_000, every=every, halt=halt), threshold=10)
    e = r.tables["episodes"]
    assert len(e) == 1 and e.duration[0] >= 590 - every
    assert e.start[0].date() != e.end[0].date()


@pytest.mark.parametrize("step", [0.1, 0.25, 0.5, 2.0])
def test_any_step_keeps_the_vehicle_seconds_of_episodes_and_areas(tmp_path, step):
    r = density(queue(tmp_path / "q"), threshold=10, step=step)
    assert r.tables["episodes"].vehicle_seconds.sum() == pytest.approx(4 * 599, rel=0.01)
    whole = density(queue(tmp_path / "p"), threshold=10)
    seconds = [x.places["areas"].vehicle_seconds.sum() for x in (r, whole)]
    assert seconds[0] == pytest.approx(seconds[1], rel=0.01) and seconds[1] >= 0.8 * 4 * 599
    assert r.summary["delay_s"] == pytest.approx(whole.summary["delay_s"], rel=0.01)


def days(path, jammed):
    """One road with a short jam on each of the days in ``jammed``, six days in all."""
    site = grid_site()
    n = site.roads()
    t = np.arange(120.0)
    with DatasetWriter.create(path, "recorded", site) as w:
        for k in range(3):
            for day in range(6):
                jam = day in jammed and k < 2
                e = n.edge("e10x" if k < 2 else "e00y")
                v = np.full(120, 0.25 if jam else 2.5)
                s = (18 - 4.5 * k) + 0.002 * t if jam else (2.5 * t + 10 * k) % 20
                xy = n.position(np.full(120, e, np.int32), s)
                tr = Trajectory(
                    f"T{k}", T0 + day * 86_400_000_000 + (t * 1e6).astype(np.int64),
                    {"x": xy[:, 0], "y": xy[:, 1], "speed": v, "edge_id": Labels(np.full(120, e, np.int32), n.edge_ids), "edge_offset": s},
                )  # fmt: skip
                w.write(tr.with_columns(trip_id=trip_ids(tr) + 100 * day))
    return Dataset(path)


def test_with_many_days_whole_days_are_resampled(tmp_path):
    """A jam on one day of six is weaker evidence than a sixth of it on each day, although the delay is the same."""
    once, always = (
        density(days(tmp_path / "a", {2}), step=2.0),
        density(days(tmp_path / "b", set(range(6))), step=2.0),
    )
    # Six shifts of two minutes: nights are not watched.
    assert always.summary["hours"] == pytest.approx(6 * 120 / 3600, rel=0.02)
    one, every = once.places["areas"].iloc[0], always.places["areas"].iloc[0]
    assert one.delay_low == 0 and one.delay_high > 1.5 * one.delay
    assert every.delay_low > 0.9 * every.delay and every.delay_high < 1.1 * every.delay


def test_the_timeline_is_the_episodes(fleet):
    r = density(fleet)
    series = next(s for s in r.shapes if s.name == "episodes")
    e = r.tables["episodes"]
    assert sum(y.sum() for y in series.y.values()) == pytest.approx(e.vehicle_seconds.sum())
    assert set(e.area) - {0} <= set(r.places["areas"].area)


def at_shift_start(path, stand, days=1, behind=6.0):
    """Two trucks parked one behind the other on one road for ``stand`` (2,) seconds, which then drive off."""
    site = grid_site()
    n = site.roads()
    with DatasetWriter.create(path, "recorded", site) as w:
        for k, still in enumerate(stand):
            for day in range(days):
                t = np.arange(still + 40.0)
                v = np.where(t < still, 0.0, 2.5)
                s = 18 - behind * k + np.cumsum(v)
                e = np.where(s <= 20, n.edge("e00x"), n.edge("e10x")).astype(np.int32)
                s = np.minimum(s - 20 * (s > 20), 20)
                xy = n.position(e, s)
                tr = Trajectory(
                    f"T{k}", T0 + day * 86_400_000_000 + (t * 1e6).astype(np.int64),
                    {"x": xy[:, 0], "y": xy[:, 1], "speed": v, "edge_id": Labels(e, n.edge_ids), "edge_offset": s},
                )  # fmt: skip
                w.write(tr.with_columns(trip_id=trip_ids(tr) + 100 * day))
    return Dataset(path)


def test_what_stands_before_the_first_motion_delays_nobody(tmp_path):
    """Parked trucks are left out by default: also at the beginning of the log, and of every shift."""
    for days in (1, 3):
        r = density(at_shift_start(tmp_path / f"d{days}", (600, 900), days), threshold=10)
        assert r.summary["delay_s"] == 0.0
        assert r.summary["clusters"]["all"]["critical_vehicle_seconds"] == pytest.approx(
            1200 * days, rel=0.05
        )


def test_standstills_at_both_ends_of_a_trip_are_alike():
    """A log that is read backwards has the same waits on the way."""
    rng = np.random.default_rng(0)
    v = np.repeat(rng.choice([0.0, 1.5], 60), rng.integers(1, 9, 60))
    ids = np.arange(len(v)) // 100
    time = np.arange(len(v)) * 1_000_000
    there = standing_by(Trajectory("T", time, {"speed": v, "trip_id": ids}))
    back = standing_by(Trajectory("T", time, {"speed": v[::-1], "trip_id": ids[::-1].copy()}))
    assert there.any() and (there == back[::-1]).all() and not there[v > 0].any()


@pytest.mark.parametrize("trucks", [1, 2])
def test_trucks_that_never_drive_are_no_congestion(tmp_path, trucks):
    d = at_shift_start(tmp_path / "d", (600,) * trucks)
    with DatasetWriter.create(
        tmp_path / "p", "recorded", replace(d.site, network=without_limits(d.site))
    ) as w:
        for t in d.days():
            w.write(t[:500])
    assert density(Dataset(tmp_path / "p")).summary["delay_s"] == 0.0
    asked = density(Dataset(tmp_path / "p"), include_standing=True).summary["delay_s"]
    assert asked == pytest.approx(500 * 2 if trucks == 2 else 0)
    told = trips(Dataset(tmp_path / "p"))
    assert told.summary["trips_driven"] == 0 and "none of 5 m or more" in told.lines[0]


def without_limits(site):
    return replace(site.roads(), speed_limit=np.full(len(site.roads()), np.nan))

"""Recorded missions driven in one another's way: who is alone is not touched, and nobody drives through another."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from laws import corners, overlap, overlaps
from simulated_sites import TRUCK, crossing, grid, place

from fleetlog.cli.main import load_verb
from fleetlog.core.trajectory import Labels, Trajectory
from fleetlog.simulate.mission import replay
from fleetlog.store import Dataset, DatasetWriter

ARM, PACE = 40.0, 2.0
PLACES = [place(k, kind, x, y) for k, (kind, x, y) in enumerate([
    ("pick", 15, 3), ("drop", 45, 33), ("pick", 33, 45), ("drop", 3, 45),
])]  # fmt: skip


def straight_over(vehicle, edges, heading, late=0.0):
    """From one tip of the crossing to the opposite one, from rest to rest; a row every half second."""
    start = np.array([-ARM, -1.0]) if heading == 0.0 else np.array([1.0, -ARM])
    time = np.arange(0.0, 70.0, 0.5)
    t = np.clip(time - 4.0 - late, 0.0, None)
    up, length = PACE / 0.5, 2 * ARM
    total = length / PACE + up
    speed = np.minimum.reduce([0.5 * t, np.full(len(t), PACE), np.clip(0.5 * (total - t), 0.0, None)])
    s = np.clip(np.concatenate([[0.0], np.cumsum(0.25 * (speed[1:] + speed[:-1]))]), 0.0, length)
    second = s > ARM
    x, y = start[:, None] + np.outer([np.cos(heading), np.sin(heading)], s)
    columns = {
        "x": x, "y": y, "heading": np.full(len(t), heading), "speed": speed, "payload": np.zeros(len(t)),
        "edge_id": Labels(second.astype(np.int32), edges), "edge_offset": np.where(second, s - ARM, s),
        "lateral_offset": np.full(len(t), -1.0), "trip_id": np.zeros(len(t), np.int64),
        "battery_power": np.full(len(t), 800.0), "soc": np.full(len(t), 0.9),
    }  # fmt: skip
    return Trajectory(vehicle, 1_767_592_800_000_000 + np.rint(time * 1e6).astype(np.int64), columns)


def recorded(folder, trajectories, site):
    with DatasetWriter.create(folder, "recorded", site) as writer:
        for trajectory in trajectories:
            writer.write(trajectory)
    return Dataset(folder)


def driven(dataset, folder, together):
    with DatasetWriter.create(folder, "simulated", dataset.site) as writer:
        summary = replay(dataset, TRUCK, writer, together=together)
    return summary, Dataset(folder)


def arrivals(dataset):
    """Seconds until each truck stands at the end of its way."""
    found = {}
    for vehicle in dataset.vehicles:
        t = dataset.read(vehicle)
        found[vehicle] = t.seconds()[np.flatnonzero(t.floats("speed") > 0.0)[-1]]
    return found


def touching(dataset):
    """Rows at which footprints of two trucks share ground."""
    tracks = [dataset.read(v) for v in dataset.vehicles]
    n = min(len(t) for t in tracks)
    boxes = [corners(*(t.floats(c)[:n] for c in ("x", "y", "heading"))) for t in tracks]
    return sum(overlap(boxes[0][k], boxes[1][k]) for k in range(n))


@pytest.fixture
def two(tmp_path):
    """Two trucks that were recorded where they cannot have been: on the crossing at the same time."""
    across = straight_over("A", ("-armw", "arme"), 0.0)
    up = straight_over("B", ("-arms", "armn"), np.pi / 2)
    return recorded(tmp_path / "two", [across, up], crossing(ARM))


def test_of_two_trucks_that_want_one_crossing_one_waits(two, tmp_path):
    _, alone = driven(two, tmp_path / "alone", False)
    summary, together = driven(two, tmp_path / "together", True)
    assert touching(together) == 0
    before, after = arrivals(alone), arrivals(together)
    late = sorted(after[v] - before[v] for v in before)
    assert late[0] == pytest.approx(0.0, abs=0.5)
    # What the footprint of the other needs to pass, at most from rest and to it.
    assert 0.5 < late[1] < 15.0
    assert summary.let_past == 0
    assert summary.lost_share == pytest.approx(late[1] / sum(after[v] - 4.0 for v in after), abs=0.02)


def test_trucks_far_enough_apart_in_time_do_not_wait(tmp_path):
    across = straight_over("A", ("-armw", "arme"), 0.0)
    later = straight_over("B", ("-arms", "armn"), np.pi / 2, late=15.0)
    both = recorded(tmp_path / "both", [across, later], crossing(ARM))
    summary, together = driven(both, tmp_path / "together", True)
    _, alone = driven(both, tmp_path / "alone", False)
    assert summary.lost_share == 0.0
    assert arrivals(together) == arrivals(alone)


def test_a_truck_alone_drives_as_without_others(simulated, tmp_path):
    recording = simulated(grid(3, 3, places=PLACES), 1, 1200.0, seed=2, interval=1.0).dataset
    one, by_itself = driven(recording, tmp_path / "alone", False)
    two, together = driven(recording, tmp_path / "together", True)
    a, b = by_itself.read("T1"), together.read("T1")
    assert (a.time == b.time).all()
    assert a.labels("edge_id").strings() == b.labels("edge_id").strings()
    for name in ("speed", "edge_offset", "payload", "fork_height", "battery_power", "soc"):
        assert np.array_equal(a.floats(name), b.floats(name), equal_nan=True), name
    assert (one.distance_ratio, one.duration_ratio) == (two.distance_ratio, two.duration_ratio)
    assert (two.lost_share, two.let_past) == (0.0, 0)
    assert one.lost_share is None
    # It keeps to its lane: a quarter of the road of four metres to the right.
    on_road = b.labels("edge_id").codes >= 0
    assert b.floats("lateral_offset")[on_road] == pytest.approx(-1.0)
    assert np.hypot(a.floats("x") - b.floats("x"), a.floats("y") - b.floats("y")).max() < 1.01


def test_no_footprints_overlap_where_the_recording_has_none(simulated, tmp_path):
    class Outcome:
        def __init__(self, dataset):
            self.tracks = [dataset.read(v) for v in dataset.vehicles]
            self.n = min(len(t) for t in self.tracks)

        def array(self, name):
            return np.array([t.floats(name)[: self.n] for t in self.tracks])

    recording = simulated(grid(3, 3, places=PLACES), 6, 1200.0, seed=3, interval=1.0).dataset
    _, alone = driven(recording, tmp_path / "alone", False)
    summary, together = driven(recording, tmp_path / "together", True)
    assert len(overlaps(Outcome(alone))) > 10
    assert not overlaps(Outcome(together))
    assert summary.let_past == 0
    assert 0.0 < summary.lost_share < 0.3
    again, same = driven(recording, tmp_path / "again", True)
    assert again == summary
    for vehicle in same.vehicles:
        assert (same.read(vehicle).floats("x") == together.read(vehicle).floats("x")).all()


def test_the_command_and_its_refusal(two, tmp_path):
    verb, truck = load_verb("simulate"), tmp_path / "truck.toml"
    truck.write_text('name = "t"\n[chassis]\nmass = 4400.0\n')
    base = ["--like", str(two.path), "--truck", str(truck), "--no-recording", "--json", "-o"]
    done = CliRunner().invoke(verb, [*base, str(tmp_path / "out"), "--same-mission", "--together"])
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    assert told["lost_share"] > 0.0 and told["let_past"] == 0
    alone = CliRunner().invoke(verb, [*base, str(tmp_path / "by-itself"), "--same-mission"])
    assert "lost_share" not in json.loads(alone.stdout)
    refused = CliRunner().invoke(verb, [*base, str(tmp_path / "none"), "--together"])
    assert refused.exit_code == 2
    assert "add --same-mission" in refused.output
    assert not (tmp_path / "none").exists()

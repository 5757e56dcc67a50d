"""Slope, curvature, forks, load and power of a motion."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parent))
from truth import long_road, on_road, shuttle

from fleetlog.core.network import Edge, build_network
from fleetlog.core.trajectory import Labels, Trajectory
from fleetlog.physics.motion import reconstruct
from fleetlog.physics.motion.rows import read_rows, speed_is_mean


def seconds(n: int, rate: float = 1.0) -> np.ndarray:
    return np.round(np.arange(n) / rate * 1e6).astype(np.int64)


def square_course(rate: float) -> tuple[Trajectory, object]:
    """Three sides of a 20 m square at 2 m/s: two left turns."""
    corners = np.array([[0, 0, 0], [20, 0, 0], [20, 20, 0], [0, 20, 0]], float)
    edges = [Edge(f"e{i}", f"n{i}", f"n{i + 1}", corners[i : i + 2], f"e{i}") for i in range(3)]
    network = build_network(edges)
    way = np.arange(0.5, 59.5, 2.0 / rate)
    at = (way // 20).astype(np.int32)
    xy = network.position(at, way - 20.0 * at)
    columns = {
        "x": xy[:, 0].copy(),
        "y": xy[:, 1].copy(),
        "edge_id": Labels(at, network.edge_ids),
        "edge_offset": way - 20.0 * at,
    }
    return Trajectory("T", seconds(len(way), rate), columns), network


@pytest.mark.parametrize("rate", [0.5, 1.0, 10.0])
def test_corners_add_up_to_their_angle_and_are_rounded(rate: float) -> None:
    track, network = square_course(rate)
    motion = reconstruct(track, network).motion
    assert (motion.curvature * motion.speed * motion.dt).sum() == pytest.approx(np.pi, rel=0.06)
    assert motion.curvature.max() <= 1.0 / 2.5 + 1e-6
    if rate == 10.0:
        assert motion.curvature.max() == pytest.approx(0.4, rel=0.01)
        assert motion.curvature[50] == 0.0


def rounded_course(
    rate: float, radius: float, lane: float, dip: float = 0.0
) -> tuple[Trajectory, object, np.ndarray]:
    """Two left turns of a radius, on a line ``lane`` metres to the left of the roads, and the way driven: at 2 m/s, in
    the corners by ``dip`` less."""
    corners = 40.0 * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    network = build_network(
        [Edge(f"e{i}", f"n{i}", f"n{i + 1}", corners[i : i + 2], f"e{i}") for i in range(3)]
    )
    inner = corners + np.array([[0, lane, 0], [-lane, lane, 0], [-lane, -lane, 0], [0, -lane, 0]])
    arc = np.linspace(0.0, np.pi / 2.0, 400)
    turn = radius * np.column_stack([np.sin(arc), 1.0 - np.cos(arc), 0.0 * arc])
    second = np.column_stack([-turn[:, 1], turn[:, 0], 0.0 * arc])
    line = np.concatenate([
        inner[:1], inner[1] - [radius, 0, 0] + turn, inner[2] - [0, radius, 0] + second, inner[3:],
    ])  # fmt: skip
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(line[:, :2], axis=0).T)))
    fine = np.arange(1.0, along[-1] - 1.0, 0.01)
    near = np.abs(fine - along[-1] / 2.0) - (along[-1] / 2.0 - 40.0 + (1.0 - np.pi / 4.0) * radius)
    pace = 2.0 - dip * np.exp(-((near / 3.0) ** 2))
    clock = np.append(0.0, np.cumsum(0.01 / pace[:-1]))
    way = np.interp(np.arange(0.0, clock[-1], 1.0 / rate), clock, fine)
    x, y = (np.interp(way, along, line[:, k]) for k in (0, 1))
    beside = np.abs(np.stack([y, x - 40.0, y - 40.0]))
    beside += 1e3 * np.stack([x > 40.0 + abs(lane), (y < 0.0) | (y > 40.0), x > 40.0 + abs(lane)])
    at = beside.argmin(axis=0).astype(np.int32)
    offset = np.clip(np.choose(at, [x, y, 40.0 - x]), 0.0, 40.0)
    track = Trajectory("T", seconds(len(way), rate), {
        "x": x, "y": y, "speed": np.interp(way, fine, pace), "edge_id": Labels(at, network.edge_ids), "edge_offset": offset,
        "lateral_offset": np.choose(at, [y, 40.0 - x, 40.0 - y]),
    })  # fmt: skip
    return track, network, way


@pytest.mark.parametrize("rate", [0.5, 1.0, 2.0])
@pytest.mark.parametrize(
    ("radius", "lane"), [(2.5, 0.0), (8.0, 0.0), (12.0, 0.0), (4.0, 1.7), (4.0, -1.7), (8.0, -1.7)]
)
def test_a_corner_that_is_cut_or_taken_wide_turns_by_its_angle(
    rate: float, radius: float, lane: float
) -> None:
    """Trucks keep to their lane and round corners as they like; half way they are beside both roads."""
    track, network, way = rounded_course(rate, radius, lane)
    motion = reconstruct(track, network).motion
    assert (np.abs(motion.curvature) * motion.speed * motion.dt).sum() == pytest.approx(np.pi, rel=0.1)
    # Where rows are seconds apart the way along the map counts for more.
    longer = (motion.speed * motion.dt).sum()
    assert longer == pytest.approx(way[-1] - way[0], rel=0.01 if rate >= 1.0 else 0.06)


@pytest.mark.parametrize("rate", [2.0, 5.0])
def test_positions_alone_show_how_trucks_slow_down_in_a_corner(rate: float) -> None:
    """Beside a corner a truck goes along neither road: its progress along them is not that of its way."""
    track, network, _ = rounded_course(rate, 2.5, 0.0, dip=0.8)
    motion = reconstruct(track.without("speed"), network).motion
    true = np.interp(motion.time, track.seconds(), track.floats("speed"))
    bend = np.abs(motion.curvature) > 0.2
    assert bend.any()
    assert motion.speed[bend] == pytest.approx(true[bend], abs=0.12)


@pytest.mark.parametrize("angle", [1e-9, 1e-7, 1.1e-6, 3e-6, 1e-4, 1e-2])
def test_a_road_drawn_in_many_pieces_is_as_long_as_the_road(angle: float) -> None:
    """The line swings by an angle [rad] at every vertex; what rounding saves is no more than the swing itself."""
    side = np.array([0.0, 1.0] * 15)
    points = np.column_stack([3.5 * np.arange(30.0), 1.75 * angle * side, np.zeros(30)])
    network = build_network([Edge("a", "n0", "n1", points, "a", 3.0)])
    way = np.arange(1.0, 100.0)
    track = Trajectory("T", seconds(len(way), 1.0), {
        "x": way.copy(), "y": np.zeros(len(way)), "edge_id": Labels(np.zeros(len(way), np.int32), network.edge_ids),
        "edge_offset": way,
    })  # fmt: skip
    motion = reconstruct(track, network).motion
    driven = (motion.speed * motion.dt)[(motion.time >= 10.0) & (motion.time < 90.0)].sum()
    assert driven == pytest.approx(80.0, rel=1e-3)


def test_slope_of_the_map() -> None:
    road = long_road(climb=0.05)
    truth = shuttle(100.0, 1.0, 1)
    motion = reconstruct(on_road(truth, road, 0.0, 1), road).motion
    assert np.allclose(np.tan(motion.slope), 0.05)


def test_slope_from_measured_heights() -> None:
    truth = shuttle(900.0, 1.0, 2)
    road = long_road()
    height = 3.0 * np.sin(truth.way / 40.0)
    noisy = height + np.random.default_rng(3).normal(0, 0.1, len(height))
    motion = reconstruct(on_road(truth, road, 0.05, 4).with_columns(z=noisy), road).motion
    way, speed = (np.interp(motion.time, truth.t, v) for v in (truth.way, truth.speed))
    true_slope = 3.0 / 40.0 * np.cos(way / 40.0)
    moving = speed > 0.5
    assert np.corrcoef(motion.slope[moving], true_slope[moving])[0, 1] > 0.97
    assert np.sqrt(np.mean((motion.slope - true_slope)[moving] ** 2)) < 0.02


@settings(max_examples=20, deadline=None)
@given(st.sampled_from([0.001, 0.01, 0.05]), st.sampled_from([1.0, 10.0]), st.integers(0, 50))
def test_lifting_adds_up_to_the_change_of_height(quantum: float, rate: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    height = np.clip(
        np.cumsum(np.repeat(rng.choice([0, 0, 0.35, -0.35], 20), round(4 * rate))) / rate, 0.0, 6.0
    )
    log = Trajectory("T", seconds(len(height), rate), {"x": np.zeros(len(height)), "y": np.zeros(len(height)),
                     "fork_height": np.round(height / quantum) * quantum})  # fmt: skip
    motion = reconstruct(log).motion
    lifted = (motion.lift_speed * motion.dt).sum()
    first = log.floats("fork_height")
    assert lifted == pytest.approx(first[-1] - first[0], abs=0.1)
    raised = (np.maximum(motion.lift_speed, 0) * motion.dt).sum()
    assert raised <= np.maximum(np.diff(first), 0).sum() + 1e-9


def test_jitter_of_the_forks_does_no_lifting_work() -> None:
    height = 1.0 + np.random.default_rng(5).normal(0, 0.003, 5000)
    log = Trajectory(
        "T", seconds(5000, 10.0), {"x": np.zeros(5000), "y": np.zeros(5000), "fork_height": height}
    )
    motion = reconstruct(log).motion
    raised = (np.maximum(motion.lift_speed, 0) * motion.dt).sum()
    assert raised < 0.05 * np.maximum(np.diff(height), 0).sum()


def test_a_load_is_held_through_a_short_silence_only() -> None:
    load = np.array([np.nan, 500.0, np.nan, np.nan, 0.0] + [np.nan] * 100)
    log = Trajectory("T", seconds(105), {"x": np.zeros(105), "y": np.zeros(105), "payload": load})
    found = reconstruct(log)
    first = np.searchsorted(found.row, np.arange(105))
    assert found.motion.payload[first][:5].tolist() == [0.0, 500.0, 500.0, 500.0, 0.0]
    load[4] = 300.0
    held = reconstruct(log.with_columns(payload=load)).motion.payload[first]
    assert held[60] == 300.0 and held[100] == 0.0


def test_power_is_measured_or_voltage_times_current() -> None:
    log = Trajectory("T", seconds(3), {"x": np.arange(3.0), "y": np.zeros(3), "battery_power": np.array([10.0, np.nan, np.nan]),
                     "battery_voltage": np.array([48.0, 48.0, np.nan]), "battery_current": np.array([9.0, 2.0, 1.0])})  # fmt: skip
    found = reconstruct(log)
    power = found.motion.power[np.searchsorted(found.row, np.arange(3))]
    assert power[0] == 10.0 and power[1] == 96.0 and np.isnan(power[2])


@pytest.mark.parametrize("pieces", [4, 20])
def test_how_finely_roads_are_drawn_changes_no_corner(pieces: int) -> None:
    plain, network = square_course(5.0)
    fine = build_network([
        Edge(e.id, e.start, e.end, np.linspace(e.points[0], e.points[-1], pieces + 1), e.road) for e in network.edges()
    ])  # fmt: skip
    one, other = reconstruct(plain, network).motion, reconstruct(plain, fine).motion
    assert np.allclose(one.curvature, other.curvature, atol=1e-6)
    assert np.allclose(one.speed, other.speed, atol=1e-6)


@pytest.mark.parametrize("held", [1, 2, 4, 8])
@pytest.mark.parametrize("mean", [False, True])
def test_whether_the_speed_is_a_mean_is_told_however_often_positions_are_repeated(
    held: int, mean: bool
) -> None:
    rng = np.random.default_rng(held)
    speed = []
    for top in rng.uniform(1.0, 2.5, 80):
        up = np.linspace(0.0, top, 40)
        speed += [*up, *np.full(rng.integers(40, 120), top), *up[::-1], *np.zeros(rng.integers(30, 90))]
    row = np.arange(30, len(speed), 20)
    way = (np.cumsum(speed) / 20.0)[row]
    told = np.diff(way, prepend=way[0]) if mean else np.array(speed)[row]
    x = way[np.arange(len(row)) // held * held]
    log = Trajectory("T", row * 50_000, {"x": x, "y": 0.0 * x, "speed": told})
    rows = read_rows(log, None, 1.0)
    assert speed_is_mean(rows, rows.x) == mean


@pytest.mark.parametrize("lane, bay, told", [(0.0, 3.0, False), (2.6, 2.6, True), (2.6, 9.0, False)])
def test_who_keeps_beside_the_line_is_on_the_road_and_who_stands_in_a_bay_is_not(
    lane: float, bay: float, told: bool
) -> None:
    """Lanes of a wide road may be drawn as one line, which nobody drives on."""
    network = build_network([Edge("e", "a", "b", np.array([[0.0, 0.0, 0.0], [400.0, 0.0, 0.0]]), "e")])
    way = np.interp(np.arange(260.0), [0, 100, 160, 260], [0, 200, 200, 400])
    beside = np.where((np.arange(260) > 100) & (np.arange(260) < 160), bay, lane)
    columns = {
        "x": way, "y": beside, "lateral_offset": beside, "edge_offset": way, "speed": np.gradient(way),
        "edge_id": Labels(np.zeros(260, np.int32), network.edge_ids),
    }  # fmt: skip
    edge = read_rows(Trajectory("T", seconds(260), columns), network, 1.0).edge
    assert (edge[:100] == 0).all()
    assert (edge[105:155] == 0).all() == told


def test_a_hall_without_positions_is_on_no_road() -> None:
    """A truck drives in by a road, about in the hall for a minute, where the log has its speed alone, and out."""
    line = np.array([[0.0, 0.0, 0.0], [100.0, 0.0, 0.0]])
    network = build_network([Edge("e", "a", "b", line, "e"), Edge("-e", "b", "a", line[::-1].copy(), "e")])
    t = np.arange(160.0)
    inside = (t >= 50.0) & (t < 110.0)
    x = np.where(inside, np.nan, np.where(t < 50.0, 2.0 * t, 100.0 - 2.0 * (t - 110.0)))
    columns = {
        "x": x, "y": 0.0 * x, "speed": np.full(160, 2.0), "edge_offset": np.where(t < 50.0, x, 100.0 - x),
        "edge_id": Labels(np.where(inside, -1, (t >= 110.0).astype(int)).astype(np.int32), network.edge_ids),
    }  # fmt: skip
    found = reconstruct(Trajectory("T", seconds(160), columns), network)
    motion, hall = found.motion, inside[found.row]
    assert (motion.edge[hall] < 0).mean() > 0.95
    for edge in (0, 1):
        assert motion.dt[motion.edge == edge].sum() == pytest.approx(50.0, abs=2.0)

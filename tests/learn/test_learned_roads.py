"""Learned maps against drawn ones: found, directed, as long, and turned when the traces are turned."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

import numpy as np
import pytest

from fleetlog.core.network import Edge, Network, build_network
from fleetlog.core.trajectory import Trajectory
from fleetlog.learn.cells import gather, moving
from fleetlog.learn.lines import Chain
from fleetlog.learn.refine import Fit
from fleetlog.learn.roads import Evidence, Roads, Settings, _returning, learn_roads

NOISE = 0.4
SQUARE = [(0.0, 0.0), (60.0, 0.0), (60.0, 40.0), (0.0, 40.0), (0.0, 0.0)]


def drive(corners, vehicle: str, seed: int, turn: float = 0.0, speed: float = 2.0) -> Trajectory:
    """A truck along a line at constant speed, 1 Hz, with noise; the whole drawing turned by ``turn`` rad."""
    rng = np.random.default_rng(seed)
    points = np.array(corners)
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    at = np.arange(0.0, s[-1], speed)
    xy = np.column_stack([np.interp(at, s, v) for v in points.T]) + rng.normal(0.0, NOISE, (len(at), 2))
    xy = xy @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    time = (np.arange(len(at)) * 1_000_000 + 1_767_600_000_000_000).astype(np.int64)
    return Trajectory(vehicle, time, {"x": xy[:, 0], "y": xy[:, 1], "speed": np.full(len(at), speed)})


def learned(drives: list[Trajectory]) -> Roads:
    cells = gather(moving(t)[0] for t in drives)
    return learn_roads(cells, NOISE, lambda: drives, Settings())


def distance_to(corners, points: np.ndarray) -> np.ndarray:
    """(N,) metres from points to a line."""
    out = np.full(len(points), np.inf)
    for a, b in pairwise(np.array(corners)):
        share = np.clip(((points - a) @ (b - a)) / ((b - a) @ (b - a)), 0.0, 1.0)
        out = np.minimum(out, np.hypot(*(points - a - share[:, None] * (b - a)).T))
    return out


def headings(network: Network) -> np.ndarray:
    return np.concatenate([np.diff(network.polyline(i)[:, :2], axis=0) for i in range(len(network))])


@pytest.fixture(scope="module")
def round_course() -> Roads:
    return learned([drive(SQUARE * 6, f"T{k}", k) for k in range(4)])


def test_a_ring_driven_one_way_is_a_ring_of_one_way_roads(round_course):
    n = round_course.network
    assert (n.reverse < 0).all()
    assert n.length.sum() == pytest.approx(200.0, rel=0.03)
    assert distance_to(SQUARE, n.points[:, :2]).max() < 1.5
    assert np.median(distance_to(SQUARE, n.points[:, :2])) < 0.2
    middle = n.points[:, :2] - [30.0, 20.0]
    ahead = np.concatenate([np.gradient(n.polyline(i)[:, :2], axis=0) for i in range(len(n))])
    assert (middle[:, 0] * ahead[:, 1] - middle[:, 1] * ahead[:, 0] > 0).all()  # counter-clockwise, as driven


def test_evidence_counts_rounds_trucks_and_days(round_course):
    e = round_course.evidence
    assert set(e.mean_passes(round_course.network).tolist()) <= set(
        range(20, 29)
    )  # 4 trucks, 6 rounds each, each begun somewhere
    assert all(e.vehicles[i] == {"T0", "T1", "T2", "T3"} for i in range(len(round_course.network)))
    assert all(len(days) == 1 for days in e.days.values())


def test_a_road_driven_both_ways_is_one_two_way_road():
    there, back = [(0.0, -0.9), (80.0, -0.9)], [(80.0, 0.9), (0.0, 0.9)]
    n = learned([drive(there + back, f"T{k}", k) for k in range(6)]).network
    long = n.length > 30.0
    assert (n.reverse[long] >= 0).all()
    assert np.abs(n.points[(n.points[:, 0] > 10) & (n.points[:, 0] < 70), 1]).max() < 0.4


def test_directions_four_metres_apart_are_two_one_way_roads():
    there, back = [(0.0, -2.0), (80.0, -2.0)], [(80.0, 2.0), (0.0, 2.0)]
    n = learned(
        [drive(there, f"T{k}", k) for k in range(6)] + [drive(back, f"B{k}", 9 + k) for k in range(6)]
    ).network
    assert (n.reverse < 0).all()
    ahead = headings(n)[:, 0]
    y = np.concatenate([n.polyline(i)[:-1, 1] for i in range(len(n))])
    assert (ahead[y < 0] > 0).all() and (ahead[y > 0] < 0).all()


def test_roads_that_cross_without_turns_do_not_meet_and_with_turns_do():
    east, north = [(0.0, 20.0), (60.0, 20.0)], [(30.0, -10.0), (30.0, 50.0)]
    crossing = [drive(east, f"E{k}", k) for k in range(5)] + [drive(north, f"N{k}", 20 + k) for k in range(5)]
    assert len(learned(crossing).network) == 2
    turning = [drive([(0.0, 20.0), (30.0, 20.0), (30.0, 50.0)], f"U{k}", 40 + k) for k in range(5)]
    n = learned(crossing + turning).network
    assert len(n) == 4
    assert len(n.node_ids) == 5


@pytest.mark.parametrize("seed", [0, 100, 200])
def test_no_road_between_junctions_is_shorter_than_it_is_wide(seed):
    """Two roads of two lanes each, driven straight on and turned at: no short links zigzag between the lanes."""

    def arm(k: int, out: bool) -> list[tuple[float, float]]:
        along, aside = (8.0, 50.0) if out else (50.0, 8.0), -1.8 if out else 1.8
        c, s = np.cos(0.5 * np.pi * k), np.sin(0.5 * np.pi * k)
        return [(float(c * x - s * aside), float(s * x + c * aside)) for x in along]

    ways = [arm(a, out=False) + arm((a + b) % 4, out=True) for a in range(4) for b in (1, 2, 3)]
    found = learned([drive(way, f"T{k}", seed + k) for k, way in enumerate(ways * 3)])
    n, arms = found.network, Counter[str]()
    for road in {e.road: e for e in n.edges()}.values():
        arms.update([road.start, road.end])
    for i, e in enumerate(n.edges()):
        if min(arms[e.start], arms[e.end]) > 1:
            senses = np.array([found.forth[i], not found.forth[i]]) | (n.reverse[i] >= 0)
            assert n.length[i] > found.fits[i].covered(senses)


@pytest.mark.parametrize("seed", [0, 100])
def test_two_lanes_that_come_near_for_a_few_metres_stay_two_roads(seed):
    """Lanes 3.6 m apart are 2.2 m apart half way along; nobody turns there."""

    def bent(side: float) -> list[tuple[float, float]]:
        return [(x, side * (1.8 - 0.7 * float(np.exp(-(((x - 60.0) / 8.0) ** 2))))) for x in range(0, 121, 2)]

    drives = [drive(bent(-1.0), f"A{k}", seed + k) for k in range(6)]
    drives += [drive(bent(1.0)[::-1], f"B{k}", seed + 20 + k) for k in range(6)]
    n = learned(drives).network
    assert len(n) == 2 and (n.reverse < 0).all()
    assert n.length == pytest.approx(120.0, abs=8.0)


@pytest.mark.parametrize(("gap", "nodes"), [(4.0, 3), (12.0, 4)])
def test_a_link_within_a_junction_leads_back_too(gap, nodes):
    """Two rings, each of two one-way roads, and a one-way link of ``gap`` metres from one to the other."""
    lines = {
        (0, 1): [(0.0, 0.0), (-30.0, 20.0), (-60.0, 0.0)], (1, 0): [(-60.0, 0.0), (-30.0, -20.0), (0.0, 0.0)],
        (2, 3): [(gap, 0.0), (30.0, 20.0), (60.0, 0.0)], (3, 2): [(60.0, 0.0), (30.0, -20.0), (gap, 0.0)],
        (0, 2): [(0.0, 0.0), (gap / 2.0, 0.0), (gap, 0.0)],
    }  # fmt: skip
    fits = [Fit(Chain(*ends, np.array(points)), np.zeros(2), np.zeros(2)) for ends, points in lines.items()]
    edges = [
        Edge(f"e{k}", str(f.chain.start), str(f.chain.end), np.pad(f.chain.points, ((0, 0), (0, 1))), f"e{k}")
        for k, f in enumerate(fits)
    ]
    network, count = build_network(edges), len(edges)
    found = Evidence(np.zeros(count, int), np.zeros(count), np.zeros((count, 1), int))
    met = _returning(Roads(network, found, fits, np.ones(count, bool)))
    kept = [f.chain for f in fits] if met is None else met
    assert len({c.start for c in kept} | {c.end for c in kept}) == nodes


def test_turning_the_traces_turns_the_map(round_course):
    turn = 0.6
    turned = learned([drive(SQUARE * 6, f"T{k}", k, turn) for k in range(4)]).network
    back = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    assert turned.length.sum() == pytest.approx(round_course.network.length.sum(), rel=0.02)
    assert np.quantile(distance_to(SQUARE, turned.points[:, :2] @ back), 0.95) < 0.8


def test_one_fast_drive_with_a_stop_is_one_road():
    """A row every 20 m, and a minute at a light: neither leaves a gap."""
    half = np.concatenate([np.full(15, 20.0), np.arange(20.0, 0.0, -2.0)])
    speed = np.concatenate([half, np.zeros(60), half[::-1]])
    x = np.cumsum(speed)
    xy = np.column_stack([x, np.zeros(len(x))]) + np.random.default_rng(3).normal(0.0, 0.1, (len(x), 2))
    time = (np.arange(len(x)) * 1_000_000 + 1_767_600_000_000_000).astype(np.int64)
    n = learned([Trajectory("T", time, {"x": xy[:, 0], "y": xy[:, 1], "speed": speed})]).network
    assert len(n) == 1 and n.length[0] == pytest.approx(np.ptp(x), abs=20.0)

"""Who was in whose way: laws of a rule that knows positions only."""

from __future__ import annotations

import numpy as np

from fleetlog.core.motion import Motion
from fleetlog.core.truck import Chassis, Truck
from fleetlog.discovery.channels.paths import Path, lost, lost_time, usual_time
from fleetlog.discovery.recording.conflicts import Route, hindered
from fleetlog.physics.motion.legs import Leg

TRUCK = Truck("any", Chassis(mass=4000.0))
SPEED = 3.0


def drive(
    vehicle: int, begin: tuple[float, float], heading: float, start: float, metres: float = 60.0
) -> Route:
    """One truck at a steady speed along a line."""
    s = np.arange(0.0, metres, 0.5)
    path = Motion.of(
        len(s), time=s / SPEED, speed=np.full(len(s), SPEED), x=begin[0] + s * np.cos(heading),
        y=begin[1] + s * np.sin(heading), edge=np.zeros(len(s), np.int32),
    )  # fmt: skip
    leg = Leg(s, path, np.arange(len(s)), np.nan, True, {})
    return Route(vehicle, 0, start, (leg,), np.array([np.nan]), True, np.zeros(1, np.int64))


def flags(*routes: Route) -> list[np.ndarray]:
    """Where each was hindered."""
    return [f for f, _ in hindered(routes, [np.full(r.size.sum(), SPEED) for r in routes], TRUCK)]


def test_a_truck_alone_is_never_hindered() -> None:
    assert not flags(drive(0, (0.0, 0.0), 0.0, 0.0))[0].any()


def test_the_one_behind_is_hindered_and_not_the_one_ahead() -> None:
    ahead, behind = flags(drive(0, (0.0, 0.0), 0.0, 0.0), drive(1, (0.0, 0.0), 0.0, 2.0))
    assert behind.mean() > 0.9
    assert not ahead.any()


def test_a_minute_behind_is_not_behind() -> None:
    assert not any(f.any() for f in flags(drive(0, (0.0, 0.0), 0.0, 0.0), drive(1, (0.0, 0.0), 0.0, 60.0)))


def test_at_a_crossing_the_second_is_hindered_before_it_and_free_long_after() -> None:
    first = drive(0, (30.0, -30.0), np.pi / 2.0, 0.0)
    second = drive(1, (0.0, 0.0), 0.0, 4.0)
    _, late = flags(first, second)
    where = 0.5 * np.flatnonzero(late)
    assert late.any()
    assert 10.0 < where.min() < 30.0 <= where.max() < 50.0


def test_trucks_in_opposite_lanes_do_not_meet() -> None:
    assert not any(f.any() for f in flags(drive(0, (0.0, 0.0), 0.0, 0.0), drive(1, (60.0, 2.6), np.pi, 0.0)))


def test_turning_and_shifting_the_site_changes_nothing() -> None:
    pairs = [drive(0, (0.0, 0.0), 0.0, 0.0), drive(1, (3.0, -12.0), 0.4, 3.0)]
    turn, shift = 1.1, np.array([400.0, -70.0])

    def moved(r: Route) -> Route:
        leg = r.legs[0]
        x = np.cos(turn) * leg.path.x - np.sin(turn) * leg.path.y + shift[0]
        y = np.sin(turn) * leg.path.x + np.cos(turn) * leg.path.y + shift[1]
        new = Leg(leg.distance, leg.path.replaced(x=x, y=y), leg.row, leg.wait, leg.whole, {})
        return Route(r.vehicle, r.day, r.start, (new,), r.wait, r.known, r.errand)

    for before, after in zip(flags(*pairs), flags(*map(moved, pairs)), strict=True):
        assert np.array_equal(before, after)


class _Lane:
    """One stretch of lane."""

    def __len__(self) -> int:
        return 1

    def at(self, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(len(motion), np.int32), np.ones(len(motion))


def test_time_lost_is_what_is_over_undisturbed_passages_of_the_same_place() -> None:
    rng = np.random.default_rng(1)
    passed, gone, lane = [], 0.0, _Lane()
    for trip in range(60):
        behind = trip % 3 == 0
        extra = rng.exponential(0.5, 40) if behind else np.zeros(40)
        gone += extra.sum()
        took = 1.1 + 0.02 * rng.normal(size=40) + extra
        nodes = np.zeros(40, np.int64)
        motion = Motion.of(40)
        path = Path(
            motion,
            np.arange(40.0),
            np.ones(40, bool),
            nodes,
            np.zeros(40),
            took,
            np.zeros(40),
            np.zeros(40, bool),
            np.zeros(40, np.float32),
            np.zeros(40, np.float32),
            np.array([behind]),
            np.array([behind]),
        )
        passed.append((path, np.array([not behind]), np.array([trip]), np.zeros(40), np.ones(40)))
    found = lost(*lost_time(passed, lane, usual_time(passed, lane)))
    assert found is not None
    total = sum(p.took.sum() for p, *_ in passed)
    assert abs(found.share - gone / total) < 0.01
    assert abs(found.share - gone / total) < 2.0 * found.error
    # What trucks are known to wait there, whoever is in the way, is not lost to traffic.
    known = [
        (path, whole, trip, np.where(path.behind[0], extra_of(path), 0.0), free)
        for path, whole, trip, _, free in passed
    ]
    left = lost(*lost_time(known, lane, usual_time(known, lane)))
    assert left is not None
    assert abs(left.share) < 0.01


def extra_of(path: Path) -> np.ndarray:
    """Seconds over the usual 1.1 a node."""
    return path.took - 1.1

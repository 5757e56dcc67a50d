"""What is held out is whole, a fifth of everything, and the same whatever else is read."""

from __future__ import annotations

import numpy as np
import pytest

from fleetlog.core.trajectory import Trajectory
from fleetlog.discovery.recording.blocks import Windows
from fleetlog.discovery.recording.day import Day
from fleetlog.discovery.recording.splits import HELD_OUT, make_split, passed_once, trips_apart


def windows(vehicle: int, day: int, trips: int = 40) -> Windows:
    """So many trips of ten windows on one vehicle-day."""
    t = np.arange(trips * 10)
    trip = vehicle * 1_000_000 + day * trips + t // 10
    time, n = day * 86400.0 + t * 10.0, len(t)
    return Windows(
        trip,
        np.full(n, vehicle),
        np.full(n, day),
        np.zeros(n, int),
        np.full(n, 10.0),
        np.full(n, 20.0),
        time,
        time,
        time,
    )


@pytest.mark.parametrize("trips", [40, 3])
def test_a_fifth_is_held_out_and_every_unit_is_whole(trips: int) -> None:
    s = make_split("trips", trips, trips * 100.0, [0], [0], 10, 0.2, 1)
    w = windows(0, 0, trips)
    fold = s.fold(w)
    for unit in np.unique(s.unit(w)):
        assert len(np.unique(fold[s.unit(w) == unit])) == 1
    share = np.mean(fold == HELD_OUT)
    assert 0.1 < share < 0.35
    assert set(fold[fold != HELD_OUT]) <= set(range(10))


def test_rows_and_windows_of_a_trip_are_dealt_alike_and_other_trips_do_not_matter() -> None:
    s = make_split("trips", 40, 4000.0, [0], [0], 10, 0.2, 3)
    w = windows(0, 0)
    assert np.array_equal(s.rows(w.trip, w.time, 0, 0), s.fold(w))
    part = w[w.trip > 12]
    assert np.array_equal(s.fold(part), s.fold(w)[w.trip > 12])


@pytest.mark.parametrize("holdout", ["vehicles", "days"])
def test_whole_vehicles_and_days_are_held_out(holdout: str) -> None:
    s = make_split(holdout, 600, 60000.0, [0, 1, 2], [0, 1, 2, 3, 4], 10, 0.2, 0)
    held = {}
    for v in range(3):
        for d in range(5):
            held[v, d] = set((s.fold(windows(v, d)) == HELD_OUT).tolist())
    assert all(len(h) == 1 for h in held.values())
    assert {True} in held.values() and {False} in held.values()


def driven(laps: int, trips: int = 1, placed: bool = True) -> Trajectory:
    """A round of 5 km at 10 m/s, a row a second, so many times."""
    t = np.arange(500 * laps)
    angle = 2.0 * np.pi * t / 500.0
    place = {"x": 800.0 * np.cos(angle), "y": 800.0 * np.sin(angle)} if placed else {}
    trip = t * trips // len(t)
    return Trajectory("A", t * 1_000_000, {**place, "speed": np.full(len(t), 10.0), "trip_id": trip})


def test_pieces_are_short_where_every_place_is_passed_once() -> None:
    assert passed_once([Day(0, driven(1))], 10.0)
    assert not passed_once([Day(0, driven(3))], 10.0)
    assert not passed_once([Day(0, driven(3, placed=False))], 10.0)
    once = make_split("trips", 40, 4000.0, [0], [0], 10, 0.2, 0, window=15.0, once=True)
    assert (once.kind, once.length) == ("stretches", 45.0)


def test_trips_are_apart_only_where_nothing_says_where_they_went() -> None:
    assert len(trips_apart([Day(0, driven(2, 10, placed=False))])) == 10
    assert trips_apart([Day(0, driven(2, 10))]) == ()
    assert trips_apart([Day(0, driven(2, 50, placed=False))]) == ()

"""What is held out where nothing is met twice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fleetlog.discovery import splits
from fleetlog.discovery.windows import Windows


def road(metres: np.ndarray, edge: int = -1) -> Windows:
    """A drive along an east-west road, a window every ten seconds, at the given places."""
    count = len(metres)
    zeros, ten = np.zeros(count, np.int64), np.full(count, 10.0)
    return Windows(
        trip=zeros, vehicle=zeros, day=zeros, edge=zeros + edge, duration=ten, distance=20.0 * ten, x=metres, y=0.0 * ten,
        time=10.0 * np.arange(count),
    )  # fmt: skip


OUT = 200.0 * np.arange(300)


@pytest.mark.parametrize(
    ("metres", "edge", "once"),
    [(OUT, -1, True), (np.concatenate([OUT, OUT[::-1]]), -1, False), (OUT % 4000.0, -1, False), (OUT, 3, False)],
)  # fmt: skip
def test_a_road_that_is_driven_back_is_not_passed_once(metres: np.ndarray, edge: int, once: bool) -> None:
    assert splits.passed_once(road(metres, edge)) is once


def test_standing_at_a_place_is_not_coming_back_to_it() -> None:
    assert splits.passed_once(road(np.concatenate([OUT[:150], np.full(100, OUT[150]), OUT[150:]])))


def test_what_is_kept_back_of_a_road_passed_once_has_neighbours_that_were_seen() -> None:
    w = splits.independent(road(OUT))
    kept = splits.test_windows(w, "trips", np.random.default_rng(1))
    seen = np.flatnonzero(~kept)
    gap = np.abs(np.flatnonzero(kept)[:, None] - seen[None, :]).min(axis=1)
    assert 0.15 < kept.mean() < 0.25
    assert np.median(gap) <= splits.PIECE
    assert set(splits.folds(w, splits.slow_blocks(w), np.random.default_rng(1))) == {"trip", "place"}


def test_trips_that_went_nowhere_known_are_held_out_in_parts() -> None:
    w = road(np.full(240, np.nan))
    trips = splits.independent(replace(w, trip=np.arange(240) // 12))
    kept = splits.test_windows(trips, "trips", np.random.default_rng(2))
    assert trips.pieces
    for k in range(20):
        assert not kept[12 * k : 12 * k + 12].all()
    fold = splits.folds(trips, splits.slow_blocks(trips), np.random.default_rng(2))["trip"]
    assert min(len(np.unique(fold[12 * k : 12 * k + 12])) for k in range(20)) >= 2

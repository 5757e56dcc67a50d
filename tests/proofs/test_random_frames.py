"""Frames drawn at random: found within 0.2 m and 0.2 degrees, or refused; the proof over maps is random_frames.py."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from random_frames import Outcome, Track, aligned

from fleetlog.core.network import Edge, Network, build_network

COURSE = [(0.0, 0.0), (70.0, 0.0), (70.0, 30.0), (40.0, 30.0), (40.0, 55.0), (0.0, 55.0), (0.0, 0.0)]


def network() -> Network:
    pieces = enumerate(pairwise(COURSE))
    return build_network([
        Edge(f"e{k}", str(a), str(b), np.array([[*a, 0.0], [*b, 0.0]]), f"e{k}") for k, (a, b) in pieces
    ])  # fmt: skip


def laps(count: int) -> Track:
    """Rounds of the course at 1.5 m/s, a row a second."""
    points = np.array(COURSE[:-1] * count + COURSE[:1])
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    at = np.arange(0.0, way[-1], 1.5)
    return at / 1.5, np.column_stack([np.interp(at, way, v) for v in points.T])


def outcome(seed: int, noise: float, rounds: int) -> Outcome:
    return aligned(np.random.default_rng(seed), [laps(rounds)], network(), noise)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("noise", "rounds"), [(0.3, 2), (1.0, 6), (2.0, 12)])
def test_a_frame_is_found_or_refused(seed: int, noise: float, rounds: int) -> None:
    assert outcome(seed, noise, rounds).kind in ("found", "refused")


@pytest.mark.parametrize("seed", range(3))
def test_the_frame_of_a_long_log_is_found(seed: int) -> None:
    assert outcome(seed, 0.2, 10).kind == "found"


def test_errors_that_last_are_not_averaged_away() -> None:
    """Two rounds of 1 m of noise leave the frame open by more than 0.2 m, however many rows there are."""
    assert "open" in outcome(1, 1.0, 2).refused

"""Lanes and turns as they are laid out."""

from __future__ import annotations

import numpy as np
import pytest
from simulated_sites import TRUCK, grid, road

from fleetlog.core.network import build_network
from fleetlog.simulate.track import build_track, stretch


def test_lanes_and_turns_join() -> None:
    """Turns are drawn once for all that are alike, to a micrometre: no truck jumps where they begin or end."""
    track = build_track(grid(4, 4, 34.0, seed=5).roads(), TRUCK)
    turn = np.flatnonzero(track.source >= 0)
    first, last = track.first[:-1], track.first[1:] - 1
    before, begin, end, after = last[track.source[turn]], first[turn], last[turn], first[track.target[turn]]
    for a, b in ((before, begin), (end, after)):
        assert np.hypot(track.x[a] - track.x[b], track.y[a] - track.y[b]).max() < 1e-5
        assert np.abs(np.angle(np.exp(1j * (track.heading[a] - track.heading[b])))).max() < 0.05


def test_a_road_that_leads_nowhere_has_no_turns() -> None:
    network = build_network(road("r", "a", "b", np.array([[0.0, 0.0], [20.0, 0.0]]), oneway=True))
    track = build_track(network, TRUCK)
    assert len(track) == 1
    assert track.heading == pytest.approx(0.0)


def test_a_negative_end_counts_from_the_end_of_the_line() -> None:
    line = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]])
    assert stretch(line, 4.0, -3.0) == pytest.approx(np.array([[4.0, 0.0], [10.0, 0.0], [10.0, 7.0]]))

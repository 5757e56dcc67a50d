"""Lanes and turns laid out at once are those laid out one by one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from simulated_sites import TRUCK, road

from fleetlog.core.network import build_network
from fleetlog.simulate.track import build_track, even, stretch

STEPS = st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9)), min_size=2, max_size=6)


@given(st.lists(STEPS, min_size=1, max_size=4), st.booleans())
def test_a_line_does_not_depend_on_the_others(steps: list, repeats: bool) -> None:
    lines = [np.repeat(np.cumsum(np.round(s, 2), axis=0), 1 + repeats, axis=0) for s in steps]
    for (path, length), line in zip(even(lines, 0.5), lines, strict=True):
        (alone, its_length), *_ = even([line], 0.5)
        assert length == pytest.approx(its_length)
        assert path[:, [0, 1, 3]] == pytest.approx(alone[:, [0, 1, 3]], abs=1e-7)
        assert np.exp(1j * path[:, 2]) == pytest.approx(np.exp(1j * alone[:, 2]), abs=1e-7)
        gaps = np.hypot(*np.diff(path[:, :2], axis=0).T)
        assert gaps.max() <= 0.5 + 1e-9
        assert path[[0, -1], :2] == pytest.approx(line[[0, -1]], abs=1e-6)


def test_a_road_that_leads_nowhere_has_no_turns() -> None:
    network = build_network(road("r", "a", "b", np.array([[0.0, 0.0], [20.0, 0.0]]), oneway=True))
    track = build_track(network, TRUCK)
    assert len(track) == 1
    assert track.heading == pytest.approx(0.0)


def test_a_negative_end_counts_from_the_end_of_the_line() -> None:
    line = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]])
    assert stretch(line, 4.0, -3.0) == pytest.approx(np.array([[4.0, 0.0], [10.0, 0.0], [10.0, 7.0]]))

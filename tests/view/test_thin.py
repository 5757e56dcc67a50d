"""Which rows are kept: nothing that is seen gets lost."""

from __future__ import annotations

import itertools
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from fleetlog.core.trajectory import Trajectory
from fleetlog.view import blueprint, clock

walks = hnp.arrays(float, st.integers(1, 80), elements=st.floats(-0.2, 0.2)).map(np.cumsum)
levels = hnp.arrays(float, st.integers(1, 60), elements=st.sampled_from([0.0, 1.0, 2.5, float("nan")]))
times = hnp.arrays(np.int64, st.integers(2, 80), elements=st.integers(1, 40_000_000)).map(np.cumsum)


@given(levels)
def test_collapsed_runs_come_back_by_interpolation(values: np.ndarray) -> None:
    keep = clock.moved(1e-12, values)
    at = np.arange(len(values))
    last = keep[np.searchsorted(keep, at, side="right") - 1]
    following = keep[np.searchsorted(keep, at, side="left")]
    np.testing.assert_array_equal(values[last], values)
    np.testing.assert_array_equal(values[following], values)


@given(walks, walks, st.sampled_from([0.03, 0.3]))
def test_held_position_is_never_a_step_wrong(x: np.ndarray, y: np.ndarray, step: float) -> None:
    n = min(len(x), len(y))
    x, y = x[:n], y[:n]
    keep = clock.moved(step, x, y)
    held = keep[np.searchsorted(keep, np.arange(n), side="right") - 1]
    assert np.abs(x[held] - x).max() <= step * (1 + 1e-9) and np.abs(y[held] - y).max() <= step * (1 + 1e-9)
    assert keep[0] == 0 and keep[-1] == n - 1


@given(times, st.floats(0.2, 20.0))
def test_rate_and_gaps(time: np.ndarray, rate: float) -> None:
    kept = clock.thinned(Trajectory("v", time, {"x": time * 1.0}), rate)
    assert set(kept.time) <= set(time) and kept.time[0] == time[0] and kept.time[-1] == time[-1]
    np.testing.assert_array_equal(kept.floats("x"), kept.time)
    for row in np.flatnonzero(np.diff(time) > clock.gap_limit(time)):
        assert {time[row], time[row + 1]} <= set(kept.time)
    inner = clock.rows_at_rate(time, rate)[:-1]
    bins = time[inner] // max(round(1e6 / rate), 1)
    assert (np.diff(bins) > 0).all()


@given(times)
def test_pieces_are_the_rows_without_gaps(time: np.ndarray) -> None:
    limit = clock.gap_limit(time)
    cuts = clock.pieces(time, limit)
    assert [i for s in cuts for i in range(s.start, s.stop)] == list(range(len(time)))
    assert all((np.diff(time[s]) <= limit).all() for s in cuts)
    assert all(time[b.start] - time[a.stop - 1] > limit for a, b in itertools.pairwise(cuts))


@pytest.mark.parametrize("lanes", [0, 8])
@pytest.mark.parametrize("number", [3, 8, 12, 40])
def test_a_legend_has_room_for_every_name_or_is_not_there(
    number: int, lanes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent: list[Any] = []
    monkeypatch.setattr(blueprint, "send", lambda stream, screen, columns, shares: sent.append(columns[1]))
    signals = {"speed", "power", "soc", *(["state", "open"] if lanes else [])}
    names = tuple(f"T{k}" for k in range(number))
    screen = blueprint.Screen(np.zeros((0, 3)), signals=signals, names=names, lanes=lanes)
    screen.legend = number <= 12
    blueprint.replay(cast(Any, None), screen, None)
    (column,) = sent
    shares, views = column.row_shares, column.contents
    told = [
        k for k, view in enumerate(views) if "PlotLegend" in view.properties and view.properties["PlotLegend"].visible.as_arrow_array()[0].as_py()
        and view.name == "State of charge [%]"
    ]  # fmt: skip
    assert bool(told) == screen.legend and screen.legend == (number <= (4 if lanes else 12))
    need = blueprint.FRAME + blueprint.NAME * number
    assert all(blueprint.COLUMN * shares[k] / sum(shares) >= need - 1.0 for k in told)

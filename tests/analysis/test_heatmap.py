"""Heat maps: time is conserved, maps add, and a difference that is there is found."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetlog.analysis.heatmap import difference, heatmap
from fleetlog.analysis.kernels import accumulate
from fleetlog.analysis.occupancy import cells_of, compute, extent, values
from fleetlog.errors import DataError

from .conftest import write


def map_of(dataset, cells, **chosen):
    return compute(dataset, cells, **chosen)["all"]


def test_time_distance_and_energy_are_conserved(fleet):
    m = map_of(fleet, cells_of([extent(fleet)], 1.0))
    seconds = sum(len(t) - 1 for t in fleet.days())
    assert m.grid[0].sum() == pytest.approx(seconds)
    energy = sum(
        float(np.sum((t.floats("battery_power")[1:] + t.floats("battery_power")[:-1]) / 2))
        for t in fleet.days()
    )
    assert m.grid[2].sum() == pytest.approx(energy)
    assert m.edges[0].sum() == pytest.approx(seconds)
    assert m.grid[3].sum() <= m.grid[0].sum()


@pytest.mark.parametrize("cell", [0.5, 2.0, 7.0])
def test_the_cell_size_changes_no_total(fleet, cell):
    fine, other = (map_of(fleet, cells_of([extent(fleet)], c)) for c in (1.0, cell))
    assert np.allclose(fine.grid[:4].sum(axis=(1, 2)), other.grid[:4].sum(axis=(1, 2)))


def test_maps_add_over_vehicles(fleet):
    cells = cells_of([extent(fleet)], 1.0)
    parts = [map_of(fleet, cells, vehicles=(v,)) for v in fleet.vehicles]
    total = parts[0]
    for p in parts[1:]:
        total = total + p
    whole = map_of(fleet, cells)
    assert np.allclose(total.grid, whole.grid) and np.allclose(total.edges, whole.edges)
    states = [map_of(fleet, cells, state=s) for s in ("laden", "empty")]
    assert np.allclose(states[0].grid[0] + states[1].grid[0], whole.grid[0])


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 1000), st.integers(2, 60))
def test_irregular_sampling_weighs_time_not_rows(seed, n):
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.integers(1, 9_000_000, n)).astype(np.int64)
    x, y = rng.random(n) * 30, rng.random(n) * 30
    layers, nan = np.zeros((900, 6)), np.full(n, np.nan)
    accumulate(x, y, time, nan, nan, 0.2, np.ones(n, bool), 0.0, 0.0, 1.0, 1e9, 30, layers)
    assert layers[:, 0].sum() == pytest.approx((time[-1] - time[0]) * 1e-6)


def test_a_gap_is_nobody_s_time():
    time = np.array([0, 1, 2, 500, 501], np.int64) * 1_000_000
    layers, at, nan = np.zeros((100, 6)), np.full(5, 3.5), np.full(5, np.nan)
    accumulate(at, at, time, nan, nan, 0.2, np.ones(5, bool), 0.0, 0.0, 1.0, 15.0, 10, layers)
    assert layers[:, 0].sum() == pytest.approx(3.0)


def test_passages_count_entries_not_rows():
    n = 21
    x = np.r_[np.linspace(0.5, 9.5, 10), 9.5, np.linspace(9.5, 0.5, 10)]
    layers = np.zeros((3, 12, 6))
    accumulate(
        x,
        np.full(n, 1.5),
        np.arange(n) * 1_000_000,
        np.ones(n),
        np.ones(n),
        0.2,
        np.ones(n, bool),
        0.0,
        0.0,
        1.0,
        15.0,
        12,
        layers.reshape(-1, 6),
    )
    assert layers[1, 5, 4] == 2 and layers[1, 9, 4] == 1


def test_speed_is_the_mean_over_time(fleet):
    cells = cells_of([extent(fleet)], 1000.0)
    m = map_of(fleet, cells)
    v = np.nansum(values(m.grid, "speed", 1.0) * m.grid[0]) / m.grid[0].sum()
    assert v == pytest.approx(m.grid[1].sum() / m.grid[0].sum())


def test_the_same_fleet_shows_no_difference_and_another_does(tmp_path):
    a, b = write(tmp_path / "a", range(12), 1800), write(tmp_path / "b", range(20, 32), 1800)
    cells = cells_of([extent(a), extent(b)], 5.0)
    _, mask = difference(map_of(a, cells), map_of(b, cells))
    assert mask.mean() < 0.02
    stay = map_of(b, cells)
    moved = map_of(a, cells)
    corner = 2 * cells.columns + 2
    for k, (cell, time) in enumerate(
        moved.units
    ):  # the whole fleet now also stands for ten minutes at one corner
        assert corner not in cell
        at = np.searchsorted(cell, corner)
        moved.units[k] = np.insert(cell, at, corner), np.insert(time, at, 600.0)
    moved.grid[0, 2, 2] += 600 * len(moved.units)
    share, mask = difference(moved, stay)
    assert mask[2, 2] and share[2, 2] > 0


def test_result_and_errors(fleet, tmp_path):
    r = heatmap(fleet, cell=2.0, quantity="energy", smooth=1.0)
    assert r.summary["vehicle_hours"] == pytest.approx(6 * 1799 / 3600) and set(r.tables) == {
        "cells",
        "edges",
    }
    with pytest.raises(DataError, match="wider"):
        heatmap(fleet, hours=(1, 2))
    with pytest.raises(DataError, match="larger --cell"):
        heatmap(fleet, cell=0.001)
    with pytest.raises(DataError, match="did you mean"):
        heatmap(fleet, vehicle=("T9",))


@pytest.mark.parametrize("by", ["hour", "vehicle", "load"])
def test_the_maps_of_groups_add_up_to_the_whole(fleet, by):
    cells = cells_of([extent(fleet)], 2.0)
    parts, whole = compute(fleet, cells, by), map_of(fleet, cells)
    assert len(parts) > 1 or by == "hour"
    # A truck whose load changes in a cell, or over an hour, came into it once.
    assert np.allclose(sum(p.grid for p in parts.values()), whole.grid)
    assert np.allclose(sum(p.edges for p in parts.values()), whole.edges)
    r = heatmap(fleet, cell=2.0, by=by)
    assert [s.name for s in r.shapes] == list(parts) and by in r.tables["cells"]
    assert r.tables["cells"].time.sum() == pytest.approx(whole.grid[0].sum())

"""Two fleets on one timeline."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rrd
from fixtures_view import START, drive, plant, write_fleet
from hypothesis import given
from hypothesis import strategies as st

from fleetlog.core.trajectory import Trajectory
from fleetlog.store import Dataset, DatasetWriter
from fleetlog.view.comparison import differences, totals, write_comparison

LATER = 40 * 86_400_000_000


def simulated(path: Path, later: int, mission: bool = True) -> Path:
    """The same way, 20 % less power, on another clock."""
    site = plant()
    with DatasetWriter.create(path, "simulated", site) as writer:
        writer.summary = {"distance_ratio": 1.0} if mission else {}
        for i in range(3):
            t = drive(site, f"truck {i + 1}", 200.0 * i / 3)
            writer.write(
                Trajectory(
                    t.vehicle_id,
                    t.time + later,
                    {**t.columns, "battery_power": 0.8 * t.floats("battery_power")},
                )
            )
    return path


@pytest.mark.parametrize("later", [0, LATER])
def test_both_fleets_and_their_difference(tmp_path: Path, later: int) -> None:
    recorded = write_fleet(tmp_path / "a", plant())
    out = write_comparison(recorded, simulated(tmp_path / "b", later), tmp_path / "c.rrd")
    ours, theirs = (
        rrd.vectors(out, f"/{p}/trucks/truck\\ 1", "Transform3D:translation")
        for p in ("recorded", "simulated")
    )
    np.testing.assert_array_equal(ours[0], theirs[0])
    np.testing.assert_array_equal(ours[1], theirs[1])
    time, power = rrd.scalars(out, "/difference/power/truck\\ 1")
    truth = Dataset(recorded).read("truck 1")
    known = np.isfinite(power)
    p = truth.floats("battery_power")[np.searchsorted(truth.time, time[known])]
    np.testing.assert_allclose(power[known], -0.2e-3 * p, atol=1e-9)
    time, energy = rrd.scalars(out, "/difference/energy/truck\\ 1")
    step = np.diff(truth.time, append=truth.time[-1]) * 1e-6
    total = -0.2 * (truth.floats("battery_power") * np.where(step < 5, step, 0)).sum() / 3.6e6
    assert energy[-1] == pytest.approx(total, rel=0.02)
    _, apart = rrd.scalars(out, "/difference/apart/truck\\ 1")
    assert np.nanmax(apart) < 1e-9
    _, text = rrd.column(out, "/summary", "TextDocument:text", None)
    assert ("clock is moved by -3,456,000 s" in text.to_pylist()[0][0]) == (later > 0)


def test_fleets_without_a_common_truck(tmp_path: Path) -> None:
    recorded = write_fleet(tmp_path / "a", plant(), 1)
    site = plant()
    with DatasetWriter.create(tmp_path / "b", "simulated", site) as writer:
        writer.write(drive(site, "S1", 50.0))
    out = write_comparison(recorded, tmp_path / "b", tmp_path / "c.rrd")
    assert not any("apart" in v or "simulated -" in v for v in rrd.views(out))
    assert {"/simulated/trucks/S1", "/recorded/trucks/truck\\ 1"} <= rrd.entities(out)


@given(st.floats(-50, 50), st.floats(-50, 50), st.floats(-5e3, 5e3))
def test_difference_of_a_moved_copy_is_the_move(dx: float, dy: float, dp: float) -> None:
    n = 40
    time = START + np.arange(n, dtype=np.int64) * 500_000
    s = np.arange(n, dtype=float)
    a = Trajectory("v", time, {"x": s, "y": 0.5 * s, "battery_power": 100.0 * s})
    b = Trajectory("v", time, {"x": s + dx, "y": 0.5 * s + dy, "battery_power": 100.0 * s + dp})
    out = differences(a, b)
    np.testing.assert_allclose(out["apart"], np.hypot(dx, dy), atol=1e-9)
    np.testing.assert_allclose(out["power"], 1e-3 * dp, atol=1e-9)
    assert "soc" not in out


def test_nothing_is_compared_across_a_gap() -> None:
    time = START + np.concatenate([np.arange(50), np.arange(150, 200)]).astype(np.int64) * 1_000_000
    dense = START + np.arange(200, dtype=np.int64) * 1_000_000
    a = Trajectory("v", dense, {"x": np.zeros(200), "y": np.zeros(200)})
    b = Trajectory("v", time, {"x": np.zeros(100), "y": np.ones(100)})
    apart = differences(a, b)["apart"]
    assert np.isnan(apart[51:150]).all() and np.isfinite(apart[:50]).all() and np.isfinite(apart[151:]).all()


def test_fleets_on_other_tasks_are_compared_by_their_totals(tmp_path: Path) -> None:
    recorded = write_fleet(tmp_path / "a", plant())
    out = write_comparison(recorded, simulated(tmp_path / "b", 0, mission=False), tmp_path / "c.rrd")
    energy = [rrd.scalars(out, f"/difference/used/{name}")[1][-1] for name in ("recorded", "simulated")]
    assert energy[1] == pytest.approx(0.8 * energy[0], rel=0.02)
    _, apart = rrd.scalars(out, "/difference/distance/recorded")
    trucks = Dataset(recorded)
    metres = sum(trucks.trips.distance)
    assert apart[-1] == pytest.approx(metres / 1000.0, rel=0.1) and (np.diff(apart) >= 0.0).all()
    assert not len(rrd.scalars(out, "/difference/apart/truck\\ 1")[1])


def test_totals_of_a_fleet_are_the_sums_of_its_trucks() -> None:
    day = drive(plant(), "a", 0.0)
    one, two = totals([day]), totals([day, day])
    for kind, values in one[1].items():
        np.testing.assert_allclose(two[1][kind], 2.0 * values)

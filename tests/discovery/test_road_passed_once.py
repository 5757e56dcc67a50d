"""A road that is driven once, in one direction, without a map: what may be said of it, and what not."""

from __future__ import annotations

import numpy as np
import pytest

from fleetlog.core.trajectory import Trajectory
from fleetlog.core.truck import truck_from_dict
from fleetlog.discovery.explain import Explained, Options, energy_channel
from fleetlog.discovery.fleet import Fleet
from fleetlog.discovery.model import Found
from fleetlog.discovery.replay import blocks
from fleetlog.physics.power import Physics, battery_power

TRUCK = truck_from_dict({
    "name": "car", "chassis": {"mass": 1600.0}, "drive": {"efficiency": 0.85, "regeneration": 0.65, "max_speed": 40.0},
    "resistance": {"rolling": 0.010, "drag_area": 0.65}, "auxiliary": {"power": 500.0},
})  # fmt: skip
ROWS, STEP = 900, 5.0


def wandering(rng: np.random.Generator, length: float, step: float, count: int) -> np.ndarray:
    """(count,) a random walk pulled back to zero, of unit spread, that forgets over ``length``."""
    keep = np.exp(-step / length)
    out, now = np.zeros(count), rng.normal()
    for i in range(count):
        out[i] = now
        now = keep * now + np.sqrt(1.0 - keep**2) * rng.normal()
    return out


def explained(slope: float, gusts: float, seed: int = 3) -> tuple[Explained, np.ndarray]:
    """A motorway of hills with ``slope`` root mean square, and a load that wanders by ``gusts`` [W] over two minutes."""
    rng = np.random.default_rng(seed)
    t = STEP * np.arange(ROWS)
    speed = 25.0 + 2.0 * wandering(rng, 60.0, STEP, ROWS)
    s = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * STEP)])
    heading = 0.4 * np.sin(s / 15_000.0)
    x, y = (np.concatenate([[0.0], np.cumsum(f(heading[1:]) * np.diff(s))]) for f in (np.cos, np.sin))
    track = Trajectory("T", ((1.7e9 + t) * 1e6).astype(np.int64), {
        "x": x, "y": y, "heading": heading, "speed": speed, "trip_id": np.zeros(ROWS, np.int64),
    })  # fmt: skip
    hills = slope * wandering(rng, 1500.0, 125.0, ROWS)
    (block,) = blocks(track, 0, None, 2.5)
    along = np.interp(block.motion.time, block.time, hills)
    power = block.rows(battery_power(block.motion, Physics(TRUCK, {"grade": {"slope": along}})))
    power = power + gusts * wandering(rng, 120.0, STEP, ROWS) + rng.normal(0.0, 800.0, ROWS)
    fleet = Fleet([(0, track.with_columns(battery_power=power))], ("T",), None, TRUCK, {}, {})
    return energy_channel(fleet, "battery_power", Found(TRUCK), Options()), hills


def test_hills_are_found_and_the_floor_is_not_excluded() -> None:
    e, hills = explained(0.02, 0.0)
    assert [f.term for f in e.findings] == ["grade"]
    assert e.findings[0].not_excluded == ["surface_resistance"]
    assert "other direction" in (e.findings[0].needs or "")
    assert e.fit.after < 0.9 * e.fit.before
    m = e.task.recording.blocks[0].motion
    found = np.zeros(len(m))
    for number, weight in e.task.floor.parts(m, True):
        found += e.result.fields["grade"].deviation[number] * weight
    steps = e.task.recording.blocks[0].steps
    assert np.corrcoef(found.reshape(-1, steps).mean(axis=1), hills)[0, 1] > 0.85


@pytest.mark.parametrize("seed", [3, 4])
def test_a_level_road_has_no_hills(seed: int) -> None:
    assert explained(0.0, 0.0, seed)[0].findings == []


def test_a_load_that_wanders_with_time_is_not_excluded_by_a_road_passed_once() -> None:
    for finding in explained(0.0, 1500.0)[0].findings:
        assert finding.term == "unknown" or {"surface_resistance", "auxiliary_load"} <= set(
            finding.not_excluded
        )
        assert "another time" in (finding.needs or "")

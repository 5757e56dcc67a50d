"""Trips of which nothing says where they went, each perhaps on a floor of its own."""

from __future__ import annotations

import numpy as np
import pytest

from fleetlog.core.trajectory import Trajectory
from fleetlog.core.truck import Chassis, Resistance, Truck
from fleetlog.discovery.explain import Explained, Options, energy_channel
from fleetlog.discovery.fleet import Fleet
from fleetlog.discovery.model import Found
from fleetlog.discovery.replay import blocks
from fleetlog.physics.power import Physics, battery_power

TRUCK = Truck(Chassis(4500.0), resistance=Resistance(rolling=0.015))
TRIPS, SECONDS = 24, 180


def explained(spread: float) -> tuple[Explained, np.ndarray]:
    """A day of trips without positions, each with its own rolling coefficient about the truck file's."""
    rng = np.random.default_rng(5)
    own = 0.015 + spread * rng.permutation(np.linspace(-1.0, 1.0, TRIPS))
    t = np.arange(TRIPS * SECONDS, dtype=float)
    phase = t % 45.0
    top = rng.uniform(2.0, 4.0, int(t[-1] // 45.0) + 1)[(t // 45.0).astype(int)]
    speed = np.clip(np.minimum(phase * 0.6, (40.0 - phase) * 0.6), 0.0, top)
    trip = (t // SECONDS).astype(np.int64)
    track = Trajectory(
        "T", ((1.7e9 + t + 600.0 * trip) * 1e6).astype(np.int64), {"speed": speed, "trip_id": trip}
    )
    power = np.concatenate([
        block.rows(battery_power(block.motion, Physics(TRUCK, {"rolling_resistance": {"coefficient": own[int(block.trip[0])]}})))
        for block in blocks(track, 0, None, 2.5)
    ])  # fmt: skip
    track = track.with_columns(battery_power=power + rng.normal(0.0, 300.0, len(t)))
    fleet = Fleet([(0, track)], ("T",), None, TRUCK, {}, {})
    return energy_channel(fleet, "battery_power", Found(TRUCK), Options()), own


def test_a_resistance_of_each_trips_own_is_found_and_measured() -> None:
    e, own = explained(0.010)
    assert [(f.term, f.depends_on) for f in e.findings] == [("unknown", ["trip_id"])]
    assert e.fit.after < 0.75 * e.fit.before
    (values,) = e.findings[0].when.values()
    found = np.array([values[str(k)] for k in range(TRIPS)])
    assert np.corrcoef(found[:, 0], own)[0, 1] > 0.95
    assert np.abs(found[:, 0] - (own - 0.015)).mean() < 0.0035
    assert "trip to trip" in e.findings[0].statement


@pytest.mark.parametrize("spread", [0.0, 0.0002])
def test_trips_that_are_alike_are_left_alone(spread: float) -> None:
    assert explained(spread)[0].findings == []

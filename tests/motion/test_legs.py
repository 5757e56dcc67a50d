"""Legs and how long they take: the same path and the same profile for whoever asks."""

from __future__ import annotations

import sys
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from recorded import Logger, drives, logged

from fleetlog.analysis.energy import energy
from fleetlog.calibrate.observe import observations
from fleetlog.core.site import Site
from fleetlog.core.truck import Truck
from fleetlog.physics.motion import reconstruct
from fleetlog.physics.motion.legs import free_flow, joined, legs, speed_limits
from fleetlog.physics.power import Physics
from fleetlog.simulate.mission import replay
from fleetlog.store import Dataset, DatasetWriter
from fleetlog.store.trips import trip_ids

shift = cache(drives)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> tuple[Dataset, Truck]:
    drive = shift(1, 1.0)
    log = logged(drive, Logger(), 1)
    site = Site("yard", network=drive.network)
    path = tmp_path_factory.mktemp("legs") / "data"
    with DatasetWriter.create(path, "recorded", site) as writer:
        writer.write(log.with_columns(trip_id=trip_ids(log)))
    return Dataset(path), drive.truck


def test_legs_cover_the_drive() -> None:
    drive = shift(2, 0.7)
    found = reconstruct(logged(drive, Logger(), 2), drive.network, drive.truck)
    driven = legs(found)
    m = found.motion
    assert sum(leg.distance[-1] for leg in driven) == pytest.approx(m.speed @ m.dt, rel=2e-3)
    for a, b in pairwise(driven):
        assert b.path.time[0] >= a.path.time[-1]
        assert a.path.time[-1] + a.wait == pytest.approx(b.path.time[0], abs=1.0)
    leg = driven[3]
    assert (np.diff(leg.distance) > 0.0).all() and np.diff(leg.distance).max() <= 0.5 + 1e-9
    place = leg.at(np.array([0.0, leg.distance[-1] / 2.0]))
    assert place.x[0] == pytest.approx(leg.path.x[0])


def test_joined_legs_stop_where_they_stopped() -> None:
    drive = shift(2, 0.7)
    first, second = legs(reconstruct(logged(drive, Logger(), 2), drive.network, drive.truck))[:2]
    both = joined([first, second])
    (node, wait), *_ = both.stops.items()
    assert wait == pytest.approx(second.path.time[0] - first.path.time[-1])
    profile = free_flow(both, Physics(drive.truck), np.full(len(both.distance), 3.0))
    assert profile.speed[node] == 0.0
    alone = [free_flow(leg, Physics(drive.truck), np.full(len(leg.distance), 3.0)) for leg in (first, second)]
    assert profile.duration == pytest.approx(sum(p.duration for p in alone) + wait, rel=0.01)


def test_free_flow_is_a_little_quicker_than_drivers_are() -> None:
    """Than drivers who differ by some per cent and now and then drive slowly behind another."""
    ratios = []
    for seed in (1, 2, 3, 4):
        drive = shift(seed, 0.7)
        found = reconstruct(logged(drive, Logger(), seed), drive.network, drive.truck)
        site, physics = Site("yard", network=drive.network), Physics(drive.truck)
        driven = [leg for leg in legs(found) if leg.whole]
        free = sum(free_flow(leg, physics, speed_limits(site, leg.path)).duration for leg in driven)
        ratios.append(free / sum(leg.duration for leg in driven))
    assert 0.97 < np.mean(ratios) < 1.005, ratios


def test_power_and_slope_hold_the_profile_down() -> None:
    drive = shift(1, 0.7)
    leg = max(legs(reconstruct(logged(drive, Logger(), 1), drive.network)), key=lambda leg: leg.distance[-1])
    weak = Physics(drive.truck.with_value("drive.max_power", 3000.0))
    free = np.full(len(leg.distance), np.inf)
    assert free_flow(leg, weak, free).duration > 1.2 * free_flow(leg, Physics(drive.truck), free).duration


def test_the_same_dataset_has_the_same_energy_everywhere(
    recording: tuple[Dataset, Truck], tmp_path: Path
) -> None:
    """analyze energy, calibrate and the same mission; and each against what was recorded."""
    dataset, truck = recording
    physics = Physics(truck)
    analysed = energy(dataset, truck).summary
    calibrated = observations(dataset.path, physics)
    assert calibrated.predict(physics).sum() / 1000.0 == pytest.approx(analysed["energy_kwh"], rel=1e-3)
    assert analysed["energy_kwh"] == pytest.approx(analysed["measured_kwh"], rel=0.01)
    with DatasetWriter.create(tmp_path / "again", "simulated", dataset.site) as writer:
        summary = replay(dataset, truck, writer)
    assert summary.distance_ratio == pytest.approx(1.0, abs=0.002)
    assert 0.97 < summary.duration_ratio < 1.005  # A mission driven again meets nobody
    assert summary.energy_ratio == pytest.approx(1.0, abs=0.03)
    again = energy(Dataset(tmp_path / "again"), truck).summary
    assert again["energy_kwh"] == pytest.approx(again["measured_kwh"], rel=0.01)

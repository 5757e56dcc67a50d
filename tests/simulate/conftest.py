"""Simulations that tests look at."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
import pytest
from simulated_sites import TRUCK

from fleetlog.simulate.engine import Settings, simulate
from fleetlog.store import Dataset, DatasetWriter


class Outcome:
    """A finished simulation: summary, dataset and trajectories, with arrays (V, N)."""

    def __init__(self, path, summary):
        self.summary, self.dataset = summary, Dataset(path)
        self.tracks = [self.dataset.read(v) for v in self.dataset.vehicles]

    def array(self, name):
        return np.array([t.floats(name) for t in self.tracks])


@pytest.fixture
def simulated(tmp_path):
    """A function that simulates with rows at every step and returns an Outcome."""
    count = iter(range(1000))

    def run(
        site, vehicles, duration, seed=0, truck=TRUCK, interval=0.1, demand=None, physics=None, **settings
    ):
        path = tmp_path / f"sim{next(count)}"
        with DatasetWriter.create(path, "simulated", site) as writer:
            chosen = Settings(vehicles=vehicles, duration=duration, seed=seed, interval=interval, **settings)
            summary = simulate(site, truck, writer, chosen, demand, physics)
        return Outcome(path, summary)

    return run

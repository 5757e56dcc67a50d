"""Trucks on drawn ways: rows from positions and what the truck does there, without the simulator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from fleetlog.core.site import Frame, Site
from fleetlog.core.trajectory import Trajectory
from fleetlog.store import Dataset, DatasetWriter
from fleetlog.store.trips import trip_ids

T0 = 1_772_431_200_000_000
"""Monday, 2 March 2026, 06:00 UTC."""


def straight(name, start, velocity, seconds, dt=0.5, begin=0.0, **columns) -> Trajectory:
    """A truck that drives straight ahead at constant velocity."""
    t = np.arange(0.0, seconds + 1e-9, dt)
    xy = np.asarray(start, float) + t[:, None] * np.asarray(velocity, float)
    heading = np.full(len(t), np.arctan2(velocity[1], velocity[0]))
    speed = np.full(len(t), np.hypot(*velocity))
    return rows(name, begin + t, x=xy[:, 0], y=xy[:, 1], heading=heading, speed=speed, **columns)


def rows(name, t, **columns) -> Trajectory:
    """Rows at ``t`` seconds; scalars are spread."""
    spread = {k: np.broadcast_to(np.asarray(v, float), np.shape(t)).copy() for k, v in columns.items()}
    out = Trajectory(name, T0 + np.round(np.asarray(t) * 1e6).astype(np.int64), spread)
    return out.with_columns(trip_id=trip_ids(out))


Write = Callable[..., Dataset]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def make(trucks: Sequence[Trajectory], site: Site | None = None, name: str = "d") -> Dataset:
        site = site or Site("plant", Frame(50.0, 9.0, timezone="Europe/Berlin"))
        with DatasetWriter.create(tmp_path / name, "recorded", site) as w:
            for t in trucks:
                w.write(t)
        return Dataset(tmp_path / name)

    return make

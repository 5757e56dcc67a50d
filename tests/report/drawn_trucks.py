"""Trucks on drawn ways: rows from positions and what the truck does there, without the simulator."""

from __future__ import annotations

import numpy as np

from fleetlog.core.trajectory import Trajectory
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


def random_truck(seed: int, n: int = 300):
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.choice([0.5, 1.0, 1.0, 90.0], n, p=[0.4, 0.4, 0.19, 0.01]))
    runs = np.repeat(rng.random(n // 10) < 0.5, 10)
    return rows(
        f"T{seed}", t, speed=np.where(runs, 2.0, 0.0), x=0.0, y=0.0, heading=0.0,
        payload=np.repeat(rng.choice([0.0, 900.0], n // 20), 20), fork_height=np.repeat(rng.random(n // 5), 5),
        battery_power=rng.normal(500, 900, n), soc=np.linspace(0.8, 0.6, n),
    )  # fmt: skip


def crossing(delay: float, turn: float = 0.0, shift=(0.0, 0.0), names=("A", "B")):
    """Two trucks at 2 m/s on ways that cross at right angles; the second is at the crossing ``delay`` s later."""
    c, s = np.cos(turn), np.sin(turn)
    r = np.array([[c, -s], [s, c]])
    a = straight(names[0], r @ (-20.0, 0.0) + shift, r @ (2.0, 0.0), 20.0)
    b = straight(names[1], r @ (0.0, -20.0 - 2.0 * delay) + shift, r @ (0.0, 2.0), 25.0)
    return [a, b]

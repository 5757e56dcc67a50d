"""Positions that a logger repeats until the receiver gives another."""

from __future__ import annotations

import numpy as np
import pytest

from fleetlog.core.trajectory import Trajectory
from fleetlog.core.truck import Chassis, Truck
from fleetlog.discovery.recording.blocks import block
from fleetlog.discovery.recording.day import seldom


def drive(every: int, null: bool = False) -> tuple[Trajectory, np.ndarray, np.ndarray]:
    """Round a quarter circle of 400 m at changing speed, with a stop; positions known on one row in ``every``."""
    t = np.arange(400.0)
    speed = np.where((t > 150) & (t < 200), 0.0, 3.0 + 2.0 * np.sin(t / 9.0))
    s = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))])
    x, y = 2000.0 * np.sin(s / 2000.0), 2000.0 * (1.0 - np.cos(s / 2000.0))
    last = (np.arange(400) // every) * every
    seen = np.where(last == np.arange(400), 1.0, np.nan) if null else np.ones(400)
    columns = {"x": x[last] * seen, "y": y[last] * seen, "speed": speed, "heading": np.zeros(400)}
    return Trajectory("T", (t * 1e6).astype(np.int64), columns), x, y


@pytest.mark.parametrize("null", [False, True])
def test_between_updates_a_vehicle_is_where_its_speed_took_it(null: bool) -> None:
    track, x, y = drive(12, null)
    b = block(track, 0, None, Truck(Chassis(4500.0)))
    off = np.hypot(b.rows(b.motion.x) - x, b.rows(b.motion.y) - y)[:-12]
    assert off.max() < 1.0 < np.nanmax(np.hypot(track.floats("x") - x, track.floats("y") - y)) or null
    turn = b.rows(b.motion.heading) - np.arctan2(x, 2000.0 - y)
    assert np.abs(turn[20:-20]).max() < 0.02


@pytest.mark.parametrize(("every", "few"), [(1, False), (3, False), (12, True)])
def test_a_speed_channel_is_held_only_against_positions_that_come_often(every: int, few: bool) -> None:
    assert seldom(drive(every)[0]) is few

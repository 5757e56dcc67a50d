"""Finer steps between the samples of a motion.

The switch between traction and regeneration is convex: evaluated on samples a second apart the model is wrong by several per
cent.  Speed and acceleration of two neighbouring samples fix a cubic (Hermite); the model is evaluated on pieces of it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.motion import Motion

Floats = NDArray[np.float64]
FINEST = 0.25
"""Length of a step that resolves a braking truck [s]."""
MOST = 20
"""Steps in a sample at most."""
STILL = 0.05
"""Where both neighbours are slower than this a truck stands [m/s]."""


def steps_needed(motion: Motion) -> int:
    """Steps in each sample so that none is longer than ``FINEST``; 1 where the samples are fine enough already."""
    running = motion.dt[motion.dt > 0.0]
    return int(np.clip(np.ceil(np.median(running) / FINEST - 1e-9), 1, MOST)) if len(running) else 1


def refined(motion: Motion, steps: int | None = None) -> tuple[Motion, int]:
    """The motion in ``steps`` pieces a sample, sample by sample, and ``steps``; each piece has its share of ``dt``.

    Speed and acceleration follow the cubic; edge offset moves on with the speed; all else is that of the sample.
    """
    steps = steps_needed(motion) if steps is None else steps
    if steps == 1 or len(motion) < 2:
        return motion, 1
    ahead = (np.arange(steps) + 0.5) / steps - 0.5
    since = (motion.dt[:, None] * ahead).ravel()
    fine = motion[np.repeat(np.arange(len(motion)), steps)]
    speed, acceleration = _cubic(motion, np.repeat(np.arange(len(motion)), steps), since)
    return fine.replaced(
        time=fine.time + since, dt=fine.dt / steps, speed=speed, acceleration=acceleration,
        edge_offset=np.maximum(fine.edge_offset + since * speed, 0.0),
    ), steps  # fmt: skip


def _cubic(motion: Motion, row: NDArray[np.intp], since: Floats) -> tuple[Floats, Floats]:
    """Speed and acceleration ``since`` seconds after each row, on the Hermite cubic between it and its neighbour."""
    left = np.clip(np.where(since < 0.0, row - 1, row), 0, len(motion) - 2)
    span = motion.time[left + 1] - motion.time[left]
    share = np.clip((motion.time[row] + since - motion.time[left]) / span, 0.0, 1.0)
    v0, v1 = motion.speed[left], motion.speed[left + 1]
    a0, a1 = motion.acceleration[left] * span, motion.acceleration[left + 1] * span
    c2, c3 = 3.0 * (v1 - v0) - 2.0 * a0 - a1, 2.0 * (v0 - v1) + a0 + a1
    speed = v0 + share * (a0 + share * (c2 + share * c3))
    slope = (a0 + share * (2.0 * c2 + 3.0 * share * c3)) / span
    # Beyond a gap of the log, or from one vehicle to the next, a sample's own values hold.
    alone = (span > 3.0 * np.maximum(motion.dt[row], 1e-9)) | (
        motion.vehicle[left] != motion.vehicle[left + 1]
    )
    speed = np.where(alone, motion.speed[row] + motion.acceleration[row] * since, speed)
    slope = np.where(alone, motion.acceleration[row], slope)
    still = (speed <= 0.0) | ((v0 < STILL) & (v1 < STILL))
    return np.where(still, 0.0, speed), np.where(still, 0.0, slope)


def sampled(values: Floats, steps: int) -> Floats:
    """(N,) mean over the pieces of each sample of (N * steps,) values."""
    return np.asarray(values.reshape(-1, steps).mean(axis=1)) if steps > 1 else values

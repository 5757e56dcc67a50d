"""Motion off the map: both axes smoothed alike, speed and curvature from the smooth curve."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetlog.physics.smooth.noise import Noise, Observed, estimate_noise, smooth

Floats = NDArray[np.float64]
SLOWEST_BEND = 0.3
"""Below this speed the direction of noisy positions says nothing about a bend [m/s]."""


@dataclass(frozen=True)
class PlaneMotion:
    """(N,) each: speed, acceleration along the path, their standard deviations, heading [rad], curvature [1/m], way [m]."""

    speed: Floats
    acceleration: Floats
    speed_sd: Floats
    acceleration_sd: Floats
    heading: Floats
    curvature: Floats
    way: Floats


def plane_motion(
    t: Floats, x: Floats, y: Floats, rest: NDArray[np.bool_], link: NDArray[np.uint8]
) -> PlaneMotion:
    """Smooth the positions in the plane; the noise is measured on both axes together, so turning the frame changes nothing."""
    nan = np.full(len(t), np.nan)
    link = np.where(link == 1, 0, link).astype(np.uint8)  # the plane knows no jumps of a path coordinate
    east, north = Observed(t, x, nan, rest, link), Observed(t, y, nan, rest, link)
    both = Observed(
        np.concatenate([t, t]), np.concatenate([x, y]), np.concatenate([nan, nan]), np.concatenate([rest, rest]),
        np.concatenate([link, _broken(link)]),
    )  # fmt: skip
    noise = estimate_noise(both, Noise(jerk=0.3, position=0.5))
    (mx, cov), (my, _) = smooth(east, noise), smooth(north, noise)
    vx, vy, ax, ay = mx[:, 1], my[:, 1], mx[:, 2], my[:, 2]
    speed = np.hypot(vx, vy)
    # the length of a noisy vector is too long: its mean square exceeds the true one by both variances
    fair = np.sqrt(np.maximum(speed**2 - 2.0 * cov[:, 3], 0.0))
    safe = np.maximum(speed, 1e-9)
    along = np.where(speed > 1e-9, (vx * ax + vy * ay) / safe, 0.0)
    bend = np.where(speed > SLOWEST_BEND, (vx * ay - vy * ax) / np.maximum(speed, SLOWEST_BEND) ** 3, 0.0)
    heading = _held_heading(vx, vy, speed)
    step = np.hypot(np.diff(mx[:, 0], prepend=mx[:1, 0]), np.diff(my[:, 0], prepend=my[:1, 0]))
    step[link == 2] = 0.0
    sd_v, sd_a = np.sqrt(np.maximum(cov[:, 3], 0.0)), np.sqrt(np.maximum(cov[:, 5], 0.0))
    return PlaneMotion(fair, along, sd_v, sd_a, heading, np.clip(bend, -1.0, 1.0), np.cumsum(step))


def _broken(link: NDArray[np.uint8]) -> NDArray[np.uint8]:
    out = link.copy()
    out[:1] = 2
    return out


def _held_heading(vx: Floats, vy: Floats, speed: Floats) -> Floats:
    """Direction of motion; at a standstill that of the last motion, at first that of the next."""
    moving = np.flatnonzero(speed > 0.2)
    if not len(moving):
        return np.zeros(len(speed))
    last = np.maximum(np.searchsorted(moving, np.arange(len(speed)), side="right") - 1, 0)
    return np.asarray(np.arctan2(vy, vx)[moving[last]])

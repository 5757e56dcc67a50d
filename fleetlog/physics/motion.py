"""From a log to motion: speed, acceleration, slope, curvature and lifting speed, with their uncertainty.

Speed and acceleration come from a fixed-interval (Rauch-Tung-Striebel) smoother of the way travelled, never from differences of
positions.  Stated noise: positions and the log's speed carry white noise, the acceleration is a random walk (white
jerk); the three strengths are measured on the log itself (:mod:`fleetlog.physics.smooth.noise`).  On the map the way is the
one along the matched edges; off it both axes are smoothed in the plane.  At a standstill speed and acceleration are observed to
be zero.  A silence of the log ends a stretch: no sample stands for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.motion import Motion
from fleetlog.core.network import Network
from fleetlog.core.trajectory import Trajectory
from fleetlog.errors import DataError
from fleetlog.physics.refine import refined
from fleetlog.physics.smooth.channels import fork_motion, measured_power, payload, slope_from_height
from fleetlog.physics.smooth.noise import Noise, Observed, estimate_noise, smooth
from fleetlog.physics.smooth.path import MapPath, map_curvature, map_path
from fleetlog.physics.smooth.plane import PlaneMotion, plane_motion

Floats = NDArray[np.float64]
Index = NDArray[np.int32]

SHORTEST_GAP = 10.0
"""A silence of this and of five usual intervals ends a stretch [s]."""
STANDING_SPEED = 0.05
"""Below this the log's speed is a standstill [m/s]."""

UNSURE_END = 1.5
"""Both ends of a standstill that only positions show are left to the smoother for this long [s]."""


@dataclass(frozen=True)
class SmoothMotion:
    """A motion and how well it is known: (N,) standard deviations of speed [m/s] and acceleration [m/s2], the noise found."""

    motion: Motion
    speed_sd: Floats
    acceleration_sd: Floats
    noise: Noise


def motion_from_trajectory(
    trajectory: Trajectory, network: Network | None = None, *, rate: float | None = None
) -> Motion:
    """The motion in a log; see :func:`smooth_motion`.

    ``rate`` [Hz]: denser rows are thinned to it before smoothing, sparser ones subdivided after it.
    """
    if rate is not None and len(trajectory) > 1:
        trajectory = _thinned(trajectory, rate)
    motion = smooth_motion(trajectory, network).motion
    if rate is None or not (motion.dt > 0.0).any():
        return motion
    steps = int(np.ceil(rate * float(np.median(motion.dt[motion.dt > 0.0])) - 0.01))
    return refined(motion, steps)[0] if steps > 1 else motion


def smooth_motion(
    trajectory: Trajectory, network: Network | None = None, noise: Noise | None = None
) -> SmoothMotion:
    """Smooth a log of one vehicle.

    Parameters
    ----------
    trajectory : with x and y, or speed; ``edge_id`` and ``edge_offset`` where it was matched.
    network : that it was matched to; without it the positions are smoothed in the plane.
    noise : of the smoother, measured on the log by default.

    Raises
    ------
    DataError
        where the log has neither positions nor speeds.
    """
    t = trajectory.seconds()
    n = len(t)
    if n == 0:
        return SmoothMotion(Motion.of(0), np.zeros(0), np.zeros(0), noise or Noise())
    x, y = _filled(t, trajectory.floats("x")), _filled(t, trajectory.floats("y"))
    log_speed = trajectory.floats("speed")
    if not np.isfinite(x).any() and not np.isfinite(log_speed).any():
        raise DataError(
            f"vehicle {trajectory.vehicle_id} has neither positions nor speeds",
            do="map one of them in a profile",
        )
    if not trajectory.has("x"):
        x, y = np.zeros(n), np.zeros(n)
    link = np.zeros(n, np.uint8)
    link[0] = 2
    link[1:][np.diff(t) > max(SHORTEST_GAP, 5.0 * float(np.median(np.diff(t)))) if n > 1 else []] = 2
    breaks = link == 2
    edge, offset = _matched(trajectory, network)
    rest = _standing(t, x, y, log_speed, edge, offset, link)
    offset = np.nan_to_num(offset)
    path = None
    if network is not None and (edge >= 0).any():
        path = map_path(network, edge, offset, x, y, link)
    seen = np.full(n, np.nan) if path is None else path.seen
    off = ~np.isfinite(seen) & ~np.isfinite(log_speed)
    observed = Observed(t, seen, log_speed, rest, link)
    noise = noise or estimate_noise(observed, Noise())
    mean, cov = smooth(observed, noise)
    speed, acceleration = np.maximum(mean[:, 1], 0.0), mean[:, 2]
    speed_sd, acceleration_sd = np.sqrt(np.maximum(cov[:, 3], 0.0)), np.sqrt(np.maximum(cov[:, 5], 0.0))
    plane = plane_motion(t, x, y, rest, link) if (edge < 0).any() and trajectory.has("x") else None
    if plane is not None and off.any():
        speed, acceleration = (
            np.where(off, plane.speed, speed),
            np.where(off, plane.acceleration, acceleration),
        )
        speed_sd, acceleration_sd = (
            np.where(off, plane.speed_sd, speed_sd),
            np.where(off, plane.acceleration_sd, acceleration_sd),
        )
    speed, acceleration = np.where(rest, 0.0, speed), np.where(rest, 0.0, acceleration)
    heading, curvature = _shape(network, edge, offset, path, plane)
    height, lift_speed = fork_motion(t, trajectory, breaks)
    dt = sample_spans(t, breaks)
    slope = _slope(trajectory, network, path, np.cumsum(speed * dt), breaks)
    motion = Motion(
        time=t, dt=dt, speed=speed, acceleration=acceleration, slope=slope, curvature=curvature, heading=heading,
        payload=payload(t, trajectory), lift_speed=lift_speed, fork_height=height, x=x, y=y, edge=edge, edge_offset=offset,
        ambient_temperature=trajectory.floats("ambient_temperature"), soc=trajectory.floats("soc"),
        vehicle=np.zeros(n, np.int64), trip=trajectory.trip_ids(), power=measured_power(trajectory),
    )  # fmt: skip
    return SmoothMotion(motion, speed_sd, acceleration_sd, noise)


def sample_spans(t: Floats, breaks: NDArray[np.bool_]) -> Floats:
    """(N,) seconds that each sample stands for: half-way to its neighbours, nothing across a break (the trapezoid rule)."""
    step = np.where(breaks[1:], 0.0, np.diff(t))
    return np.asarray(0.5 * (np.append(step, 0.0) + np.append(0.0, step)))


def _thinned(trajectory: Trajectory, rate: float) -> Trajectory:
    """At most one row in each 1 / ``rate`` seconds."""
    slot = np.floor(trajectory.seconds() * rate + 0.5).astype(np.int64)
    keep = np.diff(slot, prepend=slot[:1] - 1) > 0
    return trajectory if keep.all() else trajectory[keep]


def _filled(t: Floats, value: Floats) -> Floats:
    """Unknown values interpolated; all NaN stays."""
    known = np.isfinite(value)
    return value if known.all() or not known.any() else np.interp(t, t[known], value[known])


def _matched(trajectory: Trajectory, network: Network | None) -> tuple[Index, Floats]:
    if network is None:
        return np.full(len(trajectory), -1, np.int32), np.full(len(trajectory), np.nan)
    edge = trajectory.labels("edge_id").recode(network.index).astype(np.int32)
    offset = trajectory.floats("edge_offset")
    return np.where(np.isfinite(offset), edge, -1).astype(np.int32), offset


def _standing(
    t: Floats, x: Floats, y: Floats, speed: Floats, edge: Index, offset: Floats, link: NDArray[np.uint8]
) -> NDArray[np.bool_]:
    """Rows of a standstill: the log's speed says so, else the match put them on one spot, else the positions stay."""
    from fleetlog.physics.smooth.kernels import stays

    known = np.isfinite(speed)
    rest = known & (speed < STANDING_SPEED)
    if known.all():
        return rest
    equal = (np.diff(edge) == 0) & (np.diff(offset) == 0.0) & (link[1:] != 2)
    same = np.append(equal, False) | np.append(False, equal)
    noise = _position_noise(x, y)
    by_place = stays(t, x, y, link, 3.0 * noise + 0.1, max(5.0, 12.0 * noise))
    found = _inner(t, np.where(edge >= 0, same, by_place))
    return np.where(known, rest, found)


def _inner(t: Floats, rest: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Standstills without their ends: positions cannot tell the last creeping metre from standing."""
    change = np.flatnonzero(np.diff(np.concatenate([[False], rest, [False]]).astype(np.int8)))
    inner = np.zeros(len(rest), np.bool_)
    for begin, end in zip(change[::2].tolist(), change[1::2].tolist(), strict=True):
        margin = min(UNSURE_END, 0.3 * (t[end - 1] - t[begin]))
        lo, hi = np.searchsorted(t, [t[begin] + margin - 1e-6, t[end - 1] - margin + 1e-6])
        inner[lo:hi] = True
    return inner & rest


def _position_noise(x: Floats, y: Floats) -> float:
    """Spread of the noise from row to row, from third differences [m]."""
    third = np.hypot(np.diff(x, 3), np.diff(y, 3))
    # the median of a two-dimensional normal length is 1.1774 sigma
    return float(np.clip(np.median(third) / 1.1774 / np.sqrt(20.0), 0.01, 5.0)) if len(third) > 2 else 0.5


def _shape(
    network: Network | None, edge: Index, offset: Floats, path: MapPath | None, plane: PlaneMotion | None
) -> tuple[Floats, Floats]:
    """Heading [rad] and curvature [1/m]: of the map where it is matched, of the smooth curve elsewhere."""
    if network is None or path is None:
        nothing = np.zeros(len(edge))
        return (plane.heading, plane.curvature) if plane is not None else (nothing, nothing.copy())
    curvature = map_curvature(network, edge, offset, path.way)
    if plane is None:
        return path.heading, curvature
    on = edge >= 0
    return np.where(on, path.heading, plane.heading), np.where(on, curvature, plane.curvature)


def _slope(
    trajectory: Trajectory,
    network: Network | None,
    path: MapPath | None,
    way: Floats,
    breaks: NDArray[np.bool_],
) -> Floats:
    """Slope of the map where it has heights, else from the log's own heights, else 0."""
    if network is not None and path is not None and network.has_elevation:
        return path.slope
    return (
        slope_from_height(way, trajectory.floats("z"), breaks) if trajectory.has("z") else np.zeros(len(way))
    )

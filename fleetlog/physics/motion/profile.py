"""How fast a driver takes a path.

Limits, turns, setting off and braking, as a profile of speed over distance.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fleetlog.core.truck import Truck

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class SpeedProfile:
    """Speed and time along a path.

    Attributes
    ----------
    distance : (N,) nodes along the path [m], growing.
    speed : (N,) [m/s] at the nodes; its square is linear in between.
    time : (N,) arrival [s] after setting off at node 0;  wait : (N,) [s] standing at the node before
        going on.
    """

    distance: Floats
    speed: Floats
    time: Floats
    wait: Floats

    @property
    def duration(self) -> float:
        """Time to the last node, its own wait left out [s]."""
        return float(self.time[-1])

    def at(self, time: ArrayLike) -> tuple[Floats, Floats, Floats]:
        """Distance [m], speed [m/s] and acceleration [m/s2] at (M,) times [s] after setting off.

        At rest outside.
        """
        t = np.asarray(time, dtype=np.float64)
        leave = self.time + self.wait
        i = np.clip(np.searchsorted(leave, t, side="right") - 1, 0, max(len(leave) - 2, 0))
        span = self.time[i + 1] - leave[i]
        since = np.clip(t - leave[i], 0.0, span)
        v0, v1 = self.speed[i], self.speed[i + 1]
        a = np.where(span > 0.0, (v1 - v0) / np.maximum(span, 1e-12), 0.0)
        s = self.distance[i] + v0 * since + 0.5 * a * since**2
        moving = (t >= leave[i]) & (t < self.time[i + 1])
        ends = np.where(t < leave[i], v0, v1)
        speed = np.where(moving, v0 + a * since, np.where(span > 0.0, ends, v0))
        rest = (t < leave[0]) | (t > self.time[-1])
        return s, np.where(rest, 0.0, speed), np.where(moving & ~rest, a, 0.0)


def nodal(values: ArrayLike, n: int) -> Floats:
    """(N,) values at the nodes.

    Of (N - 1,) values of the stretches between them the lower of the two that meet there.
    """
    given = np.asarray(values, dtype=np.float64)
    if given.shape != (n - 1,):
        return np.broadcast_to(given, (n,)).astype(np.float64)
    out = np.empty(n)
    out[0], out[-1] = given[0], given[-1]
    out[1:-1] = np.minimum(given[:-1], given[1:])
    return out


def speed_cap(limit: ArrayLike, curvature: ArrayLike, truck: Truck, n: int) -> Floats:
    """(N,) highest speed [m/s] that limit (NaN: none), truck and turns allow, acceleration left aside.

    A driver uses ``speed_factor`` of a limit; a turn is taken at sqrt(a_lat / |curvature|).
    """
    drive = truck.drive
    sign = np.nan_to_num(np.asarray(limit, dtype=np.float64), nan=np.inf)
    bend = np.abs(np.asarray(curvature, dtype=np.float64))
    turn = np.sqrt(drive.max_lateral_acceleration / np.maximum(bend, 1e-9))
    allowed = np.minimum(nodal(sign * drive.speed_factor, n), nodal(turn, n))
    return np.minimum(allowed, drive.max_speed)


def speed_profile(
    distance: ArrayLike,
    limit: ArrayLike,
    truck: Truck,
    *,
    curvature: ArrayLike = 0.0,
    slope: ArrayLike = 0.0,
    payload: ArrayLike = 0.0,
    stops: Mapping[int, float] | None = None,
    extra: ArrayLike = np.inf,
    start_speed: float = 0.0,
    end_speed: float = 0.0,
) -> SpeedProfile:
    """The quickest drive along a path that keeps every limit.

    Parameters
    ----------
    distance : (N,) nodes along the path [m], growing; N >= 2.  Half a metre apart is fine enough.
    limit : speed limit [m/s], NaN where there is none: one number, (N,) at the nodes or (N - 1,)
        between them.
    truck : limits of speed, acceleration, braking, lateral acceleration and power.
    curvature : 1/m, like ``limit``;  slope : rad, uphill positive, (N,) or one;  payload : kg, (N,) or one.
    stops : node index to seconds of standing there.
    extra : a further cap [m/s], like ``limit`` but taken as it is (terms that act on speed:
        :func:`fleetlog.physics.power.allowed_speed`).
    start_speed, end_speed : m/s at the ends.

    Notes
    -----
    Time-optimal along a fixed path: one pass forward under acceleration, one backward under braking
    (Bobrow, Dubowsky and Gibson 1985).  Gathering speed is limited by max_power at the wheel less rolling
    and slope; braking is not.
    """
    from fleetlog.physics.motion.kernels.profile import clock, passes

    s = np.ascontiguousarray(distance, dtype=np.float64)
    n, drive = len(s), truck.drive
    cap = np.minimum(speed_cap(limit, curvature, truck, n), nodal(extra, n))
    wait = np.zeros(n)
    for node, seconds in (stops or {}).items():
        cap[node], wait[node] = 0.0, seconds
    cap[0], cap[-1] = min(cap[0], start_speed), min(cap[-1], end_speed)
    mass = truck.chassis.mass + np.broadcast_to(np.asarray(payload, dtype=np.float64), (n,))
    lean = np.ascontiguousarray(np.broadcast_to(np.asarray(slope, dtype=np.float64), (n,)))
    up, down = drive.max_acceleration, drive.max_deceleration
    speed = passes(
        s, cap, lean, np.ascontiguousarray(mass), up, down, drive.max_power, truck.resistance.rolling
    )
    return SpeedProfile(s, speed, clock(s, speed, wait, up, down), wait)

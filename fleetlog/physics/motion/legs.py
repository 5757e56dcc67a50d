"""Legs: what a truck drives from one standstill to the next, as nodes along its path; and how fast it can."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from fleetlog.core.arrays import Floats, Ints, Mask
from fleetlog.core.motion import Motion, join
from fleetlog.core.site import Site
from fleetlog.physics.motion.reconstruction import Reconstruction
from fleetlog.physics.power import Physics, allowed_speed

STEP = 0.5  # Between the nodes of a leg, at most [m]
BRIEFEST = 0.5  # A shorter standstill is the doubt about a slow moment, not a stop [s]
SHORTEST = 0.5  # A shorter leg is the doubt about a standstill [m]
SLOWEST = 0.05  # Speed that every limit leaves [m/s]


@dataclass(frozen=True)
class Leg:
    """N nodes along a path."""

    distance: Floats  # (N,) from the first node [m], growing
    path: Motion  # (N,) with ``time`` [s] and ``speed`` as they were driven; ``dt`` is nothing here
    row: Ints  # (N,) of the log at each node
    wait: float  # Seconds of standing at the last node; NaN where the log does not show the end of it
    whole: bool  # Whether the truck stood before and after, and the log was never silent between
    stops: dict[int, float]  # Node to seconds of standing there on the way, where legs were joined

    @property
    def trip(self) -> int:
        """The trip that it belongs to: a truck may set off just before the first row of it."""
        return int(self.path.trip[len(self.path) // 2])

    @property
    def duration(self) -> float:
        """Seconds from setting off to arriving, stops on the way included."""
        return float(self.path.time[-1] - self.path.time[0])

    def at(self, s: Floats) -> Motion:
        """Place and shape of the path at (M,) distances; standing."""
        near = np.clip(np.searchsorted(self.distance, s, side="right") - 1, 0, len(self.distance) - 1)
        ahead = np.clip(s, 0.0, self.distance[-1]) - self.distance[near]
        return _resampled(self.path, near, s, self.distance, ahead)


def _resampled(path: Motion, near: Ints, s: Floats, knots: Floats, ahead: Floats) -> Motion:
    """A path at (M,) distances: its samples ``near``, their places interpolated between the (N,) ``knots``
    and moved ``ahead`` on their edges [m]."""
    shape = {name: np.interp(s, knots, getattr(path, name)) for name in ("x", "y", "curvature")}
    shape["heading"] = np.interp(s, knots, np.unwrap(path.heading))
    offset = path.edge_offset[near] + np.where(path.edge[near] >= 0, ahead, 0.0)
    return path[near].replaced(**shape, edge_offset=np.maximum(offset, 0.0))


@dataclass(frozen=True)
class SpeedProfile:
    """Speed and time at the (N,) nodes of a path."""

    distance: Floats  # Along the path [m], growing
    speed: Floats  # [m/s]; its square is linear in between
    time: Floats  # Arrival [s] after setting off at node 0
    wait: Floats  # Standing before going on [s]

    @property
    def duration(self) -> float:
        """Time to the last node, its own wait left out [s]."""
        return float(self.time[-1])

    def at(self, time: ArrayLike) -> tuple[Floats, Floats, Floats]:
        """Distance [m], speed [m/s], acceleration [m/s2] at (M,) times [s] from setting off; else at rest."""
        t, leave = np.asarray(time, dtype=np.float64), self.time + self.wait
        i = np.clip(np.searchsorted(leave, t, side="right") - 1, 0, max(len(leave) - 2, 0))
        span = self.time[i + 1] - leave[i]
        since = np.clip(t - leave[i], 0.0, span)
        v0, v1 = self.speed[i], self.speed[i + 1]
        a = np.where(span > 0.0, (v1 - v0) / np.maximum(span, 1e-12), 0.0)
        s = self.distance[i] + v0 * since + 0.5 * a * since**2
        moving = (t >= leave[i]) & (t < self.time[i + 1])
        ends = np.where((t < leave[i]) | (span <= 0.0), v0, v1)
        rest = (t < leave[0]) | (t > self.time[-1])
        speed = np.where(moving, v0 + a * since, ends)
        return s, np.where(rest, 0.0, speed), np.where(moving & ~rest, a, 0.0)


def legs(found: Reconstruction) -> list[Leg]:
    """The legs of one vehicle in order of time, each within one stretch of the log."""
    if not len(m := found.motion):
        return []
    # Moments of neighbours are no farther apart than both last, but across a silence.
    gap = np.append(False, np.diff(m.time) > m.dt[1:] + m.dt[:-1] + 1e-3)
    moving = ~found.standing
    begin = _changes(moving, gap)
    # A standstill shorter than ``BRIEFEST`` within a drive counts as driving.
    brief = (np.add.reduceat(m.dt, begin) < BRIEFEST) & ~gap[begin]
    brief[[0, -1]] = False
    moving = np.repeat(moving[begin] | brief, np.diff(begin, append=len(m)))
    begin = _changes(moving, gap)
    lasts, piece = np.add.reduceat(m.dt, begin), np.cumsum(gap)[begin]
    out = []
    for k in np.flatnonzero(moving[begin]).tolist():
        # What lies before, behind and behind that, in the same stretch of the log.
        stood, stands, goes_on = (0 <= j < len(begin) and piece[j] == piece[k] for j in (k - 1, k + 1, k + 2))
        wait = float(lasts[k + 1]) if stands and goes_on else np.nan
        end = begin[k + 1] if k + 1 < len(begin) else len(m)
        out.append(_leg(found, slice(begin[k], end), wait, bool(stood and stands)))
    return [leg for leg in out if leg is not None]


def _changes(moving: Mask, gap: Mask) -> Ints:
    """Where driving, standing or another stretch begins."""
    return np.flatnonzero(np.append(True, (moving[1:] != moving[:-1]) | gap[1:]))


def _leg(found: Reconstruction, samples: slice, wait: float, whole: bool) -> Leg | None:
    m = found.motion[samples]
    step = m.speed * m.dt
    if (length := float(step.sum())) < SHORTEST:
        return None
    ends = np.append(0.0, np.cumsum(step))
    clock = np.append(m.time[0] - 0.5 * m.dt[0], m.time + 0.5 * m.dt)
    n = int(np.ceil(length / STEP)) + 1
    s = np.linspace(0.0, length, n)
    middle = 0.5 * (ends[1:] + ends[:-1])
    near = np.minimum(np.searchsorted(ends[1:], s), len(m) - 1)
    knots = middle + 1e-9 * np.arange(len(m))
    path = _resampled(m, near, s, knots, s - middle[near]).replaced(
        time=np.interp(s, ends + 1e-9 * np.arange(len(ends)), clock), dt=np.zeros(n),
        speed=np.interp(s, knots, m.speed), slope=np.interp(s, knots, m.slope), acceleration=np.zeros(n),
        lift_speed=np.zeros(n),
    )  # fmt: skip
    return Leg(s, path, found.row[samples][near], wait, whole, {})


def joined(parts: list[Leg]) -> Leg:
    """Legs one after the other, with their standstills as stops on the way."""
    if len(parts) == 1:
        return parts[0]
    begin = np.cumsum([0, *(len(p.distance) for p in parts)])
    base = np.cumsum([0.0, *(p.distance[-1] + 1e-6 for p in parts)])
    stood = (float(after.path.time[0] - p.path.time[-1]) for p, after in pairwise(parts))
    stops = dict(zip((begin[1:-1] - 1).tolist(), stood, strict=True))
    return Leg(
        np.concatenate([p.distance + b for p, b in zip(parts, base, strict=False)]),
        join([p.path for p in parts]),
        np.concatenate([p.row for p in parts]), parts[-1].wait, all(p.whole for p in parts), stops,
    )  # fmt: skip


def speed_limits(site: Site, path: Motion) -> Floats:
    """(N,) limit [m/s] of roads and zones along a path, inf for none; where roads meet the lower holds."""
    limit = np.full(len(path), np.inf)
    if site.network is not None:
        signs = site.network.speed_limit
        limit = np.append(np.where(np.isfinite(signs), signs, np.inf), np.inf)[path.edge]  # -1 is the last
        limit = np.minimum(limit, np.append(limit[:1], limit[:-1]))
    return np.asarray(np.minimum(limit, site.zone_limit(path.x, path.y)))


def free_flow(leg: Leg, physics: Physics, limit: Floats) -> SpeedProfile:
    """The quickest drive of a leg from rest to rest that keeps every limit, alone on its path.

    ``limit`` (N,) [m/s], inf where there is none; a driver uses the truck's ``speed_factor`` of it.  Terms
    that act on speed count, and stops on the way.

    Time-optimal along a fixed path: one pass forward under acceleration, one backward under braking (Bobrow,
    Dubowsky and Gibson 1985).  Gathering speed is limited by max_power at the wheel less rolling and slope;
    braking is not."""
    path, rest, wait = leg.path.replaced(speed=limit), np.zeros(len(limit), bool), np.zeros(len(limit))
    for node, seconds in leg.stops.items():
        rest[node], wait[node] = True, seconds
    at, waits = standing_still(path, physics)
    rest[at], wait[at] = True, waits
    rest[[0, -1]] = True
    speed, time, _ = quickest(leg.distance, path, physics, rest, wait)
    return SpeedProfile(leg.distance, speed, time, wait)


def standing_still(path: Motion, physics: Physics) -> tuple[Ints, Floats]:
    """The nodes of a path where trucks stand by terms that act as a wait, in the middle of each stretch that
    one of them has a time for; and how long [s]."""
    seconds = np.zeros(len(path))
    for stands in (field.along(path, 0.0) for field in physics.waits):
        first, end = np.flatnonzero(np.diff(stands > 0.0, prepend=False, append=False)).reshape(-1, 2).T
        seconds[(first + end - 1) // 2] += stands[(first + end - 1) // 2]
    node = np.flatnonzero(seconds)
    return node, seconds[node]


def quickest(
    distance: Floats, path: Motion, physics: Physics, rest: Mask, wait: Floats
) -> tuple[Floats, Floats, Floats]:
    """(N,) speeds [m/s], arrival times [s] and the speeds that are allowed on a path, where ``path.speed`` is
    the limit; a truck stops where it is at ``rest``, and stands for ``wait`` [s]."""
    from fleetlog.physics import kernels

    truck = physics.actual_truck
    drive = truck.drive
    allowed = np.minimum(path.speed * drive.speed_factor, drive.max_speed)
    cap = np.clip(allowed_speed(path.replaced(speed=allowed), physics), SLOWEST, drive.max_speed)
    up, down = drive.max_acceleration, drive.max_deceleration
    mass, slope = truck.chassis.mass + path.payload.astype(float), path.slope.astype(float)
    most = np.where(rest, 0.0, cap).astype(float)
    power, rolling = drive.max_power, truck.resistance.rolling
    return *kernels.quickest(distance, most, slope, mass, wait, up, down, power, rolling), cap

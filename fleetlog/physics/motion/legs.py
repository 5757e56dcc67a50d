"""Legs: what a truck drives from one standstill to the next, as nodes along its path."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.motion import Motion, join
from fleetlog.core.site import Site
from fleetlog.physics.motion.profile import SpeedProfile, speed_profile
from fleetlog.physics.motion.reconstruction import Reconstruction
from fleetlog.physics.power import Physics, allowed_speed

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
STEP = 0.5
"""Between the nodes of a leg, at most [m]."""
BRIEFEST = 0.5
"""A shorter standstill is the doubt about a slow moment, not a stop [s]."""
SHORTEST = 0.5
"""A shorter leg is the doubt about a standstill [m]."""


@dataclass(frozen=True)
class Leg:
    """N nodes along a path.

    Attributes
    ----------
    distance : (N,) from the first node [m], growing.
    path : (N,) the motion there: ``time`` [s] and ``speed`` as they were driven; ``dt`` is nothing here.
    row : (N,) row of the log at each node.
    wait : seconds of standing at the last node; NaN where the log does not show the end of it.
    whole : whether the truck stood before and after, and the log was never silent between.
    stops : node index to seconds of standing there on the way, where legs were joined.
    """

    distance: Floats
    path: Motion
    row: Ints
    wait: float
    whole: bool
    stops: dict[int, float]

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
        out = self.path[near]

        def along(values: Floats) -> Floats:
            return np.asarray(np.interp(s, self.distance, values))

        ahead = np.where(out.edge >= 0, np.clip(s, 0.0, self.distance[-1]) - self.distance[near], 0.0)
        return out.replaced(
            x=along(self.path.x), y=along(self.path.y), heading=along(np.unwrap(self.path.heading)),
            curvature=along(self.path.curvature), edge_offset=out.edge_offset + ahead,
        )  # fmt: skip


def legs(found: Reconstruction) -> list[Leg]:
    """The legs of one vehicle in order of time, each within one stretch of the log."""
    m = found.motion
    if not len(m):
        return []
    # Moments of neighbours are no farther apart than both last, but across a silence.
    gap = np.append(False, np.diff(m.time) > m.dt[1:] + m.dt[:-1] + 1e-3)
    runs = _runs(m, _brief_stops_driven(m, ~found.standing, gap), gap)
    return [leg for leg in (_leg(found, *run) for run in runs) if leg is not None]


def _brief_stops_driven(m: Motion, moving: NDArray[np.bool_], gap: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """``moving`` with standstills shorter than ``BRIEFEST`` counted as driving."""
    begin = np.flatnonzero(np.append(True, (np.diff(moving.astype(np.int8)) != 0) | gap[1:]))
    lasts = np.add.reduceat(m.dt, begin)
    inner = np.ones(len(begin), bool)
    inner[[0, -1]] = False
    kept = moving[begin] | ((lasts < BRIEFEST) & inner & ~gap[begin])
    return np.repeat(kept, np.diff(np.append(begin, len(moving))))


def _runs(m: Motion, moving: NDArray[np.bool_], gap: NDArray[np.bool_]) -> list[tuple[int, int, float, bool]]:
    """Every drive: its first sample and the one behind its last, and what is known of its ends.

    Seconds of the standstill after it (NaN unknown), and whether both ends are standstills.
    """
    piece = np.cumsum(gap)
    new = np.append(True, (np.diff(moving.astype(np.int8)) != 0) | gap[1:])
    begin = np.flatnonzero(new)
    end = np.append(begin[1:], len(m))
    lasts = np.add.reduceat(m.dt, begin)
    out = []
    for k in np.flatnonzero(moving[begin]).tolist():
        stood = [0 <= j < len(begin) and piece[begin[j]] == piece[begin[k]] for j in (k - 1, k + 1)]
        ended = stood[1] and k + 2 < len(begin) and piece[begin[k + 2]] == piece[begin[k]]
        out.append((int(begin[k]), int(end[k]), float(lasts[k + 1]) if ended else np.nan, all(stood)))
    return out


def _leg(found: Reconstruction, begin: int, end: int, wait: float, whole: bool) -> Leg | None:
    m = found.motion[begin:end]
    step = m.speed * m.dt
    length = float(step.sum())
    if length < SHORTEST:
        return None
    ends = np.append(0.0, np.cumsum(step))
    clock = np.append(m.time[0] - 0.5 * m.dt[0], m.time + 0.5 * m.dt)
    n = int(np.ceil(length / STEP)) + 1
    s = np.linspace(0.0, length, n)
    middle = 0.5 * (ends[1:] + ends[:-1])
    near = np.minimum(np.searchsorted(ends[1:], s), len(m) - 1)
    ahead = np.where(m.edge[near] >= 0, s - middle[near], 0.0)

    def along(values: Floats) -> Floats:
        return np.asarray(np.interp(s, middle + 1e-9 * np.arange(len(m)), values))

    path = m[near].replaced(
        time=np.interp(s, ends + 1e-9 * np.arange(len(ends)), clock), dt=np.zeros(n), speed=along(m.speed),
        curvature=along(m.curvature), heading=along(np.unwrap(m.heading)), slope=along(m.slope),
        x=along(m.x), y=along(m.y),
        edge_offset=np.maximum(m.edge_offset[near] + ahead, 0.0), acceleration=np.zeros(n),
        lift_speed=np.zeros(n),
    )  # fmt: skip
    return Leg(s, path, found.row[begin:end][near], wait, whole, {})


def joined(parts: list[Leg]) -> Leg:
    """Legs one after the other, with their standstills as stops on the way."""
    if len(parts) == 1:
        return parts[0]
    begin = np.cumsum([0, *(len(p.distance) for p in parts)])
    base = np.cumsum([0.0, *(p.distance[-1] + 1e-6 for p in parts)])
    stops = {
        int(b) - 1: float(after.path.time[0] - p.path.time[-1])
        for b, p, after in zip(begin[1:], parts, parts[1:], strict=False)
    }
    return Leg(
        np.concatenate([p.distance + b for p, b in zip(parts, base, strict=False)]),
        join([p.path for p in parts]),
        np.concatenate([p.row for p in parts]), parts[-1].wait, all(p.whole for p in parts), stops,
    )  # fmt: skip


def speed_limits(site: Site, path: Motion) -> Floats:
    """(N,) limit [m/s] of roads and zones along a path, inf where there is none.

    Where two roads meet the lower one holds.
    """
    limit = np.full(len(path), np.inf)
    if site.network is not None:
        signs = site.network.speed_limit
        limit = np.where(
            path.edge >= 0, np.where(np.isfinite(signs), signs, np.inf)[np.maximum(path.edge, 0)], np.inf
        )
        limit = np.minimum(limit, np.append(limit[:1], limit[:-1]))
    for zone in site.zones:
        if np.isfinite(zone.speed_limit):
            limit = np.where(zone.contains(path.x, path.y), np.minimum(limit, zone.speed_limit), limit)
    return limit


def free_flow(leg: Leg, physics: Physics, limit: Floats) -> SpeedProfile:
    """How a truck alone on its path drives a leg from rest to rest; terms that act on speed included.

    ``limit`` (N,) [m/s], inf where there is none; a driver uses the truck's ``speed_factor`` of it.
    """
    truck = physics.actual_truck()
    allowed = np.minimum(limit * truck.drive.speed_factor, truck.drive.max_speed)
    cap = np.maximum(allowed_speed(leg.path.replaced(speed=allowed), physics), 0.05)
    stops = dict(leg.stops)
    if "waiting" in physics.fields and "waiting" not in physics.off:
        stops.update(waits(physics.fields["waiting"].along(leg.path, 0.0)))
    return speed_profile(
        leg.distance, np.nan, truck, slope=leg.path.slope, payload=leg.path.payload, stops=stops, extra=cap
    )


def waits(seconds: Floats) -> dict[int, float]:
    """Node in the middle of every stretch with a waiting time, and that time [s]."""
    on = np.concatenate([[False], seconds > 0.0, [False]])
    edges = np.flatnonzero(np.diff(on.astype(np.int8))).reshape(-1, 2)
    return {int((a + b - 1) // 2): float(seconds[(a + b - 1) // 2]) for a, b in edges}

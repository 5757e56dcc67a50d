"""What was driven where and in which direction: metres, per square of the floor and sector of heading.

The table grows with the roads of a site, not with the length of its log.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.trajectory import Trajectory
from fleetlog.physics.motion import reconstruct

Floats = NDArray[np.float64]
SECTORS = 16
"""Sectors of heading."""
SIDE = 0.5
"""Side of a square [m]."""
LIMIT = 2.0e6
"""No coordinate of a site is larger [m]."""
DWELL = 8.0
"""Who stands longer than this manoeuvres before and after [s]."""
MANOEUVRE = 8.0
"""... for this many metres."""
ASIDE = 0.1
"""Weight of a metre of manoeuvre: it counts only where nothing else was driven."""


@dataclass(frozen=True)
class Cells:
    """What was driven (N,): ``weight`` metres, at a mean position [m] and ``heading`` [rad]."""

    x: Floats
    y: Floats
    heading: Floats
    weight: Floats

    def __len__(self) -> int:
        return len(self.x)


def moving(trajectory: Trajectory) -> tuple[Cells, float]:
    """The samples of a trajectory at which the truck moved, and the noise of its positions [m]."""
    found = reconstruct(trajectory)
    m = found.motion
    metres = np.where(found.standing, 0.0, m.speed * m.dt)
    metres *= np.where(_manoeuvres(metres, m.dt, found.standing), ASIDE, 1.0)
    keep = ~found.standing & np.isfinite(m.x) & np.isfinite(m.y) & (metres > 0.0)
    keep &= (np.abs(m.x) < LIMIT) & (np.abs(m.y) < LIMIT)
    return Cells(m.x[keep], m.y[keep], m.heading[keep], metres[keep]), float(found.noise.position)


def _manoeuvres(metres: Floats, dt: Floats, standing: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(n,) whether a sample lies within a manoeuvre of a long stand."""
    way = np.cumsum(metres)
    turn = np.flatnonzero(np.diff(standing.astype(np.int8), prepend=0, append=0)).reshape(-1, 2)
    time = np.concatenate([[0.0], np.cumsum(dt)])
    long = time[turn[:, 1]] - time[turn[:, 0]] >= DWELL
    stands = np.concatenate([[-np.inf], way[turn[long, 0]], [np.inf]])
    after = np.searchsorted(stands, way)
    before = np.maximum(after - 1, 0)
    gap = np.minimum(stands[np.minimum(after, len(stands) - 1)] - way, way - stands[before])
    return np.asarray(gap <= MANOEUVRE)


def gather(tracks: Iterable[Cells]) -> Cells:
    """The samples of all tracks, added up by square and sector."""
    keys, sums = np.zeros(0, np.int64), np.zeros((0, 5))
    width = int(2 * LIMIT / SIDE)
    for t in tracks:
        i, j = (np.floor((v + LIMIT) / SIDE).astype(np.int64) for v in (t.x, t.y))
        sector = np.floor(t.heading % (2.0 * np.pi) / (2.0 * np.pi) * SECTORS).astype(np.int64) % SECTORS
        keys, of = np.unique(np.append(keys, (i * width + j) * SECTORS + sector), return_inverse=True)
        own = [t.weight * v for v in (1.0, t.x, t.y, np.cos(t.heading), np.sin(t.heading))]
        rows = np.concatenate([sums, np.column_stack(own)])
        sums = np.column_stack([np.bincount(of, column, len(keys)) for column in rows.T])
    weight, x, y, cos, sin = sums.T
    return Cells(x / weight, y / weight, np.arctan2(sin, cos), weight)

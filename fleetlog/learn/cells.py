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
Ints = NDArray[np.int64]
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
    """Driven squares (N,): ``weight`` metres driven, at the mean position [m] and ``heading`` [rad]."""

    x: Floats
    y: Floats
    heading: Floats
    weight: Floats

    def __len__(self) -> int:
        return len(self.x)


@dataclass(frozen=True)
class Track:
    """Where one truck moved: (n,) time [s], place [m], heading [rad], metres driven, speed [m/s]."""

    time: Floats
    x: Floats
    y: Floats
    heading: Floats
    metres: Floats
    speed: Floats


def moving(trajectory: Trajectory) -> tuple[Track, float]:
    """The samples of a trajectory at which the truck moved, and the noise of its positions [m]."""
    found = reconstruct(trajectory)
    m = found.motion
    metres = np.where(found.standing, 0.0, m.speed * m.dt)
    metres *= np.where(_manoeuvres(metres, m.dt, found.standing), ASIDE, 1.0)
    keep = ~found.standing & np.isfinite(m.x) & np.isfinite(m.y) & (metres > 0.0)
    keep &= (np.abs(m.x) < LIMIT) & (np.abs(m.y) < LIMIT)
    columns = (m.time, m.x, m.y, m.heading, metres, m.speed)
    return Track(*(c[keep] for c in columns)), float(found.noise.position)


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


def gather(tracks: Iterable[Track]) -> Cells:
    """The cells of all tracks."""
    keys, sums = np.zeros(0, np.int64), np.zeros((0, 5))
    for track in tracks:
        keys, sums = _summed(np.append(keys, _keys(track)), np.concatenate([sums, _moments(track)]))
    weight = sums[:, 0]
    x, y = sums[:, 1] / weight, sums[:, 2] / weight
    return Cells(x, y, np.arctan2(sums[:, 4], sums[:, 3]), weight)


def _keys(track: Track) -> Ints:
    """(n,) number of the square and sector of each sample."""
    width = int(2 * LIMIT / SIDE)
    i, j = (np.floor((v + LIMIT) / SIDE).astype(np.int64) for v in (track.x, track.y))
    sector = np.floor(track.heading % (2.0 * np.pi) / (2.0 * np.pi) * SECTORS).astype(np.int64) % SECTORS
    return np.asarray((i * width + j) * SECTORS + sector, dtype=np.int64)


def _moments(t: Track) -> Floats:
    w = t.metres
    return np.column_stack([w, w * t.x, w * t.y, w * np.cos(t.heading), w * np.sin(t.heading)])


def _summed(keys: Ints, sums: Floats) -> tuple[Ints, Floats]:
    """Rows of the same key added."""
    names, of = np.unique(keys, return_inverse=True)
    return names, np.column_stack([np.bincount(of, column, len(names)) for column in sums.T])

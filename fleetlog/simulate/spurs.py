"""The short ways between lanes and the ground beside the road, drawn as curves."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from fleetlog.core.site import Place
from fleetlog.simulate.arrays import Floats
from fleetlog.simulate.junctions import START, Junctions
from fleetlog.simulate.paths import even, joined
from fleetlog.simulate.track import SPACING, Track

SHARES = (1.0, 0.7, 0.5)
"""Of the turn radius that the way into a bay is tried with, in this order; a truck creeps in there."""
EDGE = 0.25
"""Kept to the ends of a lane without a safe part [m]."""
DEEPEST = 25.0
"""A bay farther than this from the opposite lane has no way from there [m]."""


@dataclass(frozen=True)
class Bay:
    """A spot for one truck.

    ``lane`` is where its spur leaves at offset ``at`` [m]; ``path`` (n, 4) x, y, heading, curvature from
    there into the bay, ``length`` [m]; ``ahead`` [m] is how far past ``at`` a truck on the spur can be met on
    the lane.
    """

    place: Place
    lane: int
    at: float
    path: Floats
    length: float
    ahead: float


@dataclass(frozen=True)
class Door:
    """A spur between a lane and a bay, driven forwards into it and backwards out of it.

    ``bay`` is the number of its bay; lane, at, path, length, ahead as in :class:`Bay`.  It crosses lane
    ``crosses`` (-1: none): no truck there has its centre between ``low`` and ``high`` [m] meanwhile.
    """

    bay: int
    lane: int
    at: float
    path: Floats
    length: float
    ahead: float
    crosses: int = -1
    low: float = 0.0
    high: float = 0.0


def span(track: Track, j: Junctions, lane: int) -> tuple[float, float]:
    """First and last offset [m] of a lane where a truck may stand; in a single-lane aisle, alone."""
    low, high = float(j.clear[lane]), float(j.stop[lane])
    if high < low:
        low, high = EDGE, float(track.length[lane]) - EDGE
    return max(low, START), high


def opposite_spur(track: Track, j: Junctions, bay: Bay, radius: float, half_width: float) -> Door | None:
    """The spur, an arc of ``radius`` [m], from the opposite lane to a bay, its number left -1; None without room."""
    lane = int(track.network.reverse[bay.lane])
    if lane < 0:
        return None
    from fleetlog.simulate.kernels.geometry import first_before

    x, y, heading, _ = bay.path[-1]
    k, ahead, left = first_before(
        track.x, track.y, track.heading, track.first[lane], track.first[lane + 1], x, y, radius, DEEPEST
    )
    if k < 0:
        return None
    at = (k - int(track.first[lane])) * float(track.spacing[lane])
    low, high = span(track, j, lane)
    if ahead > radius + 2.0 * SPACING or abs(left) < radius or not low <= at <= high:
        return None
    toward = float(track.heading[k])
    turn = float(np.angle(np.exp(1j * (heading - toward))))
    shape, length = _bow(round(ahead, 3), round(left, 3), round(turn, 4))
    path = shape.copy()
    c, s = np.cos(toward), np.sin(toward)
    path[:, 0] = track.x[k] + c * shape[:, 0] - s * shape[:, 1]
    path[:, 1] = track.y[k] + s * shape[:, 0] + c * shape[:, 1]
    path[:, 2] += toward
    return Door(-1, lane, at, path, length, ahead + half_width)


@lru_cache(maxsize=4096)
def _bow(ahead: float, left: float, turn: float) -> tuple[Floats, float]:
    """The way from the origin along x to ``ahead``, ``left`` [m], turned by ``turn`` [rad]."""
    return even(joined(np.zeros(2), 0.0, np.array([ahead, left]), turn), 0.5 * SPACING)

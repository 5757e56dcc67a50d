"""The short ways between lanes and the ground beside the road, drawn as curves."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.site import Place
from fleetlog.simulate.junctions import Junctions
from fleetlog.simulate.paths import even, joined
from fleetlog.simulate.track import SPACING, Track

Floats = NDArray[np.float64]
SHARES = (1.0, 0.7, 0.5)
"""Of the turn radius that the way into a bay is tried with, in this order; a truck creeps in there."""
EDGE = 0.25
"""Kept to the ends of a lane without a safe part [m]."""
START = 0.2
"""At the very start of a lane a truck would have to stop before it is on it [m]."""
DEEPEST = 25.0
"""A bay farther than this from the opposite lane has no way from there [m]."""


@dataclass(frozen=True)
class Bay:
    """A spot for one truck.

    ``lane`` is where its spur leaves at offset ``at`` [m]; ``path`` (n, 4) x, y, heading, curvature from there into the bay,
    ``length`` [m]; ``ahead`` [m] is how far past ``at`` a truck on the spur can be met on the lane.
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

    ``bay`` is the number of its bay; lane, at, path, length, ahead as in :class:`Bay`.  It crosses lane ``crosses`` (-1: none):
    no truck there has its centre between ``low`` and ``high`` [m] meanwhile.
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
    """First and last offset [m] of a lane where a truck may stand; a single-lane aisle is its own who is on it."""
    low, high = float(j.clear[lane]), float(j.stop[lane])
    if high < low:
        low, high = EDGE, float(track.length[lane]) - EDGE
    return max(low, START), high


def opposite_spur(track: Track, j: Junctions, bay: Bay, radius: float, half_width: float) -> Door | None:
    """The spur from the opposite lane to the end of a bay, an arc of ``radius`` [m]; None where there is none or no room on it.

    The door's bay number is left open (-1).
    """
    lane = int(track.network.reverse[bay.lane])
    if lane < 0:
        return None
    x, y, heading, _ = bay.path[-1]
    rows = slice(track.first[lane], track.first[lane + 1])
    dx, dy = x - track.x[rows], y - track.y[rows]
    c, s = np.cos(track.heading[rows]), np.sin(track.heading[rows])
    along, aside = dx * c + dy * s, np.abs(dy * c - dx * s)
    fit = np.flatnonzero((along >= radius) & (aside < DEEPEST))
    if not len(fit):
        return None
    i = int(fit[np.argmin(along[fit])])
    at = i * float(track.spacing[lane])
    low, high = span(track, j, lane)
    if along[i] > radius + 2.0 * SPACING or aside[i] < radius or not low <= at <= high:
        return None
    k = track.first[lane] + i
    turn = float(np.angle(np.exp(1j * (heading - track.heading[k]))))
    ahead, left = float(along[i]), float((dy * c - dx * s)[i])
    shape, length = _bow(round(ahead, 3), round(left, 3), round(turn, 4))
    path = shape.copy()
    path[:, 0] = track.x[k] + c[i] * shape[:, 0] - s[i] * shape[:, 1]
    path[:, 1] = track.y[k] + s[i] * shape[:, 0] + c[i] * shape[:, 1]
    path[:, 2] += track.heading[k]
    return Door(-1, lane, at, path, length, ahead + half_width)


@lru_cache(maxsize=4096)
def _bow(ahead: float, left: float, turn: float) -> tuple[Floats, float]:
    """The way from the origin along x to a point ``ahead`` and ``left`` of it [m], turned by ``turn`` [rad]; often the same."""
    return even(joined(np.zeros(2), 0.0, np.array([ahead, left]), turn), 0.5 * SPACING)

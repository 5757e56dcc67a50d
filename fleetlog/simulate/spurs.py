"""The short ways between lanes and the ground beside the road, drawn as curves."""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from fleetlog.core.site import Place
from fleetlog.simulate.arrays import Floats
from fleetlog.simulate.junctions import START, Junctions
from fleetlog.simulate.paths import even, joined, moved
from fleetlog.simulate.track import SPACING, Track

SHARES = (1.0, 0.7, 0.5)
"""Of the turn radius that the way into a bay is tried with, in this order; a truck creeps in there."""
EDGE = 0.25
"""Kept to the ends of a lane without a safe part [m]."""
DEEPEST = 25.0
"""A bay farther than this from the opposite lane has no way from there [m]."""


@dataclass(frozen=True)
class Door:
    """A spur between a lane and a bay, driven forwards into it and backwards out of it.

    It leaves ``lane`` at ``at`` [m]; ``path`` (n, 4) x, y, heading, curvature leads from there into bay
    number ``bay``, ``length`` [m]; a truck on it can be met on the lane up to ``ahead`` [m] past ``at``.  It
    crosses lane ``crosses`` (-1: none): no truck there is between ``low`` and ``high`` [m] meanwhile.
    ``passed``: it leads to a spot along the road, where others pass who stands.
    """

    lane: int
    at: float
    path: Floats
    length: float
    ahead: float
    bay: int = -1
    crosses: int = -1
    low: float = 0.0
    high: float = 0.0
    passed: bool = False


class Bay(NamedTuple):
    """A spot for one truck, and the door on the lane beside it."""

    place: Place
    door: Door
    turns: bool = True
    """Whether trucks turn round there, if they can."""


def span(track: Track, j: Junctions, lane: int) -> tuple[float, float]:
    """First and last offset [m] of a lane where a truck may stand; in a single-lane aisle, alone."""
    low, high = float(j.clear[lane]), float(j.stop[lane])
    if high < low:
        low, high = EDGE, float(track.length[lane]) - EDGE
    return max(low, START), high


def opposite_spur(track: Track, j: Junctions, bay: Door, radius: float, half_width: float) -> Door | None:
    """The spur, an arc of ``radius`` [m], from the opposite lane to a bay; None without room."""
    lane = int(track.network.reverse[bay.lane])
    if lane < 0:
        return None
    rows = slice(track.first[lane], track.first[lane + 1])
    x, y, heading, _ = bay.path[-1]
    dx, dy, c, s = (
        x - track.x[rows],
        y - track.y[rows],
        np.cos(track.heading[rows]),
        np.sin(track.heading[rows]),
    )
    along, aside = dx * c + dy * s, dy * c - dx * s
    fits = (along >= radius) & (np.abs(aside) < DEEPEST)
    if not fits.any():
        return None
    nearest = int(np.argmin(np.where(fits, along, np.inf)))
    k, ahead, left = rows.start + nearest, float(along[nearest]), float(aside[nearest])
    at = (k - int(track.first[lane])) * float(track.spacing[lane])
    low, high = span(track, j, lane)
    if ahead > radius + 2.0 * SPACING or abs(left) < radius or not low <= at <= high:
        return None
    toward = float(track.heading[k])
    turn = float(np.angle(np.exp(1j * (heading - toward))))
    shape, length = _bow(round(ahead, 3), round(left, 3), round(turn, 4))
    path = moved(shape, track.x[k], track.y[k], toward)
    return Door(lane, at, path, length, ahead + half_width)


@lru_cache(maxsize=4096)
def _bow(ahead: float, left: float, turn: float) -> tuple[Floats, float]:
    """The way from the origin along x to ``ahead``, ``left`` [m], turned by ``turn`` [rad]."""
    return even(joined(np.zeros(2), 0.0, np.array([ahead, left]), turn), 0.5 * SPACING)

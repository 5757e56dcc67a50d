"""Places where recorded trucks stood along the road: no bay is drawn there, and others pass who stands.

A recording that shows trucks stop in the direction of the road says that there is room beside them, wherever
the map has it.  Nothing of a way into a bay is in such trips, and the simulated ones must not have it either.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fleetlog.core.truck import Truck
from fleetlog.simulate.arrays import Floats, Ints
from fleetlog.simulate.junctions import Junctions
from fleetlog.simulate.paths import even
from fleetlog.simulate.places import Stands
from fleetlog.simulate.spurs import Door, span
from fleetlog.simulate.track import SPACING, Track

ALONG = 0.7
"""A truck that stops within this of the direction of the road stands along it [rad]."""
BESIDE = 6.0
"""A spot along the road is at most this far from a lane [m]."""
LENGTH = 0.01
"""Of a spur to where a truck stands on the road [m]."""


class Stand(NamedTuple):
    """Where recorded trucks stood and how they came [m, rad]; whether they mostly turned round there."""

    x: float
    y: float
    heading: float
    turns: bool


def recorded_stands(stands: Stands, cluster: Ints, names: Sequence[str]) -> dict[str, Stand]:
    """How trucks stood at each place to which at least half of them came in one direction."""
    out = {}
    for k, name in enumerate(names):
        mine = np.flatnonzero((cluster == k) & np.isfinite(stands.into))
        into = stands.into[mine]
        alike = np.cos(into[:, None] - into) > np.cos(ALONG)
        if not len(mine) or alike.sum(axis=1).max() < 0.5 * len(mine):
            continue
        mine = mine[alike[np.argmax(alike.sum(axis=1))]]
        turn = np.cos(stands.out[mine] - stands.into[mine])
        turns = bool(np.mean(turn[np.isfinite(turn)] < 0.0) > 0.5) if np.isfinite(turn).any() else False
        x, y = np.median(stands.x[mine]), np.median(stands.y[mine])
        heading = np.angle(np.exp(1j * stands.into[mine]).mean())
        out[name] = Stand(float(x), float(y), float(heading), turns)
    return out


def door_beside(
    track: Track, junctions: Junctions, truck: Truck, stand: Stand, near: Sequence[tuple[float, int, float]]
) -> Door | None:
    """The spot on the nearest lane that leads as trucks came; None where no lane ``near`` does."""
    for gap, lane, at in near:
        if gap > BESIDE:
            break
        low, high = span(track, junctions, lane)
        k = int(track.first[lane] + round(float(np.clip(at, low, high)) / track.spacing[lane]))
        if high < low or abs(np.angle(np.exp(1j * (track.heading[k] - stand.heading)))) > ALONG:
            continue
        x, y, heading = float(track.x[k]), float(track.y[k]), float(track.heading[k])
        ahead = LENGTH * np.array([[0.0, 0.0], [np.cos(heading), np.sin(heading)]])
        path = np.column_stack([ahead + np.array([x, y]), [heading, heading], [0.0, 0.0]])
        on_lane = (k - track.first[lane]) * float(track.spacing[lane])
        return Door(lane, on_lane, path, LENGTH, 0.5 * truck.chassis.length, passed=True)
    return None


def turning_door(track: Track, junctions: Junctions, truck: Truck, own: Door) -> Door | None:
    """The half turn between where a truck stands and the opposite lane; None without one."""
    lane = int(track.network.reverse[own.lane])
    if lane < 0:
        return None
    rows, stands = slice(track.first[lane], track.first[lane + 1]), own.path[-1, :2]
    k = int(np.argmin(np.hypot(track.x[rows] - stands[0], track.y[rows] - stands[1])))
    at, (low, high) = k * float(track.spacing[lane]), span(track, junctions, lane)
    start = np.array([track.x[rows][k], track.y[rows][k]])
    side = stands - start
    if not low <= at <= high or np.hypot(*side) < 2.0 * SPACING:
        return None
    path, length = _half_turn(start, stands, float(track.heading[rows][k]))
    reach = 0.5 * (float(np.hypot(*side)) + truck.chassis.length)
    crossed = own.lane if junctions.capacity[own.lane] > 0 else -1
    return Door(
        lane, at, path, length, reach, own.bay, crossed, max(own.at - reach, 0.0), own.at + reach, passed=True
    )


def _half_turn(start: Floats, end: Floats, heading: float) -> tuple[Floats, float]:
    """The half circle from one point to another, begun along ``heading``."""
    middle, arm = 0.5 * (start + end), 0.5 * (start - end)
    left = np.array([-arm[1], arm[0]])
    sign = 1.0 if left @ (np.cos(heading), np.sin(heading)) > 0.0 else -1.0
    angle = np.linspace(0.0, np.pi, 33)[:, None]
    return even(middle + np.cos(angle) * arm + sign * np.sin(angle) * left, 0.5 * SPACING)

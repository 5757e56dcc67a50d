"""Legs: what a truck drives between two standstills, as a path on the map with the times at which it passed.

Progress along a path comes from integrated speed, scaled to the length that the map gives: far smoother than matched positions.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.network import Network
from fleetlog.core.trajectory import Trajectory
from fleetlog.discovery.bends import STEP, bends
from fleetlog.discovery.smooth import Akima

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

STANDING = 0.15
"""Below this a truck stands [m/s]."""
SHORTEST = 8.0
"""A shorter leg says nothing [m]."""
PURPOSE = 90.0
"""A longer standstill has a purpose of its own [s]."""
LOAD = 25.0
"""Change of payload [kg] that shows a purpose."""
FINE = 5
"""Points between two rows at which progress is known."""
LIFT = 0.08
"""Change of fork height [m] that shows a purpose."""


@dataclass(frozen=True)
class Leg:
    """N nodes ``STEP`` apart.

    ``edge``, ``offset`` (N,) where; ``curvature`` (N,) [1/m]; ``metres`` (N,) path driven for each metre of map (corners are
    cut); ``time`` (N,) [s] passing; ``wait`` [s] standing at the end without a purpose; ``payload`` [kg]; ``row`` (N,) the
    row of the log nearest to each node.
    """

    edge: NDArray[np.int32]
    offset: Floats
    curvature: Floats
    metres: Floats
    time: Floats
    wait: float
    payload: float
    row: Ints
    trip: int


def legs(trajectory: Trajectory, network: Network, radius: float) -> Iterator[Leg]:
    """The legs of one vehicle-day that lie on the map without a break."""
    time, speed = trajectory.seconds(0), np.nan_to_num(trajectory.floats("speed"))
    if len(time) < 10:
        return
    step = float(np.median(np.diff(time)))
    edge = trajectory.labels("edge_id").recode(network.index)
    offset = np.nan_to_num(trajectory.floats("edge_offset"))
    payload, height = (
        np.nan_to_num(trajectory.floats("payload")),
        np.nan_to_num(trajectory.floats("fork_height")),
    )
    trip = trajectory.trip_ids()
    moving = speed > STANDING
    change = np.flatnonzero(np.diff(np.concatenate([[False], moving, [False]]).astype(int)))
    for begin, end in zip(change[::2], change[1::2], strict=True):
        if begin == 0 or end >= len(time) or np.diff(time[begin - 1 : end + 1]).max() > 3.5 * step:
            continue
        path = _path(network, edge[begin:end], offset[begin:end])
        if path is None:
            continue
        wait = _wait(time, speed, payload, height, int(end), moving)
        rows = slice(int(begin) - 1, int(end) + 1)
        leg = _leg(
            network,
            path,
            time[rows],
            speed[rows],
            radius,
            wait,
            float(payload[begin]),
            int(begin) - 1,
            int(trip[begin]),
        )
        if leg is not None:
            yield leg


def _wait(
    time: Floats,
    speed: Floats,
    payload: Floats,
    height: Floats,
    end: int,
    moving: NDArray[np.bool_],
) -> float:
    """Seconds of the standstill that begins at row ``end``; 0 where it served a purpose or the log ends in it."""
    rest = np.flatnonzero(moving[end:])
    if not len(rest):
        return 0.0
    leave = end + int(rest[0])
    stood = slice(end, leave + 1)
    worked = np.ptp(payload[stood]) > LOAD or np.ptp(height[stood]) > LIFT
    long = float(time[leave] - time[end])
    # Without a mast or a scale in the log nobody knows which stop was work.
    blind = not payload.any() and not height.any()
    if worked or long > PURPOSE or blind:
        return 0.0
    return long


def _path(
    network: Network, edge: NDArray[np.int32], offset: Floats
) -> tuple[NDArray[np.int32], float, float] | None:
    """Edges passed, and the offsets on the first and the last; None where the match has a hole or a jump."""
    if (edge < 0).any():
        return None
    keep = np.concatenate([[True], np.diff(edge) != 0])
    path = edge[keep]
    for a, b in itertools.pairwise(path):
        if b not in network.successors(int(a)):
            return None
    return path, float(offset[0]), float(offset[-1])


def _leg(
    network: Network, path: tuple[NDArray[np.int32], float, float], time: Floats, speed: Floats, radius: float, wait: float,
    payload: float, first: int, trip: int,
) -> Leg | None:  # fmt: skip
    edges, start, stop = path
    ends = np.cumsum(network.length[edges])
    low, high = start, float(ends[-1] - network.length[edges[-1]] + stop)
    if high - low < SHORTEST:
        return None
    s = np.arange(low, high, STEP)
    which = np.minimum(np.searchsorted(ends, s, side="right"), len(edges) - 1)
    edge = edges[which].astype(np.int32)
    offset = s - np.concatenate([[0.0], ends[:-1]])[which]
    shape = bends(network, edges, radius)
    curvature, metres = shape.at(s, shape.curvature), shape.at(s, shape.metres)
    driven = np.concatenate([[0.0], np.cumsum(STEP * metres[1:])])
    progress, clock = _progress(time, speed)
    ratio = progress[-1] / max(driven[-1], 1e-9)
    if not 0.85 < ratio < 1.18:
        return None
    passing = np.interp(driven * ratio, progress, clock)
    row = first + np.clip(np.rint(np.interp(passing, time, np.arange(len(time)))), 0, len(time) - 1).astype(
        np.int64
    )
    return Leg(edge, offset, curvature, metres, passing, wait, payload, row, trip)


def _progress(time: Floats, speed: Floats) -> tuple[Floats, Floats]:
    """Distance and clock of a leg whose first and last rows stand; setting off and stopping fall between rows."""
    clock, v = time.copy(), speed.copy()
    v[0] = v[-1] = 0.0
    for first, second, end, sense in ((1, 2, 0, 1.0), (-2, -3, -1, -1.0)):
        if len(v) < 4:
            break
        gather = (v[second] - v[first]) / max(abs(clock[second] - clock[first]), 1e-6)
        if gather > 0.05:
            moment = clock[first] - sense * v[first] / gather
            clock[end] = max(moment, time[end]) if sense > 0 else min(moment, time[end])
    clock = np.maximum.accumulate(clock + np.arange(len(clock)) * 1e-6)
    if len(v) < 5:
        distance = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(clock))])
        return distance + np.arange(len(v)) * 1e-9, clock
    # Straight lines between rows would cut the tip off every slow turn.
    fine = np.linspace(0.0, len(clock) - 1.0, (len(clock) - 1) * FINE + 1)
    moments = np.interp(fine, np.arange(len(clock)), clock)
    speeds = np.maximum(Akima(clock, v)(moments), 0.0)
    distance = np.concatenate([[0.0], np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * np.diff(moments))])
    return distance + np.arange(len(moments)) * 1e-9, moments

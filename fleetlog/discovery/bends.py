"""How sharply a truck turned: from the map where there is one, else from its own track.

Headings of noisy positions are far too rough for a curvature.  On the map every vertex of the path, within an edge or between
two, is an arc of the truck's turning radius that touches both sides, entered and left over the length that steering takes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.network import Network
from fleetlog.core.trajectory import Trajectory
from fleetlog.discovery.smooth import gaussian

Floats = NDArray[np.float64]
Index = NDArray[np.int32]
Ints = NDArray[np.int64]

STEP = 0.5
"""Between the nodes of a path [m]."""
STEERING = 0.85
"""Standard deviation of the length over which the wheel is turned [m]."""
TRACK = 6.0
"""Length of track whose turning is taken together where there is no map [m]."""
NEARBY = 10
"""Samples before and after the change of edge that count as there."""
SHARPEST = 2.8
"""A sharper angle is a turn on the spot or a wrong match, not a bend [rad]."""


@dataclass(frozen=True)
class Bends:
    """Nodes ``STEP`` apart along a sequence of edges.

    ``ends`` (K,) distance at the end of each edge [m]; ``curvature`` (M,) [1/m], left positive; ``metres`` (M,) driven for
    a metre of the map, as corners are cut.
    """

    ends: Floats
    curvature: Floats
    metres: Floats

    def at(self, s: Floats, values: Floats) -> Floats:
        """(N,) of node values at distances along the path."""
        return np.interp(s, np.arange(len(values)) * STEP, values)


def bends(network: Network, edges: Index, radius: float, halted: NDArray[np.bool_] | None = None) -> Bends:
    """The bends of a path.

    ``edges`` (K,) in the order driven; ``radius`` the truck's turning radius [m]; ``halted`` (K,) whether the truck stood
    when it came to each edge: it set off anew then and drove no bend.
    """
    ends = np.cumsum(network.length[edges])
    place, angle = _vertices(network, edges, ends, halted)
    size = np.minimum(np.abs(angle), SHARPEST)
    half = np.maximum(radius * np.tan(size / 2.0), 0.5 * STEP)
    count = int(ends[-1] // STEP) + 2
    turning = _boxes(place, half, angle / (2.0 * half), count)
    saved = _boxes(place, half, np.maximum(1.0 - radius * size / (2.0 * half), 0.0) * (half > STEP), count)
    metres = np.clip(1.0 - saved, 0.4, 1.0)
    return Bends(ends, gaussian(turning, STEERING / STEP) / metres, metres)


def _vertices(
    network: Network, edges: Index, ends: Floats, halted: NDArray[np.bool_] | None
) -> tuple[Floats, Floats]:
    """Distance along the path and angle of every vertex; where one edge does not lead to the next there is no bend."""
    places, angles = [], []
    before: Floats | None = None
    for k, edge in enumerate(edges.tolist()):
        points = network.polyline(edge)
        d = np.diff(points[:, :2], axis=0)
        heading = np.arctan2(d[:, 1], d[:, 0])
        start = float(ends[k] - network.length[edge])
        distance = network.distance[network.first[edge] : network.first[edge + 1]]
        rolled = halted is None or not halted[k]
        if rolled and before is not None and edge in network.successors(int(edges[k - 1])):
            places.append(np.array([start]))
            angles.append(heading[:1] - before)
        places.append(start + distance[1:-1])
        angles.append(np.diff(heading))
        before = heading[-1:]
    return np.concatenate(places), np.angle(np.exp(1j * np.concatenate(angles)))


def _boxes(place: Floats, half: Floats, height: Floats, count: int) -> Floats:
    """(count,) sum of boxes on the nodes, their area kept whatever their width."""
    fine = np.zeros(count + 2)
    for side, sign in ((place - half, 1.0), (place + half, -1.0)):
        at = np.clip(side / STEP + 0.5, 0.0, count)
        low = np.floor(at).astype(np.int64)
        np.add.at(fine, low, sign * height * (1.0 - (at - low)))
        np.add.at(fine, low + 1, sign * height * (at - low))
    return np.cumsum(fine)[:count]


def path_curvature(
    piece: Trajectory,
    network: Network | None,
    edge: Index,
    offset: Floats,
    row: Ints,
    radius: float,
    speed: Floats,
) -> Floats:
    """(N,) curvature of the path [1/m], left positive."""
    if network is None or not (edge >= 0).any():
        return track_curvature(piece.floats("x"), piece.floats("y"))[row]
    out = np.zeros(len(edge))
    on = np.flatnonzero(edge >= 0)
    new = np.concatenate([[True], np.diff(edge[on]) != 0])
    path = bends(network, edge[on][new], radius, _halted(speed[on], np.flatnonzero(new)))
    which = np.cumsum(new) - 1
    start = np.concatenate([[0.0], path.ends[:-1]])
    out[on] = path.at(start[which] + offset[on], path.curvature)
    return out


def _halted(speed: Floats, at: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Whether the truck stood close to each of the samples ``at``."""
    still = np.concatenate([[0], np.cumsum(speed <= 0.0)])
    return np.asarray(still[np.minimum(at + NEARBY, len(speed))] > still[np.maximum(at - NEARBY, 0)])


def track_curvature(x: Floats, y: Floats) -> Floats:
    """(rows,) curvature of a track from chords of ``TRACK`` metres: noise of the positions is divided by that length."""
    s = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    s += np.arange(len(s)) * 1e-6

    def chord(a: Floats, b: Floats) -> Floats:
        dx = np.interp(b, s, x) - np.interp(a, s, x)
        dy = np.interp(b, s, y) - np.interp(a, s, y)
        return np.asarray(np.arctan2(dy, dx))

    turned = np.angle(np.exp(1j * (chord(s, s + TRACK) - chord(s - TRACK, s))))
    bend = turned / TRACK
    return np.where(np.abs(bend) > 0.03, bend, 0.0)

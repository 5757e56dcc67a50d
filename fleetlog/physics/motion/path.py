"""The path of a log as one coordinate.

Along the matched edges with corners cut, along the smoothed positions off the map. A truck rounds every
corner with its turning radius, gentle kinks as widely as it can within ``BOW`` of the corner; so the
coordinate is the way of the truck, not that of the map, and its curvature is that of the arcs.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.network import Floats, Index, Network
from fleetlog.physics.motion.plane import Plane, mean_curvature
from fleetlog.physics.motion.rows import Rows

Flags = NDArray[np.bool_]

RADIUS = 2.5  # Of a corner [m], where no truck says otherwise
BOW = 0.1
"""A gentle kink is rounded as widely as it can be while the curve stays this close to the corner [m]."""
STEERING = 0.85  # Half the length over which the wheel is turned [m]: curvature is a mean over it
SHARPEST = 3.0  # A sharper angle is a turn on the spot, not a bend [rad]
MOST_ALONG = 10.0
"""A position farther than this along the edge from its place there does not correct the place [m]."""


@dataclass(frozen=True)
class Visits:
    """V stays on one edge each, in order.

    ``edge`` (-1 off the map), map coordinate of its start ``origin`` [m], ``length`` [m]; ``joined``,
    whether it was entered from the visit before, not by a jump.
    """

    edge: Index
    origin: Floats
    length: Floats
    joined: Flags


@dataclass(frozen=True)
class Bends:
    """Angle turned [rad] and way driven [m] up to the knots of the map coordinate; linear between them."""

    knots: Floats
    turned: Floats
    driven: Floats

    def way(self, place: Floats) -> Floats:
        """Way driven up to a map coordinate [m]."""
        return _along(place, self.knots, self.driven)

    def place(self, way: Floats) -> Floats:
        """Map coordinate of a way driven [m]."""
        return _along(way, self.driven, self.knots)

    def curvature(self, way: Floats, half: Floats) -> Floats:
        """Mean curvature of the way from ``half`` m before to ``half`` m after [1/m], left positive."""
        return mean_curvature(way, half, self.driven, self.turned)


STRAIGHT = Bends(np.zeros(1), np.zeros(1), np.zeros(1))


def _along(at: Floats, knots: Floats, values: Floats) -> Floats:
    """Linear interpolation that goes on with slope 1 beyond both ends."""
    inside = np.clip(at, knots[0], knots[-1])
    return np.asarray(np.interp(inside, knots, values) + (at - inside))


@dataclass(frozen=True)
class Path:
    """The way driven as the positions of the rows show it, ``seen`` (rows,) [m] (NaN: not seen).

    ``visits`` and ``bends`` are those of the whole way.
    """

    seen: Floats
    visits: Visits
    bends: Bends

    def on_map(self, way: Floats) -> tuple[Index, Floats]:
        """(n,) edge, -1 off the map, and offset on it [m] of (n,) ways driven."""
        place, v = self.bends.place(way), self.visits
        k = np.maximum(np.searchsorted(v.origin, place, side="right") - 1, 0)
        return v.edge[k], np.clip(place - v.origin[k], 0.0, np.where(v.edge[k] >= 0, v.length[k], np.inf))


def follow(
    network: Network | None, rows: Rows, plane: Plane | None, link: NDArray[np.uint8], radius: float
) -> Path:
    """The path of some rows; marks jumps in ``link``.

    The matching has smoothed the offsets: what a position says beyond them is added back.
    """
    from fleetlog.physics.motion.kernels.way import path_coordinate

    edge, offset, x, y = rows.edge, rows.offset, rows.x, rows.y
    step = np.zeros(len(x)) if plane is None else np.diff(plane.way, prepend=plane.way[:1])
    visits = Visits(np.full(1, -1, np.int32), np.zeros(1), np.zeros(1), np.zeros(1, bool))
    place, ahead = np.cumsum(step), np.zeros(len(x))
    if network is not None:
        visits = Visits(*path_coordinate(
            edge, offset, x, y, step, network.next_first, network.next_edges, network.length,
            network.reverse, 5.0, link, place,
        ))  # fmt: skip
        ahead = edge_shape(network, edge, offset, x, y)[2]
        ahead[np.abs(ahead) > MOST_ALONG] = 0.0
    off = edge < 0
    if plane is not None:
        ahead = np.where(off, plane.ahead, ahead)
    bends = _rounded(network, visits, np.sort(place[rows.rest & ~off]), radius)
    seen = bends.way(place) + ahead
    return Path(np.where(off & (plane is None), np.nan, seen), visits, bends)


def _rounded(network: Network | None, visits: Visits, stood: Floats, radius: float) -> Bends:
    """The bends of all visits as arcs; a truck that ``stood`` (places in order) at a junction drove none."""
    if network is None or not (visits.edge >= 0).any():
        return STRAIGHT
    where, angle, leg, join = _vertices(network, visits)
    size = np.minimum(np.abs(angle), 2.8)
    reach = np.maximum(radius * np.tan(size / 2.0), BOW / np.tan(np.maximum(size, 1e-6) / 4.0))
    reach = np.clip(reach, 0.02, np.maximum(0.499 * leg, 0.02))
    near = np.maximum(reach, 1.0)
    halted = join & (np.searchsorted(stood, where - near) < np.searchsorted(stood, where + near))
    real = (np.abs(angle) > 1e-6) & (np.abs(angle) < SHARPEST) & ~halted
    where, angle, size, reach = where[real], angle[real], size[real], reach[real]
    saved = 1.0 - np.maximum(0.5 * size / np.tan(0.5 * size), 0.4)
    knots = np.concatenate([where - reach, where + reach])
    order = np.argsort(knots, kind="stable")
    knots = knots[order]
    span = np.diff(knots, prepend=knots[:1])
    turned, lost = (
        np.cumsum(np.append(0.0, np.cumsum(np.concatenate([rate, -rate])[order])[:-1]) * span)
        for rate in (angle / (2.0 * reach), saved)
    )
    if not len(knots):
        return STRAIGHT
    driven = np.maximum.accumulate(knots - np.minimum(lost, knots - knots[0]))
    return Bends(knots, turned, driven)


def _vertices(network: Network, v: Visits) -> tuple[Floats, Floats, Floats, Flags]:
    """Map coordinate, angle [rad] and shorter leg [m] of every corner passed; whether between edges."""
    on = np.flatnonzero(v.edge >= 0)
    e = v.edge[on]
    inner = np.maximum(network.first[e + 1] - network.first[e] - 2, 0)
    visit = np.repeat(np.arange(len(e)), inner)
    k = network.first[e][visit] + 1 + np.arange(len(visit)) - np.repeat(np.cumsum(inner) - inner, inner)
    p, d = network.points, network.distance
    angle = _between(p[k] - p[k - 1], p[k + 1] - p[k])
    leg = np.minimum(d[k] - d[k - 1], d[k + 1] - d[k])
    joins = on[v.joined[on]]
    last, begin = network.first[v.edge[joins - 1] + 1] - 1, network.first[v.edge[joins]]
    turn = _between(p[last] - p[last - 1], p[begin + 1] - p[begin])
    near = np.minimum(d[last] - d[last - 1], d[begin + 1])
    return (
        np.concatenate([v.origin[on][visit] + d[k], v.origin[joins]]), np.concatenate([angle, turn]),
        np.concatenate([leg, near]), np.arange(len(k) + len(joins)) >= len(k),
    )  # fmt: skip


def _between(a: Floats, b: Floats) -> Floats:
    """Angle from direction a to direction b, (n,), left positive."""
    cross, dot = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1]
    return np.asarray(np.arctan2(cross, dot))


def by_second(t: Floats, seen: Floats, link: NDArray[np.uint8]) -> Floats:
    """(N,) positions along the path as one mean a second: the errors last so long."""
    known = np.flatnonzero(np.isfinite(seen))
    if not len(known):
        return seen
    block = np.cumsum(link != 0)[known] * 1e9 + np.floor(t[known] + 1e-6)
    first = np.flatnonzero(np.diff(block, prepend=-1.0))
    last = np.append(first[1:], len(known)) - 1
    count, middle = last - first + 1, known[(first + last) // 2]
    mean_t, mean = (np.add.reduceat(v[known], first) / count for v in (t, seen))
    span, way = (v[known[last]] - v[known[first]] for v in (t, seen))
    pace = np.where(count > 1, way / np.maximum(span, 1e-9), 0.0)
    out = np.full(len(seen), np.nan)
    out[middle] = mean + pace * (t[middle] - mean_t)
    return out


def edge_shape(
    network: Network, edge: Index, offset: Floats, x: Floats, y: Floats
) -> tuple[Floats, Floats, Floats]:
    """Heading and slope of the edge [rad] at places on it, how far ahead (x, y) lies [m]; 0 off the map."""
    from fleetlog.physics.motion.kernels.way import on_edges

    ahead, heading, slope = np.zeros((3, len(edge)))
    on_edges(edge, offset, x, y, network.points, network.first, network.distance, ahead, heading, slope)
    return heading, slope, ahead

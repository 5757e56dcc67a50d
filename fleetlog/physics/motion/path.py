"""The path of a log as one coordinate.

Along the matched edges with corners cut; off the map along the track, the positions smoothed in the plane.  A
truck rounds every corner with its turning radius, gentle kinks as widely as it can within ``BOW`` of the
corner; so the coordinate is the way of the truck, not that of the map, and its curvature is that of the arcs.
"""

from typing import NamedTuple

import numpy as np

from fleetlog.core.arrays import Floats, Index, Ints, Mask
from fleetlog.core.network import Network
from fleetlog.physics.motion.noise import Noise, Observed, estimate_noise, smooth
from fleetlog.physics.motion.rows import Codes, Rows, metres_driven

RADIUS = 2.5  # Of a corner [m], where no truck says otherwise
BOW = 0.1  # A gentle kink is rounded as widely as the curve stays this close to the corner [m]
SLIGHT = 0.3  # A smaller angle is a kink of a curve, which limits no corner beside it [rad]
SHARPEST = 3.0  # A sharper angle is a turn on the spot, not a bend [rad]
MOST_ALONG = 10.0  # A position farther along the edge from its place there does not correct it [m]
BACK = 5.0  # A match may go back so far on its edge without leaving it [m]
NEAR_CENTRE = 0.3  # Nearer to the centre of an arc, in radii, the angle about it is noise
HELD = 0.2  # Below this speed noisy positions have no direction: the last one holds [m/s]


class Track(NamedTuple):
    """The track off the map at the rows, (rows,) each."""

    way: Floats  # Along the smooth curve [m]
    ahead: Floats  # How far the position lies ahead of it [m]
    heading: Floats  # [rad], unwrapped
    turned: Floats  # Angle that was driven [rad]: without what is turned at a standstill


class Visits(NamedTuple):
    """V stays on one edge each, in order."""

    edge: Index  # -1 off the map
    origin: Floats  # Map coordinate of its start [m]
    length: Floats  # [m]
    joined: Mask  # Whether it was entered from the visit before, not by a jump


class Bends(NamedTuple):
    """Angle turned [rad] and way driven [m] up to the knots of the map coordinate; linear between them."""

    knots: Floats
    turned: Floats
    driven: Floats


class Arcs(NamedTuple):
    """The corners that are rounded, (C,) each, in order."""

    where: Floats  # Map coordinate [m]
    angle: Floats  # [rad], left positive
    reach: Floats  # From the corner to either end of the arc [m]
    vertex: Ints  # Number of the point of the network

    @property
    def size(self) -> Floats:
        """The angle that is driven [rad]."""
        return np.minimum(np.abs(self.angle), 2.8)

    def bends(self) -> Bends:
        """Return what they turn, and the way driven."""
        size, reach = self.size, self.reach
        if not len(size):
            return STRAIGHT
        saved = 1.0 - np.maximum(0.5 * size / np.tan(0.5 * size), 0.4)
        ends = self.where - reach, self.where + reach
        knots, turned, lost = _ramps(*ends, self.angle / (2.0 * reach), saved)
        return Bends(knots, turned, np.maximum.accumulate(knots - np.minimum(lost, knots - knots[0])))

    def placed(self, network: Network, place: Floats, x: Floats, y: Floats) -> Floats:
        """(N,) map coordinates of trucks at (x, y), near ``place``, that are in a sharp corner, else NaN: by
        the angle that they have turned about its centre, as they go along neither of its roads."""
        out, c = np.full(len(place), np.nan), Arcs._make(v[np.abs(self.angle) > SLIGHT] for v in self)
        if not len(c.where):
            return out
        k = np.searchsorted(0.5 * (c.where[1:] + c.where[:-1]), place)
        on = np.flatnonzero(np.abs(place - c.where[k]) < c.reach[k])
        c, p = Arcs._make(v[k[on]] for v in c), network.points[:, :2]
        corner, radius = p[c.vertex], c.reach / np.tan(0.5 * c.size)
        ahead = corner - p[c.vertex - 1]
        ahead /= np.hypot(*ahead.T)[:, None]
        inward = np.sign(c.angle)[:, None] * np.column_stack([-ahead[:, 1], ahead[:, 0]])
        beside = np.column_stack([x[on], y[on]]) - corner
        along = (beside * ahead).sum(axis=1) + c.reach
        across = radius - (beside * inward).sum(axis=1)
        turned = np.arctan2(along, across) - 0.5 * c.size  # From the middle of the arc
        turned = np.clip((turned + np.pi) % (2.0 * np.pi) - np.pi, -0.5 * c.size, 0.5 * c.size)
        told = np.hypot(along, across) > NEAR_CENTRE * radius
        out[on[told]] = (c.where + 2.0 * c.reach * turned / c.size)[told]
        return out


class Path(NamedTuple):
    """The way driven as the positions of the rows show it; its visits and bends."""

    seen: Floats  # (rows,) [m], NaN: not seen
    link: Codes  # (rows,) that of the rows, with the jumps of the way
    visits: Visits
    bends: Bends

    def on_map(self, way: Floats) -> tuple[Index, Floats]:
        """(n,) edge, -1 off the map, and offset on it [m] of (n,) ways driven."""
        place, v = _along(way, self.bends.driven, self.bends.knots), self.visits
        k = np.maximum(np.searchsorted(v.origin, place, side="right") - 1, 0)
        return v.edge[k], np.clip(place - v.origin[k], 0.0, np.where(v.edge[k] >= 0, v.length[k], np.inf))

    def curvature(self, way: Floats, step: Floats, half: Floats, leaps: Ints, radius: float) -> Floats:
        """(n,) mean curvature [1/m] ``half`` m before and after samples ``step`` m long. The ``way`` leaps
        before ``leaps``, where a truck cuts a corner or takes it wide: it turned by its ``radius`` [m]."""
        driven, total = self.bends.driven, self.bends.turned
        if len(leaps):
            low, high = (np.interp(way + side * step, driven, total) for side in (-0.5, 0.5))
            ends, turned = (np.append(0.0, np.cumsum(v)) for v in (step, high - low))
            angle, place = low[leaps] - high[leaps - 1], ends[leaps]
            reach = np.maximum(0.5 * radius * np.abs(angle), 0.1)
            knots, more = _ramps(place - reach, place + reach, angle / (2.0 * reach))
            driven, way = np.sort(np.append(ends, knots)), ends[1:] - 0.5 * step
            total = np.interp(driven, ends, turned) + np.interp(driven, knots, more)
        return mean_curvature(way, half, driven, total)


OFF_MAP = Visits(np.full(1, -1, np.int32), np.zeros(1), np.zeros(1), np.zeros(1, bool))
STRAIGHT = Bends(np.zeros(1), np.zeros(1), np.zeros(1))


def _along(at: Floats, knots: Floats, values: Floats) -> Floats:
    """Linear interpolation that goes on with slope 1 beyond both ends."""
    inside = np.clip(at, knots[0], knots[-1])
    return np.asarray(np.interp(inside, knots, values) + (at - inside))


def mean_curvature(way: Floats, half: Floats, driven: Floats, turned: Floats) -> Floats:
    """Mean over a way from ``half`` m before to ``half`` m after its places [1/m], left positive."""
    low, high = (np.interp(way + side * half, driven, turned) for side in (-1.0, 1.0))
    return np.asarray((high - low) / (2.0 * half))


def track_of(rows: Rows) -> Track:
    """Smooth the positions in the plane; the noise is of both axes, so turning the frame changes nothing."""
    t, rest, link, nan = rows.t, rows.rest, rows.link, np.full(len(rows.t), np.nan)
    x, y = (np.where(rows.fresh, v, np.nan) for v in (rows.x, rows.y))
    both = Observed(np.tile(t, 2), np.append(x, y), np.tile(nan, 2), np.tile(rest, 2), np.tile(link, 2))
    noise = estimate_noise(both, Noise(jerk=0.3, position=0.5))
    jerk = np.full(len(t), noise.jerk)
    mx, my = (smooth(Observed(t, v, nan, rest, link), noise, jerk).mean for v in (x, y))
    pace, h = np.hypot(mx[:, 1], my[:, 1]), np.diff(t)
    heading = np.zeros(len(t))
    if len(moving := np.flatnonzero(pace > HELD)):
        # At a standstill that of the last motion, at first that of the next.
        last = np.maximum(np.searchsorted(moving, np.arange(len(t)), side="right") - 1, 0)
        heading = np.unwrap(np.arctan2(my[:, 1], mx[:, 1])[moving])[last]
    # The length of the cubic from row to row, by Simpson's rule over its speed.
    middle = (1.5 * np.diff(m[:, 0]) - 0.25 * h * (m[1:, 1] + m[:-1, 1]) for m in (mx, my))
    step = np.append(0.0, (h * (pace[1:] + pace[:-1]) + 4.0 * np.hypot(*middle)) / 6.0)
    step[rows.breaks] = 0.0
    ahead = (x - mx[:, 0]) * np.cos(heading) + (y - my[:, 0]) * np.sin(heading)
    slow = rest | (pace < HELD)
    turn = np.where(slow[1:] | slow[:-1] | rows.breaks[1:], 0.0, np.diff(heading))
    return Track(np.cumsum(step), ahead, heading, np.append(0.0, np.cumsum(turn)))


def follow(network: Network | None, rows: Rows, track: Track | None, radius: float) -> Path:
    """The path of some rows; the matching smoothed the offsets: what positions say beyond is added back."""
    from fleetlog.physics.motion.kernels.way import NEAR_REACH, on_edges, path_coordinate

    edge, offset, x, y = rows.edge, rows.offset, rows.x, rows.y
    off, link = edge < 0, rows.link.copy()
    step = np.zeros(len(x)) if track is None else np.diff(track.way, prepend=track.way[:1])
    # Where positions miss, as in a hall, the speed says how far it went there, and the map nothing.
    driven = np.diff(metres_driven(rows.t, rows.speed), prepend=0.0)
    step = np.where(off & ~rows.fresh & np.isfinite(rows.speed), np.maximum(driven, step), step)
    visits, bends, place, ahead = OFF_MAP, STRAIGHT, np.cumsum(step), np.zeros(len(x))
    if network is not None:
        left = (np.diff(edge) != 0) | (np.abs(np.diff(offset)) > BACK)
        most, between = 1 + (1 + NEAR_REACH) * int(left.sum()), np.empty(NEAR_REACH, np.int32)
        room = Visits(np.empty(most, np.int32), np.empty(most), np.zeros(most), np.zeros(most, np.bool_))
        count = path_coordinate(
            edge, offset, x, y, step, network.next_first, network.next_edges, network.length,
            network.reverse, BACK, link, place, between, *room,
        )  # fmt: skip
        visits = Visits._make(v[:count] for v in room)
        arcs = _rounded(network, visits, np.sort(place[rows.rest & ~off]), radius)
        bends = arcs.bends()
        _, _, ahead = shape = np.zeros((3, len(x)))
        on_edges(edge, offset, x, y, network.points, network.first, network.distance, shape)
        ahead[np.abs(ahead) > MOST_ALONG] = 0.0
        turning = np.where(off, np.nan, arcs.placed(network, place + ahead, x, y))
        place, ahead = np.where(np.isnan(turning), [place, ahead], [turning, np.zeros(len(x))])
    ahead = np.where(off, np.nan if track is None else track.ahead, ahead)
    return Path(_along(place, bends.knots, bends.driven) + ahead, link, visits, bends)


def _rounded(network: Network, visits: Visits, stood: Floats, radius: float) -> Arcs:
    """The corners of all visits; a truck that ``stood`` (places in order) at a junction rounded none."""
    every, leg, join = _vertices(network, visits)
    size = every.size
    reach = np.maximum(radius * np.tan(size / 2.0), BOW / np.tan(np.maximum(size, 1e-6) / 4.0))
    reach = np.clip(reach, 0.02, np.maximum(0.499 * leg, 0.02))
    near, where, order = np.maximum(reach, 1.0), every.where, np.argsort(every.where, kind="stable")
    halted = join & (np.searchsorted(stood, where - near) < np.searchsorted(stood, where + near))
    real = (np.abs(every.angle) > 1e-6) & (np.abs(every.angle) < SHARPEST) & ~halted
    return Arcs._make(v[order[real[order]]] for v in every._replace(reach=reach))


def _ramps(begin: Floats, end: Floats, *rates: Floats) -> list[Floats]:
    """Ends of ramps in order, and the sums of all ramps there, which grow at (n,) rates."""
    knots = np.concatenate([begin, end])
    order = np.argsort(knots, kind="stable")
    span = np.diff(knots[order], prepend=knots[order][:1])
    now = (np.cumsum(np.concatenate([rate, -rate])[order]) for rate in rates)
    return [knots[order], *(np.cumsum(np.append(0.0, rate[:-1]) * span) for rate in now)]


def _vertices(network: Network, v: Visits) -> tuple[Arcs, Floats, Mask]:
    """Every corner passed, of no reach yet, its shorter leg [m], and whether it is between edges."""
    on = np.flatnonzero(v.edge >= 0)
    first, p, d = network.first, network.points, network.distance
    inner = np.maximum(np.diff(first)[v.edge[on]] - 2, 0)
    visit = np.repeat(on, inner)
    k = first[v.edge[visit]] + 1 + np.arange(len(visit)) - np.repeat(np.cumsum(inner) - inner, inner)
    joins = on[v.joined[on]]
    last, begin = first[v.edge[joins - 1] + 1] - 1, first[v.edge[joins]]
    a, b = (p[last] - p[last - 1])[:, :2].T, (p[begin + 1] - p[begin])[:, :2].T
    between = np.arctan2(a[0] * b[1] - a[1] * b[0], a[0] * b[0] + a[1] * b[1])
    angle = np.append(network.turn[k], between)
    before = np.append(d[k] - d[k - 1], d[last] - d[last - 1])
    leg = np.minimum(before, np.append(d[k + 1] - d[k], d[begin + 1] - d[begin]))
    where = np.append(v.origin[visit] + d[k], v.origin[joins])
    # A corner is rounded as far as the next one allows, however finely the straights between are drawn.
    length, own = network.length, v.edge[visit]
    room = np.append(d[k], length[v.edge[joins - 1]])
    room = np.minimum(room, np.append(length[own] - d[k], length[v.edge[joins]]))
    order = np.argsort(where, kind="stable")
    sharp = order[np.abs(angle[order]) > SLIGHT]
    gap = np.diff(where[sharp], prepend=-np.inf, append=np.inf)
    leg[sharp] = np.minimum(room[sharp], np.minimum(gap[:-1], gap[1:]))
    return Arcs(where, angle, leg, np.append(k, last)), leg, np.arange(len(where)) >= len(k)


def by_second(t: Floats, seen: Floats, link: Codes) -> Floats:
    """(N,) positions along the path as one mean a second: the errors last so long."""
    if not len(known := np.flatnonzero(np.isfinite(seen))):
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

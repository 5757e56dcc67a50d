"""What every vehicle drove, stop by stop, as nodes in place and time, and where it was in another's way.

A truck is hindered on the stretch before a place that another leaves after it has come within reach of that
place: close behind another, before a crossing that another is to pass, behind one that stands.  The time
between the two at one place is the post-encroachment time of traffic safety (Allen, Shin and Cooper 1978).
Only positions decide, never how long anything took."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise, product

import numpy as np

from fleetlog.core.arrays import Floats, Ints, Mask
from fleetlog.core.motion import join
from fleetlog.core.truck import Truck
from fleetlog.discovery.recording.blocks import Block, counted_on, narrow
from fleetlog.physics.motion.legs import Leg, legs

WIDTH, ABREAST = 2.0, 1.2  # Two trucks are never at places nearer than this; than that, head-on [m]
BODY, REACTION = 6.0, 2.0  # Length of a truck with the gap that it keeps [m], and headway of drivers [s]
CLOSE = 3.0  # A driver heeds a truck that passes the crossing so soon after him [s]
ALONG, AGAINST = 0.7, -0.7  # Cosine between courses above which one follows, below which they meet head-on
RELEASE = 6.0  # Whoever waits for another sets off so soon after the way is free [s]
NEAR = 16.0  # Whoever stands for another is so near the place that it leaves: half a junction, a truck [m]
PASSING = 2.0  # Who is at a place for longer stands there [s]
PURPOSE = 90.0  # A longer standstill has a purpose of its own [s]
LOAD, LIFT = 25.0, 0.08  # Change of payload [kg] and fork height [m] that show a purpose
APART = 1000.0  # Between the ways of two errands, so that nothing reaches from one into the other [m]
CHORD, SPOT = 1.5, 1.0  # Who goes on at such an angle [rad], by so much way on both sides [m], turned there
BESIDE = 6.0  # So far off its road, in a bay or a turn, a truck is told by the road before or behind [m]


@dataclass(frozen=True)
class Route:
    """One vehicle-day: its legs in order; (L,) of each. ``wait`` [s] of the standstill after a leg, NaN
    unknown; ``known``, whether the log would show a purpose of it; ``errand`` counts up with every standstill
    that had one."""

    vehicle: int
    day: int
    start: float
    legs: tuple[Leg, ...]
    wait: Floats
    known: bool
    errand: Ints

    @cached_property
    def size(self) -> Ints:
        """(L,) nodes of each leg."""
        return np.array([len(leg.distance) for leg in self.legs], dtype=np.int64)

    @cached_property
    def way(self) -> Floats:
        """(N,) metres driven up to every node, errands set apart."""
        before = np.cumsum([0.0, *(leg.distance[-1] for leg in self.legs)])[:-1] + APART * self.errand
        return np.concatenate([leg.distance + b for leg, b in zip(self.legs, before, strict=True)])

    def nodes(self, name: str) -> Floats:
        """(N,) a variable of the motion at every node."""
        return np.concatenate([getattr(leg.path, name) for leg in self.legs])

    @cached_property
    def turned(self) -> Floats:
        """(L,) angle of a turn on the spot after a leg [rad]; zero for none, or in a stop for a purpose."""
        place = [(leg.path.x + 1j * leg.path.y, leg.distance) for leg in self.legs]
        came = [z[-1] - z[np.searchsorted(s, s[-1] - CHORD)] for z, s in place]
        left = [z[np.searchsorted(s[:-1], CHORD)] - z[0] for z, s in place]
        angle = np.abs(np.angle(np.append(left[1:], came[-1]) * np.conj(came)))
        return np.where((angle > SPOT) & (np.diff(self.errand, append=-1) == 0), angle, 0.0)

    @cached_property
    def arrive(self) -> Floats:
        """(N,) time at which the vehicle came to every node [s since 1970]."""
        return self.nodes("time") + self.start

    @cached_property
    def leave(self) -> Floats:
        """(N,) time at which it left."""
        out = self.arrive.copy()
        last = np.cumsum(self.size) - 1
        out[last[:-1]] = np.maximum(out[last[:-1]], self.arrive[last[:-1] + 1])
        return out

    @cached_property
    def course(self) -> Floats:
        """(N,) direction of motion in the plane [rad]."""
        x, y = self.nodes("x"), self.nodes("y")
        ahead, behind = np.minimum(np.arange(len(x)) + 2, len(x) - 1), np.maximum(np.arange(len(x)) - 2, 0)
        return np.arctan2(y[ahead] - y[behind], x[ahead] - x[behind])


def route(block: Block) -> Route | None:
    """Return the route of a vehicle-day; None where it has no legs, or none on a road."""
    assert block.known is not None
    found = list(legs(block.known))
    if all((leg.path.edge < 0).all() for leg in found):
        return None
    # Views of one motion take less room than motions.
    ends = np.cumsum([0, *(len(leg.distance) for leg in found)])
    path = narrow(join([leg.path for leg in found]))
    found = [replace(leg, path=path[a:b]) for leg, (a, b) in zip(found, pairwise(ends), strict=True)]
    m = block.motion
    known = bool(m.payload.any() or m.fork_height.any())
    wait = np.array([leg.wait for leg in found])
    after = [leg.row[0] for leg in found[1:]] + [len(block) - 1]
    paused = [block.first[leg.row[-1] : n + 2] for leg, n in zip(found, after, strict=True)]
    moved = [[np.ptp(v[k]) if len(k) else 0.0 for v in (m.payload, m.fork_height)] for k in paused]
    purpose = ~(wait <= PURPOSE) | (np.array(moved) > [LOAD, LIFT]).any(axis=1)
    errand = np.cumsum([0, *purpose[:-1]])
    return Route(block.vehicle, block.day, float(block.time[0]), tuple(found), wait, known, errand)


def on_road(leg: Leg) -> tuple[Leg, Mask]:
    """A leg with every node on the nearest road of its way, and (N,) where it truly was off the map: far from
    it, or beside it at either end, at more than its stand, as no limit of a road holds in a bay."""
    off = leg.path.edge < 0
    if not off.any() or off.all():
        return leg, off
    on = np.flatnonzero(~off)
    first, last = on[[0, -1]]
    near = on[np.abs(leg.distance[:, None] - leg.distance[on]).argmin(axis=1)]
    path = leg.path.replaced(edge=leg.path.edge[near], edge_offset=leg.path.edge_offset[near])
    away = np.abs(leg.distance - leg.distance[near]) > BESIDE
    away[:first] |= first > 1
    away[last + 1 :] |= last < len(off) - 2
    return replace(leg, path=path), away


class _Nodes:
    """Nodes of all routes of a day, (N,) each; ``first`` node of the errand of each."""

    def __init__(self, found: Sequence[Route]) -> None:
        # Ways of different trucks are set far apart too, so that one array serves all.
        self.way = counted_on([r.way for r in found], [r.way[-1] + 1e4 for r in found])
        first = np.flatnonzero(np.diff(self.way, prepend=-np.inf) > 500.0)
        self.first = first[np.searchsorted(first, np.arange(len(self.way)), side="right") - 1]
        self.vehicle = np.repeat([r.vehicle for r in found], [r.size.sum() for r in found])
        driven = ((r.nodes("x"), r.nodes("y"), r.nodes("speed"), r.arrive, r.leave, r.course) for r in found)
        values = np.concatenate([np.stack(one) for one in driven], axis=1)
        self.x, self.y, self.speed, self.arrive, self.leave, self.course = values


def hindered(found: Sequence[Route], free: Sequence[Floats], truck: Truck) -> list[tuple[Mask, Mask]]:
    """Return of each route of one day whether another truck was in the way at its nodes, and held it up until
    it left them, (N,). ``free`` (N,) of each is the speed that its roads allow [m/s]."""
    n, v = _Nodes(found), np.concatenate(free)
    drive = truck.drive
    i, j = _met(n, BODY + REACTION * v + v**2 / (2.0 * drive.max_deceleration))
    cosine = np.cos(n.course[i] - n.course[j])
    apart = np.hypot(n.x[i] - n.x[j], n.y[i] - n.y[j])
    ahead = n.speed[j] * np.maximum(cosine, 0.0)
    reach = BODY + REACTION * v[i] + np.maximum(v[i] ** 2 - ahead**2, 0.0) / (2.0 * drive.max_deceleration)
    crossing = (np.abs(cosine) < ALONG) & (n.leave[j] - n.arrive[j] < PASSING)
    late = n.arrive[i] + np.where(crossing, CLOSE, 0.0)
    begin = _before(n, i, reach)
    near = apart < np.where(cosine < AGAINST, ABREAST, WIDTH)
    real = near & (n.leave[j] > n.arrive[begin]) & (n.leave[j] < late)
    i, j, begin = i[real], j[real], begin[real]
    end = np.searchsorted(n.way, n.way[i] + v[i] ** 2 / (2.0 * drive.max_acceleration), side="right")
    change = np.bincount(begin, minlength=len(v) + 1) - np.bincount(end, minlength=len(v) + 1)
    flags, held = np.cumsum(change)[: len(v)] > 0, _held(n, begin, i, n.leave[j])
    parts = np.cumsum([r.size.sum() for r in found])[:-1]
    return list(zip(np.split(flags, parts), np.split(held, parts), strict=True))


def _held(n: _Nodes, begin: Ints, i: Ints, freed: Floats) -> Mask:
    """(N,) whether the way ahead was freed just before a truck set off from a node where it stood."""
    out = np.zeros(len(n.way), bool)
    order = np.argsort(i, kind="stable")
    i, begin, freed = i[order], begin[order], freed[order]
    for node in np.flatnonzero(n.leave - n.arrive > 0.0):
        a, b = np.searchsorted(i, [node, np.searchsorted(n.way, n.way[node] + NEAR)])
        out[node] = bool((freed[a:b][begin[a:b] <= node] > n.leave[node] - RELEASE).any())
    return out


def _before(n: _Nodes, i: Ints, reach: Floats) -> Ints:
    """The node that lies ``reach`` before node ``i``, within its errand."""
    return np.maximum(np.searchsorted(n.way, n.way[i] - reach), n.first[i])


def _met(n: _Nodes, reach: Floats) -> tuple[Ints, Ints]:
    """Pairs of a node and one of another vehicle near it that was left in the time that may matter."""
    column, row = np.floor(n.x / WIDTH).astype(np.int64), np.floor(n.y / WIDTH).astype(np.int64)
    origin = n.arrive.min()
    early, late = n.arrive[_before(n, np.arange(len(reach)), reach)] - origin, n.arrive - origin + CLOSE
    left = n.leave - origin
    span = float(max(left.max(), late.max())) + 1.0

    def key(dx: int, dy: int, time: Floats) -> Floats:
        cell = (column + dx - column.min() + 1) * (np.ptp(row) + 3) + (row + dy - row.min() + 1)
        return np.asarray(cell * span + time, dtype=np.float64)

    own = key(0, 0, left)
    order = np.argsort(own, kind="stable")  # What is looked for in this order lies near in memory
    own = own[order]
    pairs = []
    for dx, dy in product((-1, 0, 1), repeat=2):
        a, b = (np.searchsorted(own, key(dx, dy, time)[order]) for time in (early, late))
        count = np.maximum(b - a, 0)
        i = np.repeat(order, count)
        j = order[np.arange(len(i)) - np.repeat(np.cumsum(count) - count, count) + np.repeat(a, count)]
        other = n.vehicle[i] != n.vehicle[j]
        pairs.append((i[other], j[other]))
    return np.concatenate([p[0] for p in pairs]), np.concatenate([p[1] for p in pairs])

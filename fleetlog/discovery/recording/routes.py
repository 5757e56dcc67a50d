"""What every vehicle drove, stop by stop, as nodes in place and time, to see what trucks do to others."""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from fleetlog.core.arrays import Floats, Ints, Mask
from fleetlog.core.motion import join
from fleetlog.discovery.recording.blocks import Block, narrow
from fleetlog.discovery.recording.fleet import Fleet
from fleetlog.physics.motion.legs import Leg, legs

PURPOSE = 90.0  # A longer standstill has a purpose of its own [s]
LOAD, LIFT = 25.0, 0.08  # Change of payload [kg] and fork height [m] that show a purpose
APART = 1000.0  # Between the ways of two errands, so that nothing reaches from one into the other [m]
BESIDE = 6.0  # So far off its road, in a bay or a turn, a truck is told by the road before or behind [m]


@dataclass(frozen=True)
class Route:
    """One vehicle-day: its legs in order; (L,) of each.

    ``wait`` [s] of the standstill after a leg, NaN unknown; ``known``, whether the log would show a purpose
    of it; ``errand`` counts up with every standstill that had one.
    """

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
    def of(self) -> Ints:
        """(N,) leg of every node."""
        return np.repeat(np.arange(len(self.legs)), self.size)

    @cached_property
    def way(self) -> Floats:
        """(N,) metres driven up to every node, errands set apart."""
        before = np.cumsum([0.0, *(leg.distance[-1] for leg in self.legs)])[:-1] + APART * self.errand
        return np.concatenate([leg.distance + b for leg, b in zip(self.legs, before, strict=True)])

    def nodes(self, name: str) -> Floats:
        """(N,) a variable of the motion at every node."""
        return np.concatenate([getattr(leg.path, name) for leg in self.legs])

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


def routes(fleet: Fleet) -> list[Route]:
    """Return the routes of all vehicle-days."""
    return [r for r in (_route(b) for b in fleet.each_block()) if r is not None]


def _route(block: Block) -> Route | None:
    found = list(legs(block.known))
    if not found:
        return None
    # Views of one motion take less room than motions.
    ends = np.cumsum([0, *(len(leg.distance) for leg in found)])
    path = narrow(join([leg.path for leg in found]))
    found = [replace(leg, path=path[a:b]) for leg, (a, b) in zip(found, pairwise(ends), strict=True)]
    m = block.motion
    known = bool(m.payload.any() or m.fork_height.any())
    wait = np.array([leg.wait for leg in found])
    after = [leg.row[0] for leg in found[1:]] + [len(block) - 1]
    purpose = [
        not (w <= PURPOSE) or (known and _worked(block, leg.row[-1], n))
        for leg, w, n in zip(found, wait, after, strict=True)
    ]
    errand = np.cumsum([0, *purpose[:-1]])
    return Route(block.vehicle, block.day, float(block.time[0]), tuple(found), wait, known, errand)


def _worked(block: Block, first: int, last: int) -> bool:
    rows = block.first[first : last + 2]
    m = block.motion
    return bool(len(rows) and (np.ptp(m.payload[rows]) > LOAD or np.ptp(m.fork_height[rows]) > LIFT))


def on_road(leg: Leg) -> tuple[Leg, Mask]:
    """A leg with every node on the nearest road of its way, and (N,) where it truly was off the map."""
    off = leg.path.edge < 0
    if not off.any() or off.all():
        return leg, off
    on = np.flatnonzero(~off)
    near = on[np.abs(leg.distance[:, None] - leg.distance[on]).argmin(axis=1)]
    path = leg.path.replaced(edge=leg.path.edge[near], edge_offset=leg.path.edge_offset[near])
    return replace(leg, path=path), np.abs(leg.distance - leg.distance[near]) > BESIDE

"""Where trucks stand beside the road: a bay at every place, reached from a lane over a spur."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.site import Place, Site
from fleetlog.core.truck import Truck
from fleetlog.simulate.junctions import GAP, Junctions, half_box
from fleetlog.simulate.paths import arc, even
from fleetlog.simulate.track import SPACING, Track

Floats = NDArray[np.float64]

OFF_ROADS = 15.0
"""A place farther than this from every road is not on the site [m]."""
REACH = 25.0
"""A bay is drawn at most this far along the road from its place [m]."""
SHARES = (1.0, 0.7, 0.5)
"""Of the turn radius that the way into a bay is tried with, in this order; a truck creeps in there."""
STEP = 0.5


@dataclass(frozen=True)
class Bay:
    """A spot for one truck.

    ``lane`` is where its spur leaves at offset ``at`` [m]; ``path`` (n, 4) x, y, heading, curvature from there into the bay,
    ``length`` [m]; ``ahead`` [m] is how far before ``at`` a truck on the spur can be met on the lane.
    """

    place: Place
    lane: int
    at: float
    path: Floats
    length: float
    ahead: float


class BayMaker:
    """Finds free ground for bays, one after another."""

    def __init__(self, track: Track, junctions: Junctions, truck: Truck, side: float) -> None:
        from scipy.spatial import cKDTree

        self.track, self.junctions, self.truck, self.side = track, junctions, truck, side
        self.half = half_box(truck)
        self.tree = cKDTree(np.column_stack([track.x, track.y]))
        self.lanes = len(track.network)
        self._lane_tree = cKDTree(np.column_stack([track.x, track.y])[: track.first[self.lanes]])
        self.owner = np.repeat(np.arange(len(track)), np.diff(track.first))
        self.bays: list[Bay] = []
        self._taken = np.zeros((0, 3))
        self._swept = np.zeros((0, 3))

    def lanes_near(self, x: float, y: float) -> list[tuple[float, int, float]]:
        """(distance, lane, offset) of the lanes within reach of a point, nearest first."""
        found: dict[int, tuple[float, float]] = {}
        rows = np.asarray(self._lane_tree.query_ball_point((x, y), OFF_ROADS + 2.0), dtype=np.int64)
        gaps = np.hypot(self.track.x[rows] - x, self.track.y[rows] - y)
        for k in np.argsort(gaps, kind="stable"):
            lane = int(self.owner[rows[k]])
            if lane not in found:
                at = (rows[k] - self.track.first[lane]) * self.track.spacing[lane]
                found[lane] = (float(gaps[k]), float(at))
        return sorted((gap, lane, at) for lane, (gap, at) in found.items())

    def place(self, place: Place) -> Bay | None:
        """A bay for ``place`` on the nearest ground that is free, or None."""
        best: tuple[float, Bay] | None = None
        for gap, lane, at in self.lanes_near(place.x, place.y):
            if best is not None and gap > best[0] + REACH:
                break
            for shift in np.arange(0.0, REACH, STEP):
                if best is not None and gap + shift >= best[0]:
                    break
                bay = self._try(place, lane, at, shift)
                if bay is not None:
                    best = (gap + shift, bay)
                    break
        if best is None:
            return None
        self._keep(best[1])
        return best[1]

    def along(self, lane: int, at: float, place: Place) -> Bay | None:
        """A bay exactly at ``at`` on ``lane``, or None."""
        bay = self._try(place, lane, at, 0.0)
        if bay is not None:
            self._keep(bay)
        return bay

    def _keep(self, bay: Bay) -> None:
        self.bays.append(bay)
        self._taken = np.vstack([self._taken, bay.path[-1:, :3]])
        self._swept = np.vstack([self._swept, bay.path[:, :3]])

    def _try(self, place: Place, lane: int, at: float, shift: float) -> Bay | None:
        sides = (self.side,) if self._two_lanes(lane) else (self.side, -self.side)
        for share in SHARES:
            radius = share * self.truck.chassis.turn_radius
            for centre in (at - shift, at + shift) if shift else (at,):
                for side in sides:
                    bay = self._shape(place, lane, centre - radius, radius, side)
                    if bay is not None and self._free(bay):
                        return bay
        return None

    def _two_lanes(self, lane: int) -> bool:
        return (
            abs(float(self.track.lateral[self.track.first[lane] : self.track.first[lane + 1]].mean())) > 0.3
        )

    def _shape(self, place: Place, lane: int, at: float, radius: float, side: float) -> Bay | None:
        low, high = self.junctions.clear[lane], self.junctions.stop[lane]
        if high < low:
            # A single-lane aisle has no part of its own; whoever is on it has it to himself.
            low, high = 0.25, float(self.track.length[lane]) - 0.25
        k = int(self.track.first[lane] + round(at / self.track.spacing[lane]))
        at = (k - self.track.first[lane]) * float(self.track.spacing[lane])
        # At the very start of a lane a truck would have to stop before it is on it.
        if not max(low, 0.2) <= at <= high:
            return None
        start, heading = np.array([self.track.x[k], self.track.y[k]]), float(self.track.heading[k])
        into = np.array([np.cos(heading), np.sin(heading)])
        normal = side * np.array([-into[1], into[0]])
        aside = float((np.array([place.x, place.y]) - start) @ normal)
        need = self.half[0] + self.half[1] + 0.1
        deep = max(radius, need, min(aside, OFF_ROADS))
        bow = arc(start + radius * into, into, side * np.pi / 2.0, radius)
        end = start + radius * into + deep * normal
        path, length = even(np.concatenate([bow, [end]]) if deep > radius + 1e-3 else bow, 0.5 * SPACING)
        ahead = radius + self.half[1]
        return Bay(place, lane, at, path, length, max(ahead, self.half[0]))

    def _free(self, bay: Bay) -> bool:
        """Whether its ground is touched by no piece and no bay, and its spur by no safe part of another lane and no bay."""
        own = bay.lane
        reverse = (
            int(self.track.network.reverse[own])
            if self.junctions.stop[own] < self.junctions.clear[own]
            else -1
        )
        reach = 2.0 * float(np.hypot(*self.half))
        # From the bay outwards: most ground that is taken is taken there.
        for i, (x, y, heading, _) in reversed(list(enumerate(bay.path))):
            rows = np.asarray(self.tree.query_ball_point((x, y), reach), dtype=np.int64)
            if i < len(bay.path) - 1:
                safe = self.junctions.resource[rows] < 0
                rows = rows[safe & (self.owner[rows] != own) & (self.owner[rows] != reverse)]
            samples = np.column_stack([self.track.x[rows], self.track.y[rows], self.track.heading[rows]])
            if self._meets(x, y, heading, samples) or self._meets(x, y, heading, self._taken):
                return False
        x, y, heading, _ = bay.path[-1]
        return not self._meets(x, y, heading, self._swept)

    def _meets(self, x: float, y: float, heading: float, others: Floats) -> bool:
        from fleetlog.simulate.kernels.geometry import meets_any

        return bool(meets_any(x, y, heading, np.ascontiguousarray(others), *self.half))


def side_of(site: Site) -> float:
    """+1 where bays lie left of the lane, -1 right: the side that traffic keeps to."""
    return 1.0 if site.traffic == "left" else -1.0


def auto_places(maker: BayMaker, wanted: int, kinds: tuple[str, ...] = ("park", "pick", "drop")) -> list[Bay]:
    """Bays drawn along the lanes of a site without places, evenly over the roads; at most ``wanted``."""
    pitch = maker.truck.chassis.width + 2.0 * GAP
    spots: list[tuple[float, int, float]] = []
    for lane in range(maker.lanes):
        low, high = maker.junctions.clear[lane], maker.junctions.stop[lane]
        if high < low:
            low, high = 0.25, float(maker.track.length[lane]) - 0.25
        n = int(max(high - low, 0.0) / pitch)
        # The middle of a lane first, then its quarters ...: a few bays lie spread over all roads.
        spots += [(_spread(i), lane, low + (i + 0.5) / n * (high - low)) for i in range(n)]
    made: list[Bay] = []
    for _, lane, at in sorted(spots):
        if len(made) >= wanted:
            break
        kind = kinds[len(made) % len(kinds)]
        spot = maker.track.first[lane] + int(at / maker.track.spacing[lane])
        place = Place(f"{kind}-{len(made) + 1}", kind, float(maker.track.x[spot]), float(maker.track.y[spot]))  # type: ignore[arg-type]  # one of the kinds above
        bay = maker.along(lane, at, place)
        if bay is not None:
            made.append(bay)
    return made


def _spread(i: int) -> float:
    """Van der Corput's sequence of base 2: an order in which any first few are far apart."""
    out, share = 0.0, 0.5
    while i:
        out += share * (i & 1)
        i, share = i >> 1, share / 2.0
    return out

"""Where trucks stand beside the road: a bay at every place, reached from a lane over a spur."""

from __future__ import annotations

import numpy as np

from fleetlog.core.site import Place, Site
from fleetlog.core.truck import Truck
from fleetlog.simulate.arrays import Flags, Floats, Index
from fleetlog.simulate.junctions import Junctions, half_box
from fleetlog.simulate.paths import arc, even
from fleetlog.simulate.spurs import SHARES, Bay, Door, opposite_spur, span
from fleetlog.simulate.track import SPACING, Track

OFF_ROADS = 15.0
"""A place farther than this from every road is not on the site [m]."""
REACH = 25.0
"""A bay is drawn at most this far along the road from its place [m]."""
STEP = 0.5


class BayMaker:
    """Finds free ground for bays, one after another."""

    def __init__(self, track: Track, junctions: Junctions, truck: Truck, side: float) -> None:
        from scipy.spatial import cKDTree

        self.track, self.junctions, self.truck, self.side = track, junctions, truck, side
        self.half = half_box(truck)
        self.lanes = len(track.network)
        self._lane_tree = cKDTree(np.column_stack([track.x, track.y])[: track.first[self.lanes]])
        self.owner = np.repeat(np.arange(len(track), dtype=np.int32), np.diff(track.first))
        self.lasting = np.ones(self.lanes, dtype=bool)
        """(E,) lanes that bays may lie on."""
        self.bays: list[Bay] = []
        self._ground = Ground(track, junctions.resource < 0, self.owner, self.half)
        self._spurs: dict[tuple[float, float, float], tuple[Floats, float]] = {}

    def lanes_near(self, x: float, y: float) -> list[tuple[float, int, float]]:
        """(distance, lane, offset) of the lanes within reach of a point, nearest first."""
        found: dict[int, tuple[float, float]] = {}
        rows = np.asarray(self._lane_tree.query_ball_point((x, y), OFF_ROADS + 2.0), dtype=np.int64)
        gaps = np.hypot(self.track.x[rows] - x, self.track.y[rows] - y)
        for k in np.argsort(gaps, kind="stable"):
            lane = int(self.owner[rows[k]])
            if lane not in found and self.lasting[lane]:
                at = (rows[k] - self.track.first[lane]) * self.track.spacing[lane]
                found[lane] = (float(gaps[k]), float(at))
        return sorted((gap, lane, at) for lane, (gap, at) in found.items())

    def place(self, place: Place) -> Bay | None:
        """A bay on the nearest free ground, rather one that both lanes of its road lead to, or None."""
        near = self.lanes_near(place.x, place.y)
        bay = self._nearest(place, near, True) or self._nearest(place, near, False)
        if bay is not None:
            self._keep(bay)
        return bay

    def along(self, lane: int, at: float, place: Place) -> Bay | None:
        """A bay exactly at ``at`` on ``lane``, or None."""
        bay = self._try(place, lane, at, 0.0, False)
        if bay is not None:
            self._keep(bay)
        return bay

    def from_both(self, lane: int, centre: float, radius: float) -> bool:
        """Whether a bay beside ``centre`` [m] can be reached from the opposite lane too, or there is none."""
        t, reverse = self.track, int(self.track.network.reverse[lane])
        if reverse < 0:
            return True
        on_road = np.interp(max(centre, 0.0), *_offsets(t, lane))
        at = np.interp(t.network.length[lane] - on_road, *_offsets(t, reverse)[::-1]) - radius
        low, high = span(t, self.junctions, reverse)
        return bool(low + SPACING <= at <= high)

    def _nearest(self, place: Place, near: list[tuple[float, int, float]], both: bool) -> Bay | None:
        best: tuple[float, Bay] | None = None
        for gap, lane, at in near:
            if best is not None and gap > best[0] + REACH:
                break
            for shift in np.arange(0.0, REACH, STEP):
                if best is not None and gap + shift >= best[0]:
                    break
                bay = self._try(place, lane, at, float(shift), both)
                if bay is not None:
                    best = (gap + shift, bay)
                    break
        return None if best is None else best[1]

    def _keep(self, bay: Bay) -> None:
        self.bays.append(bay)
        self._ground.take(bay.door.path)

    def _try(self, place: Place, lane: int, at: float, shift: float, both: bool) -> Bay | None:
        sides = (self.side,) if self._two_lanes(lane) else (self.side, -self.side)
        for share in SHARES:
            radius = share * self.truck.chassis.turn_radius
            for centre in (at - shift, at + shift) if shift else (at,):
                if both and not self.from_both(lane, centre, SHARES[-1] * self.truck.chassis.turn_radius):
                    continue
                for side in sides:
                    bay = self._shape(place, lane, centre - radius, radius, side)
                    if bay is not None and self._free(bay) and (not both or self._opposite_free(bay)):
                        return bay
        return None

    def _two_lanes(self, lane: int) -> bool:
        # Lanes of one road lie beside its centre line all along, by the same distance.
        middle = (self.track.first[lane] + self.track.first[lane + 1]) // 2
        return abs(float(self.track.lateral[middle])) > 0.3

    def _shape(self, place: Place, lane: int, at: float, radius: float, side: float) -> Bay | None:
        low, high = span(self.track, self.junctions, lane)
        k = int(self.track.first[lane] + round(at / self.track.spacing[lane]))
        at = (k - self.track.first[lane]) * float(self.track.spacing[lane])
        if not low <= at <= high:
            return None
        x, y, heading = float(self.track.x[k]), float(self.track.y[k]), float(self.track.heading[k])
        c, s = np.cos(heading), np.sin(heading)
        aside = side * ((place.y - y) * c - (place.x - x) * s)
        need = self.half[0] + self.half[1] + 0.1
        shape, length = self._spur(radius, max(radius, need, min(aside, OFF_ROADS)), side)
        path = shape.copy()
        path[:, 0], path[:, 1] = x + c * shape[:, 0] - s * shape[:, 1], y + s * shape[:, 0] + c * shape[:, 1]
        path[:, 2] += heading
        door = Door(lane, at, path, length, max(radius + self.half[1], self.half[0]))
        return Bay(place, door)

    def _spur(self, radius: float, deep: float, side: float) -> tuple[Floats, float]:
        """The way into a bay ``deep`` m to one side, from the origin and heading along x."""
        key = (radius, deep, side)
        if key not in self._spurs:
            bow = arc(np.array([radius, 0.0]), np.array([1.0, 0.0]), side * np.pi / 2.0, radius)
            points = np.concatenate([bow, [[radius, side * deep]]]) if deep > radius + 1e-3 else bow
            self._spurs[key] = even(points, 0.5 * SPACING)
        return self._spurs[key]

    def _free(self, bay: Bay) -> bool:
        """Whether no piece or bay touches its ground, no bay or other lane's safe part its spur."""
        own = bay.door.lane
        narrow = self.junctions.stop[own] < self.junctions.clear[own]
        return self._ground.is_free(
            bay.door.path, own, int(self.track.network.reverse[own]) if narrow else -1
        )

    def _opposite_free(self, bay: Bay) -> bool:
        """Whether the opposite lane of its road leads to it too; True where there is none."""
        reverse = int(self.track.network.reverse[bay.door.lane])
        for share in SHARES:
            radius = share * self.truck.chassis.turn_radius
            door = opposite_spur(self.track, self.junctions, bay.door, radius, self.half[1])
            if door is not None and self._ground.is_free(door.path, bay.door.lane, reverse):
                return True
        return reverse < 0


class Ground:
    """What trucks stand on and drive over, in cells."""

    def __init__(self, track: Track, safe: Flags, owner: Index, half: tuple[float, float]) -> None:
        from fleetlog.simulate.kernels.ground import new_cells, put

        self.half, cell = half, 2.0 * float(np.hypot(*half))
        boxes = np.column_stack([track.x, track.y, track.heading])
        self._extent = (track.x, track.y, cell)
        self.every = new_cells(*self._extent, len(boxes))
        self.safe = new_cells(*self._extent, int(safe.sum()))
        put(self.every, boxes, owner)
        put(self.safe, boxes[safe], owner[safe])
        self.parked, self.swept = new_cells(*self._extent, 64), new_cells(*self._extent, 4096)

    def is_free(self, path: Floats, lane: int, reverse: int) -> bool:
        """See ``spur_is_free``."""
        from fleetlog.simulate.kernels.ground import spur_is_free

        return bool(
            spur_is_free(path, self.every, self.safe, self.parked, self.swept, *self.half, lane, reverse)
        )

    def take(self, path: Floats) -> None:
        """A truck may stand at the end of ``path`` (n, 4) and drive over all of it."""
        from fleetlog.simulate.kernels.ground import grown, put

        self.parked, self.swept = grown(self.parked, 1), grown(self.swept, len(path))
        put(self.parked, path[-1:], np.zeros(1, np.int32))
        put(self.swept, path, np.zeros(len(path), np.int32))


def side_of(site: Site) -> float:
    """+1 where bays lie left of the lane, -1 right: the side that traffic keeps to."""
    return 1.0 if site.traffic == "left" else -1.0


def _offsets(t: Track, lane: int) -> tuple[Floats, Floats]:
    """Metres along a lane of its samples, and along its road."""
    rows = slice(t.first[lane], t.first[lane + 1])
    return np.arange(rows.stop - rows.start) * t.spacing[lane], t.offset[rows]

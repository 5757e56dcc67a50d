"""Where trucks stand beside the road: a bay at every place, reached from a lane over a spur."""

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from fleetlog.core.site import Place
from fleetlog.core.truck import Truck
from fleetlog.simulate.arrays import Floats
from fleetlog.simulate.doors import SHARES, Bay, Door, Stand, door_beside, opposite_spur, span
from fleetlog.simulate.junctions import Junctions, half_box
from fleetlog.simulate.track import SPACING, Track, arc, even, moved

OFF_ROADS = 15.0  # A place farther than this from every road is not on the site [m]
REACH = 25.0  # A bay is drawn at most this far along the road from its place [m]
STEP = 0.5


class BayMaker:
    """Finds free ground for bays, one after another."""

    def __init__(
        self, track: Track, junctions: Junctions, truck: Truck, side: float, stands: Mapping[str, Stand]
    ) -> None:
        from scipy.spatial import cKDTree

        from fleetlog.simulate.kernels.geometry import PASSED, SAFE, new_cells, put

        self.track, self.junctions, self.truck, self.side = track, junctions, truck, side
        self.stands = stands
        self.half = half_box(truck)
        lanes = len(track.network)
        self._lane_tree = cKDTree(np.column_stack([track.x, track.y])[: track.first[lanes]])
        self.radii = [share * truck.chassis.turn_radius for share in SHARES]
        self.lasting = np.ones(lanes, dtype=bool)
        """(E,) lanes that bays may lie on."""
        self.bays: list[Bay] = []
        boxes = np.column_stack([track.x, track.y, track.heading])
        self._ground = new_cells(track.x, track.y, 2.0 * float(np.hypot(*self.half)), len(boxes))
        kind = np.where(junctions.resource < 0, SAFE, PASSED).astype(np.int32)
        put(self._ground, boxes, track.owner, kind)

    def lanes_near(self, x: float, y: float) -> list[tuple[float, int, float]]:
        """(distance, lane, offset) of the lanes within reach of a point, nearest first."""
        found: dict[int, tuple[float, float]] = {}
        rows = np.asarray(self._lane_tree.query_ball_point((x, y), OFF_ROADS + 2.0), dtype=np.int64)
        gaps = np.hypot(self.track.x[rows] - x, self.track.y[rows] - y)
        for k in np.argsort(gaps, kind="stable"):
            lane = int(self.track.owner[rows[k]])
            if lane not in found and self.lasting[lane]:
                at = (rows[k] - self.track.first[lane]) * self.track.spacing[lane]
                found[lane] = (float(gaps[k]), float(at))
        return sorted((gap, lane, at) for lane, (gap, at) in found.items())

    def place(self, place: Place) -> Bay | None:
        """Where recorded trucks stood along the road; else a bay on the nearest free ground, rather one that
        both lanes of its road lead to; or None."""
        stand = self.stands.get(place.id)
        if stand is not None:
            near = self.lanes_near(stand.x, stand.y)
            door = door_beside(self.track, self.junctions, self.truck, stand, near)
            if door is not None:
                self.bays.append(Bay(place, door, stand.turns))
                return self.bays[-1]
        near = self.lanes_near(place.x, place.y)
        return self._kept(place, self._nearest(place, near, True) or self._nearest(place, near, False))

    def along(self, lane: int, at: float, place: Place) -> Bay | None:
        """A bay exactly at ``at`` on ``lane``, or None."""
        return self._kept(place, self._try(place, lane, at, 0.0, False))

    def _kept(self, place: Place, door: Door | None) -> Bay | None:
        from fleetlog.simulate.kernels.geometry import PARKED, PASSED, grown, put

        if door is None:
            return None
        self.bays.append(Bay(place, door))
        kind = np.full(len(door.path), PASSED, np.int32)
        kind[-1] = PARKED
        self._ground = grown(self._ground, len(kind))
        put(self._ground, door.path, np.full_like(kind, -1), kind)
        return self.bays[-1]

    def from_both(self, lane: int, centre: float, radius: float) -> bool:
        """Whether a bay beside ``centre`` [m] can be reached from the opposite lane too, or there is none."""
        t, reverse = self.track, int(self.track.network.reverse[lane])
        if reverse < 0:
            return True
        on_road = np.interp(max(centre, 0.0), *_offsets(t, lane))
        at = np.interp(t.network.length[lane] - on_road, *_offsets(t, reverse)[::-1]) - radius
        low, high = span(t, self.junctions, reverse)
        return bool(low + SPACING <= at <= high)

    def _nearest(self, place: Place, near: list[tuple[float, int, float]], both: bool) -> Door | None:
        best: tuple[float, Door] | None = None
        for gap, lane, at in near:
            if best is not None and gap > best[0] + REACH:
                break
            for shift in np.arange(0.0, REACH, STEP):
                if best is not None and gap + shift >= best[0]:
                    break
                door = self._try(place, lane, at, float(shift), both)
                if door is not None:
                    best = (gap + shift, door)
                    break
        return None if best is None else best[1]

    def _try(self, place: Place, lane: int, at: float, shift: float, both: bool) -> Door | None:
        # Lanes of one road lie beside its centre line all along, by the same distance.
        middle = (self.track.first[lane] + self.track.first[lane + 1]) // 2
        two_lanes = abs(float(self.track.lateral[middle])) > 0.3
        sides = (self.side,) if two_lanes else (self.side, -self.side)
        for radius in self.radii:
            for centre in (at - shift, at + shift) if shift else (at,):
                if both and not self.from_both(lane, centre, self.radii[-1]):
                    continue
                for side in sides:
                    door = self._shape(place, lane, centre - radius, radius, side)
                    if door is not None and self._fits(door, both):
                        return door
        return None

    def _shape(self, place: Place, lane: int, at: float, radius: float, side: float) -> Door | None:
        t, (low, high) = self.track, span(self.track, self.junctions, lane)
        k = int(t.first[lane] + round(at / t.spacing[lane]))
        at = (k - t.first[lane]) * float(t.spacing[lane])
        if not low <= at <= high:
            return None
        x, y, heading = float(t.x[k]), float(t.y[k]), float(t.heading[k])
        aside = side * ((place.y - y) * np.cos(heading) - (place.x - x) * np.sin(heading))
        need = self.half[0] + self.half[1] + 0.1
        shape, length = _into(radius, max(radius, need, min(aside, OFF_ROADS)), side)
        return Door(lane, at, moved(shape, x, y, heading), length, max(radius + self.half[1], self.half[0]))

    def _free(self, door: Door, lane: int, reverse: int) -> bool:
        """Whether no piece or bay touches its ground, no bay or safe part of other lanes its spur."""
        from fleetlog.simulate.kernels.geometry import spur_is_free

        return bool(spur_is_free(self._ground, door.path, *self.half, lane, reverse))

    def _fits(self, door: Door, both: bool) -> bool:
        """Whether there is room for a door, with ``both`` also for one from the opposite lane."""
        j, reverse = self.junctions, int(self.track.network.reverse[door.lane])
        narrow = j.stop[door.lane] < j.clear[door.lane]
        if not self._free(door, door.lane, reverse if narrow else -1):
            return False
        doors = (opposite_spur(self.track, j, door, r, self.half[1]) for r in self.radii)
        return not both or reverse < 0 or any(d and self._free(d, door.lane, reverse) for d in doors)


@lru_cache(maxsize=4096)
def _into(radius: float, deep: float, side: float) -> tuple[Floats, float]:
    """The way into a bay ``deep`` m to one side, from the origin and heading along x."""
    bow = arc(np.array([radius, 0.0]), np.array([1.0, 0.0]), side * np.pi / 2.0, radius)
    points = np.concatenate([bow, [[radius, side * deep]]]) if deep > radius + 1e-3 else bow
    return even(points, 0.5 * SPACING)


def _offsets(t: Track, lane: int) -> tuple[Floats, Floats]:
    """Metres along a lane of its samples, and along its road."""
    rows = slice(t.first[lane], t.first[lane + 1])
    return np.arange(rows.stop - rows.start) * t.spacing[lane], t.offset[rows]

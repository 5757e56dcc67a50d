"""Where trucks stand beside the road: bays at places, or along its roads where a site has too few of them."""

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from fleetlog.core.arrays import Floats, Ints, Mask
from fleetlog.core.site import Place, PlaceKind, Site
from fleetlog.core.truck import Truck
from fleetlog.core.words import count, listed
from fleetlog.errors import SiteError
from fleetlog.simulate.doors import SHARES, Bay, Door, Stand, door_beside, opposite_spur, span
from fleetlog.simulate.junctions import GAP, Junctions, half_box
from fleetlog.simulate.track import SPACING, Track, arc, even, moved
from fleetlog.simulate.ways import main_part

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
        self.given, self.stands, self.half = stands, dict(stands), half_box(truck)
        lanes = len(track.network)
        self._lane_tree = cKDTree(np.column_stack([track.x, track.y])[: track.first[lanes]])
        self.radii = [share * truck.chassis.turn_radius for share in SHARES]
        self.lasting = np.ones(lanes, dtype=bool)  # (E,) lanes that bays may lie on
        self.bays: list[Bay] = []
        boxes = np.column_stack([track.x, track.y, track.heading])
        self._ground = new_cells(track.x, track.y, 2.0 * float(np.hypot(*self.half)), len(boxes))
        put(self._ground, boxes, track.owner, np.where(junctions.resource < 0, SAFE, PASSED).astype(np.int32))

    def lanes_near(self, x: float, y: float) -> list[tuple[float, int, float]]:
        """(distance, lane, offset) of the lanes within reach of a point, nearest first."""
        t, rows = self.track, np.array(self._lane_tree.query_ball_point((x, y), OFF_ROADS + 2.0), np.int64)
        rows = rows[self.lasting[t.owner[rows]]]
        gaps = np.hypot(t.x[rows] - x, t.y[rows] - y)
        order = np.argsort(gaps, kind="stable")
        lanes, first = np.unique(t.owner[rows[order]], return_index=True)
        k = order[first]
        at = (rows[k] - t.first[lanes]) * t.spacing[lanes]
        return sorted(zip(gaps[k].tolist(), lanes.tolist(), at.tolist(), strict=True))

    def place(self, place: Place) -> Bay | None:
        """Where recorded trucks stood; else the nearest free ground, best one both lanes lead to; or None."""
        if (stand := self.stands.get(place.id)) is not None:
            door = door_beside(self.track, self.junctions, self.truck, stand, self.lanes_near(*stand[:2]))
            if door is not None:
                self.bays.append(Bay(place, door, stand.turns))
                return self.bays[-1]
        near = self.lanes_near(place.x, place.y)
        return self._kept(place, self._nearest(place, near, True) or self._nearest(place, near, False))

    def on_road(self, place: Place) -> Bay | None:
        """A bay at the nearest spot on the road itself, where others pass who stands."""
        t, j, near = self.track, self.junctions, self.lanes_near(place.x, place.y)
        rows = [int(t.first[e] + round(np.clip(at, *span(t, j, e)) / t.spacing[e])) for _, e, at in near]
        k = min(rows, key=lambda k: float(np.hypot(t.x[k] - place.x, t.y[k] - place.y)))
        self.stands[place.id] = Stand(float(t.x[k]), float(t.y[k]), float(t.heading[k]), False)
        return self.place(place)

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

    def from_both(self, lane: int, centre: Floats | float, radius: float) -> Mask:
        """Whether a bay beside ``centre`` [m] can be reached from the opposite lane too, or there is none."""
        t, reverse = self.track, int(self.track.network.reverse[lane])
        if reverse < 0:
            return np.ones(np.shape(centre), dtype=np.bool_)
        on_road = np.interp(np.maximum(centre, 0.0), *offsets(t, lane))
        at = np.interp(t.network.length[lane] - on_road, *offsets(t, reverse)[::-1]) - radius
        low, high = span(t, self.junctions, reverse)
        return np.asarray((low + SPACING <= at) & (at <= high))

    def _nearest(self, place: Place, near: list[tuple[float, int, float]], both: bool) -> Door | None:
        """The door that is nearest to the place, across the road and along it."""
        shifts = np.arange(0.0, REACH, STEP).tolist()
        spots = sorted((gap + s, n, lane, at, s) for n, (gap, lane, at) in enumerate(near) for s in shifts)
        doors = (self._try(place, lane, at, shift, both) for _, _, lane, at, shift in spots)
        return next((door for door in doors if door is not None), None)

    def _try(self, place: Place, lane: int, at: float, shift: float, both: bool) -> Door | None:
        # Lanes of one road lie beside its centre line all along, by the same distance.
        middle = (self.track.first[lane] + self.track.first[lane + 1]) // 2
        two_lanes = abs(self.track.lateral[middle]) > 0.3
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
        # The rear that swings out where others turn in across the road touches nobody who stands here.
        need = self.half[0] + float(np.hypot(self.half[0], radius + self.half[1])) - radius + 0.05
        shape, length = _into(radius, max(radius, need, min(aside, OFF_ROADS)), side)
        return Door(lane, at, moved(shape, x, y, heading), length, max(radius + self.half[1], self.half[0]))

    def _fits(self, door: Door, both: bool) -> bool:
        """Whether there is room for a door, with ``both`` also for one from the opposite lane: no piece
        or bay touches its ground, no bay or safe part of other lanes its spur."""
        from fleetlog.simulate.kernels.geometry import spur_is_free

        j, lane, reverse = self.junctions, door.lane, int(self.track.network.reverse[door.lane])
        narrow = j.stop[lane] < j.clear[lane]
        if not spur_is_free(self._ground, door.path, *self.half, lane, reverse if narrow else -1):
            return False
        doors = (opposite_spur(self.track, j, door, r, self.half[1]) for r in self.radii)
        spurs = (d.path for d in doors if d is not None)
        free = (spur_is_free(self._ground, path, *self.half, lane, reverse) for path in spurs)
        return not both or reverse < 0 or any(free)


@lru_cache(maxsize=4096)
def _into(radius: float, deep: float, side: float) -> tuple[Floats, float]:
    """The way into a bay ``deep`` m to one side, from the origin and heading along x."""
    bow = arc(np.array([radius, 0.0]), np.array([1.0, 0.0]), side * np.pi / 2.0, radius)
    points = np.concatenate([bow, [[radius, side * deep]]]) if deep > radius + 1e-3 else bow
    return even(points, 0.5 * SPACING)


def offsets(t: Track, lane: int) -> tuple[Floats, Floats]:
    """Metres along a lane of its samples, and along its road."""
    rows = slice(t.first[lane], t.first[lane + 1])
    return np.arange(rows.stop - rows.start) * t.spacing[lane], t.offset[rows]


def lay_out(site: Site, maker: BayMaker, vehicles: int, mined: frozenset[str], spots: int) -> list[str]:
    """Make bays at places and for ``spots`` trucks; notes, or :class:`SiteError` (see ``_at_place``)."""
    # Bays are at lanes that lead to one another and to most of the places.
    network, near = maker.track.network, dict[str, Ints]()
    for place in site.places:
        lanes = maker.lanes_near(place.x, place.y)
        if place.id not in mined and (not lanes or lanes[0][0] > OFF_ROADS):
            do = f"move it to within {OFF_ROADS:.0f} m of a road, or draw the road that leads there"
            raise SiteError(f"place {place.id!r} at ({place.x:.1f}, {place.y:.1f}) is off the roads", do=do)
        near[place.id] = np.array([lane for _, lane, _ in lanes], dtype=np.int64)
    maker.lasting = main_part(network, near.values())
    out = {p.id: why for p in site.places if (why := _at_place(maker, p, near[p.id], p.id in mined))}
    # Trucks come to the other direction of a road where they stop through its bays.
    beside = ~maker.lasting & (network.reverse >= 0) & maker.lasting[network.reverse]
    lost, notes = "cannot be reached and left again: nobody stops there", []
    turned = "joined to the others by no turn: trucks turn round at places"
    for k, what in ((~maker.lasting & ~beside, lost), (beside, turned)):
        told = f"{k.sum()} of {len(network)} lanes ({network.length[k].sum():.0f} m) {what}"
        notes += [told] if k.any() else []
    for why in dict.fromkeys(out.values()):
        notes.append(f"places left out, {why}: {listed([repr(p) for p in out if out[p] == why])}")
    if on_road := [repr(p) for p in maker.stands if p not in maker.given]:
        notes.append(f"no room beside the road at {listed(on_road)}: trucks stand on it there, others pass")
    notes += _drawn(site, maker, spots)
    room = sum(b.place.kind != "charge" for b in maker.bays)
    if vehicles > room - 1:
        what = f"a fleet of {vehicles} is more than the site can hold: {max(room - 1, 0)} have room to park"
        raise SiteError(what, do="simulate fewer trucks or add roads and parking places")
    return notes


def _at_place(maker: BayMaker, place: Place, lanes: Ints, mined: bool) -> str | None:
    """Make the bays of a place with ``lanes`` near, the nearest first; why it gets none."""
    wanted = max(place.plugs, 1)
    made = sum(maker.place(place) is not None for _ in range(wanted))
    if made >= (wanted if place.kind == "charge" and not mined else 1):
        return None
    roads = maker.track.network.roads
    beside = [e for e in lanes if roads[e] == roads[lanes[0]]]
    if beside and not made and not maker.lasting[beside].any():
        return "which cannot be reached from the others and left again"
    if mined:
        return "which the recording shows where there is no room for a truck beside the road"
    if not made and place.kind != "charge" and maker.on_road(place) is not None:
        return None
    what = f"no room for a truck of {maker.truck.chassis.length:g} m beside the road at place {place.id!r}"
    raise SiteError(what, do="move the place to a longer stretch of road, or away from its neighbours")


def _drawn(site: Site, maker: BayMaker, vehicles: int) -> list[str]:
    """Draw the bays that the site lacks; what to say about them."""
    notes, kinds = [], {b.place.kind for b in maker.bays}
    if not site.places:
        made = auto_places(maker, max(24, 3 * vehicles))
        return [f"the site has no places: {count(made, 'spot')} to park, pick and drop drawn along its roads"]
    if not kinds & {"pick", "drop"}:
        made = auto_places(maker, max(12, 2 * vehicles), ("pick", "drop"))
        notes.append(f"the site has no pick or drop place: {count(made, 'spot')} drawn along its roads")
    if (free := sum(b.place.kind != "charge" for b in maker.bays)) < 2 * vehicles + 2:
        made = auto_places(maker, 2 * vehicles + 2 - free, ("park",), "spot")
        more = f"{count(made, 'further parking spot')} drawn along the roads for {count(vehicles, 'truck')}"
        notes += [more] if made else []
    return notes


def auto_places(
    maker: BayMaker, wanted: int, kinds: tuple[PlaceKind, ...] = ("park", "pick", "drop"), name: str = ""
) -> int:
    """Make at most so many bays, evenly over the roads, called after their kinds or a ``name``; how many."""
    pitch, radius = maker.truck.chassis.width + 2.0 * GAP, maker.truck.chassis.turn_radius
    spots: list[tuple[bool, float, int, float]] = []
    for lane in np.flatnonzero(maker.lasting).tolist():
        low, high = span(maker.track, maker.junctions, lane)
        n = int(max(high - low, 0.0) / pitch)
        centres = low + (np.arange(n) + 0.5) / max(n, 1) * (high - low)
        for i, (at, both) in enumerate(zip(centres, maker.from_both(lane, centres, radius), strict=True)):
            # First those that both lanes of a road lead to; of these the middle of a lane, then its quarters
            # ..., by the binary digits mirrored (van der Corput): a few bays lie spread over all roads.
            spread = int(f"{i:b}"[::-1], 2) / 2 ** i.bit_length()
            spots.append((not both, spread, lane, at))
    made = 0
    for *_, lane, at in sorted(spots):
        if made >= wanted:
            break
        kind = kinds[made % len(kinds)]
        spot = maker.track.first[lane] + int(at / maker.track.spacing[lane])
        x, y = float(maker.track.x[spot]), float(maker.track.y[spot])
        made += maker.along(lane, at, Place(f"{name or kind}-{made + 1}", kind, x, y)) is not None
    return made

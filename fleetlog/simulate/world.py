"""Everything that stays put in a simulation: lanes, junctions, bays, speed caps, ways; when people cross."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from itertools import compress, product
from types import MappingProxyType
from typing import Any

import numpy as np

from fleetlog.core.arrays import Floats, Index, Ints, Mask
from fleetlog.core.motion import Motion
from fleetlog.core.site import Site
from fleetlog.core.truck import Truck
from fleetlog.core.words import count, listed
from fleetlog.physics.motion.legs import standing_still
from fleetlog.physics.power import Physics, allowed_speed
from fleetlog.roads.routing import Router
from fleetlog.simulate.bays import BayMaker, lay_out, offsets
from fleetlog.simulate.doors import Bay, Door, Stand, all_doors, span
from fleetlog.simulate.junctions import Junctions, find_junctions, half_box, lanes_at, unique_pairs
from fleetlog.simulate.state import HAIR, PLAN, Roads, Trucks
from fleetlog.simulate.track import SPACING, Track, assemble, build_track
from fleetlog.simulate.ways import Ways, with_loops

SHORT = 0.5  # Trucks stop this far before a zone that people cross [m]
TURN_TIME = 3.0  # What a half turn costs in choosing a route [s]


@dataclass
class World:
    """The site as trucks drive on it, laid out for ``truck``; ``physics`` of each of ``trucks.kinds``."""

    site: Site
    trucks: Trucks
    truck: Truck
    physics: list[Physics]
    track: Track
    ground: Track  # The track with the spurs behind it: piece len(track) + d is the spur of door d
    bays: list[Bay]
    doors: list[Door]
    roads: Roads
    ways: Ways
    walks: Floats  # (Z, E) where trucks stop before each zone that people cross [m]; inf: nowhere
    notes: list[str] = field(default_factory=list)


def build_world(
    site: Site, trucks: Trucks | Truck, vehicles: int, physics: Physics | None = None,
    mined: frozenset[str] = frozenset(), room: int = 0, stands: Mapping[str, Stand] = MappingProxyType({}),
    start: float = 0.0,
) -> World:  # fmt: skip
    """Lay out a site, ``mined`` places if there is room; :class:`SiteError` if it cannot hold the trucks.
    Times of the physics count from ``start`` [s since 1970]; trucks drive as fast as they do then."""
    site, notes = with_loops(site)
    network = site.roads()
    trucks = Trucks.given(trucks, vehicles) if isinstance(trucks, Truck) else trucks
    truck = trucks.envelope
    trucks, own, absent = _with_own(trucks, physics or Physics(truck), start)
    notes = [*notes, *absent]
    at_start = [p.at(0.0) for p in own]
    fastest = max((p.actual_truck.drive for p in at_start), key=lambda d: d.max_speed * d.speed_factor)
    if narrow := [*dict.fromkeys(compress(network.roads, network.width < truck.chassis.width))]:
        what = f"the map has {count(len(narrow), 'road')} narrower than a truck of {truck.chassis.width:g} m"
        notes.append(f"{what}, first {narrow[0]!r}: trucks drive there all the same")
    track = build_track(network, truck, site.traffic)
    junctions = find_junctions(track, truck)
    maker = BayMaker(track, junctions, truck, 1.0 if site.traffic == "left" else -1.0, stands)
    notes += lay_out(site, maker, vehicles, mined, max(vehicles, room))
    doors = all_doors(track, junctions, maker.bays, truck)
    ground = with_spurs(track, doors)
    walks = stops_before(site, track, truck.chassis.length)
    roads = _roads(site, track, junctions, doors, ground, truck, at_start, walks)
    limit = np.where(np.isfinite(network.speed_limit), network.speed_limit, fastest.max_speed)
    pace = np.minimum(limit * fastest.speed_factor, fastest.max_speed)
    ways = Ways(track, Router(network, pace, turn_time=TURN_TIME), doors, len(maker.bays))
    return World(site, trucks, truck, own, track, ground, maker.bays, doors, roads, ways, walks, notes)


def _with_own(trucks: Trucks, physics: Physics, start: float) -> tuple[Trucks, list[Physics], list[str]]:
    """The trucks with those apart that have values of their own, the physics of each kind, and what to say of
    vehicles that the physics names and the fleet has not."""
    if not physics.own:
        return trucks, [replace(physics, truck=kind) for kind in trucks.kinds], []
    names = vehicle_names(len(trucks.of))
    named = zip(names, trucks.of.tolist(), strict=True)
    keys = [(k, tuple(o.vehicles is None or n in o.vehicles for o in physics.own)) for n, k in named]
    kinds = list(dict.fromkeys(keys))
    of = np.array([kinds.index(key) for key in keys], np.int32)
    apart = Trucks(tuple(trucks.kinds[k] for k, _ in kinds), of, tuple(which for _, which in kinds))
    first = [names[keys.index(kind)] for kind in kinds]
    own = [replace(physics.of(n, start), truck=t) for n, t in zip(first, apart.kinds, strict=True)]
    absent = sorted({v for o in physics.own for v in o.vehicles or ()} - {*names})
    note = f"the model has values of its own for {listed(absent)}, which this fleet lacks"
    return apart, own, [note] if absent else []


def vehicle_names(n: int) -> list[str]:
    """T1 ... Tn, padded to one width."""
    return [f"T{i + 1:0{len(str(n))}d}" for i in range(n)]


def with_spurs(track: Track, doors: list[Door]) -> Track:
    """The track with one piece more for each door, laid on the edge of its lane."""
    none = np.full(len(doors), -1, np.int32)
    lanes = np.array([d.lane for d in doors], dtype=np.int32)
    spurs = assemble(track.network, [(d.path, d.length) for d in doors], none, none, lanes)
    spurs = replace(spurs, first=spurs.first[1:] + track.first[-1], slope=np.zeros(len(spurs.x)))
    parts = (f.name for f in fields(Track) if f.name != "network")
    joined: dict[str, Any] = {n: np.concatenate([getattr(track, n), getattr(spurs, n)]) for n in parts}
    return replace(track, **joined)


def caps(site: Site, track: Track, physics: list[Physics]) -> Floats:
    """(2 K, S) highest speed [m/s] of truck k without (row 2 k) and with a load (2 k + 1), by limits of roads
    and zones, truck and terms, braking ahead of every bend included."""
    from fleetlog.simulate.kernels.geometry import brake_ahead

    limit = np.nan_to_num(track.network.speed_limit, nan=np.inf)[track.edge]
    # In the middle of a connector the lower of the two limits holds on both sides of the change.
    change = np.flatnonzero(np.diff(track.edge) != 0)
    change = change[track.source[track.owner[change]] >= 0]
    limit[change] = limit[change + 1] = np.minimum(limit[change], limit[change + 1])
    limit, out = np.minimum(limit, site.zone_limit(track.x, track.y)), []
    for p, laden in product(physics, (False, True)):
        truck = p.actual_truck
        motion = Motion.of(
            len(track.x), speed=np.minimum(limit * truck.drive.speed_factor, truck.drive.max_speed),
            curvature=track.curvature, slope=track.slope, heading=track.heading, x=track.x, y=track.y,
            edge=track.edge, edge_offset=track.offset, payload=0.5 * truck.chassis.rated_load * laden,
        )  # fmt: skip
        out.append(np.maximum(allowed_speed(motion, p), 0.05))
        brake_ahead(out[-1], track.first, track.spacing, PLAN * truck.drive.max_deceleration)
    return np.array(out)


def stops_to_wait(track: Track, j: Junctions, physics: list[Physics]) -> tuple[Ints, Floats, Floats]:
    """(K E + 1,) first stops of trucks k on lanes e, where they are [m] and how long each lasts [s]: by terms
    that act as a wait; of one in a junction, where the lane has room beside it."""
    network, stops = track.network, list[tuple[int, float, float]]()
    for k, p in enumerate(physics):
        for e in sorted({e for where in p.waits for e in where.edge.tolist() if e >= 0}):
            along = np.linspace(0.0, network.length[e], int(network.length[e] / SPACING) + 2)
            path = Motion.of(len(along), edge=np.full(len(along), e), edge_offset=along)
            node, seconds = standing_still(path, p)
            at = np.clip(np.interp(along[node], *offsets(track, e)[::-1]), *span(track, j, e)).tolist()
            stops += [(k * len(network) + e, *stop) for stop in zip(at, seconds.tolist(), strict=True)]
    row, at, seconds = np.array(sorted(stops), dtype=np.float64).reshape(-1, 3).T.copy()
    return np.searchsorted(row, np.arange(len(physics) * len(network) + 1)).astype(np.int64), at, seconds


def _roads(
    site: Site, track: Track, j: Junctions, doors: list[Door], ground: Track, truck: Truck,
    physics: list[Physics], walks: Floats,
) -> Roads:  # fmt: skip
    from fleetlog.simulate.kernels.geometry import meetings

    on_spur = ground.owner >= len(track)
    met = meetings(ground.x, ground.y, ground.z, ground.heading, ground.owner, on_spur, *half_box(truck))
    a, b = np.append(j.conflicts, _spur_conflicts(track, j, doors, ground, met), axis=0).T
    count = len(track) + 2 * len(track.network) + len(doors)
    key = np.unique(np.append(a * count + b, b * count + a))
    first = np.searchsorted(key, np.arange(count + 1, dtype=np.int64) * count)
    cap = caps(site, track, physics)
    enter = cap[:, track.first[: len(track.network)]].reshape(len(physics), 2, -1).min(axis=1)
    brake = PLAN * np.array([p.actual_truck.drive.max_deceleration for p in physics])[:, None]
    run_in = (enter * enter / (2.0 * brake) + HAIR * enter).max(axis=0)
    kinds = {"lane": np.int32, "crosses": np.int32}
    by_door: dict[str, Any] = {
        f"door_{name}": np.array([getattr(d, name) for d in doors], kinds.get(name, np.float64))
        for name in ("lane", "at", "length", "ahead", "crosses", "low", "high")
    }
    _, off = _over(by_door["door_lane"], track, ground, met)
    onto, over = _over(by_door["door_crosses"], track, ground, met)
    return Roads(
        track.first, track.spacing, track.length, track.slope, cap, *stops_to_wait(track, j, physics),
        walks.min(axis=0, initial=np.inf), run_in, j.clear, j.stop, j.capacity, track.swings, first,
        (key % count).astype(np.int32), **by_door, door_off=off, door_onto=onto, door_over=over,
    )  # fmt: skip


def _over(lane: Index, track: Track, g: Track, met: Ints) -> tuple[Floats, Floats]:
    """(D,) metres along each spur between which a truck on it is over lane ``lane`` (D,), by the samples of
    the ground that trucks would meet on, ``met``: one of them kept to both sides."""
    spur = g.owner[met[:, 1]]
    which, at = spur - len(track), (met[:, 1] - g.first[spur]) * g.spacing[spur]
    length, over = g.length[len(track) :], g.owner[met[:, 0]] == lane[which]
    low, high, pad = length.copy(), np.zeros(len(lane)), g.spacing[len(track) :]
    np.minimum.at(low, which[over], at[over])
    np.maximum.at(high, which[over], at[over])
    return np.maximum(low - pad, 0.0), np.minimum(high + pad, length)


def _spur_conflicts(track: Track, j: Junctions, doors: list[Door], g: Track, met: Ints) -> Ints:
    """(N, 2) resources that exclude each other because of a spur, but for those that lead onto its lane;
    ``met`` (P, 2) samples of the ground, the second on a spur."""
    samples, spurs = len(track.x), len(track) + 2 * len(track.network)
    resource = np.append(j.resource, g.owner[samples:] - len(track) + spurs).astype(np.int64)
    # b > a always, and spurs come last: b is the spur.
    a, b = resource[met].T
    passed = np.append(np.zeros(spurs, dtype=bool), [d.passed for d in doors])
    keep = (a >= 0) & ~passed[a] & ~passed[b]
    found = unique_pairs(a[keep], b[keep])
    lane = np.array([d.lane for d in doors], dtype=np.int64)[found[:, 1] - spurs]
    _, entered, _, target = lanes_at(track, spurs + len(doors))[:, found[:, 0]]
    return np.asarray(found[(entered != lane) & (target != lane)])


def stops_before(site: Site, track: Track, length: float) -> Floats:
    """(Z, E) where trucks of a length stop on each lane before each zone that closes [m]; inf: nowhere."""
    lanes = len(track.network)
    samples = slice(0, track.first[lanes])
    zones = [zone for zone in site.zones if zone.closed_every > 0.0]
    out = np.full((len(zones), lanes), np.inf)
    for row, zone in zip(out, zones, strict=True):
        inside = np.flatnonzero(zone.contains(track.x[samples], track.y[samples]))
        lane = track.owner[inside]
        np.minimum.at(row, lane, (inside - track.first[lane]) * track.spacing[lane])
        row -= 0.5 * length + SHORT
        # Who cannot stand before the zone on its lane goes through.
        row[row <= 0.0] = np.inf
    return out


class Crossings:
    """When people cross, all for as long; exponential times of a mean lie between; a function of the seed."""

    def __init__(self, site: Site, stops: Floats, seed: int) -> None:
        self._zones, self._lanes = [z for z in site.zones if z.closed_every > 0.0], np.isfinite(stops)
        self._rng = [np.random.Generator(np.random.PCG64([seed, 11, k])) for k in range(len(self._zones))]
        self._begin = [r.exponential(z.closed_every) for r, z in zip(self._rng, self._zones, strict=True)]

    def tick(self, now: float, closed: Mask) -> None:
        """Mark the lanes that are ``closed`` (E,) at ``now`` [s]."""
        closed[:] = False
        for k, zone in enumerate(self._zones):
            while self._begin[k] + zone.closed_for <= now:
                self._begin[k] += zone.closed_for + self._rng[k].exponential(zone.closed_every)
            if self._begin[k] <= now:
                closed |= self._lanes[k]

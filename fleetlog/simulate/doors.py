"""The ways into a bay: from its own lane, and across it from the opposite one, to turn round."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fleetlog.core.arrays import Floats, Ints
from fleetlog.core.site import Place, Site
from fleetlog.core.truck import Truck
from fleetlog.simulate.junctions import START, Junctions, half_box
from fleetlog.simulate.places import Stands
from fleetlog.simulate.track import SPACING, Track, bow, even, moved

SHARES = (1.0, 0.7, 0.5)
"""Of the turn radius that the way into a bay is tried with, in this order; a truck creeps in there."""
EDGE = 0.25  # Kept to the ends of a lane without a safe part [m]
DEEPEST = 25.0  # A bay farther than this from the opposite lane has no way from there [m]
ALONG = 0.7  # Directions within this of one another, or of that of a road, are alike [rad]
BESIDE = 6.0  # A spot along the road is at most this far from a lane [m]
LENGTH = 0.01  # Of a spur to where a truck stands on the road [m]


@dataclass(frozen=True)
class Door:
    """A spur between a lane and a bay, driven forwards into it and backwards out of it.

    It leaves ``lane`` at ``at`` [m]; ``path`` (n, 4) x, y, heading, curvature leads from there into bay
    number ``bay``, ``length`` [m]; a truck on it can be met on the lane up to ``ahead`` [m] past ``at``.  It
    crosses lane ``crosses`` (-1: none): no truck there is between ``low`` and ``high`` [m] meanwhile.
    ``passed``: it leads to a spot along the road, where others pass who stands."""

    lane: int
    at: float
    path: Floats
    length: float
    ahead: float
    bay: int = -1
    crosses: int = -1
    low: float = 0.0
    high: float = 0.0
    passed: bool = False


class Bay(NamedTuple):
    """A spot for one truck, and the door on the lane beside it."""

    place: Place
    door: Door
    turns: bool = True  # Whether trucks turn round there, if they can


def span(track: Track, j: Junctions, lane: int) -> tuple[float, float]:
    """First and last offset [m] of a lane where a truck may stand; in a single-lane aisle, alone."""
    low, high = float(j.clear[lane]), float(j.stop[lane])
    if high < low:
        low, high = EDGE, float(track.length[lane]) - EDGE
    return max(low, START), high


def opposite_spur(track: Track, j: Junctions, bay: Door, radius: float, half_width: float) -> Door | None:
    """The spur, an arc of ``radius`` [m], from the opposite lane to a bay; None without room."""
    if (lane := int(track.network.reverse[bay.lane])) < 0:
        return None
    rows = slice(track.first[lane], track.first[lane + 1])
    x, y, heading, _ = bay.path[-1]
    dx, dy = x - track.x[rows], y - track.y[rows]
    c, s = np.cos(track.heading[rows]), np.sin(track.heading[rows])
    along, aside = dx * c + dy * s, dy * c - dx * s
    if not (fits := (along >= radius) & (np.abs(aside) < DEEPEST)).any():
        return None
    nearest = int(np.argmin(np.where(fits, along, np.inf)))
    k, ahead, left = rows.start + nearest, float(along[nearest]), float(aside[nearest])
    at = (k - int(track.first[lane])) * float(track.spacing[lane])
    low, high = span(track, j, lane)
    if ahead > radius + 2.0 * SPACING or abs(left) < radius or not low <= at <= high:
        return None
    toward = float(track.heading[k])
    turn = float(np.angle(np.exp(1j * (heading - toward))))
    shape, length = bow(round(ahead, 3), round(left, 3), round(turn, 4), 0.5 * SPACING)
    return Door(lane, at, moved(shape, track.x[k], track.y[k], toward), length, ahead + half_width)


class Stand(NamedTuple):
    """Where recorded trucks stood and how they came [m, rad]; whether two turned round there."""

    x: float
    y: float
    heading: float
    turns: bool


def recorded_stands(
    site: Site, stands: Stands, cluster: Ints, names: Sequence[str]
) -> tuple[Site, Ints, list[str], dict[str, Stand]]:
    """How trucks stood at each place. They leave in the direction in which they came: for every direction a
    place of its own, in ``site``, ``cluster`` and ``names`` too; of a charger the one of at least half."""
    cluster, names, known, out = cluster.copy(), list(names), {p.id: p for p in site.places}, {}
    for k, name in enumerate(tuple(names)):
        left, own, number = np.flatnonzero((cluster == k) & np.isfinite(stands.into)), name, k
        charges, visits = known[name].kind == "charge", len(left)
        while len(left) > (visits // 2 if charges else 0):
            into = stands.into[left]
            alike = np.cos(into[:, None] - into) > np.cos(ALONG)
            chosen = alike[np.argmax(alike.sum(axis=1))]
            mine, left = left[chosen], left[~chosen]
            if charges and 2 * len(mine) < visits:
                break
            if number != k:
                own = f"{name}.{number}"
                known[own], names = replace(known[name], id=own, plugs=0), [*names, own]
            cluster[mine], number = number, len(names)
            turns = bool((np.cos(stands.out[mine] - stands.into[mine]) < 0.0).sum() >= min(2, len(mine)))
            x, y = (float(np.median(values[mine])) for values in (stands.x, stands.y))
            out[own] = Stand(x, y, float(np.angle(np.exp(1j * stands.into[mine]).mean())), turns)
    return replace(site, places=tuple(known.values())), cluster, names, out


def door_beside(
    track: Track, junctions: Junctions, truck: Truck, stand: Stand, near: Sequence[tuple[float, int, float]]
) -> Door | None:
    """The spot on the nearest lane that leads as trucks came; None where no lane ``near`` does."""
    for _, lane, at in (one for one in near if one[0] <= BESIDE):
        low, high = span(track, junctions, lane)
        if stand.turns and (other := int(track.network.reverse[lane])) >= 0:
            # So far from the crossing that the opposite lane has room beside it too.
            first, last = (track.length[other] - o for o in span(track, junctions, other)[::-1])
            low, high = max(low, first + SPACING), min(high, last - SPACING)
        k = int(track.first[lane] + round(float(np.clip(at, low, high)) / track.spacing[lane]))
        if high < low or abs(np.angle(np.exp(1j * (track.heading[k] - stand.heading)))) > ALONG:
            continue
        path = moved(np.outer([0.0, LENGTH], [1.0, 0.0, 0.0, 0.0]), track.x[k], track.y[k], track.heading[k])
        on_lane = (k - track.first[lane]) * float(track.spacing[lane])
        return Door(lane, on_lane, path, LENGTH, 0.5 * truck.chassis.length, passed=True)
    return None


def turning_door(track: Track, junctions: Junctions, truck: Truck, own: Door) -> Door | None:
    """The half turn, a half circle, between where a truck stands and the opposite lane; None without one."""
    if (lane := int(track.network.reverse[own.lane])) < 0:
        return None
    rows, stands = slice(track.first[lane], track.first[lane + 1]), own.path[-1, :2]
    k = int(np.argmin(np.hypot(track.x[rows] - stands[0], track.y[rows] - stands[1])))
    at, (low, high) = k * float(track.spacing[lane]), span(track, junctions, lane)
    start = np.array([track.x[rows][k], track.y[rows][k]])
    side = stands - start
    if not low <= at <= high or np.hypot(*side) < 2.0 * SPACING:
        return None
    middle, arm, toward = 0.5 * (start + stands), 0.5 * (start - stands), float(track.heading[rows][k])
    left = np.array([-arm[1], arm[0]])
    sign = 1.0 if left @ (np.cos(toward), np.sin(toward)) > 0.0 else -1.0
    angle = np.linspace(0.0, np.pi, 33)[:, None]
    path, length = even(middle + np.cos(angle) * arm + sign * np.sin(angle) * left, 0.5 * SPACING)
    reach = 0.5 * (float(np.hypot(*side)) + truck.chassis.length)
    crossed = own.lane if junctions.capacity[own.lane] > 0 else -1
    crossing = crossed, max(own.at - reach, 0.0), own.at + reach
    return Door(lane, at, path, length, reach, own.bay, *crossing, passed=True)


def all_doors(track: Track, junctions: Junctions, bays: list[Bay], truck: Truck) -> list[Door]:
    """Door b of bay b on its own lane, for every bay; then those on opposite lanes that have room."""
    own = [replace(bay.door, bay=b) for b, bay in enumerate(bays)]
    passed = [d for d in own if d.passed and bays[d.bay].turns]
    opposite = [d for door in passed if (d := turning_door(track, junctions, truck, door)) is not None]
    todo = [b for b, bay in enumerate(bays) if not bay.door.passed]
    for share in SHARES:
        radius, half_width = share * truck.chassis.turn_radius, half_box(truck)[1]
        tried = ((b, opposite_spur(track, junctions, bays[b].door, radius, half_width)) for b in todo)
        found = [replace(d, bay=b) for b, d in tried if d is not None]
        good = _checked(track, junctions, bays, found, truck)
        opposite += good
        todo = sorted({*todo} - {d.bay for d in good})
    return own + sorted(opposite, key=lambda d: d.bay)


def _checked(track: Track, j: Junctions, bays: list[Bay], doors: list[Door], truck: Truck) -> list[Door]:
    """Those that touch no parked truck and only lanes that they end on or cross; with that crossing."""
    from fleetlog.simulate.kernels.geometry import meetings

    if not doors:
        return []
    samples, pieces = len(track.x), len(track)
    bay = np.array([d.bay for d in doors])
    near = np.array([bays[b].door.lane for b in bay])
    ends, shape = np.array([b.door.path[-1] for b in bays]), np.concatenate([d.path for d in doors])
    parts = zip((track.x, track.y, track.heading), ends.T, shape.T, strict=False)
    x, y, heading = (np.concatenate(part) for part in parts)
    number = np.repeat(np.arange(len(doors)), [len(d.path) for d in doors])
    floor = track.z[track.first[[b.door.lane for b in bays]]]
    z = np.concatenate([track.z, floor, floor[bay[number]]])
    owner = np.concatenate([track.owner, pieces + np.arange(len(bays)), pieces + len(bays) + number])
    start, lane = samples + len(bays), np.array([d.lane for d in doors])
    ask = np.arange(len(x)) >= start
    a, b = meetings(x, y, z, heading, owner.astype(np.int32), ask, *half_box(truck)).T
    beside = owner[a] != lane[number[b - start]]
    a, door = a[beside], number[b[beside] - start]
    on_track, crossed = a < samples, owner[a] == near[door]
    safe = on_track & (j.resource[np.minimum(a, samples - 1)] < 0)
    parked = ~on_track & (a < start) & (owner[a] - pieces != bay[door])
    bad = np.isin(np.arange(len(doors)), door[parked | (safe & ~crossed)])
    low, high, at = np.full(len(doors), np.inf), np.full(len(doors), -np.inf), near[door]
    offset = (a - track.first[at]) * track.spacing[at]
    np.minimum.at(low, door[crossed], offset[crossed])
    np.maximum.at(high, door[crossed], offset[crossed])
    crosses, pad = (j.capacity[near] > 0) & (low <= high), track.spacing[near]
    return [
        replace(d, crosses=int(near[i]), low=low[i] - pad[i], high=high[i] + pad[i]) if crosses[i] else d
        for i, d in enumerate(doors)
        if not bad[i]
    ]

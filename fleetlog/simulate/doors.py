"""The ways into a bay: from its own lane, and across it from the opposite one, to turn round."""

from dataclasses import replace

import numpy as np

from fleetlog.core.truck import Truck
from fleetlog.simulate.junctions import Junctions, half_box
from fleetlog.simulate.roadside import turning_door
from fleetlog.simulate.spurs import SHARES, Bay, Door, opposite_spur
from fleetlog.simulate.track import Track


def all_doors(track: Track, junctions: Junctions, bays: list[Bay], truck: Truck) -> list[Door]:
    """Door b of bay b on its own lane, for every bay; then those on opposite lanes that have room."""
    half = half_box(truck)
    own = [replace(bay.door, bay=b) for b, bay in enumerate(bays)]
    passed = [d for d in own if d.passed and bays[d.bay].turns]
    opposite = [d for door in passed if (d := turning_door(track, junctions, truck, door)) is not None]
    todo = [b for b, bay in enumerate(bays) if not bay.door.passed]
    for share in SHARES:
        tried = [
            opposite_spur(track, junctions, bays[b].door, share * truck.chassis.turn_radius, half[1])
            for b in todo
        ]
        found = [replace(d, bay=b) for b, d in zip(todo, tried, strict=True) if d is not None]
        good = _checked(track, junctions, bays, found, half)
        opposite += good
        done = {d.bay for d in good}
        todo = [b for b in todo if b not in done]
    return own + sorted(opposite, key=lambda d: d.bay)


def _checked(
    track: Track, j: Junctions, bays: list[Bay], doors: list[Door], half: tuple[float, float]
) -> list[Door]:
    """Those that touch no parked truck and only lanes that they end on or cross; with that crossing."""
    from fleetlog.simulate.kernels.geometry import meetings

    if not doors:
        return []
    samples, pieces = len(track.x), len(track)
    bay = np.array([d.bay for d in doors])
    near = np.array([bays[b].door.lane for b in bay])
    ends, shape = np.array([b.door.path[-1] for b in bays]), np.concatenate([d.path for d in doors])
    x, y, heading = (
        np.concatenate([t, ends[:, k], shape[:, k]]) for k, t in enumerate((track.x, track.y, track.heading))
    )
    number = np.repeat(np.arange(len(doors)), [len(d.path) for d in doors])
    floor = track.z[track.first[[b.door.lane for b in bays]]]
    z = np.concatenate([track.z, floor, floor[bay[number]]])
    owner = np.concatenate([track.owner, pieces + np.arange(len(bays)), pieces + len(bays) + number])
    start = samples + len(bays)
    skip = np.full(len(x), -1, np.int32)
    skip[start:] = np.array([d.lane for d in doors])[number]
    pairs = meetings(x, y, z, heading, owner.astype(np.int32), skip >= 0, *half, skip)
    a, door = pairs[:, 0], number[np.maximum(pairs[:, 1] - start, 0)]
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

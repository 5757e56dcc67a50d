"""How the drivers of a recording drive: what each asks of speed limit, acceleration, brakes and turns."""

from dataclasses import replace
from typing import Any

import numpy as np

from fleetlog.core.arrays import Floats, Mask
from fleetlog.core.motion import Motion
from fleetlog.core.site import Site
from fleetlog.core.truck import Truck
from fleetlog.physics.motion import measured_channels, reconstruct
from fleetlog.simulate.state import DRIVER, PLAN
from fleetlog.simulate.track import SWING, Track, build_track
from fleetlog.store.dataset import Dataset

LEAST = 30.0  # Seconds of cruising, of speeding up, of braking, of turning that tell what a driver does there
STEADY, CHANGES = 0.08, 0.15  # Below the first a truck keeps its speed, above the second it changes it [m/s2]
STRAIGHT, TURNS = 0.03, 0.1
"""Below the first curvature a road is straight, above the second a truck turns [1/m]."""
NEAR, FEW = 2.0, 10
"""A truck is slowest within so many seconds of where it goes over to the next edge; turns that are enough."""
SHARE = 0.6  # A little above the middle: rows once a second round off the highest values
MOST = 16  # Drivers that are told apart; of more, neighbours in speed are one


def recorded_drivers(dataset: Dataset, truck: Truck) -> tuple[Truck, ...]:
    """The truck as each vehicle of a recording was driven."""
    track = build_track(dataset.site.roads(), truck, dataset.site.traffic)
    found = []
    for vehicle in dataset.vehicles:
        rows = measured_channels(dataset.read(vehicle), dataset.meta)
        one = reconstruct(rows, dataset.site.network, truck).motion if len(rows) > 1 else None
        found.append(truck if one is None else driven(one, dataset.site, truck, track))
    out = list(found)
    by_speed = np.argsort([t.drive.speed_factor for t in found], kind="stable")
    for group in np.array_split(by_speed, min(len(found), MOST)):
        drives = [found[k].drive for k in group]
        mean: dict[str, Any] = {n: float(np.mean([getattr(d, n) for d in drives])) for n in DRIVER}
        for k in group:
            out[k] = replace(truck, drive=replace(truck.drive, **mean))
    return tuple(out)


def driven(motion: Motion, site: Site, truck: Truck, track: Track) -> Truck:
    """The truck with the typical speed, acceleration and braking of a recorded motion."""
    speed, change = motion.speed, motion.acceleration
    # The last one holds off the roads, where the edge is -1.
    signs = np.append(np.nan_to_num(site.roads().speed_limit, nan=np.inf), np.inf)
    limit = np.minimum(signs[motion.edge], site.zone_limit(motion.x, motion.y))
    limit = np.minimum(limit, truck.drive.max_speed)
    drives = (speed > 0.5) & (motion.dt > 0.0)
    straight = drives & (np.abs(motion.curvature) < STRAIGHT)
    steady, slow = straight & (np.abs(change) < STEADY), straight & (speed < 0.8 * limit)
    asked = {
        "speed_factor": _typical(speed / limit, steady & (speed > 0.6 * limit), motion.dt),
        "max_acceleration": _typical(change, slow & (change > CHANGES), motion.dt),
        "max_deceleration": _typical(-change / PLAN, slow & (change < -CHANGES), motion.dt),
        "max_lateral_acceleration": _in_turns(motion, track),
    }
    known = {name: value for name, value in asked.items() if value is not None}
    return replace(truck, drive=replace(truck.drive, **known))


def _in_turns(motion: Motion, track: Track) -> float | None:
    """The lateral acceleration [m/s2] that the turns as they are drawn take at the recorded speeds."""
    changes = np.flatnonzero((np.diff(motion.edge) != 0) & (motion.edge[1:] >= 0) & (motion.edge[:-1] >= 0))
    found = []
    for k in changes.tolist():
        piece = track.by_turn.get((int(motion.edge[k]), int(motion.edge[k + 1])), -1)
        near = slice(*np.searchsorted(motion.time, motion.time[k] + np.array([-NEAR, NEAR])))
        if piece >= 0:
            path = track.curvature[track.first[piece] : track.first[piece + 1]]
            bend, turn = float(np.abs(path).max()), abs(float(path.sum()) * track.spacing[piece])
            if bend > TURNS and turn < SWING:
                found.append(float(motion.speed[near].min()) ** 2 * bend)
    # Who has just set off, or waits, is slower than the turn asks for.
    return round(float(np.quantile(found, 0.85)), 3) if len(found) >= FEW else None


def _typical(values: Floats, chosen: Mask, weight: Floats) -> float | None:
    """What was chosen is below this for ``SHARE`` of its time; None where it is too little."""
    if weight[chosen].sum() < LEAST:
        return None
    typical = np.quantile(values[chosen], SHARE, weights=weight[chosen], method="inverted_cdf")
    return round(float(typical), 3)

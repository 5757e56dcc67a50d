"""The speed channel: legs laid end to end, and what their travel times are missing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.motion import Motion
from fleetlog.core.trajectory import Trajectory
from fleetlog.discovery.bench import MATERIAL
from fleetlog.discovery.bends import STEP
from fleetlog.discovery.candidates import Candidate, knobs
from fleetlog.discovery.explain import Explained, Options, explained, make_task
from fleetlog.discovery.fleet import Fleet
from fleetlog.discovery.journeys import Journeys
from fleetlog.discovery.legs import Leg, legs
from fleetlog.discovery.model import Found
from fleetlog.discovery.stretches import make_stretches
from fleetlog.discovery.windows import Windows
from fleetlog.errors import DataError
from fleetlog.physics.power import all_terms

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

WINDOW = 12.0
"""Length of path whose time is taken together [m]."""
PLACE = 0.05
"""Share of the time at a place that counts there: less is the profile's own roughness."""
MOST_NODES = 1_000_000
"""Of longer recordings every other leg, every third and so on is looked at."""
LEAST_WAIT = 2.0
"""A shorter standstill is no wait [s]."""
FEWEST_STOPS = 5
OFTEN = 0.25
"""Share of passages that stand at a place where there is something to wait for."""
TIGHT = 0.85
"""Share of the sharpest curvature above which a bend is taken at its own speed."""
HONEST = 0.15
"""Share by which drivers may take turns otherwise than the truck file says."""


def speed_channel(fleet: Fleet, channel: str, base: Found, options: Options) -> Explained:
    """Search, judge and word what the travel times are missing."""
    journeys = gather(fleet)
    free, curves = journeys.curves(base)
    named = [
        Candidate(n, "field" if t.field else "scalar", t, t.depends_on, () if t.field else knobs(t))
        for n, t in sorted(all_terms().items())
        if t.acts == "speed" and t.parameters and (not options.terms or n in options.terms)
    ]
    turns = lateral_acceleration(journeys)
    nominal = base.value(all_terms()["cornering_speed"], "lateral_acceleration")
    if turns is None or abs(turns[0] / nominal - 1.0) < HONEST:
        # Turns are taken as the truck file says: then whatever is slow, it is not that.
        named = [c for c in named if c.name != "cornering_speed"]
    task = make_task(journeys, [*named, *curves], free, journeys.floor, base, options)
    # A place of waiting belongs to one direction of the road, and not to its neighbours.
    lanes = journeys.lanes
    task = replace(
        task,
        material=(MATERIAL, PLACE),
        own_floors={"waiting": lanes},
        own_roots={"waiting": np.eye(len(lanes))},
    )
    direct = {} if turns is None else {"cornering_speed": {"lateral_acceleration": turns}}
    out = explained(task, channel, f"rms error of the time for {WINDOW:.0f} m, over rms time", direct)
    journeys.latest.forget()
    return out


def gather(fleet: Fleet) -> Journeys:
    """All legs of a fleet."""
    assert fleet.network is not None
    floor = make_stretches(fleet.network)
    parts = _spaced(list(_all_legs(fleet)))
    if len(parts) < 10:
        raise DataError(
            "too few drives lie on the map",
            do="check the site, or leave the channel speed out with --channels",
        )
    motion, metres, inside, of, recorded, frame = _laid_out(fleet, parts)
    lanes = make_stretches(fleet.network, apart=True)
    cell, lane = floor.at(motion)[0], lanes.at(motion)[0]
    usable = np.isfinite(recorded) & (recorded > 0.0)
    gated = _gated(parts, inside, lane, len(lanes))
    return Journeys(
        frame, np.where(usable, recorded, 0.0), usable, motion, metres, inside, of, cell, lane, gated, fleet.truck, floor, lanes,
        len(fleet.vehicles),
    )  # fmt: skip


def _gated(
    parts: list[tuple[int, Trajectory, Leg]], inside: NDArray[np.bool_], lane: NDArray[np.int32], count: int
) -> NDArray[np.bool_]:
    """(count,) stretches where a good share of those who come by stand without a purpose."""
    size = np.array([len(leg.edge) for _, _, leg in parts])
    end = np.cumsum(size) - 1
    stood = np.array([leg.wait > LEAST_WAIT for _, _, leg in parts])
    stops = np.bincount(lane[end[stood]], minlength=count)
    begin = np.flatnonzero(np.concatenate([[True], (np.diff(lane) != 0) | ~inside[1:]]))
    passes = np.bincount(lane[begin], minlength=count)
    near = np.maximum(stops, np.maximum(np.roll(stops, 1), np.roll(stops, -1)))
    return (near >= FEWEST_STOPS) & (near > OFTEN * passes)


def lateral_acceleration(j: Journeys) -> tuple[float, float] | None:
    """v^2 |curvature| at the slowest point of the tightest bends: median and its standard error; None with too few."""
    seconds = np.where(j.inside, np.diff(j.motion.time, prepend=j.motion.time[:1]), 0.0)
    bend = np.abs(j.motion.curvature)
    tight = bend > TIGHT / j.truck.chassis.turn_radius
    change = np.flatnonzero(np.diff(np.concatenate([[0], tight.astype(int), [0]])))
    seen = []
    for a, b in zip(change[::2], change[1::2], strict=True):
        # A bend at the very begin of the first leg has no way into it.
        if b - a < 4 or a < 3 or not j.inside[a - 3 : b + 3].all() or seconds[a:b].max() > 5.0:
            continue
        # Mean over three steps: the slowest single one is the noisiest.
        pace = np.convolve(seconds[a - 1 : b + 1], np.ones(3) / 3.0, "valid")
        k = int(np.argmax(pace))
        v = STEP * j.metres[a + k] / pace[k]
        seen.append(v * v * bend[a + k])
    if len(seen) < FEWEST_STOPS:
        return None
    values = np.array(seen)
    middle = float(np.median(values))
    return middle, float(1.4826 * np.median(np.abs(values - middle)) / np.sqrt(len(values)))


def _spaced(parts: list[tuple[int, Trajectory, Leg]]) -> list[tuple[int, Trajectory, Leg]]:
    """Every k-th leg where there are so many that memory would run out: a sample of drives over all vehicles and days."""
    nodes = sum(len(leg.edge) for _, _, leg in parts)
    return parts[:: max(1, round(nodes / MOST_NODES))]


def _all_legs(fleet: Fleet) -> Iterator[tuple[int, Trajectory, Leg]]:
    assert fleet.network is not None
    for vehicle, trajectory in fleet.days:
        if trajectory.has("edge_id"):
            for leg in legs(trajectory, fleet.network, fleet.truck.chassis.turn_radius):
                yield vehicle, trajectory, leg


def _laid_out(
    fleet: Fleet, parts: list[tuple[int, Trajectory, Leg]]
) -> tuple[Motion, Floats, NDArray[np.bool_], Ints, Floats, Windows]:
    """Nodes of all legs end to end, their windows, and the seconds recorded in each."""
    assert fleet.network is not None
    size = np.array([len(leg.edge) for _, _, leg in parts])
    begin = np.concatenate([[0], np.cumsum(size)[:-1]])
    inside = np.ones(int(size.sum()), bool)
    inside[begin] = False

    def laid(values: list[NDArray[Any]]) -> NDArray[Any]:
        return np.concatenate(values)

    edge = laid([leg.edge for _, _, leg in parts])
    offset = laid([leg.offset for _, _, leg in parts])
    time = laid([leg.time + t.time[0] * 1e-6 for _, t, leg in parts])
    place = fleet.network.position(edge, offset)
    drive = fleet.truck.drive
    limit = np.nan_to_num(fleet.network.speed_limit[edge], nan=np.inf) * drive.speed_factor
    motion = Motion.of(
        len(edge), time=time, dt=0.0, speed=np.minimum(limit, drive.max_speed), heading=fleet.network.heading(edge, offset),
        curvature=laid([leg.curvature for _, _, leg in parts]), payload=np.repeat([leg.payload for _, _, leg in parts], size),
        x=place[:, 0], y=place[:, 1], edge=edge, edge_offset=offset, vehicle=np.repeat([v for v, _, _ in parts], size),
        soc=laid([t.floats("soc")[leg.row] for _, t, leg in parts]),
        ambient_temperature=laid([t.floats("ambient_temperature")[leg.row] for _, t, leg in parts]),
    )  # fmt: skip
    # A window holds WINDOW metres of one leg; the last takes the rest.
    local = np.concatenate(
        [np.minimum(np.arange(n) * STEP // WINDOW, max((n - 1) * STEP // WINDOW - 1, 0)) for n in size]
    )
    count = np.array([int(local[b + n - 1]) + 1 for b, n in zip(begin, size, strict=True)])
    of = (local + np.repeat(np.concatenate([[0], np.cumsum(count)[:-1]]), size)).astype(np.int64)
    seconds = np.where(inside, np.diff(time, prepend=time[:1]), 0.0)
    recorded = np.asarray(np.bincount(of, seconds), dtype=np.float64)
    last = np.cumsum(count) - 1
    recorded[last] += np.array([leg.wait for _, _, leg in parts])
    metres = laid([leg.metres for _, _, leg in parts])
    driven = np.asarray(np.bincount(of, np.where(inside, STEP * metres, 0.0)), dtype=np.float64)
    middle = np.searchsorted(of, np.arange(len(recorded))) + np.bincount(of) // 2
    day = np.concatenate(
        [np.full(n, int(t.time[0] // 86_400_000_000)) for n, (_, t, _) in zip(size, parts, strict=True)]
    )
    trip = np.repeat([leg.trip + 1_000_000 * v for v, _, leg in parts], size)
    # Noise grows with the time a metre takes, so metres stand in for the duration of a window.
    windows = Windows(
        trip=trip[middle], vehicle=motion.vehicle[middle], day=day[middle], edge=edge[middle].astype(np.int64),
        duration=np.maximum(driven, STEP), distance=driven, x=motion.x[middle],
        y=motion.y[middle], time=time[middle],
    )  # fmt: skip
    return motion, metres, inside, of, recorded, windows

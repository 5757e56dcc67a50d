"""The speed channel: the time that stretches of a path took, against the quickest drive that limits, turns and truck allow.

A profile forward under acceleration and backward under braking is one pass over all legs laid end to end: between standstills
v^2 - 2 a s cannot grow, so a running minimum is the profile.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.motion import Motion
from fleetlog.core.trajectory import Trajectory
from fleetlog.core.truck import Truck
from fleetlog.discovery import generic
from fleetlog.discovery.bends import STEP
from fleetlog.discovery.candidates import Candidate, knobs, moved, tilted
from fleetlog.discovery.explain import Explained, Options, explained, make_task
from fleetlog.discovery.fleet import Fleet
from fleetlog.discovery.legs import Leg, legs
from fleetlog.discovery.model import Found
from fleetlog.discovery.residual import MATERIAL, Columns, Table
from fleetlog.discovery.stretches import Stretches, make_stretches
from fleetlog.discovery.windows import Windows
from fleetlog.errors import DataError
from fleetlog.physics.power import Physics, all_terms, allowed_speed

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

WINDOW = 12.0
"""Length of path whose time is taken together [m]."""
SLOWEST = 0.15
"""Mean speed over a step of the path is not taken below this [m/s]."""
PLACE = 0.05
"""Share of the time at a place that counts there: less is the profile's own roughness."""
CRUDE = 0.05
"""Share of a window's time that a profile of constant accelerations may be off by."""
MOST_NODES = 1_000_000
"""Of longer recordings every other leg, every third and so on is looked at."""
ZONE = 1.05
"""A zone slows down; a factor above this is no zone."""
LEAST_WAIT = 2.0
"""A shorter standstill is no wait [s]."""
FEWEST_STOPS = 5
OFTEN = 0.25
"""Share of passages that stand at a place where there is something to wait for."""
TIGHT = 0.85
"""Share of the sharpest curvature above which a bend is taken at its own speed."""
HONEST = 0.15
"""Share by which drivers may take turns otherwise than the truck file says."""
MORE = 0.02
"""Relative step for the sensitivity to a value of the truck."""


@dataclass(frozen=True)
class Journeys:
    """All legs laid end to end: G nodes, W windows; implements what the search needs of a channel.

    ``motion`` (G,) with ``speed`` the limit that drivers may use; ``metres`` (G,) driven for a metre of map; ``inside`` (G,)
    whether the node has a predecessor in its leg; ``of`` (G,) window; ``cell`` (G,) stretch of road, ``lane`` (G,) of one
    direction of it; ``gated`` whether trucks often stand on a lane's stretch; ``recorded`` (W,) [s].
    """

    windows: Windows
    recorded: Floats
    whole: NDArray[np.bool_]
    motion: Motion
    metres: Floats
    inside: NDArray[np.bool_]
    of: Ints
    cell: NDArray[np.int32]
    lane: NDArray[np.int32]
    gated: NDArray[np.bool_]
    truck: Truck
    floor: Stretches
    lanes: Stretches
    vehicles: int
    latest: list[tuple[Found, list[Candidate], Table]] = field(default_factory=list)

    def times(self, found: Found) -> tuple[Floats, NDArray[np.bool_]]:
        """(G,) seconds for the step to each node, and whether the speed there is held down by a cap, not by gathering speed."""
        physics = Physics(found.truck, {**found.values, **self._along(found)})
        drive = physics.actual_truck().drive
        cap = allowed_speed(self.motion, physics)
        cap = np.where(self.inside & np.append(self.inside[1:], False), cap, 0.0)
        s = np.cumsum(np.where(self.inside, STEP * self.metres, 0.0)) + np.cumsum(~self.inside) * 1e-3
        v2 = (
            np.minimum.accumulate(cap**2 - 2.0 * drive.max_acceleration * s)
            + 2.0 * drive.max_acceleration * s
        )
        back = 2.0 * drive.max_deceleration * (s[-1] - s)
        v2 = np.minimum.accumulate((v2 - back)[::-1])[::-1] + back
        v = np.sqrt(np.maximum(v2, 0.0))
        mean = np.maximum(0.5 * (v + np.concatenate([[0.0], v[:-1]])), SLOWEST)
        seconds = np.where(self.inside, STEP * self.metres / mean, 0.0)
        wait = self._wait(found)
        return seconds + wait, (v > 0.97 * cap) & self.inside

    def _along(self, found: Found) -> dict[str, dict[str, Floats]]:
        if "speed_zone" not in found.fields:
            return {}
        deviation = found.fields["speed_zone"]
        return {"speed_zone": {"factor": np.clip(1.0 + deviation[self.cell], 0.05, ZONE)}}

    def _wait(self, found: Found) -> Floats:
        if "waiting" not in found.fields:
            return np.zeros(len(self.of))
        return np.maximum(found.fields["waiting"], 0.0)[self.lane] * self._share

    @property
    def _share(self) -> Floats:
        """(G,) part of its stretch that a step covers."""
        length = (self.lanes.end - self.lanes.start)[self.lane]
        return np.where(self.inside, STEP / np.maximum(length, STEP), 0.0)

    def _windowed(self, values: Floats) -> Floats:
        return np.asarray(np.bincount(self.of, values, len(self.windows)), dtype=np.float64)

    def tabulate(self, found: Found, named: list[Candidate], free: dict[str, Columns]) -> Table:
        """Recorded minus modelled seconds, and the columns of all candidates about the model; the last table is kept."""
        for model, candidates, table in self.latest:
            if model is found and all(c in candidates for c in named):
                return table
        self.latest.clear()
        self.latest.append((found, named, self._table(found, named, free)))
        return self.latest[0][2]

    def _table(self, found: Found, named: list[Candidate], free: dict[str, Columns]) -> Table:
        seconds, capped = self.times(found)
        model = self._windowed(seconds)
        groups = {c.name: self._candidate(found, c, seconds, capped).astype(np.float32) for c in named}
        nuisance = self._nuisance(found, seconds)
        spread = self._spreads(nuisance)
        flat = {k: v.astype(np.float32) for k, v in nuisance.items()}
        return Table(
            self.windows,
            self.recorded - model,
            model,
            groups,
            flat,
            spread,
            np.zeros(len(model)),
            CRUDE * self.recorded,
            free,
        )

    def column(self, found: Found, candidate: Candidate) -> Floats:
        """(W, p) seconds of one named candidate about a model."""
        return self._candidate(found, candidate, *self.times(found))

    def effect(self, before: Found, after: Found) -> Floats:
        """(W,) seconds that one model says more than another."""
        return self._windowed(self.times(after)[0] - self.times(before)[0])

    def _candidate(self, found: Found, c: Candidate, seconds: Floats, capped: NDArray[np.bool_]) -> Floats:
        term = c.term
        assert term is not None
        if term.name == "waiting":
            return self._spread_over(self.lane, len(self.lanes), self._share) * self.gated
        if c.kind == "field":
            factor = np.minimum(1.0 + found.fields.get(term.name, np.zeros(len(self.floor)))[self.cell], ZONE)
            # Where the cap binds, time goes with its inverse; where speed is being gathered it does not feel the cap.
            return self._spread_over(
                self.cell, len(self.floor), np.where(capped, -seconds / np.maximum(factor, 0.05), 0.0)
            )
        out = []
        for knob in c.knobs:
            setting, size = tilted(found, term, knob)
            change = self.times(moved(found, term, setting))[0] - seconds
            if not change.any():
                # A cap just above what is allowed anyway does nothing; just below it does.
                setting = {**setting, knob.parameter: setting[knob.parameter] - 2.0 * size}
                size = -size
                change = self.times(moved(found, term, setting))[0] - seconds
            out.append(self._windowed(change) / size)
        return np.stack(out, axis=1)

    def _spread_over(self, place: NDArray[np.int32], count: int, values: Floats) -> Floats:
        flat = self.of * count + place
        total = np.bincount(flat, values, len(self.windows) * count)
        return np.asarray(total.reshape(-1, count), dtype=np.float64)

    def _nuisance(self, found: Found, seconds: Floats) -> dict[str, Floats]:
        """Drivers differ in speed, setting off and braking, and the truck file is a little off in all of them."""
        out: dict[str, Floats] = {}
        keys = (
            "drive.speed_factor",
            "drive.max_acceleration",
            "drive.max_deceleration",
            "drive.max_lateral_acceleration",
        )
        names = ("speed", "acceleration_limit", "braking", "cornering_speed")
        for name, key in zip(names, keys, strict=True):
            change = self._windowed(self._scaled(found, key) - seconds) / MORE
            out[name] = change[:, None]
            own = np.zeros((len(self.windows), self.vehicles))
            own[np.arange(len(own)), self.windows.vehicle] = change
            out[f"vehicle {name}"] = own
        # Nobody sets off, stops or turns with the corners that a profile of constant accelerations has.
        first, last = ~self.inside, np.append(~self.inside[1:], True)
        v = np.where(self.inside, STEP * self.metres / np.maximum(seconds, 1e-3), 0.0)
        dip = self.inside & (v <= np.roll(v, 1)) & (v < np.roll(v, -1)) & ~np.roll(first, 1)
        out["moments"] = np.stack([self._windowed(m.astype(float)) for m in (first, last, dip)], axis=1)
        out["pace"] = self._windowed(seconds)[:, None]
        slow = self.inside & (np.abs(self.motion.curvature) < 0.05) & (v < 0.9 * self.motion.speed)
        out["gathering"] = np.stack(
            [self._windowed(seconds * (slow & m)) for m in (v > np.roll(v, 1), v < np.roll(v, 1))], axis=1
        )
        return out

    def _scaled(self, found: Found, key: str) -> Floats:
        """(G,) seconds with one value of the truck a little larger."""
        if key == "drive.speed_factor":
            motion = self.motion.replaced(speed=(1.0 + MORE) * self.motion.speed)
            return replace(self, motion=motion).times(found)[0]
        for name, term in all_terms().items():
            for parameter in term.parameters:
                if parameter.truck_key == key and name in found.values:
                    return self.times(
                        found.with_value(
                            name, parameter.name, (1.0 + MORE) * found.value(term, parameter.name)
                        )
                    )[0]
        truck = found.truck.with_value(key, (1.0 + MORE) * found.truck.value(key))
        return self.times(replace(found, truck=truck))[0]

    def _spreads(self, nuisance: dict[str, Floats]) -> dict[str, Floats]:
        relative = {
            "speed": 0.04,
            "acceleration_limit": 0.08,
            "braking": 0.15,
            "cornering_speed": 0.05,
            "moments": 0.25,
            "pace": 0.015,
            "gathering": 0.05,
        }
        total = float(np.abs(self.recorded).sum()) or 1.0
        out = {}
        for name, x in nuisance.items():
            spread = relative[name.removeprefix("vehicle ")]
            if name in ("speed", "acceleration_limit", "cornering_speed"):
                spread = min(spread, 0.5 * MATERIAL / max(float(np.abs(x).sum()) / total, 1e-12))
            out[name] = np.full(x.shape[1], spread)
        return out

    def curves(self, found: Found) -> tuple[dict[str, Columns], list[Candidate]]:
        """Free dependences: time as a share of the model's, by every recorded variable."""
        seconds = self.times(found)[0]
        m = self.motion
        state = {
            "payload": m.payload, "time": (m.time / 3600.0) % 24.0, "soc": m.soc, "ambient_temperature": m.ambient_temperature,
            "speed": m.speed, "curvature": np.abs(m.curvature),
        }  # fmt: skip
        columns: dict[str, Columns] = {}
        candidates = []
        for name, values in state.items():
            known = values[np.isfinite(values)]
            if len(known) < 100 or np.ptp(known) < {
                "payload": 50.0,
                "soc": 0.02,
                "ambient_temperature": 1.5,
            }.get(name, 0.1):
                continue
            low, high = (float(q) for q in np.quantile(known, [0.01, 0.99]))
            span = np.linspace(low, high, 6)
            ends = np.array(generic.FIXED["curvature"]) if name == "curvature" else span
            j, w = generic.hats(values, ends)
            right = np.nan_to_num(w)
            stacked = self._spread_over(j.astype(np.int32), len(ends), seconds * (1.0 - right))
            stacked += self._spread_over((j + 1).astype(np.int32), len(ends), seconds * right)
            columns[f"time by {name}"] = stacked.astype(np.float32)
            slow = name in ("time", "soc", "ambient_temperature")
            candidates.append(
                Candidate(f"time by {name}", "generic", None, (name,), slow=slow, internal=name == "speed")
            )
        turns = [f(k * m.heading) for k in (1, 2) for f in (np.cos, np.sin)]
        columns["time by heading"] = np.stack([self._windowed(seconds * t) for t in turns], axis=1).astype(
            np.float32
        )
        candidates.append(Candidate("time by heading", "generic", None, ("heading",)))
        if self.vehicles > 1:
            own = self._spread_over(m.vehicle.astype(np.int32), self.vehicles, seconds)
            columns["time by vehicle"] = own.astype(np.float32)
            candidates.append(Candidate("time by vehicle", "generic", None, ("vehicle_id",)))
        return columns, candidates


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
    journeys.latest.clear()
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
        if b - a < 4 or not j.inside[a - 3 : b + 3].all() or seconds[a:b].max() > 5.0:
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

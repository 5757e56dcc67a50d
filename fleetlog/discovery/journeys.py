"""The speed channel: the time that stretches of a path took, against the quickest drive that limits, turns and truck allow.

A profile forward under acceleration and backward under braking is one pass over all legs laid end to end: between standstills
v^2 - 2 a s cannot grow, so a running minimum is the profile.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.motion import Motion
from fleetlog.core.truck import Truck
from fleetlog.discovery import generic
from fleetlog.discovery.bench import MATERIAL, Columns, Latest, Table
from fleetlog.discovery.bends import STEP
from fleetlog.discovery.candidates import Candidate, moved, tilted
from fleetlog.discovery.model import Found
from fleetlog.discovery.stretches import Stretches
from fleetlog.discovery.windows import Windows
from fleetlog.physics.power import Physics, all_terms, allowed_speed

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SLOWEST = 0.15
"""Mean speed over a step of the path is not taken below this [m/s]."""
CRUDE = 0.05
"""Share of a window's time that a profile of constant accelerations may be off by."""
ZONE = 1.05
"""A zone slows down; a factor above this is no zone."""
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
    latest: Latest = field(default_factory=Latest)

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
        return self.latest.table(found, named, lambda: self._table(found, named, free))

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

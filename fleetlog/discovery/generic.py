"""Free dependences: force or power as any smooth function of a recorded variable.

They are what makes "unknown, but it follows X" possible, and they keep the named explanations honest, which must beat them.
``force`` ones act through the drive (0.01 m g v), ``drive`` ones on what the drive draws (a tenth of it), ``power`` ones on the
battery (300 W); hat functions make the curve.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.motion import Motion
from fleetlog.discovery import splits
from fleetlog.discovery.candidates import SLOW, Candidate
from fleetlog.discovery.replay import Block
from fleetlog.discovery.windows import Cut
from fleetlog.physics.power import Physics
from fleetlog.physics.term import GRAVITY

Floats = NDArray[np.float64]

FORCE = 0.01
"""Unit of a force dependence, as a share of the weight."""
POWER = 300.0
"""Unit of a power dependence [W]."""
DRIVE = 0.1
"""Unit of a dependence of the drive, as a share of the power it draws."""


@dataclass(frozen=True)
class Ranges:
    """What the hat functions span, from the data: quantiles of each variable over the recording, NaN-free."""

    knots: dict[str, Floats]
    vehicles: int
    days: tuple[int, ...]
    trips: tuple[int, ...] = ()
    """Trips that may each have a resistance of their own: few and long ones, of which nothing tells where they went."""


def drive_gain(motion: Motion, physics: Physics) -> Floats:
    """(N,) W at the battery for each newton of extra resistance."""
    truck, motion = physics.actual_truck(), physics.actual_motion(motion)
    total = np.zeros(len(motion))
    for term in physics.active():
        if term.acts == "force" and term.function is not None:
            total += term.function(motion, truck, physics.values.get(term.name, {}))
    return np.where(total >= 0.0, 1.0 / truck.drive.efficiency, truck.drive.regeneration) * motion.speed


def variables(block: Block, start: float) -> dict[str, Floats]:
    """(N,) the recorded variables that a mismatch may follow; ``start`` [s] is when the vehicle's day began."""
    m = block.motion
    return {
        "speed": m.speed, "payload": m.payload, "acceleration": m.acceleration, "curvature": np.abs(m.curvature),
        "ambient_temperature": m.ambient_temperature, "soc": m.soc, "time": (m.time / 3600.0) % 24.0,
        "time since start": (m.time - start) / 3600.0, "lift_speed": m.lift_speed, "fork_height": m.fork_height,
    }  # fmt: skip


FIXED: dict[str, tuple[float, ...]] = {
    "acceleration": (-0.8, -0.4, -0.1, 0.1, 0.4, 0.8),
    "curvature": (0.0, 0.03, 0.07, 0.12, 0.2, 0.4),
    "lift_speed": (-0.5, -0.25, 0.0, 0.25, 0.5),
}
COUNT = {
    "speed": 7,
    "payload": 6,
    "ambient_temperature": 6,
    "soc": 6,
    "time": 7,
    "time since start": 6,
    "fork_height": 4,
}


def ranges(blocks: list[Block], starts: dict[tuple[int, int], float]) -> Ranges:
    """Knots from the data: even steps between the 0.5 and 99.5 per cent points; a variable that hardly moves has none."""
    pooled: dict[str, list[Floats]] = {}
    for block in blocks:
        for name, values in variables(block, starts[block.vehicle, block.day]).items():
            pooled.setdefault(name, []).append(values[:: 4 * block.steps])
    knots = {}
    for name, pieces in pooled.items():
        values = np.concatenate(pieces)
        values = values[np.isfinite(values)]
        if len(values) < 100:
            continue
        low, high = np.quantile(values, [0.005, 0.995])
        if high - low < {"payload": 50.0, "soc": 0.02, "ambient_temperature": 1.5}.get(name, 0.1):
            continue
        knots[name] = np.array(FIXED[name]) if name in FIXED else np.linspace(low, high, COUNT[name])
    days = tuple(sorted({b.day for b in blocks}))
    trips = splits.apart(
        {int(t) for b in blocks for t in np.unique(b.trip)},
        sum(float(b.motion.dt.sum()) for b in blocks),
        any(np.isfinite(b.motion.x).any() for b in blocks),
    )
    return Ranges(knots, 1 + max(b.vehicle for b in blocks), days, trips)


def generic_candidates(r: Ranges, with_map: bool) -> list[Candidate]:
    """The free dependences that these data can carry."""
    internal = {"speed", "payload", "acceleration", "curvature", "fork_height"}
    out = []
    for name in r.knots:
        slow = name in SLOW
        if name not in ("lift_speed", "fork_height"):
            out.append(
                Candidate(f"force by {name}", "generic", None, (name,), slow=slow, internal=name in internal)
            )
        if slow:
            out.append(Candidate(f"drive by {name}", "generic", None, (name,), slow=True))
        if name != "acceleration":
            out.append(
                Candidate(f"power by {name}", "generic", None, (name,), slow=slow, internal=name in internal)
            )
    out.append(Candidate("force by heading", "generic", None, ("heading",)))
    out.append(Candidate("drag by heading", "generic", None, ("heading", "speed")))
    out.append(Candidate("power when standing", "generic", None, ("standing",), internal=True))
    if "payload" in r.knots:
        out.append(
            Candidate("power by payload and speed", "generic", None, ("payload", "speed"), internal=True)
        )
        out.append(Candidate("lift power by payload", "generic", None, ("lift_speed", "payload")))
    if "ambient_temperature" in r.knots:
        pair = ("ambient_temperature", "speed")
        out.append(
            Candidate(
                "force by ambient_temperature and speed", "generic", None, pair, slow=True, internal=True
            )
        )
    if r.vehicles > 1:
        out.append(Candidate("force by vehicle", "generic", None, ("vehicle_id",)))
        out.append(Candidate("power by vehicle", "generic", None, ("vehicle_id",)))
    if len(r.days) > 1:
        out.append(Candidate("force by day", "generic", None, ("day",), slow=True))
        out.append(Candidate("power by day", "generic", None, ("day",), slow=True))
    if r.trips:
        out.append(Candidate("force by trip", "generic", None, ("trip_id",)))
        out.append(Candidate("power by trip", "generic", None, ("trip_id",)))
    if with_map:
        out.append(Candidate("power by place", "generic", None, ("x", "y")))
    return out


def measured_candidates(r: Ranges) -> list[Candidate]:
    """Free dependences of the state of charge where power itself is measured: what the battery does with it."""
    out = [
        Candidate(f"power by {n}", "generic", None, (n,), slow=n in SLOW)
        for n in r.knots
        if n in ("ambient_temperature", "soc")
    ]
    out.append(Candidate("share of power", "generic", None, ("battery_power",)))
    if r.vehicles > 1:
        out.append(Candidate("power by vehicle", "generic", None, ("vehicle_id",)))
    return out


def columns(
    block: Block,
    c: Cut,
    r: Ranges,
    gain: Floats,
    mass: Floats,
    drive: Floats,
    start: float,
    cell: NDArray[np.int32],
    cells: int,
) -> Iterator[tuple[str, Floats]]:
    """(windows, p) kJ of every free dependence, by the candidate's name."""
    m = block.motion
    weight = FORCE * GRAVITY * mass * gain
    moving = np.asarray(POWER * (m.speed > 0.0), dtype=np.float64)
    state = variables(block, start)
    for name, knots in r.knots.items():
        j, w = hats(state[name], knots)
        if name not in ("lift_speed", "fork_height"):
            yield f"force by {name}", _hat_energy(block, c, j, w, len(knots), weight)
        if name in SLOW:
            yield f"drive by {name}", _hat_energy(block, c, j, w, len(knots), DRIVE * np.maximum(drive, 0.0))
        if name != "acceleration":
            base = moving if name in ("speed", "payload", "curvature") else np.full(len(m), POWER)
            energy = _hat_energy(block, c, j, w, len(knots), base)
            # At zero lift speed or height there is no lift; a constant is the auxiliary load's business.
            keep = knots != 0.0 if name in ("lift_speed", "curvature") else np.ones(len(knots), bool)
            yield f"power by {name}", energy[:, keep]
    turns = [f(k * m.heading) for k in (1, 2, 3, 4) for f in (np.cos, np.sin)]
    yield "force by heading", np.stack([c.energy(block, weight * t) for t in turns], axis=1)
    yield (
        "drag by heading",
        np.stack([c.energy(block, 100.0 * gain * t) for t in (np.ones(len(m)), *turns)], axis=1),
    )
    yield (
        "power when standing",
        c.energy(block, np.asarray(POWER * (m.speed <= 0.0), dtype=np.float64))[:, None],
    )
    if "payload" in r.knots:
        yield "power by payload and speed", _pair(block, c, state, r, "payload", "speed", moving)
        j, w = hats(m.payload, r.knots["payload"])
        lift = GRAVITY * 500.0 * np.maximum(m.lift_speed, 0.0)
        yield "lift power by payload", _hat_energy(block, c, j, w, len(r.knots["payload"]), lift)
    if "ambient_temperature" in r.knots:
        pair = _pair(block, c, state, r, "ambient_temperature", "speed", weight)
        yield "force by ambient_temperature and speed", pair
    measured = np.nan_to_num(m.power)
    yield (
        "share of power",
        np.stack([c.energy(block, p) for p in (measured, np.minimum(measured, 0.0))], axis=1),
    )
    one = np.zeros((c.count, r.vehicles))
    if r.vehicles > 1:
        for name, power in (("force by vehicle", weight), ("power by vehicle", np.full(len(m), POWER))):
            own = one.copy()
            own[:, block.vehicle] = c.energy(block, power)
            yield name, own
    if len(r.days) > 1:
        for name, power in (("force by day", weight), ("power by day", np.full(len(m), POWER))):
            own = np.zeros((c.count, len(r.days)))
            own[:, r.days.index(block.day)] = c.energy(block, power)
            yield name, own
    if r.trips:
        which = np.repeat(np.searchsorted(r.trips, block.trip), block.steps).astype(np.int32)
        for name, power in (("force by trip", weight), ("power by trip", np.full(len(m), POWER))):
            own = c.energies(block, which, len(r.trips), power)
            # The first column is what they have in common, so that a trip never seen is taken for a usual one.
            yield name, np.concatenate([own.sum(axis=1, keepdims=True), own], axis=1)
    if cells:
        yield "power by place", c.energies(block, cell, cells, moving)


def hats(values: Floats, knots: Floats) -> tuple[NDArray[np.intp], Floats]:
    """Left knot and weight of the right one for piecewise-linear interpolation; unknown values weigh nothing."""
    x = np.clip(np.nan_to_num(values, nan=knots[0]), knots[0], knots[-1])
    j = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, len(knots) - 2)
    w = (x - knots[j]) / (knots[j + 1] - knots[j])
    return j, np.where(np.isfinite(values), w, np.nan)


def _hat_energy(block: Block, c: Cut, j: NDArray[np.intp], w: Floats, k: int, power: Floats) -> Floats:
    e = np.where(np.isfinite(w), power * block.motion.dt, 0.0) * 1e-3
    w = np.nan_to_num(w)
    flat = c.of_sample * k + j
    left = np.bincount(flat, e * (1.0 - w), c.count * k)
    right = np.bincount(flat + 1, e * w, c.count * k)
    return np.asarray((left + right).reshape(c.count, k), dtype=np.float64)


def _pair(block: Block, c: Cut, state: dict[str, Floats], r: Ranges, a: str, b: str, power: Floats) -> Floats:
    """Products of four hats of one variable with four of another."""
    if a not in r.knots or b not in r.knots:
        return np.zeros((c.count, 1))
    out = []
    ka, kb = (np.linspace(r.knots[n][0], r.knots[n][-1], 4) for n in (a, b))
    ja, wa = hats(state[a], ka)
    for i in range(4):
        share = np.where(ja == i, 1.0 - wa, np.where(ja == i - 1, wa, 0.0))
        jb, wb = hats(state[b], kb)
        out.append(_hat_energy(block, c, jb, wb, 4, power * np.nan_to_num(share)))
    return np.concatenate(out, axis=1)

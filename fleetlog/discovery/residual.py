"""Recorded minus modelled energy by window, and the energy that every explanation would add there."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fleetlog.discovery import generic, splits, unseen, windows
from fleetlog.discovery.bench import COARSE, MATERIAL, Columns, Latest, Table
from fleetlog.discovery.candidates import MECHANISM, Candidate, Knob, tilted
from fleetlog.discovery.evaluate import Evaluation
from fleetlog.discovery.model import Found
from fleetlog.discovery.replay import Block
from fleetlog.discovery.stretches import Cells
from fleetlog.discovery.windows import Cut, Windows
from fleetlog.physics.power import all_terms
from fleetlog.physics.term import Term

Floats = NDArray[np.float64]

CLOCKS = 3.0
"""The state of charge keeps its own time [s]."""
UNSEEN = 0.2
"""Share of the energy that each way of moving between rows that are far apart may have taken."""
HONEST = 0.12
"""What a coefficient of the truck file may honestly be off by, as a share of what is material (one standard deviation)."""
CRUDE = 0.01
"""Share of a window's energy that sampling keeps any model from explaining."""


@dataclass(frozen=True)
class Recording:
    """Everything about the recorded rows that does not change while the search goes on."""

    blocks: list[Block]
    cuts: list[Cut]
    windows: Windows
    starts: dict[tuple[int, int], float]
    ranges: generic.Ranges
    floor: Cells | None
    channel: str
    measured: bool
    recorded: Floats
    whole: NDArray[np.bool_]
    coarse: bool = False
    """Whether rows are so far apart that much happens between them."""
    unweighed: bool = False
    """Whether trucks carry loads that are not in the log."""
    latest: Latest = field(default_factory=Latest)

    @property
    def cells(self) -> int:
        """Number of pieces of the floor."""
        return 0 if self.floor is None else len(self.floor)

    def evaluation(self, block: Block, found: Found) -> Evaluation:
        """One block under a model."""
        return Evaluation(block, found, self.floor, self.channel, self.measured)

    def pairs(self) -> Iterator[tuple[Block, Cut]]:
        """Blocks with their windows."""
        return zip(self.blocks, self.cuts, strict=True)

    def tabulate(self, found: Found, named: list[Candidate], free: dict[str, Columns]) -> Table:
        """The residual under ``found`` and the columns of all named candidates about it."""
        return self.latest.table(found, named, lambda: tabulate(self, found, named, free))

    def column(self, found: Found, candidate: Candidate) -> Floats:
        """(W, p) kJ of one named candidate about a model."""
        return tabulate_one(self, found, candidate)

    def effect(self, before: Found, after: Found) -> Floats:
        """(W,) kJ that one model says more than another."""
        return effect(self, before, after)


def prepare(
    blocks: list[Block],
    floor: Cells | None,
    channel: str,
    measured: bool,
    width: float,
    capacity: float,
    coarse: bool = False,
    lifts: bool = True,
) -> Recording:
    """Windows of all blocks, with the recorded energy of the channel in each; ``capacity`` of the battery [J].

    ``lifts``: the vehicles are made to lift, so that loads and lifting may have gone unrecorded.
    ``whole`` marks windows whose every row has the channel, and in which the battery was not charged.
    """
    starts: dict[tuple[int, int], float] = {}
    for b in blocks:
        key = (b.vehicle, b.day)
        starts[key] = min(starts.get(key, np.inf), float(b.time[0]))
    cuts = [windows.cut(b, width) for b in blocks]
    frame = windows.join([windows.describe(b, c) for b, c in zip(blocks, cuts, strict=True)])
    frame = splits.independent(frame)
    pairs = [recorded_energy(b, c, channel, capacity) for b, c in zip(blocks, cuts, strict=True)]
    energy = np.concatenate(pairs)
    whole = np.isfinite(energy)
    blind = lifts and not measured
    still = None if not blind else unseen.quiet(blocks, [c.of_row for c in cuts], frame, energy)
    if still is not None:
        whole &= still
    spans = generic.ranges(blocks, starts)
    return Recording(
        blocks, cuts, frame, starts, spans, floor, channel, measured, np.where(whole, energy, 0.0), whole,
        coarse, blind and unseen.carries(blocks, still is not None),
    )  # fmt: skip


def recorded_energy(block: Block, c: Cut, channel: str, capacity: float) -> Floats:
    """(windows,) kJ that the channel shows; NaN where a row is missing or the battery was charged."""
    if channel == "battery_power":
        dt = block.rows(block.motion.dt) * block.steps
        return np.asarray(np.bincount(c.of_row, block.power * dt, c.count) * 1e-3, dtype=np.float64)
    first = np.flatnonzero(np.concatenate([[True], np.diff(c.of_row) != 0]))
    soc = block.soc
    # A row stands for the time around its stamp, so a window begins half way between two stamps.
    border = np.concatenate([soc[:1], 0.5 * (soc[first[1:] - 1] + soc[first[1:]]), soc[-1:]])
    drop = -np.diff(border)
    charged = np.bincount(c.of_row, np.diff(soc, prepend=soc[:1]) > 0.005, c.count) > 0
    return np.where(charged, np.nan, drop * capacity * 1e-3)


def generic_columns(recording: Recording, found: Found) -> dict[str, Columns]:
    """Free dependences of every window; they depend on the model only through the drive's gain, so once is enough."""
    pieces: dict[str, list[Columns]] = {}
    for block, c in recording.pairs():
        e = recording.evaluation(block, found)
        start = recording.starts[block.vehicle, block.day]
        for name, x in generic.columns(
            block,
            c,
            recording.ranges,
            e.gain,
            e.mass,
            e.force * e.gain,
            start,
            _place(recording, block),
            recording.cells,
        ):
            pieces.setdefault(name, []).append(x.astype(np.float32))
    return {k: np.concatenate(v) for k, v in pieces.items()}


def tabulate(recording: Recording, found: Found, named: list[Candidate], free: dict[str, Columns]) -> Table:
    """The residual under ``found`` and the columns of all named candidates about it."""
    groups: dict[str, list[Columns]] = {}
    nuisance: dict[str, list[Columns]] = {}
    model, jitter, load = [], [], []
    for block, c in recording.pairs():
        e = recording.evaluation(block, found)
        model.append(c.energy(block, e.power))
        jumps = _jumps(block, c, e) if recording.channel == "battery_power" else np.zeros(c.count)
        jitter.append(jumps)
        if recording.unweighed:
            load.append(_load(e, c))
        for candidate in named:
            groups.setdefault(candidate.name, []).append(
                _named(recording, e, c, candidate).astype(np.float32)
            )
        for name, x in _nuisance(recording, e, c, jumps).items():
            nuisance.setdefault(name, []).append(x.astype(np.float32))
    modelled = np.concatenate(model)
    flat = {k: np.concatenate(v) for k, v in nuisance.items()}
    kept = {k: np.concatenate(v) for k, v in groups.items()}
    return Table(
        recording.windows,
        recording.recorded - modelled,
        modelled,
        kept,
        flat,
        _spreads(flat, recording),
        np.concatenate(jitter),
        CRUDE * np.abs(recording.recorded),
        free,
        np.concatenate(load) if load else None,
    )


def _load(e: Evaluation, c: Cut) -> Floats:
    """(windows,) kJ that one standard deviation of a load that nobody weighed adds."""
    chassis, more = e.found.truck.chassis, 10.0
    heavier = replace(
        e, block=replace(e.block, motion=e.block.motion.replaced(payload=e.block.motion.payload + more))
    )
    spread = min(0.5 * chassis.rated_load, unseen.PART * chassis.mass)
    return c.energy(e.block, heavier.power - e.power) * spread / more


def tabulate_one(recording: Recording, found: Found, candidate: Candidate) -> Floats:
    """(W, p) kJ of one named candidate about a model."""
    pieces = []
    for block, c in recording.pairs():
        e = recording.evaluation(block, found)
        pieces.append(_named(recording, e, c, candidate))
    return np.concatenate(pieces)


def _place(recording: Recording, block: Block) -> NDArray[np.int32]:
    """(N,) piece of floor of each sample, -1 for none."""
    if recording.floor is None:
        return np.full(len(block.motion), -1, np.int32)
    return recording.floor.parts(block.motion, False)[0][0]


def _named(recording: Recording, e: Evaluation, c: Cut, candidate: Candidate) -> Floats:
    """(windows, p) kJ per unit: of the parameter for one number, of the setting for a grid, per cell for a field."""
    term = candidate.term
    assert term is not None
    if candidate.kind == "field":
        assert recording.floor is not None
        slope, size = e.slope(term), recording.floor.size(term.odd)
        parts = recording.floor.parts(e.block.motion, term.odd)
        pieces = [c.energies(e.block, number, size, slope * weight) for number, weight in parts]
        return np.asarray(np.sum(pieces, axis=0), dtype=np.float64)
    out = []
    for knob in candidate.knobs:
        setting, delta = tilted(e.found, term, knob)
        # A shape changes nothing by itself only while the amplitude is neutral; else it is taken as it is now.
        change = e.change(term, setting)
        if knob.shape and _acting(e.found, term):
            change = change - e.change(term, dict(knob.shape))
        out.append(c.energy(e.block, change) / delta)
    return np.stack(out, axis=1)


def _acting(found: Found, term: Term) -> bool:
    """Whether any number of a term but its shapes is off its neutral value."""
    return any(p.neutral == 0.0 and found.value(term, p.name) != 0.0 for p in term.parameters)


def _jumps(block: Block, c: Cut, e: Evaluation) -> Floats:
    """(windows,) root mean square of the residual power's second difference, scaled to that of white noise [W]."""
    r = np.nan_to_num(block.power - block.rows(e.power))
    bend = np.zeros(len(r))
    bend[1:-1] = (r[2:] - 2.0 * r[1:-1] + r[:-2]) / np.sqrt(6.0)
    count = np.maximum(np.bincount(c.of_row, minlength=c.count), 1)
    return np.sqrt(np.bincount(c.of_row, bend**2, c.count) / count)


def _nuisance(recording: Recording, e: Evaluation, c: Cut, jumps: Floats) -> dict[str, Floats]:
    """Small honest errors: the truck file's coefficients, each vehicle's and vehicle-day's own, and what rows do not resolve."""
    block, m = e.block, e.block.motion
    terms = all_terms()
    out: dict[str, Floats] = {}
    if not recording.measured:
        for name in MECHANISM:
            setting, size = tilted(e.found, terms[name], Knob(terms[name].parameters[0].name))
            out[name] = c.energy(block, e.change(terms[name], setting) / size)[:, None]
    else:
        out["capacity"] = c.energy(block, e.power)[:, None]
    rolling = c.energy(block, e.truck.resistance.rolling * e.mass * 9.81 * e.gain)
    ones = c.energy(block, np.ones(len(m)))
    if not recording.measured:
        out["vehicle rolling"] = _own(rolling, block.vehicle, recording.ranges.vehicles)
    out["vehicle load"] = _own(ones, block.vehicle, recording.ranges.vehicles)
    if len(recording.ranges.days) > 1:
        shifts = sorted(recording.starts)
        out["vehicle-day load"] = _own(ones, shifts.index((block.vehicle, block.day)), len(shifts))
    out["lag"] = _own(
        c.energy(block, -np.gradient(e.power, m.time)), block.vehicle, recording.ranges.vehicles
    )
    speed, acceleration = block.kinked
    kinked = replace(block, motion=m.replaced(speed=speed, acceleration=acceleration))
    out["kinks"] = c.energy(block, replace(e, block=kinked).power - e.power)[:, None]
    if recording.coarse:
        for name, power in unseen.between_rows(e).items():
            out[name] = c.energy(block, power)[:, None]
    if recording.channel == "battery_power":
        wobble = jumps[c.of_sample] * e.truck.drive.efficiency
        out["ripple"] = c.energy(block, _rectified(e, wobble))[:, None]
    return out


def _own(values: Floats, which: int, count: int) -> Floats:
    out = np.zeros((len(values), count))
    out[:, which] = values
    return out


def _rectified(e: Evaluation, wobble: Floats) -> Floats:
    """(N,) W that the convex switch between traction and braking adds where mechanical power wobbles by ``wobble`` [W]."""
    from scipy.special import ndtr

    drive = e.truck.drive
    size = np.maximum(wobble, 1e-6)
    z = np.abs(e.force * e.motion.speed) / size
    bend = (
        (1.0 / drive.efficiency - drive.regeneration)
        * size
        * (np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi) - z * ndtr(-z))
    )
    return np.asarray(np.where(e.motion.speed > 0.05, bend, 0.0))


def _spreads(nuisance: dict[str, Columns], recording: Recording) -> dict[str, Floats]:
    """Standard deviation of every nuisance: honest tolerance.

    The box is twice as wide; all that a coefficient of the truck file can explain in it is a quarter of what is material.
    """
    fixed = {
        "vehicle rolling": 0.03, "vehicle load": 25.0, "vehicle-day load": 30.0, "lag": 0.15,
        "ripple": 0.5, "capacity": 0.02, "kinks": 0.7,
    }  # fmt: skip
    total = float(np.abs(recording.recorded).sum()) or 1.0
    out = {}
    for name, x in nuisance.items():
        spread = MECHANISM.get(name, fixed.get(name, 0.05))
        if name.startswith("unseen"):
            spread = UNSEEN / max(float(np.abs(x).sum(dtype=float)) / total, 1e-12)
        if name in MECHANISM:
            effect = float(np.abs(x).sum(dtype=float)) / total
            spread = min(spread, HONEST * MATERIAL / max(effect, 1e-12))
        if name in ("vehicle load", "vehicle-day load"):
            # A machine of forty watts has no twenty-five to spare.
            spread = min(spread, 1e3 * MATERIAL * total / float(recording.windows.duration.sum()))
        if recording.coarse and name in ("auxiliary_load", "vehicle load", "vehicle-day load"):
            spread *= COARSE / MATERIAL
        if name == "lag" and recording.measured:
            spread = CLOCKS
        out[name] = np.full(x.shape[1], spread)
    return out


def effect(recording: Recording, before: Found, after: Found) -> Floats:
    """(W,) kJ that one model says more than another."""
    out = []
    for block, c in recording.pairs():
        a, b = (recording.evaluation(block, f).power for f in (after, before))
        out.append(c.energy(block, a - b))
    return np.concatenate(out)

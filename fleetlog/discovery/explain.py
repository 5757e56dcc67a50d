"""One energy channel from rows to findings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.discovery import estimate, fields, generic, polish, residual, splits, words
from fleetlog.discovery.bench import COARSE, Bench, Columns
from fleetlog.discovery.candidates import Candidate, named_candidates
from fleetlog.discovery.classes import own_values
from fleetlog.discovery.dropping import without
from fleetlog.discovery.finding import ChannelFit, Finding, Parameter
from fleetlog.discovery.fleet import Fleet
from fleetlog.discovery.model import Found
from fleetlog.discovery.open_ends import left_open
from fleetlog.discovery.proposal import proposed
from fleetlog.discovery.replay import Block
from fleetlog.discovery.search import search
from fleetlog.discovery.select import Choice
from fleetlog.discovery.squares import make_squares
from fleetlog.discovery.stretches import Cells, make_stretches
from fleetlog.discovery.task import State, Task
from fleetlog.discovery.windows import MOST, WIDTH

Floats = NDArray[np.float64]

PLAIN = 3.0
"""Standard errors by which a field must differ from nothing."""
SPARSE_ROWS = 12.0
"""Rows in a window where rows are far apart: what falls between them averages out over so many."""
ROUGH = 0.08
"""What the replay of rows that are far apart misses of a number (one standard deviation)."""
UNSEEN = frozenset({
    "rolling_resistance", "cornering_resistance", "viscous_drag", "aerodynamic_drag", "rotational_inertia", "drivetrain_efficiency",
    "regeneration", "lift_efficiency", "payload", "speed", "acceleration", "curvature",
})  # fmt: skip
"""Terms and variables that look like motion between rows, where those are far apart."""
QUANTA = 8.0
"""A window of a stepped state of charge holds at least this many steps on average."""


@dataclass(frozen=True)
class Options:
    """How a diagnosis is asked for."""

    terms: tuple[str, ...] = ()
    holdout: str = "trips"
    seed: int = 0


@dataclass(frozen=True)
class Explained:
    """What came of a channel; ``task`` and the states are kept for the pictures."""

    fit: ChannelFit
    findings: list[Finding]
    task: Task
    state: State
    result: estimate.Estimates


def cells_of(fleet: Fleet) -> Cells | None:
    """Stretches of the map, or squares of the floor without one; None where neither helps."""
    if fleet.network is not None and fleet.has("edge_id"):
        return make_stretches(fleet.network)
    x, y = (np.concatenate([t.floats(c) for _, t in fleet.days]) for c in ("x", "y"))
    return make_squares(x, y)


def energy_channel(fleet: Fleet, channel: str, base: Found, options: Options) -> Explained:
    """Search, judge and word what an energy channel is missing."""
    measured = channel == "soc" and fleet.has("battery_power") and not fleet.sparse
    blocks = fleet.blocks
    capacity = 3600.0 * fleet.truck.battery.capacity_wh
    if measured and fleet.lag:
        blocks = [on_the_clock_of_charge(b, fleet.lag.get(b.vehicle, 0.0), capacity) for b in blocks]
    floor = cells_of(fleet)
    recording = residual.prepare(
        blocks, floor, channel, measured, width(fleet, channel), capacity, fleet.sparse,
        fleet.truck.chassis.rated_load > 0.0,
    )  # fmt: skip
    spans = recording.ranges
    candidates = [
        *named_candidates(channel, measured, floor is not None, options.terms),
        *(generic.measured_candidates(spans) if measured else generic.generic_candidates(spans, floor is not None)),
    ]  # fmt: skip
    if fleet.sparse and not measured:
        candidates = [c for c in candidates if c.name not in UNSEEN and not UNSEEN & set(c.depends_on)]
    free = residual.generic_columns(recording, base)
    task = make_task(recording, candidates, free, floor, base, options)
    if fleet.sparse:
        task = replace(task, rough=ROUGH, material=(COARSE, COARSE))
    unit = f"rms error of energy per {width(fleet, channel):.0f} s window, over rms energy"
    out = explained(task, channel, unit)
    recording.latest.forget()
    return out


def on_the_clock_of_charge(block: Block, lag: float, capacity: float) -> Block:
    """The block with its measured power moved by ``lag`` [s], where the state of charge then follows it better."""
    moved = np.interp(block.time + lag, block.time, block.power)
    paid = -np.diff(block.soc) * capacity
    off = [
        float(np.nansum((paid - 0.5 * (p[1:] + p[:-1]) * np.diff(block.time)) ** 2))
        for p in (block.power, moved)
    ]
    if off[0] <= off[1]:
        return block
    return replace(block, power=moved, motion=block.motion.replaced(power=np.repeat(moved, block.steps)))


def width(fleet: Fleet, channel: str) -> float:
    """Length of a window [s]: ten seconds, longer for many rows and for a coarse state of charge."""
    wide = max(WIDTH, (SPARSE_ROWS if fleet.sparse else 3.0) * fleet.step, fleet.rows * fleet.step / MOST)
    if channel == "soc":
        drops = [np.diff(t.floats("soc")) for _, t in fleet.days]
        change = np.concatenate(drops)
        change = np.abs(change[np.isfinite(change) & (change != 0.0)])
        if len(change):
            quantum = float(np.quantile(change, 0.05))
            span = sum(float(t.time[-1] - t.time[0]) * 1e-6 for _, t in fleet.days)
            used = sum(float(np.abs(d[np.isfinite(d) & (d < 0)]).sum()) for d in drops)
            wide = max(wide, QUANTA * quantum * span / max(used, 1e-9))
    return float(min(wide, 600.0))


def make_task(
    bench: Bench,
    candidates: list[Candidate],
    free: dict[str, Columns],
    floor: Cells | None,
    base: Found,
    options: Options,
) -> Task:
    """The search task with its splits, all from one seed."""
    rng = np.random.default_rng(options.seed)
    block = splits.slow_blocks(bench.windows)
    test = splits.test_windows(bench.windows, options.holdout, rng)
    roots = {} if floor is None else {odd: floor.root(odd) for odd in (True, False)}
    usable = {k: v for k, v in free.items() if np.any(v)}
    kept = {c.name: c for c in candidates if c.named or c.name in usable}
    # Corners of clean recordings are replayed to some three per cent: less at a place is the replay's own.
    return Task(
        bench,
        kept,
        usable,
        splits.folds(bench.windows, block, rng),
        block,
        roots,
        floor,
        base,
        ~test,
        options.seed,
    )


def explained(
    task: Task, channel: str, metric: str, direct: dict[str, dict[str, tuple[float, float]]] | None = None
) -> Explained:
    """Search on the windows that may be seen, judge on the others, estimate on all.

    ``direct`` holds numbers that are better read off the rows than fitted.
    """
    state = search(task, State(task.base))
    result = estimate.estimates(task, state, direct or {})
    told = [c for c in state.chosen if not c.candidate.named or _counts(task, c, result)]
    names = {c.candidate.name for c in told}
    for choice in [c for c in state.chosen if c.candidate.name not in names]:
        result.drop(choice.candidate.name)
        state = without(task, state, choice)
    # What was found beside another explanation is no alternative to it.
    told = [replace(c, tied=tuple(n for n in c.tied if n not in names)) for c in told]
    state = replace(state, chosen=told)
    errors = estimate.held_out(task, state)
    fit = ChannelFit(channel, metric, errors.before, errors.after, errors.floor)
    findings = [_finding(task, channel, c, result, fit, errors.gains.get(c.candidate.name)) for c in told]
    return Explained(fit, findings, task, state, result)


def _counts(task: Task, choice: Choice, result: estimate.Estimates) -> bool:
    """Whether a term chosen is sure and material with the numbers of all trips."""
    where, parameters = _numbers(task, choice, result)
    return _says_something(choice.candidate, where, parameters) and _matters(task, choice, result)


def _matters(task: Task, choice: Choice, result: estimate.Estimates) -> bool:
    """Whether the final number, from all trips, is still worth the name."""
    c = choice.candidate
    if c.kind != "scalar":
        return True
    found = result.state.found
    share = (
        np.abs(task.recording.effect(found.without(c.name), found)).sum()
        / np.abs(task.recording.recorded).sum()
    )
    # A coefficient of the truck file must stand out from what the replay itself misses, too.
    least = task.material[0]
    return bool(share >= least)


def _says_something(c: Candidate, where: dict[str, Any] | None, parameters: list[Parameter]) -> bool:
    """Whether what stands out of a field is sure as a whole: places that contradict one another are noise."""
    if where is None or not parameters or c.term is None:
        return True
    first, neutral = parameters[0], c.term.parameters[0].neutral
    error = (first.high - first.low) / (2.0 * estimate.SURE)
    return abs(first.value - neutral) > PLAIN * error


def _finding(
    task: Task, channel: str, choice: Choice, result: estimate.Estimates, fit: ChannelFit, gain: float | None
) -> Finding:
    c = choice.candidate
    evidence = _evidence(choice, fit, gain)
    fitted = {"metric": fit.metric, "before": fit.before, "after": fit.after}
    tied = [*choice.tied, *left_open(task, choice)]
    parameters: list[Parameter] = []
    needs: str | None
    if c.term is None:
        name, where, when = "unknown", _where_of_generic(task, choice), own_values(task, result.state, choice)
        text, needs = words.unknown(c.name, c.depends_on, when)
        expression, proposal = proposed(task, result.state, choice)
        text, evidence = text + expression, {**evidence, **proposal}
    else:
        where, parameters = _numbers(task, choice, result)
        name, when = c.name, _when(c.name, parameters)
        first = c.term.parameters[0]
        nominal = first.nominal(task.base.truck) if first.truck_key else None
        text, needs = words.statement(c.name, parameters, where, nominal), words.needs(c.name, tied)
    return Finding(
        name, channel, text, tied, needs, list(c.depends_on), where, when, parameters, evidence, fitted, choice.gain.trip
    )  # fmt: skip


def _evidence(choice: Choice, fit: ChannelFit, own: float | None) -> dict[str, Any]:
    """Gains in the units of the channel's metric; ``own`` the measured one of a term.

    Alternatives were compared beside the small honest errors of truck and logger; their gains are scaled as the chosen one's.
    """

    def gain(share: float) -> float:
        return fit.before * (1.0 - float(np.sqrt(min(max(1.0 - share, 0.0), 4.0))))

    mine = gain(choice.gain.trip)
    # By itself a term may gain nothing where only drivers' and truck's small errors beside it make it fit.
    scale = 1.0 if own is None or own <= 0.0 else own / max(mine, 1e-12)
    rivals = sorted(choice.rivals.items(), key=lambda kv: -kv[1].trip)[:6]
    return {
        "p_value": choice.evidence.p_value,
        "log_evidence": choice.evidence.log_evidence,
        "held_out_gain": scale * mine,
        "alternatives": [{"term": n, "held_out_gain": scale * gain(g.trip)} for n, g in rivals],
    }


def _numbers(
    task: Task, choice: Choice, result: estimate.Estimates
) -> tuple[dict[str, Any] | None, list[Parameter]]:
    c = choice.candidate
    assert c.term is not None
    if c.kind == "field":
        return field_numbers(task.cells(c.term), result.fields[c.name], c)
    out = []
    shapes = {name for k in choice.knobs for name, _ in k.shape}
    for parameter in c.term.parameters:
        if parameter.name not in result.numbers[c.name] and parameter.name not in shapes:
            # The other side of a term with two, as cooling beside heating: nothing was said of it.
            continue
        value, error = result.numbers[c.name].get(
            parameter.name,
            (result.state.found.value(c.term, parameter.name), _grid_error(choice, parameter.name)),
        )
        told = _with_interval(parameter.name, value, error, parameter.unit)
        out.append(replace(told, low=max(told.low, parameter.low), high=min(told.high, parameter.high)))
    extra = [
        Parameter(f"added_{p.name}", p.value - n, p.low - n, p.high - n, p.unit)
        for p, n in ((out[0], c.term.parameters[0].nominal(task.base.truck)),) if c.term.parameters[0].unit == "W"
    ]  # fmt: skip
    return None, [*out, *extra]


def _grid_error(choice: Choice, parameter: str) -> float:
    """Standard error of a shape that was only tried at some values: the interval reaches half way to the next on the grid."""
    if not any(parameter in dict(k.shape) for k in choice.knobs):
        return 0.0
    return 0.5 * polish.spacing(choice.candidate, choice.knobs) / estimate.SURE


def field_numbers(
    floor: Cells, values: fields.Values, c: Candidate
) -> tuple[dict[str, Any] | None, list[Parameter]]:
    """Where a field stands out, and its size there."""
    assert c.term is not None
    first = c.term.parameters[0]
    edges, extent = fields.places(floor, values, c.term)
    where = {"edges": edges, "extent": extent} if extent is not None else None
    mask = fields.belonging(floor, values, c.term)
    if not mask.any():
        return where, []
    deviation, error = values.deviation[mask], values.error[mask]
    if c.term.odd:
        k = int(np.argmax(np.abs(deviation)))
        value, spread = abs(float(deviation[k])), float(error[k])
        return where, [_with_interval(f"max_{c.name}", value, spread, first.unit)]
    if fields.amount(c.term) and edges:
        most = edges[0]
        return where, [Parameter(first.name, most["value"], most["low"], most["high"], first.unit)]
    weight = np.maximum(values.samples[mask], 1).astype(float)
    value = first.neutral + float(np.average(deviation, weights=weight))
    # Neighbours share their errors through the prior, so averaging does not shrink them.
    spread = float(np.sqrt(np.average(error**2, weights=weight)) / max(1.0, np.sqrt(len(error) / 4.0)))
    return where, [_with_interval(first.name, value, spread, first.unit)]


def _with_interval(name: str, value: float, error: float, unit: str) -> Parameter:
    """A number with its 95 per cent interval; ``error`` is the standard one."""
    return Parameter(name, value, value - estimate.SURE * error, value + estimate.SURE * error, unit)


def _when(term: str, parameters: list[Parameter]) -> dict[str, Any] | None:
    if term != "thermal_load":
        return None
    number = {p.name: p.value for p in parameters}
    side = "below" if number.get("heating", 0.0) >= number.get("cooling", 0.0) else "above"
    return {f"ambient_temperature_{side}": number.get("threshold")}


def _where_of_generic(task: Task, choice: Choice) -> dict[str, Any] | None:
    """Extent of the windows that a place-bound free dependence touches most."""
    if not choice.candidate.place:
        return None
    w = task.recording.windows
    x = task.free[choice.candidate.name]
    touched = np.abs(x).max(axis=1) > 0
    if not touched.any():
        return None
    return {
        "edges": [],
        "extent": [
            float(w.x[touched].min()),
            float(w.y[touched].min()),
            float(w.x[touched].max()),
            float(w.y[touched].max()),
        ],
    }

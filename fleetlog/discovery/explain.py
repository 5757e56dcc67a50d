"""One channel, from the recording to its findings: search, judge, word."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.discovery.channels.base import Channel
from fleetlog.discovery.hypotheses.curves import UNIT
from fleetlog.discovery.hypotheses.hypothesis import Hypothesis, hypotheses
from fleetlog.discovery.model import Knob, Model
from fleetlog.discovery.recording.splits import HELD_OUT
from fleetlog.discovery.report import fields, traffic, words
from fleetlog.discovery.report.fields import Values
from fleetlog.discovery.report.finding import Adjustment, ChannelFit, Finding, Parameter
from fleetlog.discovery.search.forward import Search, search
from fleetlog.discovery.search.intervals import NORMAL, Known, intervals
from fleetlog.discovery.search.joint import Joint, refit
from fleetlog.discovery.search.judge import Scores, judge, strongest
from fleetlog.discovery.search.problem import Problem
from fleetlog.discovery.search.sizes import without
from fleetlog.discovery.settings import Settings

Floats = NDArray[np.float64]

EXCLUDED = 4.0
"""Natural logarithm of the odds by which a rival must be behind to be excluded: 55 to 1, about two
standard errors."""


@dataclass(frozen=True)
class Explained:
    """What came of a channel: the models, the findings, and what pictures and files need."""

    problem: Problem
    before: Model
    after: Model
    fit: ChannelFit
    findings: list[Finding]
    adjustments: list[Adjustment]
    fields: dict[str, Values]
    numbers: dict[Knob, Parameter]
    unexplained: bool
    log: list[str]


def explain(problem: Problem, base: Model, only: tuple[str, ...] = ()) -> Explained:
    """Say what a channel is missing."""
    channel, settings = problem.channel, problem.settings
    count = sum(int(unit.whole.sum()) for _, unit in problem.training())
    if count < settings.fewest:
        reason = f"only {count} windows can be used, {settings.fewest} are needed; record more"
        return _unjudged(problem, base, reason)
    problem.rest = tuple(hypotheses(channel, only))
    # Hypotheses are compared on an even sample of trips; what is found is fitted to all.
    found = search(problem.sampled(settings.sample / count), base)
    problem.learn(found.joint.model, found.joint.chosen)
    kept = [h for h in found.joint.chosen if h.term is not None]
    # What is written holds no free curve; the corrections beside it are fitted without one, too.
    final = refit(problem, found.joint.model, kept)
    known = intervals(problem, final)
    numbers = _numbers(known)
    told = [h for h in found.joint.chosen if not _within_tolerance(base, numbers, h)]
    before = refit(problem, base, [h for h in kept if h not in told])
    named = [h for h in kept if h in told]
    tried = {h: without(final, h) for h in named}
    untold = _strongest_untold(problem, found)
    beside = {h: refit(problem, final.model, [*kept, h], steps=1) for h in told if h.term is None}
    scores = judge(problem, before.model, final.model, tried, beside)
    fit = _fit(channel, scores, strongest(problem, found.base, untold) if untold else None)
    values = {h.term: _values(problem, known, h) for h in named if h.term and (h.field or h.patterns)}
    findings = [_finding(problem, found, h, final, scores, fit, values, numbers, beside) for h in told]
    after = final.model
    lost = channel.lost(after)
    if lost is not None and traffic.counts(lost, settings):
        findings.append(traffic.finding_of(lost, channel, _with_traffic(problem, after, fit)))
        values[findings[-1].term] = traffic.values(lost)
        after = after.with_field(findings[-1].term, traffic.values(lost).deviation)
    order = sorted(findings, key=lambda f: -f.strength)
    return Explained(
        problem, before.model, after, fit, order, _adjustments(channel, final, told, numbers),
        values, numbers, _above_floor(fit, max(settings.material, channel.model_error), settings), found.log,
    )  # fmt: skip


def _with_traffic(problem: Problem, model: Model, fit: ChannelFit) -> dict[str, Any]:
    """The error on held-out trips with the windows in which other vehicles were in the way, and without."""
    off, size = 0.0, 0.0
    for number, unit in enumerate(problem.channel.units()):
        use = (problem.folds(number, unit)[0] == HELD_OUT) & (unit.recorded > 0.0)
        off += float(((unit.recorded - problem.channel.predict(unit, model))[use] ** 2).sum())
        size += float((unit.recorded[use] ** 2).sum())
    return {"metric": fit.metric, "before": float(np.sqrt(off / size)) if size else None, "after": fit.after}


def _unjudged(problem: Problem, base: Model, reason: str) -> Explained:
    fit = ChannelFit(problem.channel.name, problem.channel.metric, None, None, None, reason)
    return Explained(problem, base, base, fit, [], [], {}, {}, False, [])


def _within_tolerance(base: Model, numbers: dict[Knob, Parameter], h: Hypothesis) -> bool:
    """Whether a number found may be no more than a truck file or a logger is off, by its interval."""
    if len(h.knobs) != 1 or h.setting:
        return False
    knob = h.knobs[0]
    if knob.scope.timed:  # A truck file that is a little off is off all the time.
        return False
    p, found, nominal = knob.definition, numbers[knob], base.value(knob.fleet)
    allowed = p.allowance(base.truck)
    above = p.ceiling or found.low <= nominal + allowed
    return above if found.value > nominal else found.high >= nominal - allowed


def _strongest_untold(problem: Problem, found: Search) -> Joint | None:
    """The strongest single hypothesis beside the base, whatever came of it: its p-value is uniform where
    nothing is concealed."""
    h = found.best_untold
    return None if h is None else refit(problem, found.base.model, [h], steps=1)


def _fit(channel: Channel, s: Scores, p_value: float | None) -> ChannelFit:
    reason = None if s.before is not None else "too few trips to hold some out; record more"
    return ChannelFit(channel.name, channel.metric, s.before, s.after, s.floor, reason, p_value)


def _above_floor(fit: ChannelFit, least: float, settings: Settings) -> bool:
    """Whether more than noise, and something material, is left."""
    if fit.after is None or fit.floor is None:
        return False
    left = np.sqrt(max(fit.after**2 - fit.floor**2, 0.0))
    return bool(left > least and fit.after > settings.at_floor * fit.floor)


def _numbers(known: Known) -> dict[Knob, Parameter]:
    """Every number of the model with its interval, by knob; a vehicle's own is told in full, not as a
    deviation."""
    joint, errors = known.joint, known.errors()
    assert joint.design is not None
    model = joint.model
    out = {}
    for atom, error in zip(joint.design.atoms, errors, strict=True):
        if atom.knob is None:
            continue
        knob, p = atom.knob, atom.knob.definition
        at = model.total(knob)
        ends = sorted(p.value_of(at + s * NORMAL * error) for s in (-1.0, 1.0))
        out[knob] = Parameter(p.name, p.value_of(at), ends[0], ends[1], p.unit, p.nominal(model.truck))
    return out


def _values(problem: Problem, known: Known, h: Hypothesis) -> Values:
    """A field with the error of every cell."""
    joint = known.joint
    cells = problem.channel.cells(h.physics)
    assert joint.design is not None and cells is not None and h.physics is not None and h.term is not None
    own = [i for i, a in enumerate(joint.design.atoms) if a.owner == h]
    basis = np.column_stack([p.weights for p in h.patterns]) if h.patterns else cells.root(h.physics.odd)
    covariance = known.covariance[np.ix_(own, own)]
    error = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", basis, covariance, basis), 0.0))
    passes, widening = problem.channel.passes(h.physics), problem.settings.widening
    return Values(joint.model.fields[h.term], error, passes, basis, covariance, widening)


def _finding(
    problem: Problem, found: Search, h: Hypothesis, final: Joint, scores: Scores, fit: ChannelFit,
    values: dict[str, Values], numbers: dict[Knob, Parameter], beside: dict[Hypothesis, Joint],
) -> Finding:  # fmt: skip
    channel, term = problem.channel, h.physics
    scope = words.scope(h.scope, channel.vehicles)
    rivals = _open(found, h)
    where, parameters = _where(problem, found, h, values, numbers)
    text = (
        words.unknown(h.depends_on, where)
        if term is None
        else words.statement(term, parameters, where, scope)
    )
    # A free curve is no part of the model that is written: it is judged beside it.
    unfitted = fit.after if term is None else scores.without.get(h, fit.before)
    fitted = scores.beside.get(h, fit.after)
    gain = None if unfitted is None or fitted is None else unfitted - fitted
    return Finding(
        h.term or "unknown", channel.name, text, rivals, words.needs(h.term, rivals), list(h.depends_on),
        where, _classes(problem, beside[h]) if h in beside else _when(h), scope, parameters,
        {"p_value": scores.p_values.get(h, fit.p_value), "held_out_gain": gain,
        "alternatives": _alternatives(found, h, gain)},
        {"metric": channel.metric, "before": unfitted, "after": fitted}, gain or 0.0,
    )  # fmt: skip


def _open(found: Search, h: Hypothesis) -> list[str]:
    """Rivals that the trips cannot tell from a finding, once each."""
    near = [r for r in found.rivals.get(h.kind, []) if r.behind < EXCLUDED]
    chosen = {c.term for c in found.joint.chosen}
    names = [r.hypothesis.term or f"unknown({','.join(r.hypothesis.depends_on)})" for r in near]
    return [n for n in dict.fromkeys(names) if n not in chosen]


def _alternatives(found: Search, h: Hypothesis, gain: float | None) -> list[dict[str, Any]]:
    """The share of the finding's gain that each rival reached, on the trips of the search."""
    return [
        {"term": r.hypothesis.term or "unknown", "depends_on": list(r.hypothesis.depends_on),
         "held_out_gain": None if gain is None else gain * r.share}
        for r in found.rivals.get(h.kind, [])[:6]
    ]  # fmt: skip


def _where(
    problem: Problem, found: Search, h: Hypothesis, values: dict[str, Values], numbers: dict[Knob, Parameter]
) -> tuple[dict[str, Any] | None, list[Parameter]]:
    term = h.physics
    if term is None:
        return (fields.extent_of(problem.channel) if h.places else None), []
    if h.field or h.patterns:
        cells = problem.channel.cells(term)
        assert cells is not None
        return fields.told(cells, values[term.name], term, h)
    out = [numbers[k] for k in h.knobs if k in numbers]
    for name, _ in h.setting:
        p = term.by_name[name]
        value = found.joint.model.value(Knob(term.name, name))
        half = 0.5 * (p.high - p.low) / 12.0
        out.append(
            Parameter(name, value, max(value - half, p.low), min(value + half, p.high), p.unit, p.neutral)
        )
    for k in h.knobs:
        p, n = k.definition, numbers.get(k)
        if p.added and n is not None:
            added = [v - n.nominal for v in (n.value, n.low, n.high)]
            out.append(Parameter(f"added_{p.name}", added[0], added[1], added[2], p.unit))
    return None, out


def _when(h: Hypothesis) -> dict[str, Any] | None:
    term = h.physics
    bounds = (
        {} if term is None else {p.bounds: dict(h.setting).get(p.name) for p in term.parameters if p.bounds}
    )
    return {f"{k}_threshold": v for k, v in bounds.items() if v is not None} or None


def _classes(problem: Problem, beside: Joint) -> dict[str, Any] | None:
    """What each trip has of its own, with its interval: a share of the weight for a force, watts for a
    power."""
    h = beside.chosen[-1]
    if h.curve is None or not h.curve.classes:
        return None
    assert beside.design is not None and beside.fitted is not None
    own = [i for i, a in enumerate(beside.design.atoms) if a.owner == h]
    unit, error = UNIT[h.curve.mode], intervals(problem, beside).errors()[own]
    ends = np.array([-1.0, 1.0]) * NORMAL * error[:, None]
    rows = zip(h.curve.classes, unit * beside.fitted.beta[own], unit * ends, strict=True)
    return {"trips": {name: [float(v), float(v + low), float(v + high)] for name, v, (low, high) in rows}}


def _adjustments(
    channel: Channel, final: Joint, told: list[Hypothesis], numbers: dict[Knob, Parameter]
) -> list[Adjustment]:
    taken = {k for h in told for k in h.knobs}
    out = []
    for knob, n in numbers.items():
        if knob not in taken and knob in final.model.at:
            vehicle = None if knob.scope.one is None else channel.vehicles[knob.scope.one]
            out.append(Adjustment(f"{knob.term}.{knob.parameter}", vehicle, n.value, n.low, n.high, n.unit))
    return out

"""One channel, from the recording to its findings: search, judge, word."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np
from scipy.special import ndtr

from fleetlog.core.arrays import Floats
from fleetlog.core.words import percent
from fleetlog.discovery.channels.base import Channel
from fleetlog.discovery.hypotheses.cells import LARGE
from fleetlog.discovery.hypotheses.hypothesis import Hypothesis, hypotheses, scanned
from fleetlog.discovery.hypotheses.sources import UNIT
from fleetlog.discovery.model import Knob, Model, Scope
from fleetlog.discovery.recording.splits import HELD_OUT, Split
from fleetlog.discovery.report import fields, others, words
from fleetlog.discovery.report.fields import Values
from fleetlog.discovery.report.finding import NORMAL, ChannelFit, Errors, Finding, Parameter, interval
from fleetlog.discovery.search.finish import Search, on_bound
from fleetlog.discovery.search.forward import search
from fleetlog.discovery.search.joint import Joint, covariance, errors, refit, said, strain
from fleetlog.discovery.search.judge import judge
from fleetlog.discovery.search.problem import Noise, Problem
from fleetlog.discovery.settings import Settings

EXCLUDED = 4.0  # Logarithm of the odds by which an excluded rival is behind: 55 to 1, two standard errors
BY_ITSELF = float(ndtr(-1.0))  # P-value of what is as large as the model's own error: one deviation of it


@dataclass(frozen=True)
class Explained:
    """What came of a channel: the models, the findings, and what pictures and files need."""

    problem: Problem
    before: Model
    after: Model
    fit: ChannelFit
    findings: list[Finding]
    adjustments: list[dict[str, Any]]
    fields: dict[str, Values]
    numbers: dict[Knob, Parameter]
    unexplained: bool
    slight: tuple[Hypothesis, float] | None = None  # What is no finding as it moves no more than this share
    unseen: Sequence[Hypothesis] = ()  # Free curves that are no finding
    bare: Model | None = None  # What is written, without what was found
    strain: dict[int | None, float] = field(default_factory=dict)  # See :func:`joint.strain`
    hidden: str | None = None  # What may lie beside the findings


class Task:
    """A channel to explain: the ``problem``, ``windows`` that may be looked at, and a ``sample``, of a
    ``share`` of their trips, on which hypotheses are compared; what is found is fitted to all."""

    def __init__(self, channel: Channel, split: Split, settings: Settings) -> None:
        self.problem = Problem(channel, split, settings, ())
        self.windows = sum(channel.each(self.problem.count))
        trucks = settings.of_truck * len(channel.fleet.vehicles)
        self.share = min(max(settings.sample // 2, trucks), settings.sample) / max(self.windows, 1)
        self.sample = self.problem.sampled(self.share)


def _too_sparse(problem: Problem) -> bool:
    """Whether rows of all trucks are as far apart as a window is to be."""
    return problem.channel.sparse >= {d.vehicle for d in problem.channel.fleet.days}


Searched: TypeAlias = tuple[Search, Noise] | None  # Of a channel's sample; None with too few windows


def searched(base: Model, only: tuple[str, ...], own: Task) -> Searched:
    """Return what explains the sample of a channel, and its noise."""
    if own.windows < own.problem.settings.fewest or _too_sparse(own.problem):
        return None
    own.sample.rest = tuple(hypotheses(own.sample.channel, only))
    return search(own.sample, base), own.sample.noise


def explain(asked: Task, base: Model, result: Searched) -> Explained:
    """Say what a channel is missing, by what was found on its sample."""
    problem, sample = asked.problem, asked.sample
    channel, settings = problem.channel, problem.settings
    if result is None:
        reason = f"only {asked.windows} windows can be used, {settings.fewest} are needed; record more"
        if _too_sparse(problem):
            apart = f"rows are {channel.fleet.step:.0f} s apart, and motion between them is not known"
            reason = f"{apart}; record a row every few seconds"
        fit = ChannelFit(channel.name, channel.metric, None, None, None, reason)
        return Explained(problem, base, base, fit, [], [], {}, {}, False)
    found, sample.noise = result
    if asked.share >= 1.0:
        problem.noise = sample.noise
    problem.learn(found.joint.model, found.joint.chosen)
    kept = [h for h in found.joint.chosen if h.term is not None]
    # What is written holds no free curve; the corrections beside it are fitted without one, too.
    final = _on_all(asked, found.joint, kept)
    while True:
        known = covariance(problem, final)
        numbers = _numbers(final, errors(known[0]))
        # A number may only be plausible beside a curve, or be none of its time once all trips are fitted.
        none = [h for h in kept if h.scope.timed and _within_tolerance(base, numbers, h)]
        if not (gone := [h for h in kept if h.knobs and (h in none or on_bound(problem, final, h))]):
            break
        kept = [h for h in kept if h not in gone]
        model = found.joint.model.without({k for h in gone for k in h.knobs}, set())
        final = _on_all(asked, replace(found.joint, model=model), kept)
    chosen = [h for h in found.joint.chosen if h.term is None or h in kept]
    told = [h for h in chosen if not _within_tolerance(base, numbers, h)]
    named, untold = ([h for h in kept if (h in told) == wanted] for wanted in (True, False))
    # The strongest single hypothesis, whatever came of it: its p-value is uniform on a clean recording.
    best = [h for h in (found.best_untold,) if h is not None]
    # What a number of the truck file is off beside no finding is known as well from the sample.
    sums = sample.sums(found.base.model, [*untold, *best]) if named or best else None
    # Where nothing is told, there is no difference between before and after.
    before = refit(sample, found.base.model, untold, known=sums) if named else final
    beside = {h: refit(problem, final.model, [*kept, h], steps=1) for h in told if h.term is None}
    pair = [found.base, refit(sample, found.base.model, best, steps=1, known=sums)] if best else []
    without = {h: final.without(h) for h in named}
    fit, judged, rest, lasting = judge(problem, before.model, final, without, beside, pair, asked.share)
    values = {h.term: _values(problem, final, h, *known) for h in named if h.term and (h.field or h.patterns)}
    free = {h: _values(problem, j, h, *covariance(problem, j)) for h, j in beside.items() if h.field}
    # A free curve says no more than that something is left: unseen trips must show it, beyond the model's own
    # error, and of free places one at least must stand out.
    doubtful = [
        h for h in beside if BY_ITSELF < (judged[h].p_value or 0.0) < 1.0
        or (h in free and not fields.together(channel.cells(None), free[h]).any())
    ]  # fmt: skip
    told = [h for h in told if h not in doubtful]
    beside = {h: beside[h] for h in told if h in beside}
    findings = []
    for h in told:
        where, parameters = _where(problem, found, h, free.get(h, values.get(h.term or "")), numbers)
        shaped = {f"{k.definition.bounds}_threshold": v for k, v in h.shapes.items() if k.definition.bounds}
        when, scope = (shaped or None, h.scope) if h not in beside else _classes(problem, beside[h])
        own = judged.get(h, Errors(fit.metric, fit.before, fit.after, fit.p_value))
        findings.append(_finding(problem, found, h, where, when, scope, parameters, own))
    after = final.model
    if (lost := channel.lost(after)) is not None and others.counts(lost, settings):
        own = Errors(fit.metric, unseen(channel, after, final), fit.after, lost.p_value)
        findings.append(others.of_lost(lost, channel, own))
        values[findings[-1].term] = others.values(lost)
        after = after.with_field(findings[-1].term, others.values(lost).deviation)
    evident = [one for one in lasting if others.lasts(one, channel, settings)]
    if not beside and problem.split.kind != "stretches" and evident:
        findings.append(others.of_lasting(evident, fit, channel.fleet.vehicles))
    order = sorted(findings, key=lambda f: -f.strength)
    # What predicts worse than the nominal model, all together, explains nothing.
    worse = bool(fit.before and fit.after and fit.after > settings.at_floor * fit.before)
    if after is not final.model:  # The nominal model knows of no other vehicle in the way.
        fit.before = unseen(channel, before.model, final)
    unexplained = worse or (rest is not None and _above_floor(problem, rest, fit.floor))
    hidden = fit.reason or (None if unexplained else _hidden(asked, fit))
    if not findings:
        fit.reason = hidden
    taken = {k for h in told for k in h.knobs}
    trucks = channel.fleet.vehicles
    small = [
        {"name": f"{k.term}.{k.parameter}", "vehicle": None if k.scope.one is None else trucks[k.scope.one],
         "value": n.value, "low": n.low, "high": n.high, "unit": n.unit}
        for k, n in numbers.items()
        if k not in taken and final.model.at.get(k, base.coordinate(k)) != base.coordinate(k)
        and k.definition.edges[0] < n.value < k.definition.edges[1]
    ]  # fmt: skip
    off = strain(sample, final) if channel.bends else {}  # How trucks are driven is a habit
    small += [] if channel.bends else _habits(channel, final, errors(known[0]))
    told_of = order, small, values, numbers, unexplained, found.slight, doubtful, final.without(*named), off
    return Explained(problem, before.model, after, fit, *told_of, hidden)


def _on_all(asked: Task, joint: Joint, kept: Sequence[Hypothesis]) -> Joint:
    """Fit hypotheses to all trips: from where a sample leads, one step is as good as many (Le Cam 1956)."""
    if asked.share >= 1.0 or joint.chosen != tuple(kept):
        joint = refit(asked.sample, joint.model, kept)
    return joint if asked.share >= 1.0 else refit(asked.problem, joint.model, kept, steps=1)


def _habits(channel: Channel, joint: Joint, error: Floats) -> list[dict[str, Any]]:
    """How trucks are driven beside what the profile says, as adjustments."""
    own = [i for i, a in enumerate(joint.design.atoms) if a.of_error]
    told = zip(channel.errors, joint.fitted.beta[own].tolist(), error[own].tolist(), strict=True)
    return [
        {"name": f"{channel.name}.{s.name.replace(' ', '_')}", "vehicle": None, "value": at,
         "low": at - NORMAL * e, "high": at + NORMAL * e, "unit": s.unit}
        for s, at, e in told if at
    ]  # fmt: skip


def unseen(channel: Channel, model: Model, habit: Joint | None = None) -> float | None:
    """Return a model's error on held-out trips; beside a fit's ``habit`` also with others in the way."""
    off, size = 0.0, 0.0
    for unit in channel.units():
        use = (unit.fold == HELD_OUT) & (unit.whole if habit is None else unit.recorded > 0.0)
        beside = 0.0 if habit is None else said(channel, unit, habit)[1]
        off += float(((unit.recorded - channel.predict(unit, model) - beside)[use] ** 2).sum())
        size += float((unit.recorded[use] ** 2).sum())
    return float(np.sqrt(off / size)) if size else None


def _within_tolerance(base: Model, numbers: dict[Knob, Parameter], h: Hypothesis) -> bool:
    """Whether a number found may be no more than a truck file or a logger is off, by its interval."""
    if len(h.knobs) != 1 or h.setting:
        return False
    knob = h.knobs[0]
    p, found, nominal = knob.definition, numbers[knob], base.value(knob.fleet)
    # A truck file that is a little off is off all the time.
    always = not knob.scope.timed
    allowed = max(p.allowance(base.truck), p.allowance(base.truck, not knob.scope.whole)) if always else 0.0
    above = (p.ceiling and always) or found.low <= nominal + allowed
    return above if found.value > nominal else found.high >= nominal - allowed


def _above_floor(problem: Problem, rest: float, floor: float | None) -> bool:
    """Whether an error beside what sampling hides has more than noise, something material, and more than the
    model's own error where it gathers."""
    if floor is None:
        return False
    left = np.sqrt(max(rest**2 - floor**2, 0.0))
    channel = problem.channel
    least = max(problem.settings.material, channel.gathers * channel.plain_error)
    return bool(left > least and rest > problem.settings.at_floor * floor)


def _hidden(asked: Task, fit: ChannelFit) -> str | None:
    """Say what may hide: an error that few trips show; or a number that changes a material share of every
    window, by what noise leaves to a model that is right. It would gain half of windows * (share / floor)^2;
    more where trucks differ, as a poor logger hides only what its own truck shows."""
    if fit.after and _above_floor(asked.problem, fit.after, fit.floor):
        return f"{percent(fit.after)} is left, but in too few trips to tell it from chance; record more"
    settings, each = asked.problem.settings, dict[int, Floats]()
    for unit in asked.sample.training():
        use, noise = unit.whole, 1.0 / asked.sample.noise.plain(unit)
        own = np.array([use.sum(), (unit.recorded[use] ** 2).sum(), noise[use].sum()])
        each[unit.key[0]] = each.get(unit.key[0], 0.0) + own
    count, energy, noise = np.stack([own for own in each.values() if own[0] > 0.0], axis=1)
    known = count @ (energy / noise) / count.sum() / (energy.sum() / noise.sum())
    nats = 2.0 * (settings.evidence + settings.parameter)
    least = (fit.floor or 0.0) * np.sqrt(nats / asked.windows / known)
    if least <= settings.material:
        return None
    return f"noise hides what changes it by less than {percent(least)}; record more, or rows closer together"


def _numbers(joint: Joint, error: Floats) -> dict[Knob, Parameter]:
    """Every number with its interval, by knob; a vehicle's own is told in full, not as a deviation."""
    model, atoms = joint.model, zip(joint.design.atoms, error, strict=True)
    known = ((a.knob, a.knob.definition, e) for a, e in atoms if a.knob is not None)
    return {k: interval(p, model.total(k), e, p.nominal(model.truck)) for k, p, e in known}


def _values(problem: Problem, joint: Joint, h: Hypothesis, *known: Floats) -> Values:
    """A field with the error of every cell; without a term in watts, or as a share of the time."""
    own = [i for i, a in enumerate(joint.design.atoms) if a.owner == h]
    cells = problem.channel.cells(h.physics)
    basis = np.column_stack([p.weights for p in h.patterns]) if h.patterns else cells.root
    inner = [part[np.ix_(own, own)] for part in known]
    passes = problem.channel.passes(h.physics)
    if h.term:
        return Values(joint.model.fields[h.term], passes, basis, *inner)
    basis = UNIT["time" if problem.channel.name == "speed" else "moving"] * basis
    return Values(basis @ joint.fitted.beta[own], passes, basis, *inner)


def _finding(
    problem: Problem, found: Search, h: Hypothesis, where: dict[str, Any] | None, when: dict[str, Any] | None,
    whose: Scope, parameters: list[Parameter], own: Errors,
) -> Finding:  # fmt: skip
    channel, term = problem.channel, h.physics
    scope, rivals = words.scope(whose, channel.fleet.vehicles), _open(found, h)
    # The share of the finding's gain that each rival reached, on the trips of the search
    others = [
        {"term": r.hypothesis.name, "depends_on": list(r.hypothesis.depends_on),
         "held_out_gain": None if own.gain is None else own.gain * r.share}
        for r in found.rivals.get(h.kind, [])[:6]
    ]  # fmt: skip
    unknown = words.unknown(h.depends_on, where, scope)
    text = words.statement(term, parameters, where, scope) if term else unknown
    return Finding(
        h.name, channel.name, text, rivals, words.needs(h.term, rivals), list(h.depends_on),
        where, when, scope, parameters, own.evidence(others), own.fit, own.gain or 0.0, h.term,
    )  # fmt: skip


def _open(found: Search, h: Hypothesis) -> list[str]:
    """Rivals that the trips cannot tell from a finding, once each."""
    near = [r.hypothesis for r in found.rivals.get(h.kind, []) if r.behind < EXCLUDED]
    chosen = {c.term for c in found.joint.chosen}
    names = [o.name if o.name == o.term else f"{o.name}({','.join(o.depends_on)})" for o in near]
    return [n for n in dict.fromkeys(names) if n not in chosen]


def _where(
    problem: Problem, found: Search, h: Hypothesis, v: Values | None, numbers: dict[Knob, Parameter]
) -> tuple[dict[str, Any] | None, list[Parameter]]:
    if v is not None and (h.field or h.patterns):
        return fields.told(problem.channel.cells(h.physics), v, h)
    out = [numbers[k] for k in h.knobs if k in numbers]
    for knob in h.shapes:
        p, now = knob.definition, found.joint.model.value(knob)
        half = 0.5 * scanned(p)
        out.append(Parameter(p.name, now, max(now - half, p.low), min(now + half, p.high), p.unit, p.neutral))
    for n in [numbers[k] for k in h.knobs if k.definition.added and k in numbers]:
        value, low, high = (v - n.nominal for v in (n.value, n.low, n.high))
        out.append(Parameter(f"added_{n.name}", value, low, high, n.unit))
    return None, out


def _classes(problem: Problem, beside: Joint) -> tuple[dict[str, Any] | None, Scope]:
    """What each trip has of its own, with its interval: a share of the weight (force), or watts (power); and
    the vehicles that stand out where each has a value, all if most do."""
    h = beside.chosen[-1]
    by_vehicle = h.curve is not None and h.curve.variables == ("vehicle_id",)
    if h.curve is None or not (h.curve.classes or by_vehicle):
        return None, h.scope
    own = [i for i, a in enumerate(beside.design.atoms) if a.owner == h]
    value, half = beside.fitted.beta[own], NORMAL * errors(covariance(problem, beside)[0])[own]
    if by_vehicle:
        odd = np.flatnonzero(np.abs(value) > np.maximum(half, LARGE * np.abs(value).max()))
        return None, h.scope if 2 * len(odd) > len(value) else Scope(tuple(odd.tolist()))
    each = UNIT[h.curve.mode] * np.stack([value, value - half, value + half], axis=1)
    trips = dict(zip(h.curve.classes, each.tolist(), strict=True))
    return {"trips": trips, "unit": "1" if h.curve.mode in ("force", "drive") else "W"}, h.scope

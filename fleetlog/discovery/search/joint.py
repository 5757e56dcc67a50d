"""The joint fit: all numbers of some hypotheses together, by Gauss and Newton, on sums about the model; what
it says of windows, and how large an effect in it is."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.special import ndtri

from fleetlog.core.arrays import Floats
from fleetlog.discovery.channels.base import Channel, Unit
from fleetlog.discovery.hypotheses.hypothesis import Chosen, Hypothesis
from fleetlog.discovery.hypotheses.sources import Layout
from fleetlog.discovery.model import Knob, Model
from fleetlog.discovery.search.design import Design, make_design
from fleetlog.discovery.search.problem import Problem
from fleetlog.discovery.search.ridge import Fitted, Sums, cross_validated

MOST_STEPS = 4
SETTLED = 0.1  # Steps end when all are below this share of tolerance or range: each is a tenth of the last
SHARES = (1.0, 0.25)  # Of its tolerances that a truck file uses; one share for all its numbers is fitted
VARIANCES = (0.03, 0.3, 3.0, 30.0)  # Tried for fields and free curves, of what is usual; ten apart will do
CHANCE = 0.025  # That a number lies beyond either side of its tolerance, which is stated at 95 %


@dataclass(frozen=True)
class Joint:
    """A set of hypotheses fitted: the model, its (F,) cross-validated losses in natural logarithms, and its
    score. ``score`` is minus the logarithm of what speaks for the model: losses, penalty of the prior, and
    the cost of its numbers."""

    model: Model
    chosen: Chosen
    losses: Floats
    score: float
    energy: float  # Weighted square of the recorded quantity, in the unit of the losses
    design: Design
    fitted: Fitted

    def without(self, *several: Hypothesis) -> Model:
        """Return the model with hypotheses taken out and everything else in place."""
        fields = {h.term for h in several if (h.field or h.patterns) and h.term}
        return self.model.without({k for h in several for k in (*h.knobs, *h.shapes)}, fields)


def verified(worse: Joint, better: Joint) -> float:
    """Return by how much a model is better on unseen trips: root mean square over that of the energy."""
    return float(np.sqrt(max(float((worse.losses - better.losses).sum()), 0.0) / max(better.energy, 1e-12)))


def scored(
    problem: Problem, sums: Sums, model: Model, chosen: Sequence[Hypothesis], shares: Sequence[float] = SHARES
) -> Joint:
    """Return hypotheses fitted linearly about a model, the truck file taken to be as good as fits best."""
    unit = 2.0 * problem.noise.design
    design = make_design(problem.channel, sums.layout, model, chosen)
    normal = design.normal(sums)
    cost = sum(problem.price(h) for h in chosen)
    out = []
    for share in shares:
        own = design.scaled(share)
        fitted = cross_validated(normal, own.prior)
        losses = fitted.losses / unit
        score = float(losses.sum()) + fitted.penalty + own.occam(normal, share) + cost
        out.append(Joint(model, tuple(chosen), losses, score, sums.energy / unit, own, fitted))
    return min(out, key=lambda j: j.score)


def tuned(problem: Problem, sums: Sums, model: Model, chosen: Sequence[Hypothesis]) -> Joint:
    """Return a set of hypotheses fitted linearly about a model, each field and free curve with the variance
    that fits best beside the others: of what the first had to take up the next may tell the cause."""
    best = scored(problem, sums, model, chosen)
    for i, h in enumerate(chosen):
        for variance in () if h.numbers else VARIANCES:
            tried = [*best.chosen[:i], replace(h, variance=variance), *best.chosen[i + 1 :]]
            best = min(best, scored(problem, sums, model, tried), key=lambda j: j.score)
    return best


def tightened(chosen: Chosen) -> list[Chosen]:
    """Return hypotheses, and the same with tight priors of fields: wide ones take up what is yet to tell."""
    tight = tuple(replace(h, variance=VARIANCES[0]) if h.field and h.term else h for h in chosen)
    return [chosen] if tight == chosen else [chosen, tight]


def moved(joint: Joint, problem: Problem) -> tuple[Model, float]:
    """Return the model after a fit's step, and how far the boldest number went, as a share of its range."""
    steps: dict[Knob, float] = {}
    fields: dict[str, Floats] = {}
    far = 0.0
    patterns: dict[Hypothesis, int] = {}
    for atom, step in zip(joint.design.atoms, joint.fitted.beta, strict=True):
        if atom.knob is not None:
            steps[atom.knob] = steps.get(atom.knob, 0.0) + float(step)
            far = max(far, abs(float(step)) * np.sqrt(atom.precision))
        elif (h := atom.owner) is not None and h.term is not None:
            i = patterns[h] = patterns.get(h, -1) + 1
            shape = h.patterns[i].weights if h.patterns else problem.channel.cells(h.physics).root[:, i]
            fields[h.term] = fields.get(h.term, 0.0) + float(step) * shape
    model = joint.model.moved(steps)
    for h in joint.chosen:
        for knob, value in h.shapes.items():
            if knob not in model.at:
                model = replace(model, at={**model.at, knob: knob.definition.scaled(value)})
    for term, deviation in fields.items():
        when = next(h.when for h in joint.chosen if h.term == term)
        model = model.with_field(term, joint.model.fields.get(term, 0.0) + deviation, when)
    return model, far


def refit(
    problem: Problem, model: Model, chosen: Sequence[Hypothesis], steps: int = MOST_STEPS,
    known: Sums | None = None,
) -> Joint:  # fmt: skip
    """Fit a set of hypotheses exactly: the columns are taken anew about the model until it settles. ``known``
    are products about ``model``, which serve the first step if they hold all columns of the hypotheses."""
    joint = None
    if known is not None and not known.layout.holds(problem.layout(chosen)):
        known = None
    for _ in range(steps):
        sums, known = known or problem.sums(model, chosen), None
        joint = scored(problem, sums, model, chosen)
        model, far = moved(joint, problem)
        if far < SETTLED:
            break
    assert joint is not None
    return replace(joint, model=model)


def covariance(problem: Problem, joint: Joint) -> tuple[Floats, Floats]:
    """Return the (k, k) covariance of a fit's coefficients; zero for those on a bound of what is plausible. A
    sandwich (Liang and Zeger 1986, doi 10.1093/biomet/73.1.13), whose meat is the sum over trips of the
    squares of their scores; the prior's part, none of the second matrix, scatters as the prior says."""
    design, prior, beta = joint.design, joint.design.prior, joint.fitted.beta
    gram, meat, shift = _products(problem, joint)
    # A tolerance holds at 95 %: a number on the edge of its own is known no better than one beside it.
    known = [a.ends or (a.owner is None and not (a.of_error and problem.channel.bends)) for a in design.atoms]
    free = prior.within(beta) | np.array(known, bool)
    bread = np.zeros_like(gram)
    inner = gram + np.diag(prior.precision)
    root = np.sqrt(np.maximum(np.diag(inner), 1e-300))  # Ohms and watts differ by more than rounding allows
    scale = np.outer(root, root)
    kept = np.ix_(free, free)
    bread[kept] = np.linalg.pinv((inner / scale)[kept]) / scale[kept]
    scatter = problem.settings.widening**2 * (bread @ meat @ bread)
    out = scatter + problem.settings.widening**2 * (bread @ np.diag(prior.precision) @ bread)
    # The model may be off by its own error in all windows alike: by so much all numbers move together.
    out += np.outer(bread @ shift, bread @ shift)
    # The model's own error differs from place to place, so each place may be off by it alone.
    for h in (h for h in joint.chosen if h.patterns):
        own = [a.owner == h for a in design.atoms]
        shape = np.array([p.weights / np.linalg.norm(p.weights) for p in h.patterns])
        each = bread[:, own] * shift[own] @ shape
        out += each @ each.T
    return np.asarray(out), scatter


def strain(problem: Problem, joint: Joint) -> dict[int | None, float]:
    """Return the share of the energy by which numbers that are off within their tolerances move the model
    together: all of them (None), and those that set a vehicle apart from the others. What they might by
    chance, each on its own, is left out (95 %, of all vehicles)."""
    design, prior = joint.design, joint.design.prior
    sources, vehicles = problem.layout(joint.chosen).sources, len(problem.channel.fleet.vehicles)
    energy, moved = np.zeros(vehicles), np.zeros((vehicles, len(design.atoms)))
    for unit in problem.training():
        modelled, x = problem.channel.columns(unit, joint.model, sources)
        energy[unit.key[0]] += float(modelled[unit.whole].sum())
        moved[unit.key[0]] += design.columns(x, unit.windows.vehicle)[unit.whole].sum(axis=0)
    allowed = np.array([a.owner is None and a.knob is not None for a in design.atoms])
    apart = allowed & np.array([a.vehicle is not None for a in design.atoms])
    off, half = joint.fitted.beta - prior.centre, (prior.high - prior.low) / 2.0
    out: dict[int | None, float] = {}
    for v in (None, *range(vehicles)):
        own, several = (allowed, 1) if v is None else (apart, vehicles)
        by, total = (moved.sum(axis=0), energy.sum()) if v is None else (moved[v], energy[v])
        together, likely = abs(float(by[own] @ off[own])), float(np.linalg.norm(by[own] * half[own]))
        if together > likely * float(ndtri(CHANCE / several) / ndtri(CHANCE)):
            out[v] = together / max(float(total), 1e-12)
    return out


def errors(covariance: Floats) -> Floats:
    """Return the standard error of every coefficient, (k,)."""
    return np.sqrt(np.maximum(np.diag(covariance), 0.0))


def _products(problem: Problem, joint: Joint) -> tuple[Floats, Floats, Floats]:
    """The (k, k) products of columns and of the trips' scores, and the (k,) scores of the model's error."""
    parts = problem.channel.each(partial(_scores, problem, joint, problem.layout(joint.chosen)))
    gram, total, shift, clusters = (sum(p[1:], p[0]) for p in zip(*parts, strict=True))
    return gram, total * clusters / max(clusters - 1.0, 1.0), shift


def _scores(
    problem: Problem, joint: Joint, layout: Layout, units: Iterable[Unit]
) -> tuple[Floats, Floats, Floats, int]:
    """The same of some units, and their number of trips."""
    k = len(joint.design.atoms)
    gram, total, clusters, shift = np.zeros((k, k)), np.zeros((k, k)), 0, np.zeros(k)
    # What free curves say is not in the model, and no residual.
    curves = np.array([a.owner is not None and a.owner.term is None for a in joint.design.atoms])
    said = np.where(curves, joint.fitted.beta, 0.0)
    for unit in problem.training(units):
        modelled, x = problem.channel.columns(unit, joint.model, layout.sources)
        own = joint.design.columns(x, unit.windows.vehicle)
        weighted = own * (problem.noise.weight(unit) * unit.whole)[:, None]
        gram += weighted.T @ own
        shift += weighted.T @ (problem.channel.own_error[unit.key[0]] * np.abs(modelled))
        _, which = np.unique(problem.split.unit(unit.windows), return_inverse=True)
        sums = np.zeros((int(which.max()) + 1, k))
        np.add.at(sums, which, weighted * (unit.recorded - modelled - own @ said)[:, None])
        total += sums.T @ sums
        clusters += len(sums)
    return gram, total, shift, clusters


@dataclass(frozen=True)
class Size:
    """How large an effect is where it acts: the ``share`` of the energy that it makes up, and what of it was
    ``verified``. Verified is the root mean square, over that of the energy, that unseen trips confirm."""

    share: float
    verified: float


def size_of(problem: Problem, now: Joint, joint: Joint) -> Size:
    """Return the size of the last hypothesis, in the windows that it touches. Of a free curve only what
    tolerances cannot say as well: the difference that it makes beside them."""
    h = joint.chosen[-1]
    before = now if h.term is None else replace(joint, model=joint.without(h))

    def seen(unit: Unit) -> Floats:
        effect = said(problem.channel, unit, joint)[0] - said(problem.channel, unit, before)[0]
        there = h.scope.share(int(unit.windows.vehicle[0]), unit.windows.time)
        weight = problem.noise.weight(unit)
        return np.abs(np.stack([effect, unit.recorded, unit.level, weight, there]))[:, unit.whole]

    size, energy, level, weight, there = np.concatenate([seen(u) for u in problem.training()], axis=1)
    acts, power = there > 0.0, weight * size**2
    touched = acts & (size > problem.settings.material * level) if h.placed else acts
    if not touched.any():
        return Size(0.0, 0.0)
    gained = float((now.losses - joint.losses).sum())
    if h.knobs:  # Tolerances may say most of a number in its place: what that costs them speaks for it, too
        gained = max(gained, now.score - joint.score + problem.price(h))
    # Of what is confirmed so much is of the windows touched, by the squares of what the effect says of all.
    part = float(power[touched].sum() / power[acts].sum()) if h.placed else 1.0
    gained = 2.0 * problem.noise.design * max(gained, 0.0) * part
    verified = np.sqrt(gained / max(float((weight * energy**2)[touched].sum()), 1e-12))
    return Size(float(size[touched].sum() / max(float(energy[touched].sum()), 1e-12)), float(verified))


def said(channel: Channel, unit: Unit, joint: Joint) -> tuple[Floats, Floats]:
    """Return what a fit says of every window, (W,): its model, and what free curves add; and what by it
    sampling hides, which is no physics, and not in the model."""
    about, out = channel.about(unit.own, joint.model), []
    curves = [h.sources[0] for h in joint.chosen if h.term is None]
    of_curves = [a.owner is not None and a.owner.term is None for a in joint.design.atoms]
    for sources, own in ((curves, of_curves), (channel.errors, [a.of_error for a in joint.design.atoms])):
        x = about.columns(sources) if sources else np.zeros((len(unit.windows), 0))
        out.append(np.asarray(x @ joint.fitted.beta[own]))
    return about.modelled + out[0], out[1]

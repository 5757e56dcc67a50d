"""The joint fit: all numbers of a set of hypotheses together, by Gauss and Newton, on sums about the
model of the moment."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fleetlog.discovery.hypotheses.hypothesis import Hypothesis
from fleetlog.discovery.model import Knob, Model
from fleetlog.discovery.search.design import Design, make_design
from fleetlog.discovery.search.problem import Problem
from fleetlog.discovery.search.ridge import Fitted, cross_validated
from fleetlog.discovery.search.sums import Sums
from fleetlog.physics.power import all_terms

Floats = NDArray[np.float64]

MOST_STEPS = 4
SETTLED = 0.02  # Steps end when every number moves by less than this share of its tolerance or range
SHARES = (1.0, 0.25)
"""A truck file that is right leaves its tolerances unused; one share for all its numbers is fitted."""
VARIANCES = (0.03, 0.3, 3.0, 30.0)
"""Prior variances that are tried for fields and free curves, in units of what is usual; ten times apart
is fine enough."""


@dataclass(frozen=True)
class Joint:
    """A set of hypotheses fitted: the model, its (F,) cross-validated losses in natural logarithms, and
    its score.

    ``score`` is minus the logarithm of what speaks for the model: losses, penalty of the prior, and the
    cost of its numbers.
    """

    model: Model
    chosen: tuple[Hypothesis, ...]
    losses: Floats
    score: float
    energy: float = 1.0  # Weighted square of the recorded quantity, in the unit of the losses
    design: Design | None = None
    fitted: Fitted | None = None


def verified(worse: Joint, better: Joint) -> float:
    """Return by how much one model is better than another on unseen trips: root mean square over that of
    the energy."""
    return float(np.sqrt(max(float((worse.losses - better.losses).sum()), 0.0) / max(better.energy, 1e-12)))


def scored(
    problem: Problem, sums: Sums, model: Model, chosen: Sequence[Hypothesis], shares: Sequence[float] = SHARES
) -> Joint:
    """Return a set of hypotheses fitted linearly about a model, the truck file taken to be as good as
    fits best."""
    noise = problem.noise
    assert noise is not None
    design = make_design(problem.channel, sums.layout, model, chosen)
    normal = design.normal(sums)
    cost = sum(problem.settings.parameter * h.numbers + h.choices for h in chosen)
    out = []
    for share in shares:
        own = design.scaled(share)
        fitted = cross_validated(normal, own.prior)
        losses = fitted.losses / (2.0 * noise.design)
        score = float(losses.sum()) + fitted.penalty + own.occam(normal, share) + cost
        out.append(
            Joint(model, tuple(chosen), losses, score, sums.energy / (2.0 * noise.design), own, fitted)
        )
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


def tightened(chosen: tuple[Hypothesis, ...]) -> list[tuple[Hypothesis, ...]]:
    """Return a set of hypotheses, and the same with the tightest prior of fields: a wide one takes up what
    is yet to be told apart."""
    tight = tuple(
        replace(h, variance=VARIANCES[0]) if h.field and h.term and not h.patterns else h for h in chosen
    )
    return [chosen] if tight == chosen else [chosen, tight]


def moved(joint: Joint, problem: Problem) -> tuple[Model, float]:
    """Return the model after the step of a fit, and how far the boldest number went, as a share of its
    range."""
    assert joint.design is not None and joint.fitted is not None
    steps: dict[Knob, float] = {}
    fields: dict[str, Floats] = {}
    far = 0.0
    patterns: dict[Hypothesis, int] = {}
    for atom, step in zip(joint.design.atoms, joint.fitted.beta, strict=True):
        if atom.knob is not None:
            own = atom.knob
            steps[own] = steps.get(own, 0.0) + float(step)
            far = max(far, abs(float(step)) * np.sqrt(atom.precision))
        elif atom.owner is not None and atom.owner.physics is not None:
            i = patterns.get(atom.owner, 0)
            patterns[atom.owner] = i + 1
            _add_field(problem, fields, atom.owner, i, float(step))
    model = joint.model.moved(steps)
    for h in joint.chosen:
        settled = dict(h.setting)
        for name, value in settled.items():
            knob = Knob(h.term or "", name)
            if knob not in model.at:
                model = model.with_at({knob: all_terms()[knob.term].by_name[name].scaled(value)})
    for term, deviation in fields.items():
        before = joint.model.fields.get(term)
        when = next(h.when for h in joint.chosen if h.term == term)
        model = model.with_field(term, deviation if before is None else before + deviation, when)
    return model, far


def _add_field(problem: Problem, fields: dict[str, Floats], h: Hypothesis, i: int, step: float) -> None:
    cells = problem.channel.cells(h.physics)
    assert cells is not None and h.physics is not None and h.term is not None
    shape = h.patterns[i].weights if h.patterns else cells.root(h.physics.odd)[:, i]
    change = step * shape
    fields[h.term] = fields.get(h.term, np.zeros(len(change))) + change


def refit(problem: Problem, model: Model, chosen: Sequence[Hypothesis], steps: int = MOST_STEPS) -> Joint:
    """Fit a set of hypotheses exactly: the columns are taken anew about the model until it settles."""
    joint = None
    for _ in range(steps):
        sums = problem.sums(model, chosen)
        joint = scored(problem, sums, model, chosen)
        model, far = moved(joint, problem)
        if far < SETTLED:
            break
    assert joint is not None
    return replace(joint, model=model)

"""Every hypothesis beside a model, at once."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fleetlog.discovery.hypotheses.hypothesis import Hypothesis
from fleetlog.discovery.search.beside import Added, Beside, beside
from fleetlog.discovery.search.design import Design, of_hypothesis
from fleetlog.discovery.search.joint import SHARES, VARIANCES, Joint, scored, tightened
from fleetlog.discovery.search.problem import Problem
from fleetlog.discovery.search.ridge import Prior
from fleetlog.discovery.search.sums import Sums

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Screened:
    """A hypothesis beside a model: what its addition gains, in natural logarithms, all told and (F,) by
    fold."""

    hypothesis: Hypothesis
    gain: float
    by_fold: Floats
    beside: tuple[Hypothesis, ...] = ()
    """The model that it is added to: of fields in it the prior may be tighter."""


def screen(problem: Problem, sums: Sums, joint: Joint, tried: Sequence[Hypothesis]) -> list[Screened]:
    """Return the gain of every hypothesis, best first; slow ones by stretches of hours, the others by
    trips."""
    best: dict[Hypothesis, Screened] = {}
    for chosen, share in itertools.product(tightened(joint.chosen), SHARES):
        other = scored(problem, sums, joint.model, chosen, [share])
        head = joint.score - other.score
        for s in (s for slow in (False, True) for s in _screen(problem, sums, other, tried, slow)):
            now = Screened(s.hypothesis, s.gain + head, s.by_fold, chosen)
            key = s.hypothesis.kind
            if key not in best or now.gain > best[key].gain:
                best[key] = now
    return sorted(best.values(), key=lambda s: -s.gain)


def _screen(
    problem: Problem, sums: Sums, joint: Joint, tried: Sequence[Hypothesis], slow: bool
) -> list[Screened]:
    mine = [h for h in tried if h.slow == slow]
    atoms = [of_hypothesis(problem.channel, sums.layout, joint.model, h) for h in mine]
    if not mine:
        return []
    model, added = beside(joint, sums, [a for own in atoms for a in own], slow)
    ends = np.cumsum([len(own) for own in atoms])
    parts = [added.part(slice(end - len(own), end)) for end, own in zip(ends, atoms, strict=True)]
    priors = [Design(tuple(own)).prior for own in atoms]
    return [_best(problem, h, model, new, p) for h, new, p in zip(mine, parts, priors, strict=True)]


def _best(problem: Problem, h: Hypothesis, model: Beside, new: Added, prior: Prior) -> Screened:
    """A hypothesis with the variance of its prior that serves it best."""
    assert problem.noise is not None
    variances = (1.0,) if h.numbers else VARIANCES
    cost = problem.settings.parameter * h.numbers + h.choices
    tries = []
    gains = model.gains(new, [replace(prior, precision=prior.precision / v) for v in variances])
    for v, (square, paid) in zip(variances, gains, strict=True):
        by_fold = 0.5 * square / problem.noise.design
        own = h if h.numbers else replace(h, variance=v)
        tries.append(Screened(own, float(by_fold.sum()) - cost - paid, by_fold))
    return max(tries, key=lambda s: s.gain)

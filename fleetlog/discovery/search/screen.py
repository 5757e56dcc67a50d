"""Every hypothesis beside a model, at once."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from fleetlog.core.arrays import Floats
from fleetlog.discovery.hypotheses.hypothesis import Hypothesis
from fleetlog.discovery.search.beside import beside
from fleetlog.discovery.search.design import Atom, Design, of_hypothesis
from fleetlog.discovery.search.joint import SHARES, VARIANCES, Joint, scored, tightened
from fleetlog.discovery.search.problem import Problem
from fleetlog.discovery.search.ridge import Prior
from fleetlog.discovery.search.sums import Sums

TOGETHER = 100  # Columns that are looked at together: many small products cost time, very large ones room


@dataclass(frozen=True)
class Screened:
    """A hypothesis beside a model: what its addition gains, in logarithms, in all and (F,) by fold."""

    hypothesis: Hypothesis
    gain: float
    by_fold: Floats
    beside: tuple[Hypothesis, ...] = ()
    """The model that it is added to: of fields in it the prior may be tighter."""


def screen(problem: Problem, sums: Sums, joint: Joint, tried: Sequence[Hypothesis]) -> list[Screened]:
    """Return the gain of every hypothesis, best first; slow ones by stretches of hours, others by trips."""
    best: dict[Hypothesis, Screened] = {}
    for chosen, share in itertools.product(tightened(joint.chosen), SHARES):
        other = scored(problem, sums, joint.model, chosen, [share])
        head = joint.score - other.score
        found = (_screen(problem, sums, other, tried, slow) for slow in (False, True))
        for s in itertools.chain.from_iterable(found):
            now = Screened(s.hypothesis, s.gain + head, s.by_fold, chosen)
            key = s.hypothesis.kind
            if key not in best or now.gain > best[key].gain:
                best[key] = now
    return sorted(best.values(), key=lambda s: -s.gain)


def _screen(
    problem: Problem, sums: Sums, joint: Joint, tried: Sequence[Hypothesis], slow: bool
) -> Iterator[Screened]:
    """Yield every hypothesis, those with a prior of unknown width at several widths."""
    mine = [(h, of_hypothesis(problem.channel, sums.layout, joint.model, h)) for h in tried if h.slow == slow]
    ends = itertools.accumulate(len(own) for _, own in mine)
    grouped = itertools.groupby(zip(mine, ends, strict=True), lambda pair: pair[1] // TOGETHER)
    sets = [[one for one, _ in group] for _, group in grouped]
    products = beside(joint, sums, ([a for _, own in s for a in own] for s in sets), slow)
    for some, (model, added) in zip(sets, products, strict=True):
        wide = list(_at_every_width(some))
        for (h, _, _), (square, paid) in zip(wide, model.gains(added, [w[1:] for w in wide]), strict=True):
            by_fold = 0.5 * square / problem.noise.design
            cost = problem.settings.parameter * h.numbers + h.choices + paid
            yield Screened(h, float(by_fold.sum()) - cost, by_fold)


def _at_every_width(
    tried: Sequence[tuple[Hypothesis, list[Atom]]],
) -> Iterator[tuple[Hypothesis, slice, Prior]]:
    """Hypotheses with the columns of each, and the prior of these."""
    start = 0
    for h, own in tried:
        at, prior = slice(start, start + len(own)), Design(tuple(own)).prior
        start = at.stop
        if h.numbers:
            yield h, at, prior
        else:
            for v in VARIANCES:
                yield replace(h, variance=v), at, replace(prior, precision=prior.precision / v)

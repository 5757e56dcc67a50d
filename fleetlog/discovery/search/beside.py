"""Every hypothesis beside a model at once: the model's coefficients are eliminated from its columns by fold.

What remains is a regression of the few columns alone (Frisch and Waugh 1933, doi 10.2307/1907330).
Coefficients of the model that stand on a bound stay there; the joint fit afterwards lets them go.
"""

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.discovery.hypotheses.hypothesis import Hypothesis
from fleetlog.discovery.search.design import Atom, Design, of_hypothesis
from fleetlog.discovery.search.joint import SHARES, VARIANCES, Joint, scored, tightened
from fleetlog.discovery.search.problem import Problem
from fleetlog.discovery.search.ridge import Prior, Sums, stiff

TOGETHER = 100  # Columns that are looked at together: many small products cost time, very large ones room


@dataclass(frozen=True)
class Added:
    """J columns: products ``cross`` (F, K, J) with others, ``along`` (F, J) a residual, ``own`` (F, J, J)."""

    cross: Floats
    along: Floats
    own: Floats


class Left(NamedTuple):
    """What a model leaves of J columns: ``by`` (K, J) their regression on its own, ``beta`` (K,) its fit
    without them, and their (J, J) ``product`` and (J,) ``moment`` then."""

    by: Floats
    beta: Floats
    product: Floats
    moment: Floats

    def step(self, at: slice, prior: Prior) -> Floats:
        """Return the likeliest coefficients of some of the columns alone."""
        right, product = self.moment[at] + prior.precision * prior.centre, stiff(self.product[at, at], prior)
        # Most are one number, for which the general way takes ten times as long.
        likeliest = right / product[0] if len(right) == 1 else np.linalg.solve(product, right)
        return np.clip(likeliest, prior.low, prior.high)


@dataclass(frozen=True)
class Beside:
    """A model of K coefficients: products ``gram`` (F, K, K) and ``moment`` (F, K) by fold, and its prior."""

    gram: Floats
    moment: Floats
    prior: Prior
    _fits: dict[int | None, tuple[Floats, Floats]] = field(default_factory=dict, repr=False)

    def fit(self, without: int | None = None) -> tuple[Floats, Floats]:
        """Return the (K, K) inverse of its products and its (K,) fit, on all folds or all but one."""
        if without not in self._fits:
            gram, moment = (_but(p, without) for p in (self.gram, self.moment))
            inverse = np.asarray(np.linalg.inv(stiff(gram, self.prior)), float)
            self._fits[without] = inverse, inverse @ (moment + self.prior.precision * self.prior.centre)
        return self._fits[without]

    def left(self, new: Added, without: int | None = None) -> Left:
        """Eliminate the model from columns, on all folds or all but one."""
        inverse, beta = self.fit(without)
        cross, along, own = (_but(p, without) for p in (new.cross, new.along, new.own))
        by = inverse @ cross
        return Left(by, beta, own - cross.T @ by, along - cross.T @ beta)

    def gains(self, new: Added, several: Sequence[tuple[slice, Prior]]) -> list[tuple[Floats, float]]:
        """Return for each of several of the columns under a prior what they gain on every unseen fold, (F,),
        and what they cost all priors."""
        gains = np.zeros((len(several), len(self.gram)))
        for f, (gram, cross) in enumerate(zip(self.gram, new.cross, strict=True)):
            seen = self.left(new, f)
            through = gram @ seen.by
            # Of the fold held out: its products once the fit on the others is taken away.
            product = new.own[f] - cross.T @ seen.by - seen.by.T @ (cross - through)
            moment = new.along[f] - seen.by.T @ self.moment[f] - (cross - through).T @ seen.beta
            for i, (at, prior) in enumerate(several):
                step = seen.step(at, prior)
                gains[i, f] = 2.0 * step @ moment[at] - step @ product[at, at] @ step
        whole = self.left(new)
        paid = []
        for at, prior in several:
            step = whole.step(at, prior)
            paid.append(prior.penalty(step) + self.prior.penalty(whole.beta - whole.by[:, at] @ step))
        return [(g, p - self.prior.penalty(whole.beta)) for g, p in zip(gains, paid, strict=True)]


def _but(products: Floats, fold: int | None) -> Floats:
    total = products.sum(axis=0)
    return np.asarray(total if fold is None else total - products[fold])


def beside(
    joint: Joint, sums: Sums, several: Iterable[Sequence[Atom]], slow: bool = False
) -> Iterator[tuple[Beside, Added]]:
    """Yield a joint model, and products of each of several sets of further coefficients' columns."""
    known = [
        not slow or (a.vehicle is None and a.columns.max() < sums.layout.core) for a in joint.design.atoms
    ]
    own = Design(tuple(a for a, k in zip(joint.design.atoms, known, strict=True) if k))
    prior, beta = own.prior, joint.fitted.beta[known]
    base = np.flatnonzero(prior.within(beta))
    held = beta.copy()
    held[base] = 0.0
    model = None
    for columns in several:
        n = Design((*own.atoms, *columns)).normal(sums, slow)
        moment, extra = n.moment - n.gram[:, :, : len(beta)] @ held, slice(len(beta), None)
        model = model or Beside(n.gram[:, base][:, :, base], moment[:, base], prior.part(base))
        yield model, Added(n.gram[:, base, extra], moment[:, extra], n.gram[:, extra, extra])


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

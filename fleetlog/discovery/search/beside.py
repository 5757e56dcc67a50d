"""Every hypothesis beside a model at once, and the stretches of road over which a field stands out.

The coefficients of the model are eliminated from the further columns, fold by fold.  What remains is a
regression of the few columns alone (Frisch and Waugh 1933, doi 10.2307/1907330). Coefficients of the model
that stand on a bound stay there; the joint fit afterwards lets them go."""

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from fleetlog.core.arrays import Floats, Ints
from fleetlog.discovery.hypotheses.cells import Stretches
from fleetlog.discovery.hypotheses.hypothesis import Chosen, Hypothesis, Pattern
from fleetlog.discovery.recording.blocks import stacked
from fleetlog.discovery.recording.turns import REACH
from fleetlog.discovery.search.design import Atom, Design, of_hypothesis
from fleetlog.discovery.search.joint import SHARES, VARIANCES, Joint, scored, tightened
from fleetlog.discovery.search.problem import Problem
from fleetlog.discovery.search.ridge import Prior, Sums, inverse, stiff

TOGETHER = 100  # Columns that are looked at together: many small products cost time, very large ones room
MOST_PATTERNS = 6


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
        return np.clip(np.linalg.solve(product, right), prior.low, prior.high)

    def alone(self, at: Ints, prior: Prior) -> Floats:
        """Return the likeliest coefficient of each of some of the columns, without the others."""
        own = self.product[at, at]
        drawn, stiffened = self.moment[at] + prior.precision * prior.centre, np.maximum(own, 1e-12) * 1e-9
        return np.clip(drawn / (own + (prior.precision + stiffened)), prior.low, prior.high)


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
            own = inverse(stiff(gram, self.prior))
            self._fits[without] = own, own @ (moment + self.prior.precision * self.prior.centre)
        return self._fits[without]

    def left(self, new: Added, without: int | None = None) -> Left:
        """Eliminate the model from columns, on all folds or all but one."""
        own_inverse, beta = self.fit(without)
        cross, along, own = (_but(p, without) for p in (new.cross, new.along, new.own))
        by = own_inverse @ cross
        return Left(by, beta, own - cross.T @ by, along - cross.T @ beta)

    def gains(self, new: Added, several: Sequence[tuple[slice, Prior]]) -> list[tuple[Floats, float]]:
        """Return for each of several of the columns under a prior what they gain on every unseen fold, (F,),
        and what they cost all priors."""
        gains, paid = np.zeros((len(several), len(self.gram))), np.zeros(len(several))
        # Most have one column: these are looked at together, as the general way takes twenty times as long.
        one = np.array([at.stop - at.start == 1 for at, _ in several], bool)
        more = [(i, *several[i]) for i in np.flatnonzero(~one).tolist()]
        own = [several[i] for i in np.flatnonzero(one).tolist()]
        where, none = np.array([at.start for at, _ in own], np.int64), self.prior.part(np.zeros(0, np.int64))
        each = Prior(**stacked([none, *(prior for _, prior in own)]))
        for f, (gram, cross) in enumerate(zip(self.gram, new.cross, strict=True)):
            seen = self.left(new, f)
            through = gram @ seen.by
            # Of the fold held out: its products once the fit on the others is taken away.
            product = new.own[f] - cross.T @ seen.by - seen.by.T @ (cross - through)
            moment = new.along[f] - seen.by.T @ self.moment[f] - (cross - through).T @ seen.beta
            alone = seen.alone(where, each)
            gains[one, f] = alone * (2.0 * moment[where] - product[where, where] * alone)
            for i, at, prior in more:
                step = seen.step(at, prior)
                gains[i, f] = 2.0 * step @ moment[at] - step @ product[at, at] @ step
        whole = self.left(new)
        alone = whole.alone(where, each)
        moved = whole.beta[:, None] - whole.by[:, where] * alone - self.prior.centre[:, None]
        paid[one] = 0.5 * (each.precision * (alone - each.centre) ** 2 + self.prior.precision @ moved**2)
        for i, at, prior in more:
            step = whole.step(at, prior)
            paid[i] = prior.penalty(step) + self.prior.penalty(whole.beta - whole.by[:, at] @ step)
        return list(zip(gains, (paid - self.prior.penalty(whole.beta)).tolist(), strict=True))


def _but(products: Floats, fold: int | None) -> Floats:
    total = products.sum(axis=0)
    return np.asarray(total if fold is None else total - products[fold])


def beside(
    joint: Joint, sums: Sums, several: Iterable[Sequence[Atom]], slow: bool = False
) -> Iterator[tuple[Beside, Added]]:
    """Yield a joint model, and products of each of several sets of further coefficients' columns."""
    atoms = joint.design.atoms
    known = [not slow or (a.vehicle is None and a.columns.max() < sums.layout.core) for a in atoms]
    own = Design(tuple(a for a, k in zip(atoms, known, strict=True) if k))
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
    beside: Chosen = ()
    """The model that it is added to: of fields in it the prior may be tighter."""


def screen(problem: Problem, sums: Sums, joint: Joint, tried: Sequence[Hypothesis]) -> list[Screened]:
    """Return the gain of every hypothesis, best first; slow ones by stretches of hours, others by trips."""
    best: dict[Hypothesis, Screened] = {}
    for chosen, share in itertools.product(tightened(joint.chosen), SHARES):
        other = scored(problem, sums, joint.model, chosen, [share])
        head = joint.score - other.score
        found = (gained(problem, sums, other, [h for h in tried if h.slow == s], s) for s in (False, True))
        for s in itertools.chain.from_iterable(found):
            now = Screened(s.hypothesis, s.gain + head, s.by_fold, chosen)
            key = s.hypothesis.kind
            if key not in best or now.gain > best[key].gain:
                best[key] = now
    return sorted(best.values(), key=lambda s: -s.gain)


def gained(
    problem: Problem, sums: Sums, joint: Joint, tried: Sequence[Hypothesis], slow: bool = False
) -> Iterator[Screened]:
    """Yield every hypothesis, those with a prior of unknown width at several widths; on trips that were not
    seen, or on stretches of hours (``slow``)."""
    mine = [(h, of_hypothesis(problem.channel, sums.layout, joint.model, h)) for h in tried]
    ends = itertools.accumulate(len(own) for _, own in mine)
    grouped = itertools.groupby(zip(mine, ends, strict=True), lambda pair: pair[1] // TOGETHER)
    sets = [[one for one, _ in group] for _, group in grouped]
    products = beside(joint, sums, ([a for _, own in s for a in own] for s in sets), slow)
    for some, (model, added) in zip(sets, products, strict=True):
        wide = list(_by_width(some))
        for (h, _, _), (square, paid) in zip(wide, model.gains(added, [w[1:] for w in wide]), strict=True):
            by_fold = 0.5 * square / problem.noise.design
            yield Screened(h, float(by_fold.sum()) - (problem.price(h) + paid), by_fold)


def _by_width(tried: Sequence[tuple[Hypothesis, list[Atom]]]) -> Iterator[tuple[Hypothesis, slice, Prior]]:
    """Hypotheses with the columns of each, and the prior of these."""
    start = 0
    for h, own in tried:
        at, prior = slice(start, start + len(own)), Design(tuple(own)).prior
        start = at.stop
        for v in (1.0,) if h.numbers else VARIANCES:
            yield replace(h, variance=v), at, replace(prior, precision=prior.precision / v)


def pattern_hypotheses(problem: Problem, sums: Sums, joint: Joint, h: Hypothesis) -> list[Hypothesis]:
    """Return simple shapes of a field: an even slope of the site, one stretch of road, two, and so on."""
    cells = problem.channel.cells(h.physics)
    out = []
    if cells.odd:
        even = tuple(Pattern(d.tobytes(), "whole site") for d in cells.directions())
        out.append(replace(h, field=False, patterns=even))
    if isinstance(cells, Stretches):
        found = _stretches(problem, sums, joint, h, cells)
        out += [replace(h, field=False, patterns=tuple(found[: i + 1])) for i in range(len(found))]
    return out


def _stretches(problem: Problem, sums: Sums, joint: Joint, h: Hypothesis, cells: Stretches) -> list[Pattern]:
    assert h.physics is not None
    # (C,) moments and (C, C) products of the cells beside the model: columns are in the prior's basis.
    own = of_hypothesis(problem.channel, sums.layout, joint.model, h)
    left = next(model.left(columns) for model, columns in beside(joint, sums, [own]))
    moment, product = cells.inverse.T @ left.moment, cells.inverse.T @ left.product @ cells.inverse
    evident = 2.0 * problem.noise.design * (problem.settings.parameter + 5.0)
    passes = problem.channel.passes(h.physics)
    moment, product = moment * (passes > 0), product * np.outer(passes > 0, passes > 0)
    share = passes / max(float(passes.sum()), 1.0)
    material = max(problem.settings.material, problem.channel.place_error) ** 2 * sums.energy
    plausible = h.physics.parameters[0].plausible
    # What is near a junction alone is not told from how the junction is crossed; but waits are often there.
    near = 0.0 if h.waits else REACH
    found: list[Pattern] = []
    while len(found) < MOST_PATTERNS:
        runs = (_best(moment, product, plausible, near, cells, *road) for road in cells.roads())
        best, first, last = max(runs, key=lambda run: run[0])
        if best < max(evident, material * float(share[first:last].sum())):
            break
        pattern = np.zeros(len(cells))
        pattern[first:last] = 1.0
        found.append(Pattern(pattern.tobytes(), cells.label(first, last)))
        # The next is what this one leaves.
        along = product @ pattern
        size = float(pattern @ along)
        moment = moment - along * float(pattern @ moment) / size
        product = product - np.outer(along, along) / size
    return found


def _best(
    moment: Floats, product: Floats, plausible: tuple[float, float], near: float, cells: Stretches,
    first: int, last: int,
) -> tuple[float, int, int]:  # fmt: skip
    """The run of cells of a road whose common value, a plausible one, explains most: twice the gain in
    likelihood, its ends.  A part of the road at its end says more than what it has within ``near`` [m] of
    the junction says alone, or it is none."""
    n = last - first
    u = np.concatenate([[0.0], np.cumsum(moment[first:last])])
    d = np.zeros((n + 1, n + 1))
    d[1:, 1:] = np.cumsum(np.cumsum(product[first:last, first:last], axis=0), axis=1)
    i, j = np.triu_indices(n + 1, 1)
    size = d[j, j] - d[i, j] - d[j, i] + d[i, i]
    own = np.trace(product) / len(product)
    along = u[j] - u[i]
    value = np.clip(along / np.maximum(size, 1e-12), *plausible)
    gain = np.zeros((n + 1, n + 1))
    gain[i, j] = np.where(size > 1e-3 * own, value * (2.0 * along - value * size), 0.0)
    close = int(near // ((cells.end[last - 1] - cells.start[first]) / n))
    at_begin, at_end = (i == 0) & (j < n), (j == n) & (i > 0)
    a, b = np.where(at_end, np.maximum(i, n - close), i), np.where(at_begin, np.minimum(j, close), j)
    near_end = np.where(at_begin | at_end, gain[a, b], 0.0) if close else 0.0
    told = np.where(gain[i, j] > near_end, gain[i, j], 0.0)
    # Of runs that say the same the shortest: cells that nothing touches belong to none.
    k = int(np.argmax(told - 1e-6 * told.max() * (j - i)))
    return float(told[k]), first + int(i[k]), first + int(j[k])

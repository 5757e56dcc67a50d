"""Every hypothesis beside a model, at once: the model's own coefficients are eliminated from all columns,
fold by fold.

What remains of each hypothesis is a regression of its few columns alone (Frisch and Waugh 1933, doi
10.2307/1907330).
Coefficients of the model that stand on a bound stay there; the joint fit afterwards lets them go.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.discovery.hypotheses.hypothesis import Hypothesis
from fleetlog.discovery.search.design import Atom, Design, of_hypothesis
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
    fast = [h for h in tried if not h.slow]
    slow = [h for h in tried if h.slow]
    best: dict[Hypothesis, Screened] = {}
    for chosen, share in itertools.product(tightened(joint.chosen), SHARES):
        other = scored(problem, sums, joint.model, chosen, [share])
        head = joint.score - other.score
        for s in _screen(problem, sums, other, fast, False) + _screen(problem, sums, other, slow, True):
            now = Screened(s.hypothesis, s.gain + head, s.by_fold, chosen)
            key = s.hypothesis.kind
            if key not in best or now.gain > best[key].gain:
                best[key] = now
    return sorted(best.values(), key=lambda s: -s.gain)


def _screen(
    problem: Problem, sums: Sums, joint: Joint, tried: Sequence[Hypothesis], slow: bool
) -> list[Screened]:
    if not tried:
        return []
    assert problem.noise is not None and joint.design is not None and joint.fitted is not None
    scale = 0.5 / problem.noise.design
    kept = [
        i
        for i, a in enumerate(joint.design.atoms)
        if not (slow and (a.vehicle is not None or a.columns.max() >= sums.core))
    ]
    atoms, beta = [joint.design.atoms[i] for i in kept], joint.fitted.beta[kept]
    prior = Design(tuple(atoms)).prior
    free = np.flatnonzero((beta > prior.low) & (beta < prior.high))
    columns: list[Atom] = []
    where: list[tuple[Hypothesis, slice]] = []
    for h in tried:
        own = of_hypothesis(problem.channel, sums.layout, joint.model, h)
        where.append((h, slice(len(columns), len(columns) + len(own))))
        columns.extend(own)
    normal = Design((*atoms, *columns)).normal(sums, slow)
    k, held = len(atoms), beta.copy()
    held[free] = 0.0
    fixed = np.flatnonzero(held)
    base, extra = free, np.arange(k, k + len(columns))
    moment = normal.moment - np.einsum("fij,j->fi", normal.gram[:, :, fixed], held[fixed])
    square = (
        normal.square
        - 2.0 * normal.moment[:, fixed] @ held[fixed]
        + np.einsum("i,fij,j->f", held[fixed], normal.gram[:, fixed][:, :, fixed], held[fixed])
    )
    left = _Left(normal.gram, moment, square, base, extra, _only(prior, base))
    add = Design(tuple(columns)).prior
    losses = np.zeros((len(where), len(VARIANCES), len(square)))
    plain = np.zeros(len(square))
    for f in range(len(square)):
        plain[f] = left.fold(f)
        for i, (h, at) in enumerate(where):
            for j, v in enumerate(_variances(h)):
                losses[i, j, f] = left.loss(at, _scaled(add, at, v))
    left.whole()
    out = []
    for i, (h, at) in enumerate(where):
        tries = []
        for j, v in enumerate(_variances(h)):
            gains = (plain - losses[i, j]) * scale
            mine = _scaled(add, at, v)
            cost = (
                problem.settings.parameter * h.numbers
                + h.choices
                + left.penalty(at, mine)
                - left.penalty(at, None)
            )
            tries.append(
                Screened(h if h.numbers else replace(h, variance=v), float(gains.sum()) - cost, gains)
            )
        out.append(max(tries, key=lambda s: s.gain))
    return out


def _variances(h: Hypothesis) -> tuple[float, ...]:
    return (1.0,) if h.numbers else VARIANCES


def _scaled(prior: Prior, at: slice, variance: float) -> Prior:
    precision = prior.precision[at] / variance
    return Prior(precision, prior.centre[at], prior.low[at], prior.high[at])


def _only(prior: Prior, which: NDArray[np.intp]) -> Prior:
    return Prior(prior.precision[which], prior.centre[which], prior.low[which], prior.high[which])


class _Left:
    """Columns ``extra`` once the coefficients ``base`` are eliminated, about one fold held out or none."""

    def __init__(
        self,
        gram: Floats,
        moment: Floats,
        square: Floats,
        base: NDArray[np.intp],
        extra: NDArray[np.intp],
        prior: Prior,
    ) -> None:
        self.gram, self.moment, self.square, self.base, self.extra, self.prior = (
            gram,
            moment,
            square,
            base,
            extra,
            prior,
        )
        self.total, self.sum = gram.sum(axis=0), moment.sum(axis=0)

    def fold(self, f: int) -> float:
        """Eliminate by all folds but one; return that one's loss."""
        self._eliminate(self.total - self.gram[f], self.sum - self.moment[f])
        b, e, g, m = self.base, self.extra, self.gram[f], self.moment[f]
        bb, be = g[np.ix_(b, b)], g[np.ix_(b, e)]
        through = bb @ self.by
        self.test = g[np.ix_(e, e)] - self.by.T @ be - (self.by.T @ be).T + self.by.T @ through
        self.test_moment = m[e] - self.by.T @ m[b] - (be - through).T @ self.beta
        self.plain = float(self.square[f] - 2.0 * self.beta @ m[b] + self.beta @ bb @ self.beta)
        return self.plain

    def whole(self) -> None:
        """Eliminate by all folds."""
        self._eliminate(self.total, self.sum)

    def _eliminate(self, gram: Floats, moment: Floats) -> None:
        b, e = self.base, self.extra
        h = gram[np.ix_(b, b)] + np.diag(self.prior.precision + 1e-9 * np.maximum(gram[b, b], 1e-12))
        cross = gram[np.ix_(b, e)]
        solved = np.linalg.solve(
            h, np.column_stack([cross, moment[b] + self.prior.precision * self.prior.centre])
        )
        self.by, self.beta = solved[:, :-1], solved[:, -1]
        self.train = gram[np.ix_(e, e)] - cross.T @ self.by
        self.train_moment = moment[e] - cross.T @ self.beta

    def step(self, at: slice, prior: Prior) -> Floats:
        """Return the likeliest coefficients of some of the extra columns."""
        d = self.train[at, at]
        h = d + np.diag(prior.precision + 1e-9 * np.maximum(np.diag(d), 1e-12))
        return np.clip(
            np.linalg.solve(h, self.train_moment[at] + prior.precision * prior.centre), prior.low, prior.high
        )

    def loss(self, at: slice, prior: Prior) -> float:
        """Return the loss of the fold held out with some of the extra columns in the model."""
        step = self.step(at, prior)
        change = step @ self.test[at, at] @ step - 2.0 * step @ self.test_moment[at]
        return float(self.plain + change)

    def penalty(self, at: slice, prior: Prior | None) -> float:
        """Return what the priors of the base (and of the columns) cost."""
        step = None if prior is None else self.step(at, prior)
        beta: Any = self.beta if step is None else np.asarray(self.beta - self.by[:, at] @ step, float)
        own = self.prior.penalty(beta)
        return own if step is None or prior is None else own + prior.penalty(step)

"""How strongly each explanation speaks, given what is already in the model, and how often chance would speak as loudly.

Empirical-Bayes evidence of a group of columns, deflated by a design effect because residuals are correlated over minutes; the
family-wise p-value comes from flipping the signs of whole trips, and of whole vehicle-days for slow variables.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import erfc

import numpy as np
from numpy.typing import NDArray

from fleetlog.discovery.linear import Fit, Ints, Problem, Selection, fit

Floats = NDArray[np.float64]
Rows = NDArray[np.float32]

FLIPS = 200
WIDE = 30
"""Columns of a group whose statistic is a sum of so many parts that its flips are normal: then their mean and width say more
than the largest of all candidates, which single numbers with long tails decide."""
RAREST = 1e-6
"""Further out no normal tail is to be trusted."""


@dataclass(frozen=True)
class Evidence:
    """``raw`` and deflated ``log_evidence``, ``columns`` to use, prior variance ``tau``, corrected ``p_value``."""

    log_evidence: float
    raw: float
    columns: Ints
    tau: float
    p_value: float


@dataclass
class _Scored:
    log_evidence: float
    raw: float
    columns: Ints
    tau: float
    scores: Rows
    statistic: Callable[[Floats], Floats]


def scan(
    p: Problem,
    s: Selection,
    names: list[str],
    *,
    variants: frozenset[str],
    slow: frozenset[str],
    rng: np.random.Generator,
) -> dict[str, Evidence]:
    """Evidence of every named group that is not yet selected.

    ``variants`` are groups of which one column is to be used (settings of a shape parameter), ``slow`` those that change
    over hours.
    """
    f = fit(p, s)
    residual = p.y - p.predicted(f.columns, f.beta)
    rest = _Rest(p, f, residual, p.x[:, f.columns], p.gram[:, f.columns] @ f.inverse, _Sums(p.trip))
    scored = {}
    for name in names:
        if name in s.columns or not len(p.at.get(name, ())):
            continue
        one = _score(rest, p.at[name], name in variants)
        if one is not None:
            scored[name] = one
    return _with_p_values(p, rest.trips, scored, slow, rng)


class _Sums:
    """Sums over the windows of each cluster."""

    def __init__(self, which: Ints) -> None:
        self.order = np.argsort(which, kind="stable")
        self.begin = np.searchsorted(which[self.order], np.arange(which.max() + 1))

    def sum(self, values: NDArray[np.float32] | Floats) -> Floats:
        """(clusters, ...)."""
        return np.add.reduceat(values[self.order], self.begin, axis=0).astype(float)


@dataclass
class _Rest:
    """What a model leaves: (W,) its ``residual``; ``through`` (P, c) takes its columns ``fitted`` (W, c) out of others."""

    problem: Problem
    fit: Fit
    residual: Floats
    fitted: Rows
    through: Floats
    trips: _Sums

    def own(self, g: Ints) -> Rows:
        """(W, g) what of each column is its own, once what is in the model already is allowed for."""
        return self.problem.x[:, g] - self.fitted @ self.through[g].T.astype(np.float32)

    def scores(self, own: Rows, after: Floats) -> Floats:
        """(trips, g) what every trip says of each column, of the residual that is left once the group is allowed for.

        What flips under the null must not hold the effect itself (ter Braak 1992): an effect on few trips would hide behind
        its own size.
        """
        return self.trips.sum(own * after[:, None].astype(np.float32))


def _score(rest: _Rest, g: Ints, variant: bool) -> _Scored | None:
    p, c = rest.problem, rest.fit.columns
    left = p.gram[np.ix_(g, g)] - rest.through[g] @ p.gram[np.ix_(c, g)]
    u = p.moment[g] - p.gram[np.ix_(g, c)] @ rest.fit.beta
    own = np.diag(p.gram)[g]
    if not (own > 0).any():
        return None
    return (_score_best_column if variant or len(g) == 1 else _score_group)(rest, g, left, u)


def _score_best_column(rest: _Rest, g: Ints, left: Floats, u: Floats) -> _Scored | None:
    p, d = rest.problem, np.diag(left)
    usable = d > 1e-6 * np.diag(p.gram)[g] + 1e-12
    if not usable.any():
        return None
    z2 = np.where(usable, u**2 / np.where(usable, d, 1.0), 0.0)
    j = int(np.argmax(z2))
    beta = u[j] / d[j]
    own = rest.own(g)
    after = rest.residual - own[:, j] * beta
    design = _design_effect(p, own[:, j] * after, d[j])
    scores = rest.scores(own, after)

    def statistic(v: Floats) -> Floats:
        z = np.where(usable, v**2 / np.where(usable, d, 1.0), 0.0) / design
        return np.asarray(np.maximum(np.logaddexp.reduce(_one(z), axis=-1) - np.log(len(g)), 0.0))

    raw = float(np.maximum(np.logaddexp.reduce(_one(z2)) - np.log(len(g)), 0.0))
    return _Scored(
        float(statistic(u)),
        raw,
        g[j : j + 1],
        max(float(beta**2), 1e-12),
        scores.astype(np.float32),
        statistic,
    )


def _score_group(rest: _Rest, g: Ints, left: Floats, u: Floats) -> _Scored | None:
    values, vectors = _eigen((left + left.T) / 2.0)
    keep = values > max(values.max() * 1e-7, 1e-9)
    if not keep.any():
        return None
    values, vectors = values[keep], vectors[:, keep]
    q = vectors.T @ u
    raw, tau = _evidence(values, q**2)
    share = tau * values / (1.0 + tau * values)
    beta = vectors @ (q * tau / (1.0 + tau * values))
    own = rest.own(g)
    after = rest.residual - own @ beta.astype(np.float32)
    scores = rest.scores(own, after)
    per_trip = scores @ (vectors / np.sqrt(values))
    share = share / share.sum() if share.sum() > 1e-6 else np.full(len(values), 1.0 / len(values))
    design = max(float((per_trip**2).sum(axis=0) @ share), 0.7)
    deflated, tau = _evidence(values / design, (q / design) ** 2)
    grid = np.logspace(-6, 7, 27) / values.max() * design

    def statistic(v: Floats) -> Floats:
        q2 = (v @ vectors) ** 2 / design**2
        t = grid[:, None] * values / design
        e = 0.5 * (np.atleast_2d(q2) @ (grid[:, None] / (1.0 + t)).T - np.log1p(t).sum(axis=1))
        return np.asarray(np.maximum(e.max(axis=1), 0.0))

    return _Scored(deflated, raw, g, max(tau, 1e-12), scores.astype(np.float32), statistic)


def _design_effect(p: Problem, product: Floats, norm: float) -> float:
    by_trip = np.bincount(p.trip, product)
    by_block = np.bincount(p.block, product)
    return float(max((by_trip**2).sum() / norm, 0.9 * (by_block**2).sum() / norm, 0.7))


def _one(z2: Floats) -> Floats:
    """Evidence of a single column at its best prior variance."""
    return np.where(z2 > 1.0, 0.5 * (z2 - 1.0 - np.log(np.maximum(z2, 1e-9))), 0.0)


def _evidence(values: Floats, q2: Floats) -> tuple[float, float]:
    """Largest log evidence over the prior variance, and that variance."""
    t = np.logspace(-6, 7, 53)[:, None] / values.max()
    e = 0.5 * np.sum(t * q2 / (1.0 + t * values) - np.log1p(t * values), axis=1)
    j = int(np.argmax(e))
    return max(float(e[j]), 0.0), float(t[j, 0])


def _eigen(m: Floats) -> tuple[Floats, Floats]:
    try:
        return np.linalg.eigh(m)
    except np.linalg.LinAlgError:
        return np.linalg.eigh(m + 1e-10 * np.trace(m) / len(m) * np.eye(len(m)))


def _with_p_values(
    p: Problem, trips: _Sums, scored: dict[str, _Scored], slow: frozenset[str], rng: np.random.Generator
) -> dict[str, Evidence]:
    """Family-wise: each statistic against the largest of all under sign flips of whole clusters."""
    count = len(trips.begin)
    block_of_trip = np.zeros(count, np.int64)
    block_of_trip[p.trip] = p.block
    by_trip = rng.choice([-1.0, 1.0], (FLIPS, count))
    by_block = rng.choice([-1.0, 1.0], (FLIPS, int(p.block.max()) + 1))[:, block_of_trip]
    worst = np.zeros((2, FLIPS))
    strength: dict[str, tuple[float, float]] = {}
    for name, one in scored.items():
        level = []
        for i, flips in enumerate((by_trip, by_block)):
            if i == 1 and name not in slow:
                level.append(np.inf)
                continue
            root = np.sqrt(one.statistic(flips @ one.scores))
            middle, width = root.mean(), max(float(root.std()), 0.15)
            worst[i] = np.maximum(worst[i], (root - middle) / width)
            level.append((np.sqrt(one.log_evidence) - middle) / width)
        strength[name] = (float(level[0]), float(level[1]))
    out = {}
    for name, one in scored.items():
        chance = max((1.0 + np.sum(worst[i] >= strength[name][i] - 1e-9)) / (FLIPS + 1.0) for i in (0, 1))
        if len(one.columns) >= WIDE:
            tail = len(scored) * 0.5 * erfc(min(strength[name]) / np.sqrt(2.0))
            chance = min(chance, max(tail, RAREST))
        out[name] = Evidence(one.log_evidence, one.raw, one.columns, one.tau, float(chance))
    return out

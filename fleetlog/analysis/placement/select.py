"""Choosing at most k sites: p-median, spaced top-k, maximal covering; with forced and forbidden sites.

All distances are from demand (row) to site (column), since trucks drive towards the charger.  Ties go to the smallest
vertex number.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from fleetlog.errors import DataError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
STARTS = 10
EXACT_CELLS = 20_000
"""Up to so many demand-site pairs HiGHS settles the p-median when the bound leaves a gap."""


@dataclass(frozen=True)
class Choice:
    """The sites, what they achieve, and the proven gap to the best possible (0: optimal; NaN: no bound computed)."""

    sites: Ints
    objective: float
    gap: float


def top_k(rank: Floats, k: int) -> Choice:
    """The k highest ranks; the baseline: neighbours of a hot vertex are hot too."""
    sites = np.sort(np.lexsort((np.arange(len(rank)), -rank))[:k])
    return Choice(sites, float(rank[sites].sum()), 0.0)


def p_median(
    weight: Floats,
    distance: Floats,
    k: int,
    forced: Ints | None = None,
    forbidden: Ints | None = None,
    seed: int = 0,
) -> Choice:
    """Sites that minimise the weighted distance from demand i (rows, ``weight`` (m,)) to the nearest site (columns).

    Fast interchange from several starts, a Lagrangian lower bound, and where a gap is left on a small instance HiGHS.
    The objective is the weighted mean distance.
    """
    from fleetlog.analysis.placement.kernels import interchange, lagrangian

    n = distance.shape[1]
    forced = np.zeros(0, np.int64) if forced is None else np.asarray(forced, np.int64)
    open_ = np.ones(n, np.bool_)
    open_[np.zeros(0, np.int64) if forbidden is None else forbidden] = False
    open_[forced] = True
    k = min(k, int(open_.sum()))
    if k < max(1, len(forced)):
        raise DataError(f"{k} sites cannot hold {len(forced)} forced ones", do="raise -k or force fewer")
    candidates = np.flatnonzero(open_)
    total = max(float(weight.sum()), 1e-300)
    cost = np.ascontiguousarray((weight[:, None] * _finite(distance))[weight > 0][:, candidates] / total)
    is_forced = np.isin(candidates, forced)
    fixed = np.flatnonzero(is_forced)
    rng = np.random.default_rng(seed)
    best: tuple[float, Ints] | None = None
    for start in range(STARTS):
        free = np.setdiff1d(np.arange(len(candidates)), fixed)
        rest = _greedy(cost, fixed, k) if start == 0 else rng.choice(free, k - len(fixed), replace=False)
        chosen, value = interchange(cost, np.concatenate([fixed, rest]).astype(np.int64), is_forced, 10_000)
        if best is None or (round(value, 12), tuple(chosen)) < (round(best[0], 12), tuple(best[1])):
            best = (value, chosen)
    assert best is not None
    value, chosen = best
    bound = lagrangian(np.ascontiguousarray(cost.T), k, is_forced, value, 3000, 1e-9)
    if value - bound > 1e-9 * max(value, 1e-300) and cost.size <= EXACT_CELLS:
        value, chosen = _exact(cost, k, is_forced)
        bound = value
    gap = max(0.0, (value - bound) / value) if value > 0 else 0.0
    return Choice(candidates[chosen], float(value), gap if gap > 1e-9 else 0.0)


def _finite(distance: Floats) -> Floats:
    """Unreachable pairs at ten times the longest reachable distance, so that they are shunned, not lost."""
    finite = np.isfinite(distance)
    far = 10.0 * float(distance[finite].max(initial=1.0))
    return np.where(finite, distance, far)


def _greedy(cost: Floats, fixed: Ints, k: int) -> Ints:
    best = cost[:, fixed].min(axis=1) if len(fixed) else np.full(len(cost), np.inf)
    out: list[int] = []
    for _ in range(k - len(fixed)):
        totals = np.minimum(cost, best[:, None]).sum(axis=0)
        totals[[*fixed, *out]] = np.inf
        out.append(int(totals.argmin()))
        best = np.minimum(best, cost[:, out[-1]])
    return np.array(out, dtype=np.int64)


def _exact(cost: Floats, k: int, forced: NDArray[np.bool_]) -> tuple[float, Ints]:
    """The p-median as a mixed-integer program: y_ij <= x_j, sum_j y_ij = 1, sum x <= k; only x is integer."""
    from scipy.optimize import Bounds, LinearConstraint, milp

    m, n = cost.shape
    c = np.concatenate([np.zeros(n), cost.ravel()])
    i, j = (a.ravel() for a in np.mgrid[0:m, 0:n])
    row = np.arange(m * n)
    y = n + row
    link = sparse.coo_array(
        (np.r_[np.ones(m * n), -np.ones(m * n)], (np.r_[row, row], np.r_[y, j])), shape=(m * n, n + m * n)
    )
    once = sparse.coo_array((np.ones(m * n), (i, y)), shape=(m, n + m * n))
    few = sparse.coo_array((np.ones(n), (np.zeros(n, int), np.arange(n))), shape=(1, n + m * n))
    low = np.concatenate([forced.astype(float), np.zeros(m * n)])
    result = milp(
        c,
        constraints=[
            LinearConstraint(link.tocsr(), -np.inf, 0),
            LinearConstraint(once.tocsr(), 1, 1),
            LinearConstraint(few.tocsr(), 0, k),
        ],
        integrality=np.r_[np.ones(n), np.zeros(m * n)],
        bounds=Bounds(low, 1),
    )
    sites = np.flatnonzero(result.x[:n] > 0.5)
    return float(result.fun), sites.astype(np.int64)


def spaced(rank: Floats, distance: Floats, k: int, spacing: float) -> Choice:
    """max sum r_j x_j with at most k sites, no two nearer than ``spacing`` in either direction (HiGHS)."""
    from scipy.optimize import Bounds, LinearConstraint, milp

    n = len(rank)
    a, b = np.nonzero(np.triu(np.minimum(distance, distance.T) < spacing, 1))
    rows = [LinearConstraint(np.ones((1, n)), 0, k)]
    if len(a):
        pair = np.arange(len(a))
        apart = sparse.coo_array((np.ones(2 * len(a)), (np.r_[pair, pair], np.r_[a, b])), shape=(len(a), n))
        rows.append(LinearConstraint(apart.tocsr(), -np.inf, 1))
    # A hair's preference for small numbers breaks ties the same way every time.
    result = milp(
        -(rank - 1e-10 * rank.max() * np.arange(n) / n),
        constraints=rows,
        integrality=np.ones(n),
        bounds=Bounds(0, 1),
    )
    sites = np.flatnonzero(result.x > 0.5)
    return Choice(sites, float(rank[sites].sum()), 0.0)


def cover(weight: Floats, distance: Floats, k: int, radius: float) -> Choice:
    """max weight of demand with a site within ``radius`` (HiGHS); the objective is the covered share."""
    from scipy.optimize import Bounds, LinearConstraint, milp

    m, n = distance.shape
    reach = sparse.csr_array((distance <= radius).astype(float))
    link = sparse.hstack([-reach, sparse.eye_array(m)]).tocsr()
    few = sparse.csr_array(np.r_[np.ones(n), np.zeros(m)][None, :])
    c = np.r_[1e-10 * np.arange(n) / n, -weight / max(weight.sum(), 1e-300)]
    result = milp(
        c, constraints=[LinearConstraint(link, -np.inf, 0), LinearConstraint(few, 0, k)],
        integrality=np.r_[np.ones(n), np.zeros(m)], bounds=Bounds(0, 1),
    )  # fmt: skip
    sites = np.flatnonzero(result.x[:n] > 0.5)
    covered = (distance[:, sites] <= radius).any(axis=1)
    return Choice(sites, float(weight[covered].sum() / max(weight.sum(), 1e-300)), 0.0)

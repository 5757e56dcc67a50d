"""Choosing at most k sites: p-median, spaced top-k, maximal covering; with forced and forbidden sites.

Distances are from demand (row) to site (column), the way to the charger.  Ties go to the smallest number."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy import sparse
from scipy.optimize import Bounds, LinearConstraint, milp

from fleetlog.core.arrays import Floats, Ints, Mask
from fleetlog.core.words import count, percent
from fleetlog.errors import DataError

STARTS, MOST_ROUNDS, ROUNDS = 10, 10_000, 3000
EXACT_CELLS = 20_000  # Up to so many demand-site pairs HiGHS settles the p-median when the bound leaves a gap
CAPACITY_CELLS = 200_000
PATIENCE = 60.0  # HiGHS works so long on a p-median with capacities; its best answer and gap are taken [s]


@dataclass(frozen=True)
class Choice:
    """The sites, what they achieve, the proven gap to the best possible (0: optimal), the share of the demand
    that each site serves (k,): empty where that is what it is the nearest to; how many were left out."""

    sites: Ints
    objective: float
    gap: float
    served: Floats = field(default_factory=lambda: np.zeros(0))
    idle: int = 0


def top_k(rank: Floats, k: int) -> Choice:
    """The k highest ranks; the baseline: neighbours of a hot vertex are hot too."""
    sites = np.sort(np.lexsort((np.arange(len(rank)), -rank))[:k])
    return Choice(sites, float(rank[sites].sum()), 0.0)


def p_median(
    weight: Floats, distance: Floats, k: int, forced: Sequence[int] | Ints = (),
    forbidden: Sequence[int] | Ints = (), capacity: float | None = None,
) -> Choice:  # fmt: skip
    """Sites (columns) that minimise the weighted distance from demand (rows, ``weight`` (m,)) to the nearest.

    Fast interchange from several starts, a Lagrangian lower bound, and where a gap is left on a small
    instance HiGHS.  The objective is the weighted mean distance.  ``capacity`` is the largest share of all
    demand that one site may serve; then HiGHS solves it whole, and demand may go past its nearest site."""
    every = np.arange(distance.shape[1])
    candidates = np.flatnonzero(~np.isin(every, forbidden) | np.isin(every, forced))
    k, must = min(k, len(candidates)), np.isin(candidates, forced)
    if k < max(1, len(forced)):
        what = f"{count(k, 'site')} cannot hold the {len(forced)} that are forced or kept"
        raise DataError(what, do="raise -k, force fewer, or leave --keep-existing out")
    total = max(float(weight.sum()), 1e-300)
    cost = (weight[:, None] * finite(distance))[weight > 0][:, candidates] / total
    if capacity is not None and capacity < 1.0:
        return _limited(cost, weight[weight > 0] / total, candidates, k, must, capacity)
    fixed, free = np.flatnonzero(must), np.flatnonzero(~must)
    rng = np.random.default_rng(0)
    drawn = (rng.choice(free, k - len(fixed), replace=False) for _ in range(STARTS - 1))
    starts = (np.concatenate([fixed, rest]).astype(np.int64) for rest in (greedy(cost, fixed, k), *drawn))
    found = [interchange(cost, start, must) for start in starts]
    chosen, value = min(found, key=lambda f: (round(f[1], 12), tuple(f[0])))
    bound = lagrangian(cost, np.median(cost, axis=1) * 0.5 + np.min(cost, axis=1) * 0.5, k, must, value)
    if value - bound > 1e-9 * max(value, 1e-300) and cost.size <= EXACT_CELLS:
        result = _program(cost, k, must)
        chosen, value = np.flatnonzero(result.x[: len(candidates)] > 0.5), float(result.fun)
        bound = value
    gap = max(0.0, (value - bound) / value) if value > 0 else 0.0
    return Choice(candidates[chosen], float(value), gap if gap > 1e-9 else 0.0)


def finite(distance: Floats) -> Floats:
    """Unreachable pairs at ten times the longest reachable distance, so that they are shunned, not lost."""
    finite = np.isfinite(distance)
    return np.where(finite, distance, 10.0 * float(distance[finite].max(initial=1.0)))


def greedy(cost: Floats, fixed: Ints, k: int) -> Ints:
    """Sites added to the ``fixed`` ones, one by one, each where it helps most; ``cost`` is demand by site."""
    best = cost[:, fixed].min(axis=1) if len(fixed) else np.full(len(cost), np.inf)
    out: list[int] = []
    for _ in range(k - len(fixed)):
        totals = np.minimum(cost, best[:, None]).sum(axis=0)
        totals[[*fixed, *out]] = np.inf
        out.append(int(totals.argmin()))
        best = np.minimum(best, cost[:, out[-1]])
    return np.array(out, dtype=np.int64)


def interchange(cost: Floats, sites: Ints, fixed: Mask) -> tuple[Ints, float]:
    """p-median by best-improvement interchange (Teitz and Bart 1968, with Whitaker's bookkeeping).

    ``cost`` (m, n) is the weighted distance of demand i to site j, ``sites`` (k,) the start, ``fixed`` (n,)
    sites that may not leave.  Where a site leaves, its demand goes to the second-nearest one or to the new
    one, so all exchanges together are two comparisons of the costs.  Returns the sites and the total cost."""
    chosen, demand = sites.copy(), np.arange(len(cost))
    for _ in range(MOST_ROUNDS):
        away = cost[:, chosen]
        near = away.argmin(axis=1)
        first = away[demand, near]
        away[demand, near] = np.inf
        added = np.minimum(cost, first[:, None])
        of = sparse.csr_array((np.ones(len(cost)), (near, demand)), shape=(len(chosen), len(cost)))
        total = of @ (np.minimum(cost, away.min(axis=1, keepdims=True)) - added) + added.sum(axis=0)
        total[fixed[chosen]], total[:, chosen] = np.inf, np.inf
        new, out = np.unravel_index(total.T.argmin(), total.T.shape)
        if total[out, new] >= first.sum() - 1e-9:
            break
        chosen[out] = new
    return np.sort(chosen), float(np.cumsum(cost[:, chosen].min(axis=1))[-1])


def lagrangian(cost: Floats, u: Floats, k: int, forced: Mask, upper: float) -> float:
    """A lower bound of the p-median cost: subgradient steps on the relaxed "every demand is served once".

    ``cost`` (m, n) is of demand i to site j, ``u`` (m,) multipliers to start from, which are changed. L(u) =
    sum_i u_i + sum of the k smallest of rho_j, where rho_j = sum_i min(0, c_ij - u_i); forced sites are
    always among the k.  Stops when the bound is as good as ``upper``."""
    best, scale, stale = -np.inf, 1.5, 0
    for _ in range(ROUNDS):
        saved = np.minimum(cost - u[:, None], 0.0)
        rho = saved.sum(axis=0)
        picked = np.argsort(np.where(forced, -np.inf, rho))[:k]
        bound = float(u.sum() + rho[picked].sum())
        stale += 1
        if bound > best + 1e-9 * abs(upper):
            best, stale = bound, 0
        elif stale >= 12:
            scale, stale = scale * 0.6, 0
        unserved = 1.0 - (saved[:, picked] < 0.0).sum(axis=1)
        norm = float(unserved @ unserved)
        if norm == 0.0 or scale < 1e-4 or upper - best <= 1e-9 * upper:
            break
        u += scale * (1.02 * upper - bound) / norm * unserved
    return best


def _limited(cost: Floats, share: Floats, candidates: Ints, k: int, forced: Mask, capacity: float) -> Choice:
    """The p-median of which no site serves more than ``capacity``."""
    m, n = cost.shape
    raise_it = "raise --capacity or -k"
    if k * capacity < 1.0 - 1e-9:
        raise DataError(f"{k} sites of {percent(capacity)} each cannot serve all demand", do=raise_it)
    if cost.size > CAPACITY_CELLS:
        what = f"{m} demand vertices and {n} candidates are too many with a capacity"
        raise DataError(what, do="leave it out")
    if (result := _program(cost, k, forced, share, capacity)).x is None:
        raise DataError("no choice of sites keeps the capacity", do=raise_it)
    on = np.flatnonzero(result.x[:n] > 0.5)
    served = (share[:, None] * result.x[n:].reshape(m, n)).sum(axis=0)[on]
    return Choice(candidates[on], float(result.fun), float(result.mip_gap or 0.0), served)


def _program(cost: Floats, k: int, forced: Mask, share: Floats | None = None, capacity: float = 1.0) -> Any:
    """The p-median by HiGHS on x (n,), integer, and y (m n,): y_ij <= x_j, sum_j y_ij = 1, sum x <= k;
    with the ``share`` (m,) of each demand also sum_i share_i y_ij <= capacity x_j."""
    m, n = cost.shape
    i, j = (a.ravel() for a in np.mgrid[0:m, 0:n])
    row, site, width = np.arange(m * n), np.arange(n), n + m * n
    y = n + row
    link = _sparse(np.r_[np.ones(m * n), -np.ones(m * n)], np.r_[row, row], np.r_[y, j], width)
    rules = [
        LinearConstraint(link, -np.inf, 0.0),
        LinearConstraint(_sparse(np.ones(m * n), i, y, width), 1.0, 1.0),
        LinearConstraint(_sparse(np.ones(n), np.zeros(n, int), site, width), 0.0, float(k)),
    ]
    if share is not None:
        entries = np.r_[share[i], np.full(n, -capacity)]
        rules.append(LinearConstraint(_sparse(entries, np.r_[j, site], np.r_[y, site], width), -np.inf, 0.0))
    whole = np.arange(width) < n
    low = Bounds(np.where(whole, np.resize(forced, width), 0.0), 1)
    cost = np.r_[np.zeros(n), cost.ravel()]
    return milp(cost, constraints=rules, integrality=whole, bounds=low, options={"time_limit": PATIENCE})


def _sparse(values: Floats, row: Ints, column: Ints, width: int) -> sparse.csr_array:
    return sparse.csr_array((values, (row, column)), shape=(int(row.max()) + 1, width))


def spaced(rank: Floats, distance: Floats, k: int, spacing: float) -> Choice:
    """max sum r_j x_j with at most k sites, no two nearer than ``spacing`` in either direction (HiGHS)."""
    n = len(rank)
    a, b = np.nonzero(np.triu(np.minimum(distance, distance.T) < spacing, 1))
    rules = [LinearConstraint(np.ones((1, n)), 0.0, k)]
    if len(a):
        pair = np.arange(len(a))
        both = _sparse(np.ones(2 * len(a)), np.r_[pair, pair], np.r_[a, b], n)
        rules.append(LinearConstraint(both, -np.inf, 1.0))
    # A hair's preference for small numbers breaks ties the same way every time.
    cost = -(rank - 1e-10 * rank.max() * np.arange(n) / n)
    sites = np.flatnonzero(milp(cost, constraints=rules, integrality=np.ones(n), bounds=Bounds(0, 1)).x > 0.5)
    return Choice(sites, float(rank[sites].sum()), 0.0)


def cover(weight: Floats, distance: Floats, k: int, radius: float) -> Choice:
    """max weight of demand with a site within ``radius`` (HiGHS); the objective is the covered share."""
    m, n = distance.shape
    site = np.arange(n + m) < n
    link = sparse.hstack([-sparse.csr_array((distance <= radius).astype(float)), sparse.eye_array(m)]).tocsr()
    rules = [LinearConstraint(link, -np.inf, 0.0), LinearConstraint(site.astype(float)[None], 0.0, k)]
    total = max(weight.sum(), 1e-300)
    cost = np.r_[1e-10 * np.arange(n) / n, -weight / total]
    sites = np.flatnonzero(milp(cost, constraints=rules, integrality=site, bounds=Bounds(0, 1)).x[:n] > 0.5)
    return Choice(sites, float(weight[(distance[:, sites] <= radius).any(axis=1)].sum() / total), 0.0)

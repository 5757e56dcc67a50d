"""Numba kernels of the site selection."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fleetlog.core.trajectory import Floats, Ints


@njit(cache=True)
def interchange(cost: Floats, sites: Ints, fixed: NDArray[np.bool_], max_rounds: int) -> tuple[Ints, float]:
    """p-median by best-improvement interchange (Teitz and Bart 1968, with Whitaker's bookkeeping).

    cost : (m, n) weighted distance of demand i to site j;  sites : (k,) start;  fixed : (n,) sites that may
        not leave.
    For each candidate the saving of adding it and the loss of dropping each open site come from nearest and
    second-nearest sites, so one round is m n operations.  Returns the sites and the total cost.
    """
    m, n = cost.shape
    k = len(sites)
    chosen = sites.copy()
    where = np.full(n, -1, np.int64)
    for a in range(k):
        where[chosen[a]] = a
    near, second = np.empty(m, np.int64), np.empty(m)
    first = np.empty(m)
    loss_base, loss = np.empty(k), np.empty(k)
    for _ in range(max_rounds):
        for i in range(m):
            d1, d2, a1 = np.inf, np.inf, 0
            for a in range(k):
                d = cost[i, chosen[a]]
                if d < d1:
                    d2, d1, a1 = d1, d, a
                elif d < d2:
                    d2 = d
            first[i], second[i], near[i] = d1, d2, a1
        loss_base[:] = 0.0
        for i in range(m):
            loss_base[near[i]] += second[i] - first[i]
        best, best_in, best_out = -1e-9, -1, -1
        for j in range(n):
            if where[j] >= 0:
                continue
            gain = 0.0
            loss[:] = loss_base
            for i in range(m):
                d = cost[i, j]
                if d < first[i]:
                    gain += first[i] - d
                    loss[near[i]] -= second[i] - first[i]
                elif d < second[i]:
                    loss[near[i]] -= second[i] - d
            for a in range(k):
                if not fixed[chosen[a]] and loss[a] - gain < best:
                    best, best_in, best_out = loss[a] - gain, j, a
        if best_in < 0:
            break
        where[chosen[best_out]] = -1
        chosen[best_out] = best_in
        where[best_in] = best_out
    total = 0.0
    for i in range(m):
        total += cost[i][chosen].min()
    return np.sort(chosen), total


@njit(cache=True)
def lagrangian(
    cost: Floats, k: int, forced: NDArray[np.bool_], upper: float, rounds: int, stop: float
) -> float:
    """A lower bound of the p-median cost: subgradient steps on the relaxed "every demand is served once".

    cost : (n, m), site by demand.  L(u) = sum_i u_i + sum of the k smallest of rho_j, where
    rho_j = sum_i min(0, c_ji - u_i); forced sites are always among the k.
    Stops when the bound is within the share ``stop`` of ``upper``.
    """
    n, m = cost.shape
    u = np.empty(m)
    for i in range(m):
        u[i] = np.median(cost[:, i]) * 0.5 + np.min(cost[:, i]) * 0.5
    rho, key, served = np.empty(n), np.empty(n), np.empty(m)
    best, scale, stale = -np.inf, 1.5, 0
    for _ in range(rounds):
        for j in range(n):
            r = 0.0
            for i in range(m):
                d = cost[j, i] - u[i]
                if d < 0.0:
                    r += d
            rho[j] = r
            key[j] = -np.inf if forced[j] else r
        picked = np.argsort(key)[:k]
        bound = u.sum()
        served[:] = 0.0
        for j in picked:
            bound += rho[j]
            for i in range(m):
                if cost[j, i] < u[i]:
                    served[i] += 1.0
        if bound > best + 1e-9 * abs(upper):
            best, stale = bound, 0
        else:
            stale += 1
            if stale >= 12:
                scale, stale = scale * 0.6, 0
        norm = 0.0
        for i in range(m):
            norm += (1.0 - served[i]) ** 2
        if norm == 0.0 or scale < 1e-4 or upper - best <= stop * upper:
            break
        step = scale * (1.02 * upper - bound) / norm
        for i in range(m):
            u[i] += step * (1.0 - served[i])
    return best

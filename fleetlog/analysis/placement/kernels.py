"""The Numba kernel of the site selection."""

import numpy as np

from fleetlog.compiling import kernel
from fleetlog.core.arrays import Floats, Mask


@kernel()
def lagrangian(
    cost: Floats, u: Floats, k: int, forced: Mask, upper: float, rounds: int, stop: float
) -> float:
    """A lower bound of the p-median cost: subgradient steps on the relaxed "every demand is served once".

    cost : (n, m), site by demand; u : (m,) multipliers to start from, which are changed.
    L(u) = sum_i u_i + sum of the k smallest of rho_j, where rho_j = sum_i min(0, c_ji - u_i); forced sites
    are always among the k.  Stops when the bound is within the share ``stop`` of ``upper``.
    """
    n, m = cost.shape
    rho, key, served = np.empty(n), np.empty(n), np.empty(m)
    best, scale, stale = -np.inf, 1.5, 0
    for _ in range(rounds):
        for j in range(n):
            rho[j] = 0.0
            for i in range(m):
                rho[j] += min(cost[j, i] - u[i], 0.0)
            key[j] = -np.inf if forced[j] else rho[j]
        picked = np.argsort(key)[:k]
        bound = u.sum()
        served[:] = 0.0
        for j in picked:
            bound += rho[j]
            for i in range(m):
                served[i] += cost[j, i] < u[i]
        stale += 1
        if bound > best + 1e-9 * abs(upper):
            best, stale = bound, 0
        elif stale >= 12:
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

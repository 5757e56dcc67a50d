"""Link matrices over road vertices and their stationary ranks.

M_ji = C_ij / sum_j C_ij from counted moves i -> j is column-stochastic; with damping alpha and teleport v the
rank solves

    r = alpha (M r + w (a . r)) + (1 - alpha) v

where a marks dangling vertices (left without a counted move) and w = v takes their mass.  Two identities
decide what such a rank can say (both are tests): on closed trajectories the stationary vector of the flow
matrix *is* the share of visits, and with v equal to that share it is so for every alpha.
"""

import numpy as np
from scipy import sparse

from fleetlog.core.arrays import Floats, Ints


def link_matrix(counts: sparse.csr_array) -> sparse.csc_array:
    """Column-stochastic M (n, n) from move counts C (row: from); a column of a dangling vertex is 0."""
    out = np.asarray(counts.sum(axis=1)).ravel()
    return sparse.csc_array((sparse.diags_array(1.0 / np.where(out > 0, out, np.inf)) @ counts).T)


def rank(counts: sparse.csr_array, alpha: float = 0.85, teleport: Floats | None = None) -> Floats:
    """(n,) rank of every vertex, sum 1; solved directly, exact to rounding."""
    n = counts.shape[0]
    v = np.full(n, 1.0 / n) if teleport is None else np.asarray(teleport, float) / np.sum(teleport)
    # (I - alpha M) r = beta v, whatever mass the dangling vertices send along v: a scaling of one solution.
    system = sparse.csc_array(sparse.eye_array(n) - alpha * link_matrix(counts))
    r = np.asarray(sparse.linalg.spsolve(system, v), dtype=np.float64)
    return np.asarray(r / r.sum(), dtype=np.float64)


def flow_counts(visits: list[Ints], n: int) -> sparse.csr_array:
    """C (n, n): how often a truck went from one vertex to the next, over unbroken sequences of visits."""
    pairs = [np.zeros((0, 2), np.int64), *(np.column_stack([s[:-1], s[1:]]) for s in visits)]
    start, end = np.concatenate(pairs).T
    return sparse.csr_array((np.ones(len(start)), (start, end)), shape=(n, n))


def visit_share(visits: list[Ints], n: int) -> Floats:
    """(n,) share of arrivals, the first vertex of a sequence not counted."""
    arrivals = np.concatenate([np.zeros(0, np.int64), *(s[1:] for s in visits)])
    counts = np.bincount(arrivals, minlength=n)
    return np.asarray(counts / max(int(counts.sum()), 1), dtype=np.float64)


def vote_scores(share: Floats, distance: Floats, length: float) -> Floats:
    """(n,) one-shot votes: every visit to i splits one vote over sites j by exp(-D_ij / length)."""
    phi = np.exp(-distance / length)
    return np.asarray((phi / phi.sum(axis=1, keepdims=True)).T @ share)

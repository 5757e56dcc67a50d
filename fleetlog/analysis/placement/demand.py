"""Where trucks need a charger: visits, standstills and urgency per road vertex; and how vertices rank.

Link matrices over road vertices and their stationary ranks: M_ji = C_ij / sum_j C_ij from counted moves
i -> j is column-stochastic; with damping alpha and teleport v the rank solves

    r = alpha (M r + w (a . r)) + (1 - alpha) v

where a marks dangling vertices (left without a counted move) and w = v takes their mass.  Two identities
decide what such a rank can say (both are tests): on closed trajectories the stationary vector of the flow
matrix *is* the share of visits, and with v equal to that share it is so for every alpha.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from fleetlog.core.arrays import Floats, Index, Ints
from fleetlog.core.network import Network
from fleetlog.store import Dataset
from fleetlog.store.trips import MAX_GAP, STANDING_SPEED, runs

ENOUGH_SOC, LEAST_SOC = 0.5, 0.2  # Urgency rises from 0 at the first to 1 at the second state of charge
LOAD_CHANGE = 25.0
COLUMNS = ("edge_id", "edge_offset", "speed", "soc", "payload", "x", "y")


@dataclass(frozen=True)
class Unit:
    """What one vehicle did on one day, per road vertex (n,); left out in turn to test stability.

    Of standstills of at least the shortest useful time: seconds ``standing``, the same weighted by the
    urgency of the state of charge, and ``spells`` with urgency (vertex, -1 off the map; start, end in us) for
    the number of plugs.  ``loading`` counts changes of the payload.
    """

    vehicle: str
    day: int
    visits: list[Ints]
    standing: Floats
    urgent: Floats
    loading: Floats
    spells: list[tuple[int, int, int]]


def urgency(soc: Floats) -> Floats:
    """0 from ``ENOUGH_SOC`` up, 1 from ``LEAST_SOC`` down; 0 where unknown."""
    return np.nan_to_num(np.clip((ENOUGH_SOC - soc) / (ENOUGH_SOC - LEAST_SOC), 0.0, 1.0))


def day_of(dataset: Dataset, vehicle: str, date: str, shortest: float) -> Unit:
    """One vehicle-day; ``shortest`` [s] is the least standstill in which charging is worth plugging in."""
    t, network = dataset.read(vehicle, date, COLUMNS), dataset.site.roads()
    n = len(network.node_ids)
    edge, offset = t.labels("edge_id").recode(network.index), np.nan_to_num(t.floats("edge_offset"))
    # The nearer end of the edge that a row is on.
    nearer = np.where(offset < 0.5 * network.length[edge], network.start[edge], network.end[edge])
    vertex = np.where(edge >= 0, nearer, -1).astype(np.int64)
    time = t.seconds()
    dt = np.clip(np.diff(time, append=time[-1:]), 0.0, MAX_GAP)
    stands = np.nan_to_num(t.floats("speed"), nan=1.0) <= STANDING_SPEED
    u = urgency(t.floats("soc"))
    standing, urgent = np.zeros(n), np.zeros(n)
    spells = []
    for a, b in runs(stands):
        if dt[a:b].sum() < shortest:
            continue
        on = vertex[a:b] >= 0
        np.add.at(standing, vertex[a:b][on], dt[a:b][on])
        np.add.at(urgent, vertex[a:b][on], (dt * u)[a:b][on])
        if (u[a:b] > 0).any():
            spells.append((int(vertex[a]), int(t.time[a]), int(t.time[b - 1])))
    changed = vertex[:-1][np.abs(np.diff(t.floats("payload"))) > LOAD_CHANGE]
    loading = np.bincount(changed[changed >= 0], minlength=n).astype(float)
    day, visits = int(t.time[0] // 86_400_000_000), _visits(edge, time, network)
    return Unit(t.vehicle_id, day, visits, standing, urgent, loading, spells)


def _visits(edge: Index, time: Floats, network: Network) -> list[Ints]:
    """Sequences of vertices in the order driven, broken at gaps, off the map, and where edges do not join."""
    out: list[list[int]] = [[]]
    for i in np.flatnonzero(np.diff(edge, prepend=-2)).tolist():
        e = int(edge[i])
        gap = i > 0 and time[i] - time[i - 1] > MAX_GAP
        if e < 0 or gap or (out[-1] and out[-1][-1] != network.start[e]):
            out.append([])
        if e >= 0:
            out[-1] += [] if out[-1] else [int(network.start[e])]
            out[-1].append(int(network.end[e]))
    return [np.array(s, dtype=np.int64) for s in out if s]


def peak(spells: Iterable[tuple[int, int, int]]) -> int:
    """The most spells (vertex, start, end) that are open at once."""
    events = sorted(event for _, a, b in spells for event in ((a, 1), (b, -1)))
    return int(np.max(np.cumsum([d for _, d in events], dtype=int), initial=0))


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

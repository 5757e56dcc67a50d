"""One question about sites: where trucks need a charger, how vertices rank, what drives cost; the choice.

Link matrices over road vertices and their stationary ranks: M_ji = C_ij / sum_j C_ij from counted moves
i -> j is column-stochastic; with damping alpha and teleport v the rank solves

    r = alpha (M r + w (a . r)) + (1 - alpha) v

where a marks dangling vertices (left without a counted move) and w = v takes their mass.  Two identities
decide what such a rank can say (both are tests): on closed trajectories the stationary vector of the flow
matrix *is* the share of visits, and with v equal to that share it is so for every alpha."""

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from fleetlog.analysis.placement.select import Choice, cover, p_median, spaced, top_k
from fleetlog.core.arrays import DAY, Floats, Index, Ints
from fleetlog.core.motion import Motion
from fleetlog.core.network import Network
from fleetlog.core.truck import Truck
from fleetlog.errors import DataError
from fleetlog.physics.power import Physics, battery_power
from fleetlog.store import Dataset
from fleetlog.store.trips import MAX_GAP, MIN_LOAD_CHANGE, STANDING_SPEED, runs

ENOUGH_SOC, LEAST_SOC = 0.5, 0.2  # Urgency rises from 0 at the first to 1 at the second state of charge
COLUMNS = ("edge_id", "edge_offset", "speed", "soc", "payload", "x", "y")
Metric = Literal["distance", "time", "energy"]
UNITS = {"distance": "m", "time": "s", "energy": "Wh"}
USUAL_SPEED = 2.5  # Where a road states no limit and no truck is given [m/s]
PIECE = 2.0  # Length over which speed and slope are taken as constant [m]
Method = Literal["pmedian", "spaced", "topk", "cover"]
Variant = Literal["flow", "vote", "urgency"]
Demand = Literal["urgency", "standing", "visits", "rank", "loading"]
NEXT_BEST = {  # Where there is no demand of a kind: why, and what is taken in its place
    "urgency": ("no truck stood with less than 50 % charge", "standing"),
    "standing": ("no truck stood for long enough", "visits"),
}
VOTE_LENGTH = 30.0
MAX_LEFT_OUT = 30  # So many days or trucks are left out in turn, to see how stable a choice is


@dataclass(frozen=True)
class Unit:
    """What one vehicle did on one day, per road vertex (n,); left out in turn to test stability.

    Of standstills of at least the shortest useful time: seconds ``standing``, the same weighted by the
    urgency of the state of charge, and ``spells`` with urgency (vertex, -1 off the map; start, end in us)
    for the number of plugs.  ``loading`` counts changes of the payload."""

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
    u = urgency(t.floats("soc"))
    standing, urgent = np.zeros(n), np.zeros(n)
    spells = []
    for a, b in runs(np.nan_to_num(t.floats("speed"), nan=1.0) <= STANDING_SPEED):
        if dt[a:b].sum() < shortest:
            continue
        on = vertex[a:b] >= 0
        np.add.at(standing, vertex[a:b][on], dt[a:b][on])
        np.add.at(urgent, vertex[a:b][on], (dt * u)[a:b][on])
        if (u[a:b] > 0).any():
            spells.append((int(vertex[a]), int(t.time[a]), int(t.time[b - 1])))
    changed = vertex[:-1][np.abs(np.diff(t.floats("payload"))) > MIN_LOAD_CHANGE]
    loading = np.bincount(changed[changed >= 0], minlength=n).astype(float)
    day, visits = int(t.time[0] // DAY), _visits(edge, time, network)
    return Unit(t.vehicle_id, day, visits, standing, urgent, loading, spells)


def _visits(edge: Index, time: Floats, network: Network) -> list[Ints]:
    """Sequences of vertices in the order driven, broken at gaps, off the map, and where edges do not join."""
    first = np.flatnonzero(np.diff(edge, prepend=-2))
    driven, gap = edge[first], np.diff(time, prepend=time[:1])[first] > MAX_GAP
    before = np.append(-1, np.where(driven >= 0, network.end[driven], -1)[:-1])
    fresh = np.flatnonzero((driven < 0) | gap | (network.start[driven] != before))
    runs = (run[run >= 0] for run in np.split(driven, fresh))
    return [np.append(network.start[run[0]], network.end[run]).astype(np.int64) for run in runs if len(run)]


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
    counts = np.bincount(np.concatenate([np.zeros(0, np.int64), *(s[1:] for s in visits)]), minlength=n)
    return np.asarray(counts / max(int(counts.sum()), 1), dtype=np.float64)


def vote_scores(share: Floats, distance: Floats, length: float) -> Floats:
    """(n,) one-shot votes: every visit to i splits one vote over sites j by exp(-D_ij / length)."""
    phi = np.exp(-distance / length)
    return np.asarray((phi / phi.sum(axis=1, keepdims=True)).T @ share)


def driving_costs(network: Network, metric: Metric, truck: Truck | None = None) -> Floats:
    """(n, n) cheapest drive from vertex (row) to vertex (column) in m, s or Wh; inf where there is none."""
    if metric != "energy":
        seconds = network.length / edge_speeds(network, truck)
        return vertex_distances(network, seconds if metric == "time" else network.length)
    if truck is None:
        raise DataError("the metric energy needs a truck", do="name one with --truck")
    return vertex_distances(network, edge_energies(network, truck))


def edge_speeds(network: Network, truck: Truck | None = None) -> Floats:
    """(E,) speed limit [m/s], under the truck's own where one is given."""
    top = USUAL_SPEED if truck is None else truck.drive.max_speed
    limit = np.where(np.isfinite(network.speed_limit), network.speed_limit, top)
    return limit if truck is None else np.minimum(limit * truck.drive.speed_factor, top)


def edge_energies(network: Network, truck: Truck) -> Floats:
    """(E,) Wh that the empty truck takes from its battery over an edge at steady speed, by the nominal model.
    Direction and grade count, since the slope of an edge is taken along its own direction. An edge on which
    more comes back than is spent counts as nothing: a drive is never chosen for what it gives back."""
    edge, offset = network.stations(PIECE)
    size = (network.length / np.bincount(edge, minlength=len(network)))[edge]
    speed, slope = edge_speeds(network, truck)[edge], network.slope(edge, offset)
    motion = Motion.of(len(edge), speed=speed, dt=size / speed, slope=slope, edge=edge, edge_offset=offset)
    watts = battery_power(motion, Physics(truck))
    return np.maximum(np.bincount(edge, watts * motion.dt, len(network)), 0.0) / 3600.0


def vertex_distances(network: Network, weight: Floats | None = None) -> Floats:
    """(n, n) shortest drive from vertex (row) to vertex (column), inf: none; ``weight`` (E,), else metres."""
    cost = np.full((len(network.node_ids),) * 2, np.inf)
    # Of parallel edges the shortest counts.
    np.minimum.at(cost, (network.start, network.end), network.length if weight is None else weight)
    return np.asarray(dijkstra(sparse.csr_array(np.where(np.isfinite(cost), np.maximum(cost, 1e-9), 0.0))))


@dataclass(frozen=True)
class Question:
    """What is asked, as in ``chargers``; ``cost`` (n, n) of a drive, vertices that must or must not be."""

    network: Network
    cost: Floats
    k: int
    method: Method
    variant: Variant
    demand: Demand
    metric: Metric
    spacing: float
    radius: float
    alpha: float
    must: Ints
    must_not: Ints
    capacity: float | None = None

    def nearest(self, sites: Ints, weight: Floats) -> Floats:
        """(k,) sums of a ``weight`` (n,) over the vertices to which each site is the nearest."""
        return np.bincount(self.cost[:, sites].argmin(axis=1), weight, len(sites)).astype(float)


@dataclass(frozen=True)
class Weighed:
    """(n,) heat share, rank and demand of every vertex; which demand was used, and notices about it."""

    share: Floats
    ranks: Floats
    weight: Floats
    used: str
    notices: list[str]


def weigh(units: list[Unit], q: Question) -> Weighed:
    """Share, rank and demand from vehicle-days."""
    visits, n = [s for u in units for s in u.visits], len(q.network.node_ids)
    share, urgent = visit_share(visits, n), total(units, "urgent")
    if q.variant == "vote":
        ranks = vote_scores(share, vertex_distances(q.network), VOTE_LENGTH)
    else:
        teleport = urgent if q.variant == "urgency" and urgent.any() else None
        ranks = rank(flow_counts(visits, n), q.alpha, teleport)
    options = {"urgency": urgent, "visits": share, "rank": ranks}
    options |= {what: total(units, what) for what in ("standing", "loading")}
    used, notices = str(q.demand), []
    while used in NEXT_BEST and not options[used].any():
        why, used = NEXT_BEST[used]
        notices.append(f"{why}, so sites are chosen by {'visits' if used == 'visits' else 'standing time'}")
    if not options[used].any():
        what = f"demand {q.demand!r} is empty: nothing of the kind in the data"
        raise DataError(what, do="choose another --demand")
    return Weighed(share, ranks, options[used], used, notices)


def total(units: list[Unit], what: str) -> Floats:
    """(n,) sum of one quantity over vehicle-days."""
    return np.asarray(np.sum([getattr(u, what) for u in units], axis=0), dtype=np.float64)


def choose(w: Weighed, q: Question) -> Choice:
    """At most k sites; one that no demand would use and nobody asked for is left out."""
    if q.method != "pmedian" and (len(q.must) or len(q.must_not) or q.capacity is not None):
        raise DataError("forced and forbidden sites and capacities need the method pmedian")
    metres = vertex_distances(q.network)
    methods: dict[Method, Callable[[], Choice]] = {
        "pmedian": lambda: p_median(w.weight, q.cost, q.k, q.must, q.must_not, q.capacity),
        "topk": lambda: top_k(w.ranks, q.k),
        "spaced": lambda: spaced(w.ranks, metres, q.k, q.spacing),
        "cover": lambda: cover(w.weight, metres, q.k, q.radius),
    }
    found = methods[q.method]()
    served = found.served if len(found.served) else q.nearest(found.sites, w.weight) / w.weight.sum()
    keep = (served > 0) | np.isin(found.sites, q.must)
    return replace(found, sites=found.sites[keep], served=served[keep], idle=int((~keep).sum()))


def stability(units: list[Unit], choice: Choice, q: Question) -> dict[str, Any]:
    """How many of the sites stay when a whole day is left out, or a truck of fewer than three days."""
    by = "day" if len({u.day for u in units}) >= 3 else "vehicle"
    kept = []
    for key in sorted({getattr(u, by) for u in units})[:MAX_LEFT_OUT]:
        rest = [u for u in units if getattr(u, by) != key]
        if any(u.visits for u in rest):
            with suppress(DataError):  # nothing of the kind is left
                again = choose(weigh(rest, q), q).sites
                kept.append(len(np.intersect1d(again, choice.sites)) / max(len(choice.sites), 1))
    mean, worst = (float(np.mean(kept)), float(np.min(kept))) if kept else (None, None)
    return {"left_out": by, "runs": len(kept), "mean_kept_share": mean, "worst_kept_share": worst}

"""One question about sites: what drives cost, and the steps of its answer: share, rank, demand, choice,
stability."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from fleetlog.analysis.placement.demand import Unit, flow_counts, rank, visit_share, vote_scores
from fleetlog.analysis.placement.select import Choice, cover, p_median, spaced, top_k
from fleetlog.core.arrays import Floats, Ints
from fleetlog.core.network import Network
from fleetlog.core.truck import Truck
from fleetlog.errors import DataError

Metric = Literal["distance", "time", "energy"]
UNITS = {"distance": "m", "time": "s", "energy": "Wh"}
USUAL_SPEED = 2.5  # Where a road states no limit and no truck is given [m/s]
PIECE = 2.0  # Length over which speed and slope are taken as constant [m]
Method = Literal["pmedian", "spaced", "topk", "cover"]
Variant = Literal["flow", "vote", "urgency"]
Demand = Literal["urgency", "standing", "visits", "rank", "loading"]
NEXT_BEST = {
    "urgency": ("no truck stood with less than 50 % charge", "standing"),
    "standing": ("no truck stood for long enough", "visits"),
}
"""Where there is no demand of a kind: why, and what is taken in its place."""
NOTHING = "nothing of the kind in the data"
VOTE_LENGTH = 30.0
MAX_LEFT_OUT = 30  # So many days or trucks are left out in turn, to see how stable a choice is


def driving_costs(network: Network, metric: Metric, truck: Truck | None = None) -> Floats:
    """(n, n) cheapest drive from vertex (row) to vertex (column) in m, s or Wh; inf where there is none."""
    if metric == "distance":
        return vertex_distances(network)
    if metric == "time":
        return vertex_distances(network, network.length / edge_speeds(network, truck))
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

    Direction and grade count, since the slope of an edge is taken along its own direction.  An edge on which
    more comes back than is spent counts as nothing: a drive is never chosen for what it gives back.
    """
    from fleetlog.core.motion import Motion
    from fleetlog.physics.power import Physics, battery_power

    edge, offset = network.stations(PIECE)
    size = (network.length / np.bincount(edge, minlength=len(network)))[edge]
    speed, slope = edge_speeds(network, truck)[edge], network.slope(edge, offset)
    motion = Motion.of(len(edge), speed=speed, dt=size / speed, slope=slope, edge=edge, edge_offset=offset)
    watts = battery_power(motion, Physics(truck))
    return np.maximum(np.bincount(edge, watts * motion.dt, len(network)), 0.0) / 3600.0


def vertex_distances(network: Network, weight: Floats | None = None) -> Floats:
    """(n, n) shortest driving distance from vertex i (row) to vertex j (column); inf where there is no way.

    ``weight`` (E,) replaces length: seconds or joules an edge.
    """
    cost = np.full((len(network.node_ids),) * 2, np.inf)
    # Of parallel edges the shortest counts.
    np.minimum.at(cost, (network.start, network.end), network.length if weight is None else weight)
    graph = sparse.csr_array(np.where(np.isfinite(cost), np.maximum(cost, 1e-9), 0.0))
    return np.asarray(dijkstra(graph))


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
        to = self.cost[:, sites].argmin(axis=1)
        return np.bincount(to, weight, len(sites)).astype(float)


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
    options = {
        "urgency": urgent, "standing": total(units, "standing"), "visits": share, "rank": ranks,
        "loading": total(units, "loading"),
    }  # fmt: skip
    used, notices = str(q.demand), []
    while used in NEXT_BEST and not options[used].any():
        why, used = NEXT_BEST[used]
        notices.append(f"{why}, so sites are chosen by {'visits' if used == 'visits' else 'standing time'}")
    if not options[used].any():
        raise DataError(f"demand {q.demand!r} is empty: {NOTHING}", do="choose another --demand")
    return Weighed(share, ranks, options[used], used, notices)


def total(units: list[Unit], what: str) -> Floats:
    """(n,) sum of one quantity over vehicle-days."""
    return np.asarray(np.sum([getattr(u, what) for u in units], axis=0), dtype=np.float64)


def choose(w: Weighed, q: Question) -> Choice:
    """At most k sites; of a p-median one that no demand would use and nobody asked for is left out."""
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
    keep = (served > 0) | np.isin(found.sites, q.must) | (q.method != "pmedian")
    return replace(found, sites=found.sites[keep], served=served[keep])


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

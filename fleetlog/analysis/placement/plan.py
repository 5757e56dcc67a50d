"""One question about sites, and the steps of its answer: share, rank, demand, choice, stability."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from fleetlog.analysis.placement.costs import Metric
from fleetlog.analysis.placement.demand import Unit
from fleetlog.analysis.placement.ranks import flow_counts, rank, vertex_distances, visit_share, vote_scores
from fleetlog.analysis.placement.select import Choice, cover, p_median, spaced, top_k
from fleetlog.core.network import Network
from fleetlog.core.trajectory import Floats, Ints
from fleetlog.errors import DataError

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
    """At most k sites; a site that no demand would use and nobody asked for is left out."""
    if q.method == "pmedian":
        found = p_median(w.weight, q.cost, q.k, q.must, q.must_not, capacity=q.capacity)
        return _without_idle(found, w.weight, q)
    if len(q.must) or len(q.must_not) or q.capacity is not None:
        raise DataError("forced and forbidden sites and capacities need the method pmedian")
    if q.method == "topk":
        return top_k(w.ranks, q.k)
    metres = vertex_distances(q.network)
    if q.method == "spaced":
        return spaced(w.ranks, metres, q.k, q.spacing)
    return cover(w.weight, metres, q.k, q.radius)


def _without_idle(choice: Choice, weight: Floats, q: Question) -> Choice:
    to = q.cost[:, choice.sites].argmin(axis=1)
    nearest = np.bincount(to, weights=weight, minlength=len(choice.sites))
    served = np.asarray(nearest if choice.served is None else choice.served, dtype=np.float64)
    keep = (served > 0) | np.isin(choice.sites, q.must)
    kept = None if choice.served is None else choice.served[keep]
    return Choice(choice.sites[keep], choice.objective, choice.gap, kept)


def stability(units: list[Unit], choice: Choice, q: Question) -> dict[str, Any]:
    """How many of the sites stay when a whole day is left out, or a truck of fewer than three days."""
    days = sorted({u.day for u in units})
    by_day = len(days) >= 3
    keys: list[Any] = list(days) if by_day else sorted({u.vehicle for u in units})
    kept = []
    for key in keys[:MAX_LEFT_OUT]:
        rest = [u for u in units if (u.day if by_day else u.vehicle) != key]
        if not any(u.visits for u in rest):
            continue
        try:
            again = choose(weigh(rest, q), q)
        except DataError:
            continue
        kept.append(len(np.intersect1d(again.sites, choice.sites)) / max(len(choice.sites), 1))
    mean, worst = (float(np.mean(kept)), float(np.min(kept))) if kept else (None, None)
    return {
        "left_out": "day" if by_day else "vehicle", "runs": len(kept), "mean_kept_share": mean,
        "worst_kept_share": worst,
    }  # fmt: skip

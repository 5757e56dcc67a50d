"""Where to charge: a ranking of road vertices by traffic, and at most k of them chosen as sites.

The ranking is PageRank-like over observed moves; the choice is a p-median by default.  What is known of the method that
inspired it, and what is our own, is told in docs/chargers.md.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fleetlog.analysis.placement.demand import Unit, peak, read_units
from fleetlog.analysis.placement.ranks import flow_counts, rank, vertex_distances, visit_share, vote_scores
from fleetlog.analysis.placement.select import Choice, cover, p_median, spaced, top_k
from fleetlog.core.network import Network
from fleetlog.core.result import Bars, Grid, Marks, Result, Shape
from fleetlog.errors import DataError, nearest
from fleetlog.store import Dataset

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Method = Literal["pmedian", "spaced", "topk", "cover"]
Variant = Literal["flow", "vote", "urgency"]
Demand = Literal["urgency", "standing", "visits", "rank", "loading"]
VOTE_LENGTH = 30.0


def chargers(
    dataset: Dataset,
    *,
    k: int = 5,
    method: Method = "pmedian",
    variant: Variant = "flow",
    demand: Demand = "urgency",
    metric: Literal["distance", "time"] = "distance",
    shortest: float = 60.0,
    spacing: float = 30.0,
    radius: float = 30.0,
    alpha: float = 0.85,
    forced: tuple[str, ...] = (),
    forbidden: tuple[str, ...] = (),
) -> Result:
    """Sites for at most ``k`` chargers (or, with demand ``loading``, for pick and drop places).

    Parameters
    ----------
    method : how sites are chosen from demand or rank.
    variant : how vertices are ranked.
    demand : what a vertex weighs: standing time weighted by urgency of the charge, standing time, visits, the rank, or
        load changes.  Where nothing is urgent it falls back to standing, then to visits, and says so.
    metric : driving distance [m] or driving time at the speed limits [s].
    shortest : the least standstill in which plugging in is worth it [s].
    spacing : least distance between sites for ``spaced``;  radius : reach of a site for ``cover`` [m].
    forced, forbidden : vertex names (or ids of charging places of the site) that must, or must not, be chosen.
    """
    network = dataset.site.network
    if network is None:
        raise DataError(
            "the dataset has no roads, and sites are chosen among road vertices", do="import it with --site"
        )
    units = read_units(dataset, network, shortest)
    n = len(network.node_ids)
    share = _share(units, n)
    if not share.any():
        raise DataError(
            "no truck was seen to pass from one road to the next", do="check that log and map belong together"
        )
    ranks = _ranks(units, share, n, network, variant, alpha)
    weight, used, notices = _weights(units, ranks, share, demand)
    distance = vertex_distances(network, _seconds(network) if metric == "time" else None)
    must, must_not = _vertices(dataset, network, forced), _vertices(dataset, network, forbidden)
    choice = _choose(method, weight, ranks, distance, k, must, must_not, spacing, radius)
    summary = _summary(
        units, network, share, ranks, weight, distance, choice,
        {"k": k, "method": method, "variant": variant, "demand": used, "metric": metric, "alpha": alpha}, notices,
    )  # fmt: skip
    summary["stability"] = _stability(
        units,
        choice,
        network,
        n,
        k,
        method,
        variant,
        demand,
        distance,
        must,
        must_not,
        spacing,
        radius,
        alpha,
    )
    sites = _site_table(network, units, choice, weight, share, ranks, distance)
    vertices = _vertex_table(network, share, ranks, weight)
    shapes: list[Shape] = [
        _heat(dataset),
        Marks(
            "chargers",
            sites[["x", "y"]].to_numpy(),
            tuple(sites["label"]),
            np.full(len(sites), 2.5),
            "charger",
        ),
        Bars(
            "demand_by_site",
            tuple(sites["label"]),
            sites["served_share"].to_numpy(),
            "share of demand served",
        ),
    ]
    return Result(
        "chargers",
        summary,
        tables={"vertices": vertices},
        places={"sites": sites},
        shapes=shapes,
        lines=_lines(summary, sites),
    )


def _share(units: list[Unit], n: int) -> Floats:
    return visit_share([s for u in units for s in u.visits], n)


def _ranks(
    units: list[Unit], share: Floats, n: int, network: Network, variant: Variant, alpha: float
) -> Floats:
    counts = flow_counts([s for u in units for s in u.visits], n)
    if variant == "flow":
        return rank(counts, alpha)
    if variant == "vote":
        d = vertex_distances(network)
        return vote_scores(share, np.where(np.isfinite(d), d, 1e9), VOTE_LENGTH)
    urgent = np.sum([u.urgent for u in units], axis=0)
    return rank(counts, alpha, urgent if urgent.any() else None)


def _weights(
    units: list[Unit], ranks: Floats, share: Floats, demand: Demand
) -> tuple[Floats, str, list[str]]:
    """Demand per vertex, what it is, and notices about a fall-back."""
    notices: list[str] = []
    options: dict[str, Floats] = {
        "urgency": np.sum([u.urgent for u in units], axis=0),
        "standing": np.sum([u.standing for u in units], axis=0),
        "visits": share, "rank": ranks, "loading": np.sum([u.loading for u in units], axis=0),
    }  # fmt: skip
    order = {"urgency": ["urgency", "standing", "visits"], "standing": ["standing", "visits"]}.get(
        demand, [demand]
    )
    for name in order:
        if options[name].any():
            return options[name], name, notices
        why = (
            "no state of charge under 50 % while standing"
            if name == "urgency"
            else "nothing of the kind in the data"
        )
        notices.append(f"demand {name!r} is empty ({why}); the next best is used")
    raise DataError(
        f"demand {demand!r} is empty: nothing of the kind in the data", do="choose another --demand"
    )


def _seconds(network: Network) -> Floats:
    return network.length / np.where(np.isfinite(network.speed_limit), network.speed_limit, 2.5)


def _vertices(dataset: Dataset, network: Network, names: tuple[str, ...]) -> Ints:
    """Vertex numbers of vertex names or of places' ids (the nearest vertex)."""
    index = {v: i for i, v in enumerate(network.node_ids)}
    places = {p.id: p for p in dataset.site.places}
    out = []
    for name in names:
        if name in index:
            out.append(index[name])
        elif name in places:
            here = (places[name].x, places[name].y)
            out.append(int(np.hypot(*(network.node_points[:, :2] - here).T).argmin()))
        else:
            raise DataError(
                f"no road vertex and no place is called {name!r}", do=nearest(name, [*index, *places])
            )
    return np.array(sorted(set(out)), dtype=np.int64)


def _choose(
    method: Method,
    weight: Floats,
    ranks: Floats,
    distance: Floats,
    k: int,
    must: Ints,
    must_not: Ints,
    spacing: float,
    radius: float,
) -> Choice:
    if method == "pmedian":
        return p_median(weight, distance, k, must, must_not)
    if len(must) or len(must_not):
        raise DataError("forced and forbidden sites need the method pmedian")
    if method == "spaced":
        return spaced(ranks, distance, k, spacing)
    return top_k(ranks, k) if method == "topk" else cover(weight, distance, k, radius)


def reach(weight: Floats, distance: Floats, sites: Ints) -> dict[str, float]:
    """Weighted mean and 95th percentile of the distance to the nearest site, over the demand that can reach one."""
    nearest_site = distance[:, sites].min(axis=1)
    ok = np.isfinite(nearest_site) & (weight > 0)
    w, d = weight[ok], nearest_site[ok]
    order = np.argsort(d)
    cumulated = np.cumsum(w[order])
    p95 = d[order][min(int(np.searchsorted(cumulated, 0.95 * cumulated[-1])), len(d) - 1)]
    return {
        "mean": float(np.average(d, weights=w)),
        "p95": float(p95),
        "unreachable_share": float(1 - w.sum() / weight.sum()),
    }


def _summary(
    units: list[Unit], network: Network, share: Floats, ranks: Floats, weight: Floats, distance: Floats, choice: Choice,
    asked: dict[str, Any], notices: list[str],
) -> dict[str, Any]:  # fmt: skip
    from scipy.stats import spearmanr

    n, k = len(share), len(choice.sites)
    rng = np.random.default_rng(0)
    random = [reach(weight, distance, rng.choice(n, k, replace=False))["mean"] for _ in range(200)]
    baselines = {
        "random": {"mean": float(np.median(random)), "best_of_200": float(np.min(random))},
        "hottest": reach(weight, distance, top_k(share, k).sites),
        "top_rank": reach(weight, distance, top_k(ranks, k).sites),
    }
    correlation = float(spearmanr(ranks, share).statistic)
    trivial = asked["variant"] == "flow"
    return {
        **asked, "sites": [network.node_ids[i] for i in choice.sites], "objective": choice.objective,
        "proven_gap": choice.gap, "reach": reach(weight, distance, choice.sites), "baselines": baselines,
        "rank_heat_spearman": correlation,
        "rank_heat_note": "high by construction: on closed trips the flow rank is the heat share" if trivial else None,
        "vehicle_days": len(units), "plugs_peak": peak([s for u in units for s in u.open_spells]), "notices": notices,
    }  # fmt: skip


def _stability(
    units: list[Unit], choice: Choice, network: Network, n: int, k: int, method: Method, variant: Variant, demand: Demand,
    distance: Floats, must: Ints, must_not: Ints, spacing: float, radius: float, alpha: float,
) -> dict[str, Any]:  # fmt: skip
    """How many of the sites stay when a whole day, or a truck where there are fewer than three days, is left out."""
    days = sorted({u.day for u in units})
    by_day = len(days) >= 3
    keys = days if by_day else sorted({u.vehicle for u in units})
    kept = []
    for key in keys[:30]:
        rest = [u for u in units if (u.day if by_day else u.vehicle) != key]
        if not rest or not any(u.visits for u in rest):
            continue
        share = _share(rest, n)
        ranks = _ranks(rest, share, n, network, variant, alpha)
        try:
            weight, _, _ = _weights(rest, ranks, share, demand)
        except DataError:
            continue
        again = _choose(method, weight, ranks, distance, k, must, must_not, spacing, radius)
        kept.append(len(np.intersect1d(again.sites, choice.sites)) / max(len(choice.sites), 1))
    return {
        "left_out": "day" if by_day else "vehicle", "runs": len(kept),
        "mean_kept_share": float(np.mean(kept)) if kept else None, "worst_kept_share": float(np.min(kept)) if kept else None,
    }  # fmt: skip


def _site_table(
    network: Network,
    units: list[Unit],
    choice: Choice,
    weight: Floats,
    share: Floats,
    ranks: Floats,
    distance: Floats,
) -> pd.DataFrame:
    to = distance[:, choice.sites].argmin(axis=1)
    served = np.bincount(to, weights=weight, minlength=len(choice.sites)) / weight.sum()
    xy = network.node_points[choice.sites]
    urgent = np.sum([u.urgent for u in units], axis=0)
    hours = np.bincount(to, weights=urgent, minlength=len(choice.sites)) / 3600
    return pd.DataFrame({
        "site": np.arange(1, len(choice.sites) + 1), "vertex": [network.node_ids[i] for i in choice.sites],
        "x": xy[:, 0], "y": xy[:, 1], "rank": ranks[choice.sites], "heat_share": share[choice.sites],
        "served_share": served, "urgent_hours": hours,
        "label": [f"{i + 1} ({s:.0%})" for i, s in enumerate(served)],
    })  # fmt: skip


def _vertex_table(network: Network, share: Floats, ranks: Floats, weight: Floats) -> pd.DataFrame:
    xy = network.node_points
    return pd.DataFrame({
        "vertex": network.node_ids, "x": xy[:, 0], "y": xy[:, 1], "heat_share": share, "rank": ranks,
        "demand_share": weight / weight.sum(),
    }).sort_values("rank", ascending=False, ignore_index=True)  # fmt: skip


def _heat(dataset: Dataset) -> Grid:
    from fleetlog.analysis.heatmap import LABELS, cells_of, compute, extent, values

    cells = cells_of([extent(dataset)], 1.0)
    layers = compute(dataset, cells).grid
    return Grid("heat", values(layers, "occupancy", 1.0), cells.x0, cells.y0, 1.0, LABELS["occupancy"])


def _lines(s: dict[str, Any], sites: pd.DataFrame) -> list[str]:
    unit = "s" if s["metric"] == "time" else "m"
    r, b = s["reach"], s["baselines"]
    gap = "optimal" if s["proven_gap"] == 0 else f"within {s['proven_gap']:.2%} of the best possible"
    out = [
        f"{len(sites)} sites by {s['method']} from {s['demand']}: {r['mean']:.1f} {unit} to the nearest on average, "
        f"95 % within {r['p95']:.1f} {unit}" + (f" ({gap})" if s["method"] == "pmedian" else ""),
        f"  against {b['random']['mean']:.1f} {unit} for random sites, {b['hottest']['mean']:.1f} {unit} for the hottest vertices",
    ]
    out += [
        f"  {row.site}: {row.vertex} at ({row.x:.0f}, {row.y:.0f}) m serves {row.served_share:.0%}"
        for row in sites.itertuples()
    ]
    st = s["stability"]
    if st["runs"]:
        out.append(
            f"  {st['mean_kept_share']:.0%} of the sites stay when a {st['left_out']} is left out (worst {st['worst_kept_share']:.0%})"
        )
    out.append(
        f"  rank and heat share correlate at {s['rank_heat_spearman']:.2f}"
        + (f": {s['rank_heat_note']}" if s["rank_heat_note"] else "")
    )
    return out + [f"  note: {n}" for n in s["notices"]]


ANALYSIS = chargers

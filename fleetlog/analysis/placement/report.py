"""What is said about chosen sites: how far, against what, how stable, how many plugs; a plan simulated."""

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from fleetlog.analysis.placement.plan import UNITS, Question, Unit, Weighed, peak, total
from fleetlog.analysis.placement.select import Choice, finite, greedy, top_k
from fleetlog.core.arrays import Floats, Ints
from fleetlog.core.site import Place, Site
from fleetlog.core.truck import Truck
from fleetlog.core.words import Sentences, count, listed, percent
from fleetlog.simulate.demand import like
from fleetlog.simulate.engine import Settings
from fleetlog.simulate.scenario import Scenario
from fleetlog.store import Dataset

SAID = Sentences(__file__)
DRAWS = 200
MOST = 4  # Sites in the first sentence
DEMANDS = {"urgency": "standing below 50 % charge", "standing": "standing time", "loading": "changes of load"}


def reach(weight: Floats, cost: Floats, sites: Ints) -> dict[str, float]:
    """Weighted mean and 95th percentile of the cost to the nearest site, where there is a way to one."""
    nearest_site = cost[:, sites].min(axis=1)
    ok = np.isfinite(nearest_site) & (weight > 0)
    w, d = weight[ok], nearest_site[ok]
    if not len(d):
        return {"mean": float("nan"), "p95": float("nan"), "unreachable_share": 1.0}
    p95 = np.quantile(d, 0.95, weights=w, method="inverted_cdf")
    mean, unreachable = np.average(d, weights=w), 1 - w.sum() / weight.sum()
    return {"mean": float(mean), "p95": float(p95), "unreachable_share": float(unreachable)}


def summarise(units: list[Unit], q: Question, w: Weighed, choice: Choice) -> dict[str, Any]:
    """The figures of an answer, JSON-ready."""
    from scipy.stats import spearmanr

    n, k = len(w.share), len(choice.sites)
    rng = np.random.default_rng(0)
    random = [reach(w.weight, q.cost, rng.choice(n, k, replace=False))["mean"] for _ in range(DRAWS)]
    shunned = w.weight[:, None] * finite(q.cost)
    baselines = {
        "random": {"mean": float(np.nanmedian(random)), "best_of_200": float(np.nanmin(random))},
        "hottest": reach(w.weight, q.cost, top_k(w.share, k).sites),
        "top_rank": reach(w.weight, q.cost, top_k(w.ranks, k).sites),
        "greedy": reach(w.weight, q.cost, greedy(shunned, np.zeros(0, np.int64), k)),
    }
    notices = list(w.notices)
    if choice.idle:
        notices.append(f"all demand is served by {k} of {k + choice.idle} sites; the others would stand idle")
    flow = "high by construction: on closed trips the flow rank is the heat share"
    return {
        "k": q.k, "method": q.method, "variant": q.variant, "demand": w.used, "metric": q.metric,
        "unit": UNITS[q.metric], "alpha": q.alpha, "capacity_share": q.capacity,
        "sites": [q.network.node_ids[i] for i in choice.sites], "objective": choice.objective,
        "proven_gap": choice.gap, "reach": reach(w.weight, q.cost, choice.sites), "baselines": baselines,
        "rank_heat_spearman": float(spearmanr(w.ranks, w.share).statistic),
        "rank_heat_note": flow if q.variant == "flow" else None, "vehicle_days": len(units),
        "plugs_peak": peak(s for u in units for s in u.spells), "notices": notices,
    }  # fmt: skip


def site_table(units: list[Unit], q: Question, w: Weighed, choice: Choice) -> pd.DataFrame:
    """One row a site: where, what it serves, how many trucks want a plug there at once."""
    sites, served = choice.sites, choice.served
    hours = q.nearest(sites, total(units, "urgent")) / 3600
    to = q.cost[:, sites].argmin(axis=1)
    # The most trucks that stood in need of charge at once nearest to each site; one at least.
    spells = [s for u in units for s in u.spells if s[0] >= 0]
    plugs = np.array([max(1, peak(s for s in spells if to[s[0]] == k)) for k in range(len(sites))])
    xy = q.network.node_points[sites]
    return pd.DataFrame({
        "site": np.arange(1, len(sites) + 1), "vertex": [q.network.node_ids[i] for i in sites], "x": xy[:, 0],
        "y": xy[:, 1], "rank": w.ranks[sites], "heat_share": w.share[sites], "served_share": served,
        "urgent_hours": hours, "plugs": plugs, "urgent_hours_per_plug": hours / plugs,
        "label": [f"{i + 1} ({percent(s)})" for i, s in enumerate(served)],
    })  # fmt: skip


def lines_of(s: dict[str, Any], sites: pd.DataFrame, dropped: list[str]) -> list[str]:
    """The answer for the terminal; the plan has no use for the chargers that are ``dropped``."""
    loading, demand = s["demand"] == "loading", DEMANDS.get(s["demand"], s["demand"])
    need = ["" if loading else f", {count(n, 'plug')}" for n in sites["plugs"]]
    rows: list[Any] = list(sites.assign(need=need).itertuples())
    new = [f"({v.x:.0f}, {v.y:.0f}) m (vertex {v.vertex}{v.need})" for v in rows if not v.existing]
    more = [count(len(new) - MOST, "more place")] if len(new) > MOST else []
    out, checked = _check_lines(s["check"]) if "check" in s else ([], [])
    do = "The plan was to install" if out else "Install"
    what = "Place pick and drop spots" if loading else f"{do} chargers"
    out += [f"{what} at {listed([*new[:MOST], *more])}."] if new else []
    out += [f"Keep {row.existing} ({row.need[2:]} needed)." for row in rows if row.existing]
    out += [f"This plan does not need {' or '.join(dropped)}."] if dropped else []
    out += [SAID("site", site=row, name=row.existing or row.vertex) for row in rows]
    gap = "optimal" if s["proven_gap"] == 0 else f"within {percent(s['proven_gap'], 2)} of the optimum"
    plan = f" This plan is {gap} by {s['metric']}." if s["method"] == "pmedian" else ""
    out.append(SAID("reach", **s, weighed=demand, plan=plan))
    if s["stability"]["runs"]:
        left = s["stability"]["left_out"].replace("vehicle", "truck")
        out.append(SAID("stability", **s["stability"], left=left))
    return out + checked + [f"Note: {n}." for n in s["notices"]]


def _check_lines(c: dict[str, Any]) -> tuple[list[str], list[str]]:
    before, after = c["before"], c["after"]
    time = f"{c['hours']:g} h" if c["hours"] >= 1.0 else f"{60.0 * c['hours']:.0f} min"
    more = after["tasks_done"] - before["tasks_done"]
    tasks = f"{count(abs(more), 'task')} {'more' if more > 0 else 'fewer'}" if more else "as many tasks"
    # Who does less ends with more charge: a little more is no gain.
    worse = more < 0 and after["soc_end_mean"] - before["soc_end_mean"] < 0.05
    against = [f"Keep the chargers as they are: in the check the planned ones do {tasks}."] if worse else []
    runs = [SAID("chargers", which=which, **run) for which, run in (("present", before), ("planned", after))]
    return against, [SAID("check", **c, tasks=tasks, time=time), *runs]


def try_plan(dataset: Dataset, sites: pd.DataFrame, truck: Truck, settings: Settings) -> dict[str, Any]:
    """Simulate ``before`` (the site's own chargers) and ``after`` (``sites``: x, y, plugs), all else equal.

    Tasks are drawn like the recorded ones, with the same seed for both; where no loads were recorded they are
    random, only their seed the same.  A planned plug has the power of the first charger that states one."""
    if dataset.kind == "recorded" and dataset.span is not None:
        settings = replace(settings, start=dataset.span[0])
    of = settings.vehicles, settings.start, settings.duration, settings.seed
    site, demand, notes = like(dataset, dataset.site, truck, *of)
    mined = frozenset(p.id for p in site.places) - {p.id for p in dataset.site.places}
    planned = with_chargers(site, sites)
    new = frozenset(p.id for p in planned.places if p.kind == "charge")
    present = Scenario(site, truck, settings, demand, mined=mined)
    both = {"before": present, "after": replace(present, site=planned, mined=mined | new)}
    out: dict[str, Any] = {
        "vehicles": settings.vehicles, "hours": settings.duration / 3600.0, "seed": settings.seed,
        "soc_start": settings.soc,
    }  # fmt: skip
    for name, scenario in both.items():
        chargers = [p for p in scenario.site.places if p.kind == "charge"]
        plugs = sum(1 if p.id in scenario.mined else max(p.plugs, 1) for p in chargers)
        s = scenario.run()
        out[name] = {
            "plugs": plugs, "soc_lowest": s.soc_lowest, "soc_mean": s.soc_mean,
            "soc_end_mean": float(np.mean(s.soc_end)), "soc_end_lowest": min(s.soc_end),
            "waiting_for_plug_h": s.limits.waiting_s["chargers"] / 3600.0, "empty_trucks": len(s.count.empty),
            "tasks_given": s.count.tasks_given, "tasks_done": s.count.tasks_done, "charges": s.count.charges,
            "charged_kwh": s.charged_wh / 1000.0, "driven_km": s.distance_m / 1000.0, "notes": s.notes,
        }  # fmt: skip
    return out | {"notes": [*notes, *demand.notes]}


def with_chargers(site: Site, sites: pd.DataFrame) -> Site:
    """The site with its chargers replaced by the planned ones, one place a plug."""
    present = [p for p in site.places if p.kind == "charge"]
    power = next((p.power for p in present if np.isfinite(p.power)), float("nan"))
    kept = [p for p in site.places if p.kind != "charge"]
    taken = {p.id for p in kept}
    new = []
    for number, (x, y, plugs) in enumerate(sites[["x", "y", "plugs"]].to_numpy(float).tolist(), start=1):
        for plug in range(int(plugs)):
            name = f"charger-{number}" + (f"-{plug + 1}" if plug else "")
            while name in taken:
                name += "p"
            new.append(Place(name, "charge", x, y, power=power))
    return replace(site, places=(*new, *kept))

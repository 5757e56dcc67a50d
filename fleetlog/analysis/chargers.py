"""Sites for chargers, and the number of plugs at each.

Road vertices are ranked by traffic, and at most k of them are chosen as sites.

The ranking is PageRank-like over observed moves; the choice is a p-median by default.  What is known of the
method that inspired it, and what is our own, is told in docs/chargers.md."""

from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd

from fleetlog.analysis import occupancy as maps
from fleetlog.analysis.placement import plan
from fleetlog.analysis.placement.report import lines_of, site_table, summarise, try_plan
from fleetlog.core.arguments import Between, Count, Duration, Seed, seconds
from fleetlog.core.arrays import Ints
from fleetlog.core.network import Network
from fleetlog.core.result import Bars, Grid, Marks, Result, Shape
from fleetlog.core.truck import Truck
from fleetlog.errors import ArgumentError, DataError, chosen
from fleetlog.simulate.engine import Settings
from fleetlog.store import Dataset
from fleetlog.store.days import each_day

NEAR = 8.0  # A charger that stands this close to a chosen vertex is the one that the plan means [m]


def chargers(
    dataset: Dataset, *, k: Annotated[int, Between(1, 10_000, whole=True)] = 5,
    method: plan.Method = "pmedian", variant: plan.Variant = "flow", demand: plan.Demand = "urgency",
    metric: plan.Metric = "distance", shortest: Annotated[float, Between(0.0, 1e6)] = 60.0,
    spacing: Annotated[float, Between(0.0, 1e6)] = 30.0, radius: Annotated[float, Between(0.0, 1e6)] = 30.0,
    alpha: Annotated[float, Between(0.0, 1.0, below=True)] = 0.85, force: tuple[str, ...] = (),
    forbid: tuple[str, ...] = (), keep_existing: bool = False,
    capacity: Annotated[float, Between(0.0, 1.0, above=True)] | None = None, truck: Truck | None = None,
    check: bool = False, vehicles: Count | None = None, duration: Duration = "8h", seed: Seed = 0,
    soc: Annotated[float, Between(0.05, 1.0)] = 0.6,
) -> Result:  # fmt: skip
    """Choose sites for chargers and the number of plugs, and say how good the choice is.

    Parameters
    ----------
    k : largest number of sites.
    method : how sites are chosen from demand or rank.
    variant : how vertices are ranked.
    demand : what a vertex weighs: standing time by urgency of the charge, standing time, visits, the rank, or
        load changes (then the sites are pick and drop places).  Where nothing is urgent it falls back to
        standing, then to visits, and says so.
    metric : what is minimised: driving distance, driving time at the speed limits, or energy of the empty
        truck, which needs --truck.
    shortest : shortest stop in which plugging in is worth it [s].
    spacing : minimum distance between sites, for --method spaced [m].
    radius : reach of a site, for --method cover [m].
    alpha : damping of the rank.
    force : a vertex or place that must be a site; may be repeated.
    forbid : a vertex or place that must not be a site; may be repeated.
    keep_existing : keep the site's own chargers; they count among the k.
    capacity : largest share of the demand that one site may serve.
    truck : truck file, or name of a preset; for --metric energy and --check.
    check : simulate the plan: the same tasks, before and after.
    vehicles : trucks in the simulation; by default as many as recorded.
    duration : simulated time: 8h, 90m.
    seed : seed of the simulation.
    soc : state of charge at the start of the simulation."""
    if truck is None and (check or metric == "energy"):
        raise ArgumentError("--check and --metric energy need a truck", do="name one with --truck")
    if (network := dataset.site.network) is None:
        what = "the dataset has no roads, and sites are chosen among road vertices"
        raise DataError(what, do="import it with --site")
    existing = tuple(p.id for p in dataset.site.places if p.kind == "charge") if keep_existing else ()
    cost = plan.driving_costs(network, metric, truck)
    must, must_not = (_vertices(dataset, network, names) for names in ((*force, *existing), forbid))
    if len(both := np.intersect1d(must, must_not)):
        what = f"vertex {network.node_ids[both[0]]!r} must be a site and must not"
        raise ArgumentError(what, where="--forbid", do="leave one out; --keep-existing keeps chargers")
    where = spacing, radius, alpha, must, must_not, capacity
    q = plan.Question(network, cost, k, method, variant, demand, metric, *where)
    units = list(each_day(dataset, plan.day_of, shortest, kinds=(plan.Unit,)))
    if not any(u.visits for u in units):
        what = "no truck was seen to pass from one road to the next"
        raise DataError(what, do="check that log and map belong together")
    weighed = plan.weigh(units, q)
    choice = plan.choose(weighed, q)
    summary = summarise(units, q, weighed, choice) | {"stability": plan.stability(units, choice, q)}
    sites = site_table(units, q, weighed, choice)
    # Chargers that stand there are kept, where they are, not built twice.
    present = [p for p in dataset.site.places if p.kind == "charge" and demand != "loading"]
    spots = list(zip(sites["x"], sites["y"], strict=True))
    near = [[p for p in present if np.hypot(p.x - x, p.y - y) <= NEAR] for x, y in spots]
    at = [(p[0].x, p[0].y) if p else xy for p, xy in zip(near, spots, strict=True)]
    x, y = np.array(at).reshape(-1, 2).T
    sites = sites.assign(x=x, y=y, existing=[", ".join(p.id for p in own) for own in near])
    if check and truck is not None:
        fleet = Settings(vehicles or len(dataset.vehicles), seconds(duration), seed=seed, soc=soc)
        summary["check"] = try_plan(dataset, sites, truck, fleet)
    x, y = network.node_points[:, :2].T
    vertices = pd.DataFrame({
        "vertex": network.node_ids, "x": x, "y": y, "heat_share": weighed.share, "rank": weighed.ranks,
        "demand_share": weighed.weight / weighed.weight.sum(),
    }).sort_values("rank", ascending=False, ignore_index=True)  # fmt: skip
    dropped = [p.id for p in present if not any(p in own for own in near)]
    shapes, lines = _shapes(dataset, sites, summary), lines_of(summary, sites, dropped)
    return Result("chargers", summary, {"vertices": vertices}, {"sites": sites}, shapes, lines)


def _vertices(dataset: Dataset, network: Network, names: tuple[str, ...]) -> Ints:
    """Vertex numbers of vertex names or of places' ids (the nearest vertex)."""
    at = network.node_points[:, :2]
    known = {p.id: int(np.hypot(*(at - (p.x, p.y)).T).argmin()) for p in dataset.site.places}
    known |= {v: i for i, v in enumerate(network.node_ids)}
    none = "no road vertex and no place is called"
    return np.unique(np.array([chosen(known, n, f"{none} {n!r}", DataError) for n in names], np.int64))


def _shapes(dataset: Dataset, sites: pd.DataFrame, summary: dict[str, Any]) -> list[Shape]:
    """The sites over the heat map, what each serves, and what a simulation of the plan gave."""
    cells = maps.cells_of([maps.extent(dataset)], 1.0)
    heat = maps.values(maps.compute(dataset, cells)["all"].grid, "occupancy", 1.0)
    shapes: list[Shape] = [Grid("heat", heat, cells.x0, cells.y0, 1.0, maps.LABELS["occupancy"])]
    stands = sites["existing"] != ""
    kinds: dict[str, tuple[pd.DataFrame, Literal["charger", "charge"]]] = {
        "new site (share of demand)": (sites[~stands], "charger"),
        "kept charger": (sites[stands], "charge"),
    }
    for name, (of, kind) in kinds.items():
        at, labels = of[["x", "y"]].to_numpy(), tuple(of["label"])
        shapes.append(Marks(name, at, labels, np.full(len(of), 2.0), kind))
    shares = 100.0 * sites["served_share"].to_numpy()
    named = tuple(f"{n}: {e or v}" for n, e, v in zip(sites.site, sites.existing, sites.vertex, strict=True))
    shapes.append(Bars("demand_by_site", named, shares, "demand served [%]"))
    return shapes + (_check_bars(summary["check"]) if "check" in summary else [])


def _check_bars(check: dict[str, Any]) -> list[Shape]:
    runs = {"present": check["before"], "planned": check["after"]}
    soc = {"lowest": "soc_lowest", "mean": "soc_mean", "at the end": "soc_end_mean"}
    charge = {f"{what}, {n}": 100.0 * run[key] for what, key in soc.items() for n, run in runs.items()}
    waiting = {n: run["waiting_for_plug_h"] for n, run in runs.items()}
    done = {n: 100.0 * run["tasks_done"] / max(run["tasks_given"], 1) for n, run in runs.items()}
    names = "state_of_charge", "waiting_for_a_plug", "tasks_done"
    axes = "state of charge [%]", "truck hours", "share of the tasks [%]"
    bars = zip(names, (charge, waiting, done), axes, strict=True)
    return [Bars(f"simulated_{name}", tuple(v), np.array([*v.values()]), axis) for name, v, axis in bars]

"""Congestion: clusters of critically high traffic density.

The rule of the clusters is stated in :mod:`fleetlog.analysis.clusters.steps`."""

from collections.abc import Iterator
from typing import Annotated, Any

import numpy as np
import pandas as pd

from fleetlog.analysis.apart import settled
from fleetlog.analysis.clusters import episodes as of
from fleetlog.analysis.clusters.episodes import BIN, PLACES, Watched, episodes
from fleetlog.analysis.clusters.steps import Crowds, Rule, as_figures, find_crowds, together
from fleetlog.core.arguments import Between
from fleetlog.core.arrays import HOUR, Floats, Ints, levels, microseconds
from fleetlog.core.network import Network
from fleetlog.core.result import Bars, EdgeValues, Marks, MovingLines, Result, Series, Shape
from fleetlog.core.words import Sentences
from fleetlog.errors import DataError
from fleetlog.store import Dataset
from fleetlog.store.dataset import ALONE
from fleetlog.store.days import Part, each_day, each_part
from fleetlog.store.trips import STANDING_SPEED

HOURS = (6, 4, 3, 2, 1)  # Of a day that one job looks at: the most with no more than ``STEPS`` of all trucks
STEPS = 2_000_000
ROW_COST = 2e-6
SILENCE = 60_000_000  # Without a row of any truck nothing is watched [us]; pauses of a log are shorter
OF_TRIP = ("vehicle_id", "trip_id", "start", "end", "x_start", "y_start", "x_end", "y_end")
SAID = Sentences(__file__)
BIN_SPEED, SPEEDS = 0.005, 1 << 16  # Speeds are counted in steps of this [m/s]; how many steps there are


def density(
    dataset: Dataset, *, threshold: Annotated[float, Between(0.01, 1e6)] = 15.0,
    speed: Annotated[float, Between(0.01, 100.0)] = 1.4, step: Annotated[float, Between(0.01, 3600.0)] = 1.0,
    min_duration: Annotated[float, Between(0.0, 1e6)] = 5.0, include_standing: bool = False,
) -> Result:  # fmt: skip
    """Find congestion: clusters of trucks along the roads, episodes, critical areas.

    Parameters
    ----------
    threshold : driving distance within which trucks belong to one cluster [m].
    speed : a cluster whose mean speed is under this is critical [m/s].
    step : time step [s].
    min_duration : ignore episodes shorter than this [s].
    include_standing : count parked, charging and handling trucks too."""
    if (network := dataset.site.network) is None:
        what = "the dataset has no roads, and density needs driving distances"
        raise DataError(what, do="import it with --site")
    if dataset.alone:
        raise DataError(ALONE, do="simulate with --together")
    rule = Rule(threshold, speed, round(step * 1e6), include_standing)
    first, last = dataset.span or (0, -1)
    # The time grid counts from 1970: no added day shifts it.
    first = first // rule.step * rule.step
    # By trips, the time within a recording in which no truck was recorded: between shifts.
    trips = dataset.trips.sort_values("start")
    begin, end = (trips[k].astype("datetime64[us, UTC]").astype("i8").to_numpy() for k in ("start", "end"))
    gap = begin[1:] - np.maximum.accumulate(end)[:-1]
    watched = Watched(tuple(dataset.vehicles), first, last + 1, rule.step, int(gap[gap > SILENCE].sum()))
    parts = list(_hours(dataset, watched))
    pieces = list(each_part(dataset, parts, find_crowds, rule, kinds=(Crowds,), cost=ROW_COST))
    if not (clusters := together(pieces, watched.vehicles)).seen:
        what = "no row of the dataset is matched to a road"
        raise DataError(what, do="check that log and map belong together")
    episode, found = episodes(clusters, speed, rule.step, max(1, round(min_duration / watched.seconds)))
    rows = of.samples(clusters, episode, network, free_speeds(dataset, network), watched.seconds)
    areas = of.critical_areas(network, rows, watched)
    table = _episode_table(clusters, watched, network, found, rows)
    table["area"] = of.area_of(table, areas)
    over_time = of.timeline(clusters, watched, np.append(table["area"], -1)[episode], dataset.dates)
    ways = zip(("moving_only", "all"), clusters.counts, strict=True)
    summary = {
        "threshold_m": threshold, "speed_limit_m_s": speed, "step_s": step, "vehicles": len(watched.vehicles),
        "hours": watched.hours, "min_duration_s": min_duration,
        "clusters": {way: as_figures(counts, watched.seconds) for way, counts in ways},
        "used": "all" if include_standing else "moving_only", "episodes": len(found),
        "delay_s": float(rows.delay.sum()), "areas": areas.head(20).to_dict("records"),
    }  # fmt: skip
    steps = pd.DataFrame(clusters.clusters).rename(columns={"time": "timestamp", "label": "cluster"})
    steps["timestamp"] = pd.to_datetime(steps["timestamp"], unit="us", utc=True)
    steps["critical"] = steps["mean_speed"] < speed
    tables = {"episodes": table, "tasks": _task_table(dataset, watched, rows), "clusters": steps}
    places = {"areas": areas} if len(areas) else {}
    shapes = [*_shapes(network, watched, clusters, areas, rows, over_time, rule)]
    result = Result("density", summary, tables, places, shapes, _lines(summary, areas))
    return settled(result, dataset, "Congestion", "delay_s", "episodes")


def _hours(dataset: Dataset, watched: Watched) -> Iterator[Part]:
    """The time grid in jobs of some hours of one day; each reads the whole day, and the days beside it."""
    steps = len(watched.vehicles) * HOUR / watched.step
    hours = next((h for h in HOURS if h * steps <= STEPS), HOURS[-1])
    for date in dataset.dates:
        near = [str(np.datetime64(date, "D") + k) for k in (-1, 0, 1)]
        reads = tuple((v, d) for v, d in dataset.vehicle_days if d in near)
        for hour in range(0, 24, hours):
            begin = microseconds(date) + hour * HOUR
            start = max(-(-begin // watched.step) * watched.step, watched.start)
            stop = min(begin + hours * HOUR, watched.stop)
            if start < stop:
                yield Part(f"date={date}/hour={hour:02d}+{hours}", (date, start, stop), reads)


def free_speeds(dataset: Dataset, network: Network) -> Floats:
    """(E,) speed [m/s] of an undisturbed truck: the 85th percentile driven, not far below a limit's usual."""
    days = each_day(dataset, _driven, kinds=(np.ndarray,), cost=0.3e-6)
    rows = pd.DataFrame(np.concatenate([*days], axis=1).T, columns=["key", "count"])
    driven = rows.groupby("key", as_index=False).sum()
    driven["edge"], driven["speed"] = driven["key"] // SPEEDS, driven["key"] % SPEEDS
    p85, limit = np.full(len(network), np.nan), network.speed_limit
    known = _percentiles(driven, least=20)
    p85[known.index] = known
    both = np.isfinite(limit) & np.isfinite(p85)
    anywhere = driven.assign(edge=0).sort_values("speed")
    usual = float((known if len(known) else _percentiles(anywhere, least=1)).median())
    ratio = float(np.median(p85[both] / limit[both])) if both.any() else 1.0
    expected = np.where(np.isfinite(limit), limit * ratio, usual)
    # A road that is always jammed must not pass for a slow road.
    # Where nothing was ever driven all time is lost.
    return np.asarray(np.nan_to_num(np.fmax(p85, 0.8 * expected), nan=np.inf), dtype=np.float64)


def _driven(dataset: Dataset, vehicle: str, date: str) -> Ints:
    """(2, n) speeds of one vehicle-day, standstills left out: edge * SPEEDS + speed / ``BIN_SPEED``; rows."""
    t = dataset.read(vehicle, date, ("edge_id", "speed"))
    e, v = t.labels("edge_id").recode(dataset.site.roads().index), t.floats("speed")
    use = (e >= 0) & (v > STANDING_SPEED)
    key = e[use].astype(np.int64) * SPEEDS + np.minimum(v[use] / BIN_SPEED, SPEEDS - 1).astype(np.int64)
    return np.stack(np.unique(key, return_counts=True))


def _percentiles(driven: pd.DataFrame, least: int) -> pd.Series:
    """By edge: the 85th percentile of its speeds [m/s], where it has as many as ``least``."""
    counts = driven.groupby("edge")["count"]
    total, wanted = counts.cumsum(), 0.85 * counts.transform("sum")
    first = (total >= wanted) & (counts.transform("sum") >= least) & ~(total - driven["count"] >= wanted)
    inside = 1.0 - (total - wanted) / driven["count"]
    return ((driven["speed"] + inside) * BIN_SPEED)[first].set_axis(driven.loc[first, "edge"])


def _episode_table(
    c: Crowds, watched: Watched, network: Network, found: pd.DataFrame, s: pd.DataFrame
) -> pd.DataFrame:
    rows, time = [], c.clusters["time"]
    members = (own for _, own in s.groupby("episode"))
    for number, (e, own) in enumerate(zip(found.to_dict("records"), members, strict=True), start=1):
        trucks, edge, delay = np.unique(own["truck"]), own["edge"].to_numpy(), own["delay"].to_numpy()
        x, y = network.position(edge, own["offset"].to_numpy())[:, :2].mean(axis=0)
        rows.append({
            "episode": number, "start": time[e["first"]], "end": time[e["last"]] + watched.step,
            "duration": e["steps"] * watched.seconds, "max_size": e["max_size"],
            "min_mean_speed": e["min_mean_speed"], "vehicles": len(trucks),
            "members": ", ".join(watched.vehicles[v] for v in trucks),
            "vehicle_seconds": len(own) * watched.seconds, "delay": float(delay.sum()),
            "edge_id": network.edge_ids[np.bincount(edge).argmax()], "x": x, "y": y,
            "born": e["born"], "died": e["died"],
        })  # fmt: skip
    table = pd.DataFrame(rows)
    ends = [c for c in ("start", "end") if c in table]
    return table.assign(**{c: pd.to_datetime(table[c], unit="us", utc=True) for c in ends})


def _task_table(dataset: Dataset, watched: Watched, s: pd.DataFrame) -> pd.DataFrame:
    """Trips by the delay that they suffered in critical clusters."""
    trips = dataset.trips
    if not len(s) or not len(trips):
        return pd.DataFrame()
    begun = trips.assign(trip=trips.index, time=trips.start.astype("datetime64[us, UTC]").astype("int64"))
    mine = s.assign(vehicle_id=np.array(watched.vehicles, dtype=object)[s["truck"]]).sort_values("time")
    rows = pd.merge_asof(mine, begun.sort_values("time"), on="time", by="vehicle_id")
    delay = rows.groupby("trip")["delay"].sum()
    late = delay[delay > 0.0].sort_values(ascending=False, kind="stable")
    return trips.loc[late.index, [*OF_TRIP]].assign(delay=late).reset_index(drop=True)


def _shapes(
    network: Network, watched: Watched, c: Crowds, areas: pd.DataFrame, rows: pd.DataFrame,
    over_time: Series, rule: Rule,
) -> Iterator[Shape]:  # fmt: skip
    if len(rows):
        codes, delay = of.delay_by_place(rows)
        edge, start = (codes // PLACES).astype(np.int32), np.asarray(codes % PLACES * BIN, np.float64)
        end = np.minimum(start + BIN, network.length[edge])
        yield EdgeValues("delay", edge, start, end, delay, "delay in critical clusters [s]")
    # The arcs as line segments, at the steps where they change from none or to none too.
    time = levels(c.arcs["time"])
    after = time + watched.step
    shown = np.union1d(time, after[after < watched.stop])
    cuts = np.searchsorted(c.arcs["time"], shown[1:])
    lines, critical = (tuple(np.split(c.arcs[name], cuts)[: len(shown)]) for name in ("ends", "critical"))
    near = f"trucks within {rule.threshold:g} m by road"
    yield from (MovingLines("clusters", shown, lines, critical, near), over_time)
    if len(areas):
        top = areas.head(10)
        labels = tuple(f"{a}: {d:,.0f} s" for a, d in zip(top.area, top.delay, strict=True))
        at, delay = top[["x", "y"]].to_numpy(), top.delay.to_numpy()
        yield Marks("area of delay, as large as its roads", at, labels, top.radius.to_numpy(), "critical")
        yield Bars("delay_by_area", tuple(f"area {a}" for a in top.area), delay, "delay [s]")


def _lines(s: dict[str, Any], areas: pd.DataFrame) -> list[str]:
    moving, every = (s["clusters"][way] for way in ("moving_only", "all"))
    used, other, how = (every, moving, "left out") if s["used"] == "all" else (moving, every, "counted too")
    out = [SAID("delay", **s), SAID("spent", used=used, other=other, how=how)]
    if len(areas) and s["delay_s"] > 0.0:
        first = areas.iloc[0]
        out.append(SAID("first", area=first, share=first.delay / s["delay_s"]))
    return out + [SAID("area", area=area) for area in areas.head(5).itertuples()]

"""Congestion: clusters of critically high traffic density.

The rule of the clusters is stated in :mod:`fleetlog.analysis.clusters.steps`.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fleetlog.analysis.clusters.areas import BIN, PLACES, Samples, critical_areas, delay_by_place, samples
from fleetlog.analysis.clusters.steps import Clusters, Fleet, find_clusters, on_grid
from fleetlog.analysis.clusters.timeline import area_of, timeline
from fleetlog.analysis.clusters.tracking import Episode, episodes
from fleetlog.core.arguments import Between
from fleetlog.core.network import Network
from fleetlog.core.result import Bars, EdgeValues, Marks, MovingLines, Result, Series, Shape
from fleetlog.core.words import count
from fleetlog.errors import DataError
from fleetlog.store import Dataset

HALT = 1.39
"""A truck slower than this counts as slow: SUMO's lane-area detector calls it halting [m/s]."""
MAX_GAP = 15.0
"""A truck that has been silent for longer is absent [s]."""

Floats = NDArray[np.float64]


def density(
    dataset: Dataset,
    *,
    threshold: Annotated[float, Between(0.01, 1e6)] = 15.0,
    speed: Annotated[float, Between(0.01, 100.0)] = 1.4,
    step: Annotated[float, Between(0.01, 3600.0)] = 1.0,
    min_duration: Annotated[float, Between(0.0, 1e6)] = 5.0,
    include_standing: bool = False,
) -> Result:
    """Find congestion: clusters of trucks along the roads, episodes, critical areas.

    Parameters
    ----------
    threshold : driving distance within which trucks belong to one cluster [m].
    speed : a cluster whose mean speed is under this is critical [m/s].
    step : time step [s].
    min_duration : ignore episodes shorter than this [s].
    include_standing : count parked, charging and handling trucks too.
    """
    network = dataset.site.network
    if network is None:
        raise DataError(
            "the dataset has no roads, and density needs driving distances", do="import it with --site"
        )
    start, stop = _span(dataset)
    fleet = on_grid(dataset, network, step, MAX_GAP, start, stop)
    if not (fleet.edge >= 0).any():
        raise DataError(
            "no row of the dataset is matched to a road", do="check that log and map belong together"
        )
    ways = {mask: find_clusters(fleet, network, threshold, HALT, mask=mask) for mask in (True, False)}
    clusters = ways[not include_standing]
    found = episodes(fleet, clusters, speed, min_duration)
    rows = samples(fleet, found, free_speeds(dataset, network))
    areas = critical_areas(network, rows, fleet)
    table = _episode_table(fleet, network, found, rows)
    table["area"] = area_of(table, areas)
    summary = {
        "threshold_m": threshold, "speed_limit_m_s": speed, "step_s": step, "vehicles": len(fleet.vehicles),
        "hours": len(fleet.time) * step / 3600.0, "min_duration_s": min_duration,
        "clusters": {("moving_only" if m else "all"): _counts(c, fleet, speed) for m, c in ways.items()},
        "used": "all" if include_standing else "moving_only",
        "episodes": len(found), "delay_s": float(rows.delay.sum()),
        "areas": areas.head(20).to_dict("records"),
    }  # fmt: skip
    return Result(
        "density",
        summary,
        tables={
            "episodes": table,
            "tasks": _task_table(dataset, fleet, rows),
            "clusters": _step_table(fleet, clusters, speed),
        },
        places={"areas": areas} if len(areas) else {},
        shapes=_shapes(
            fleet, network, clusters, speed, areas, rows, timeline(fleet, found, table["area"].to_numpy())
        ),
        lines=_lines(summary, areas),
    )


def _span(dataset: Dataset) -> tuple[int, int]:
    ends = [np.datetime64(str(dataset.meta[k]).rstrip("Z"), "us").astype(np.int64) for k in ("start", "end")]
    return int(ends[0] // 1_000_000 * 1_000_000), int(ends[1]) + 1


def free_speeds(dataset: Dataset, network: Network) -> Floats:
    """(E,) speed of an undisturbed truck [m/s].

    The 85th percentile of the speeds driven on the edge, but never far below what the fleet usually makes of
    a limit: a road that is always jammed must not pass for a slow road.
    """
    from fleetlog.store.trips import STANDING_SPEED

    edges, speeds = [], []
    for t in dataset.days(("edge_id", "speed")):
        e, v = t.labels("edge_id").recode(network.index), t.floats("speed")
        use = (e >= 0) & (v > STANDING_SPEED)
        edges.append(e[use])
        speeds.append(v[use])
    e, v = np.concatenate(edges), np.concatenate(speeds)
    p85 = np.full(len(network), np.nan)
    for edge, group in pd.Series(v).groupby(e):
        if len(group) >= 20:
            p85[int(str(edge))] = group.quantile(0.85)
    limit = network.speed_limit
    both = np.isfinite(limit) & np.isfinite(p85)
    usual = float(np.nanmedian(p85)) if np.isfinite(p85).any() else float(np.quantile(v, 0.85))
    ratio = float(np.median(p85[both] / limit[both])) if both.any() else 1.0
    expected = np.where(np.isfinite(limit), limit * ratio, usual)
    return np.asarray(np.fmax(p85, 0.8 * expected), dtype=np.float64)


def _counts(c: Clusters, fleet: Fleet, limit: float) -> dict[str, Any]:
    several = c.size >= 2
    critical = several & (c.mean_speed < limit)
    vehicle_seconds = fleet.step * float(c.size[critical].sum())
    median = _medians(c, fleet, critical)
    return {
        "cluster_seconds": fleet.step * float(several.sum()),
        "critical_cluster_seconds": fleet.step * float(critical.sum()),
        "critical_vehicle_seconds": vehicle_seconds,
        "largest": int(c.size.max(initial=0)),
        "critical_mean_speed_m_s": float(c.mean_speed[critical].mean()) if critical.any() else None,
        "critical_median_speed_m_s": float(np.mean(median)) if len(median) else None,
        "critical_slow_share": float(c.slow_share[critical].mean()) if critical.any() else None,
    }


def _medians(c: Clusters, fleet: Fleet, critical: NDArray[np.bool_]) -> Floats:
    steps, label = np.nonzero(critical)
    return np.array([np.median(fleet.speed[t][c.labels[t] == k]) for t, k in zip(steps, label, strict=True)])


def _episode_table(fleet: Fleet, network: Network, found: list[Episode], s: Samples) -> pd.DataFrame:
    rows = []
    for i, e in enumerate(found):
        mine = s.episode == i
        codes, counts = np.unique(s.edge[mine], return_counts=True)
        where = network.position(s.edge[mine], s.offset[mine])[:, :2].mean(axis=0)
        rows.append({
            "episode": i + 1, "start": fleet.time[e.first],
            "end": fleet.time[e.last] + round(fleet.step * 1e6), "duration": len(e.steps) * fleet.step,
            "max_size": max(len(m) for m in e.members), "min_mean_speed": min(e.speeds),
            "vehicles": len(np.unique(s.truck[mine])),
            "members": ", ".join(fleet.vehicles[v] for v in np.unique(s.truck[mine])),
            "vehicle_seconds": float(mine.sum()) * fleet.step, "delay": float(s.delay[mine].sum()),
            "edge_id": network.edge_ids[int(codes[counts.argmax()])], "x": where[0], "y": where[1],
            "born": e.born, "died": e.died,
        })  # fmt: skip
    table = pd.DataFrame(rows)
    for column in ("start", "end"):
        if len(table):
            table[column] = pd.to_datetime(table[column], unit="us", utc=True)
    return table


def _task_table(dataset: Dataset, fleet: Fleet, s: Samples) -> pd.DataFrame:
    """Trips by the delay that they suffered in critical clusters."""
    trips = dataset.trips
    if not len(s.delay) or not len(trips):
        return pd.DataFrame()
    out = []
    for v in np.unique(s.truck):
        mine = s.truck == v
        own = trips[trips.vehicle_id == fleet.vehicles[v]].sort_values("start")
        starts = own.start.astype("datetime64[us, UTC]").astype("int64").to_numpy()
        k = np.searchsorted(starts, fleet.time[s.step[mine]], side="right") - 1
        delay = np.bincount(np.clip(k, 0, None), weights=s.delay[mine], minlength=len(own))
        out.append(
            own[["vehicle_id", "trip_id", "start", "end", "x_start", "y_start", "x_end", "y_end"]].assign(
                delay=delay
            )
        )
    table = pd.concat(out, ignore_index=True)
    late: pd.DataFrame = table[table.delay > 0]
    return late.sort_values("delay", ascending=False, ignore_index=True)


def _step_table(fleet: Fleet, c: Clusters, limit: float) -> pd.DataFrame:
    t, k = np.nonzero(c.size >= 2)
    return pd.DataFrame(
        {
            "timestamp": pd.to_datetime(fleet.time[t], unit="us", utc=True),
            "cluster": k,
            "size": c.size[t, k],
            "mean_speed": c.mean_speed[t, k],
            "slow_share": c.slow_share[t, k],
            "critical": c.mean_speed[t, k] < limit,
        }
    )


def _shapes(
    fleet: Fleet,
    network: Network,
    c: Clusters,
    limit: float,
    areas: pd.DataFrame,
    rows: Samples,
    episode_time: Series,
) -> list[Shape]:
    critical = (c.size >= 2) & (c.mean_speed < limit)
    shapes: list[Shape] = [_arc_lines(fleet, network, c, critical)]
    shapes.append(episode_time)
    if len(rows.delay):
        shapes.insert(0, _delay_layer(network, rows))
    if len(areas):
        top = areas.head(10)
        labels = tuple(f"{a}: {d:.0f} s" for a, d in zip(top.area, top.delay, strict=True))
        shapes.append(
            Marks("critical_areas", top[["x", "y"]].to_numpy(), labels, top.radius.to_numpy(), "critical")
        )
        shapes.append(
            Bars("delay_by_area", tuple(f"area {a}" for a in top.area), top.delay.to_numpy(), "delay [s]")
        )
    return shapes


def _delay_layer(network: Network, rows: Samples) -> EdgeValues:
    """Delay per place of road; both directions of a road share a place."""
    codes, delay = delay_by_place(network, rows)
    edge = (codes // PLACES).astype(np.int32)
    start = np.asarray((codes % PLACES) * BIN, dtype=np.float64)
    return EdgeValues(
        "delay",
        edge,
        start,
        np.minimum(start + BIN, network.length[edge]),
        delay,
        "delay in critical clusters [s]",
    )


def _arc_lines(fleet: Fleet, network: Network, c: Clusters, critical: NDArray[np.bool_]) -> MovingLines:
    """The arcs as line segments, at the steps where they change from none or to none too."""
    count = np.diff(c.arc_first)
    t_of = np.repeat(np.arange(len(count)), count)
    a, b = c.arcs[:, 0], c.arcs[:, 1]
    ends = [network.position(fleet.edge[t_of, v], fleet.offset[t_of, v])[:, :2] for v in (a, b)]
    segments = np.stack(ends, axis=1)
    red = critical[t_of, c.labels[t_of, a]]
    shown = np.flatnonzero((count > 0) | (np.r_[0, count[:-1]] > 0))
    lines = tuple(segments[c.arc_first[t] : c.arc_first[t + 1]] for t in shown)
    flags = tuple(red[c.arc_first[t] : c.arc_first[t + 1]] for t in shown)
    return MovingLines("clusters", fleet.time[shown], lines, flags)


def _lines(s: dict[str, Any], areas: pd.DataFrame) -> list[str]:
    used = s["clusters"][s["used"]]
    other = s["clusters"]["all" if s["used"] == "moving_only" else "moving_only"]
    out = [
        f"Congestion delayed {count(s['vehicles'], 'truck')} by {s['delay_s']:.0f} s in {s['hours']:.2f} h, "
        f"in {count(s['episodes'], 'critical episode')}.",
        f"Trucks spent {used['critical_vehicle_seconds']:.0f} truck-seconds in critical clusters "
        f"({other['critical_vehicle_seconds']:.0f} when standing trucks are "
        f"{'left out' if s['used'] == 'all' else 'counted too'}), "
        f"at most {count(used['largest'], 'truck')} in one.",
    ]
    for row in areas.head(5).itertuples():
        out.append(
            f"  area {row.area} at ({row.x:.0f}, {row.y:.0f}) m, {row.roads}: {row.delay:.0f} s delay "
            f"({row.delay_low:.0f} to {row.delay_high:.0f}), {count(row.episodes, 'episode')}, "
            f"{count(row.vehicles, 'truck')}"
        )
    return out


ANALYSIS = density

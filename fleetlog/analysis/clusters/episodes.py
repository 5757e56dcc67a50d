"""Clusters followed over time: episodes with hysteresis, births, merges, splits; the areas of most delay.

A cluster at one step continues the cluster of the step before whose members it shares most (Jaccard share of
at least one half; Kalnis, Mamoulis and Bakiras 2005, "moving clusters").  Two disjoint clusters cannot both
share more than half with a third, so taking pairs in order of their share is the maximum-weight matching."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from fleetlog.analysis.clusters.steps import Crowds
from fleetlog.core.arrays import DAY, Floats, Index, Ints
from fleetlog.core.network import Network
from fleetlog.core.result import Series
from fleetlog.simulate.places import joined

LEAVE = 1.2  # A critical cluster stays critical until its mean speed exceeds this multiple of the limit
JACCARD = 0.5
BIN = 5.0  # Length of road that is counted as one place [m]
PLACES = 100_000  # A place's code is this times the edge, plus the number of the stretch
MARGIN = 10.0  # An episode this far outside an area's radius belongs to none [m]
SHOWN, MOST_POINTS = 5, 200_000  # Areas with a curve of their own, and points of a curve
SHARE = 0.8  # Areas are made of the fewest places that carry this share of the delay


def episodes(c: Crowds, limit: float, step: int, least: int) -> tuple[Ints, pd.DataFrame]:
    """Critical episodes of at least ``least`` steps, in order of their start; ``step`` [us]. (C,) the episode
    of every cluster, -1 for none; and a row an episode: its ``first`` and ``last`` cluster, how many
    ``steps`` it lasts, ``max_size``, ``min_mean_speed``, how it was ``born`` and how it ``died``."""
    size, time, speed = (c.clusters[name] for name in ("size", "time", "mean_speed"))
    # Clusters of one step and the next that share members, and how many they have in common.
    cluster, truck = c.owner, c.members["truck"]
    order = np.lexsort((time[cluster], truck))
    truck, cluster = truck[order], cluster[order]
    stays = (truck[1:] == truck[:-1]) & (np.diff(time[cluster]) == step)
    key, common = np.unique(cluster[:-1][stays] * len(size) + cluster[1:][stays], return_counts=True)
    before, after = np.divmod(key, max(len(size), 1))
    pairs = pd.DataFrame({"before": before, "after": after})
    share = common / (size[before] + size[after] - common)
    best = pairs.assign(share=-share)[share >= JACCARD].sort_values(["share", "after", "before"])
    matched = best.drop_duplicates("after").drop_duplicates("before")
    parent = np.full(len(size), -1)  # (C,) the cluster of the step before that each continues
    parent[matched["after"]] = matched["before"]
    of, begun = np.full(len(size), -1), 0  # (C,) the episode of each, numbered as they begin, -1 for none
    for k, (p, v) in enumerate(zip(parent.tolist(), speed.tolist(), strict=True)):
        was = of[p] if p >= 0 else -1
        if v < (limit if was < 0 else limit * LEAVE):
            of[k] = begun if was < 0 else was
            begun += was < 0
    inside = np.flatnonzero(of >= 0)
    each = pd.DataFrame({"cluster": inside, "size": size[inside], "speed": speed[inside]}).groupby(of[inside])
    found = each.agg(
        first=("cluster", "first"), last=("cluster", "last"), steps=("cluster", "size"),
        max_size=("size", "max"), min_mean_speed=("speed", "min"),
    )  # fmt: skip
    swallowed = before[(common == size[before]) & (size[after] > common)]
    ancestors, heirs, absorbed = (np.bincount(v, minlength=len(size)) for v in (after, before, swallowed))
    first, last = found["first"], found["last"]
    split = (ancestors[first] == 1) & (parent[first] < 0)
    found["born"] = np.select([ancestors[first] > 1, split], ["merge", "split"], "born")
    merged = (heirs[last] == 1) & (absorbed[last] > 0)
    found["died"] = np.select([heirs[last] > 1, merged], ["split", "merge"], "died")
    kept = found[found["steps"] >= least]
    kept = kept.iloc[np.lexsort((time[kept["last"]], time[kept["first"]]))]
    number = np.full(len(found) + 1, -1)
    number[kept.index] = np.arange(len(kept))
    return number[of], kept.reset_index(drop=True)


@dataclass(frozen=True)
class Watched:
    """The vehicles, and the time grid from ``start`` to before ``stop`` [us]; ``silent`` of it has no row."""

    vehicles: tuple[str, ...]
    start: int
    stop: int
    step: int
    silent: int = 0

    @property
    def seconds(self) -> float:
        """Of a step."""
        return self.step * 1e-6

    @property
    def hours(self) -> float:
        """Of the recording, between shifts nothing."""
        return -(-(self.stop - self.start - self.silent) // self.step) * self.seconds / 3600.0


def samples(c: Crowds, episode: Ints, network: Network, free_speed: Floats, step: float) -> pd.DataFrame:
    """One row for every truck and step inside an episode: episode, truck, time, edge, offset, place, delay.
    ``episode`` (C,) is that of a cluster, -1 for none. ``place`` is a code, see :func:`places`; ``delay`` is
    dt (1 - v / v_free), clipped at 0 [s], where ``free_speed`` (E,) is that of an undisturbed truck [m/s]."""
    inside = np.flatnonzero(episode[c.owner] >= 0)
    inside = inside[np.argsort(episode[c.owner[inside]], kind="stable")]
    truck, edge, offset, speed = (c.members[n][inside] for n in ("truck", "edge", "offset", "speed"))
    cluster = c.owner[inside]
    return pd.DataFrame({
        "episode": episode[cluster], "truck": truck, "time": c.clusters["time"][cluster],
        "edge": edge, "offset": offset, "place": places(network, edge, offset),
        "delay": step * np.clip(1.0 - speed / free_speed[edge], 0.0, 1.0),
    })  # fmt: skip


def places(network: Network, edge: Index, offset: Floats) -> Ints:
    """Place codes: road and stretch of ``BIN`` metres of it, the same for both directions of a road."""
    other = network.reverse[edge]
    canonical = np.where((other >= 0) & (other < edge), other, edge)
    along = np.where(canonical == edge, offset, network.length[edge] - offset)
    return canonical.astype(np.int64) * PLACES + (np.clip(along, 0, None) // BIN).astype(np.int64)


def critical_areas(network: Network, s: pd.DataFrame, watched: Watched) -> pd.DataFrame:
    """Connected places with critical delay, most delay first.

    Columns: area, x, y [m], delay [s], vehicle_seconds [s], episodes, vehicles, episodes_per_hour, roads,
    radius [m], delay_low, delay_high [s] (90 % interval by resampling whole days, or trucks where there are
    fewer than five days), first_share (share of the resamples in which the area ranks first)."""
    if not len(s):
        return pd.DataFrame()
    codes, delayed = delay_by_place(s)
    order = np.argsort(-delayed, kind="stable")
    # The fewest places that carry the share.
    count = int(np.searchsorted(np.cumsum(delayed[order]), SHARE * delayed.sum() * (1 - 1e-12))) + 1
    hot = np.sort(codes[order[:count]])
    edge = (hot // PLACES).astype(np.int32)
    xy = network.position(edge, np.minimum((hot % PLACES + 0.5) * BIN, network.length[edge]))[:, :2]
    group = joined(xy, 1.5 * BIN)
    s = s[s["place"].isin(hot)]
    index = np.searchsorted(hot, s["place"])
    days = (watched.stop - 1 - watched.start) // DAY + 1
    by_day = (s["time"].to_numpy() - watched.start) // DAY
    unit, units = (by_day, days) if days >= 5 else (s["truck"].to_numpy(), len(watched.vehicles))
    sums = np.zeros((units, int(group[index].max()) + 1))
    np.add.at(sums, (unit, group[index]), s["delay"].to_numpy())
    draws = np.random.default_rng(0).multinomial(units, np.full(units, 1 / units), size=500) @ sums
    first = np.bincount(draws.argmax(axis=1), minlength=sums.shape[1]) / len(draws)
    low, high = np.quantile(draws, [0.05, 0.95], axis=0)
    rows = []
    for a, (_, own) in enumerate(s.groupby(group[index])):
        here, delay = group == a, own["delay"].to_numpy()
        weight = np.bincount(index[group[index] == a], delay + 1e-9, len(hot))[here]
        x, y = np.average(xy[here], axis=0, weights=weight)
        spread = np.average(((xy[here] - (x, y)) ** 2).sum(axis=1), weights=weight)
        episodes = own["episode"].nunique()
        rows.append({
            "x": x, "y": y, "delay": delay.sum(), "vehicle_seconds": len(own) * watched.seconds,
            "episodes": episodes, "vehicles": own["truck"].nunique(),
            "episodes_per_hour": episodes / max(watched.hours, 1e-9),
            "roads": ", ".join(sorted({network.roads[e] for e in edge[here]})),
            "radius": float(np.sqrt(spread)) + BIN / 2, "delay_low": low[a], "delay_high": high[a],
            "first_share": first[a],
        })  # fmt: skip
    table = pd.DataFrame(rows).sort_values("delay", ascending=False, ignore_index=True)
    table.insert(0, "area", np.arange(1, len(table) + 1))
    return table


def delay_by_place(s: pd.DataFrame) -> tuple[Ints, Floats]:
    """Place codes, sorted, and the delay in each [s]."""
    codes, inverse = np.unique(s["place"], return_inverse=True)
    return codes, np.asarray(np.bincount(inverse, s["delay"], len(codes)), dtype=np.float64)


def area_of(table: pd.DataFrame, areas: pd.DataFrame) -> Ints:
    """(N,) number of the area that an episode's middle lies in or beside, 0 for none."""
    if not len(table) or not len(areas):
        return np.zeros(len(table), np.int64)
    at, middle = (t[["x", "y"]].to_numpy(float) for t in (table, areas))
    outside = np.hypot(*(at[:, None] - middle).T).T - areas.radius.to_numpy()
    best = outside.argmin(axis=1)
    return np.where(outside[np.arange(len(table)), best] <= MARGIN, areas.area.to_numpy()[best], 0)


def timeline(c: Crowds, watched: Watched, area: Ints, dates: Sequence[str]) -> Series:
    """Trucks in open episodes on the ``dates`` with data, by ``area`` (C,) of the clusters (0 elsewhere, -1:
    none), the first ones; of long recordings the most in each of ``MOST_POINTS`` intervals."""
    steps = -(-(watched.stop - watched.start) // watched.step)
    width = watched.step * max(1, -(-steps // MOST_POINTS))
    time = np.arange(watched.start, watched.stop, width, dtype=np.int64)
    seen = np.isin(time // DAY, np.array(dates, "datetime64[D]").astype(np.int64))
    shown = np.where(area > SHOWN, 0, area)
    curves: dict[str, Floats] = {}
    for number in [*np.unique(shown[shown > 0]).tolist(), 0]:
        of = shown == number
        at, inverse = np.unique(c.clusters["time"][of], return_inverse=True)
        curve = np.zeros(len(time))
        trucks = np.bincount(inverse, c.clusters["size"][of], len(at))
        np.maximum.at(curve, (at - watched.start) // width, trucks)
        if number or of.any() or not curves:
            curves[f"area {number}" if number else "elsewhere"] = curve[seen]
    axes = "time", "trucks in an episode"
    return Series("episodes", time[seen], curves, *axes, over_time=True, stacked=True)

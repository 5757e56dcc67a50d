"""Learned maps against the maps that were driven: edges found, false roads, lengths, and matching on both.

    fleetlog simulate --site MAP --truck TRUCK --vehicles 5 --duration 2h --seed 5 -o DATASET
    python tests/proofs/learned_maps.py DATASET... [--noise 0.3 1.0] [--save FOLDER]

Positions get a noise of which half of the variance lasts for 20 s. An edge is found where 80 % of what was driven
of it lies within 2.5 m of a learned edge of its direction; false is learned length that is near no edge of the map
(near no true track either). Routes run on both maps between the places of the site, or where it has none between
places that lie far apart on the driven roads. Rows of trucks that drive
along a road of the map (1.5 m, 30 degrees) are right where they are matched within 2.5 m and 60 degrees of the truth.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path

import numpy as np
from random_frames import noise_of
from scipy.spatial import cKDTree

from fleetlog.core.network import Network
from fleetlog.core.trajectory import Trajectory
from fleetlog.learn.learn import learn
from fleetlog.roads.matching import match
from fleetlog.roads.routing import Router
from fleetlog.store import DatasetWriter
from fleetlog.store.dataset import Dataset

NEAR, ALIKE = 2.5, np.cos(np.radians(60.0))
BESIDE, ALONG = 1.5, np.cos(np.radians(30.0))
"""Who is nearer to a road than this [m] and heads as it does drives along it, and into no bay."""
FOUND, STEP, PLACES = 0.8, 0.5, 14


@dataclass(frozen=True)
class Stations:
    """Places every half metre of lines (N, 2) [m], their directions and the line of each."""

    xy: np.ndarray
    facing: np.ndarray
    line: np.ndarray

    @classmethod
    def of(cls, n: Network) -> Stations:
        count = np.maximum(np.ceil(n.length / STEP).astype(int), 1)
        line = np.repeat(np.arange(len(n), dtype=np.int32), count)
        share = (np.arange(len(line)) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[line]
        offset = share * n.length[line]
        heading = n.heading(line, offset)
        return cls(n.position(line, offset)[:, :2], np.column_stack([np.cos(heading), np.sin(heading)]), line)

    def near(self, other: Stations, reach: float = NEAR, alike: float = ALIKE) -> np.ndarray:
        """(N,) whether a station of ``other`` that faces the same way is near."""
        around = cKDTree(other.xy).query_ball_point(self.xy, reach)
        return np.array(
            [bool((other.facing[k] @ f > alike).any()) for k, f in zip(around, self.facing, strict=True)]
        )


def moving_rows(t: Trajectory) -> np.ndarray:
    return np.flatnonzero(t.floats("speed") > 0.3)


def true_tracks(dataset: Dataset) -> Stations:
    parts = []
    for t in dataset.days(("x", "y", "speed", "heading")):
        rows, h = moving_rows(t), t.floats("heading")
        parts.append(np.column_stack([t.floats("x"), t.floats("y"), np.cos(h), np.sin(h)])[rows])
    rows = np.concatenate(parts)
    return Stations(rows[:, :2], rows[:, 2:], np.zeros(len(rows), np.int32))


def noisy(dataset: Dataset, noise: float, folder: Path) -> Dataset:
    rng = np.random.default_rng(round(1000 * noise))
    with DatasetWriter.create(folder, "recorded", dataset.site) as writer:
        for t in dataset.days(("x", "y", "speed")):
            step = max(round(1e6 / np.median(np.diff(t.time))), 1)
            t = t[::step]
            error = noise_of(rng, t.seconds(), noise)
            writer.write(t.with_columns(x=t.floats("x") + error[:, 0], y=t.floats("y") + error[:, 1]))
    return Dataset(folder)


def driven_edges(dataset: Dataset, network: Network) -> tuple[Stations, np.ndarray]:
    """Stations of the map that were driven, and how many each edge has."""
    on, tracks = Stations.of(network), true_tracks(dataset)
    seen = on.near(tracks)
    seen &= np.isin(on.line, _matched_edges(dataset, network))
    return Stations(on.xy[seen], on.facing[seen], on.line[seen]), np.bincount(
        on.line[seen], minlength=len(network)
    )


def _matched_edges(dataset: Dataset, network: Network) -> np.ndarray:
    labels = [t.labels("edge_id").recode(network.index) for t in dataset.days(("edge_id",))]
    return np.unique(np.concatenate(labels))


def nearest_stations(stations: Stations, xy: np.ndarray) -> np.ndarray:
    return stations.line[cKDTree(stations.xy).query(xy)[1]]


def spread_out(xy: np.ndarray) -> np.ndarray:
    """Places of the driven roads, each the farthest from those before it."""
    chosen = [xy[0]]
    gap = np.hypot(*(xy - chosen[0]).T)
    while len(chosen) < PLACES:
        chosen.append(xy[int(np.argmax(gap))])
        gap = np.minimum(gap, np.hypot(*(xy - chosen[-1]).T))
    return np.array(chosen)


def route_ratios(true: Network, learned: Network, places: np.ndarray) -> np.ndarray:
    """Learned over true length of the shortest routes between places, either way round at both ends."""
    lengths = []
    for n in (true, learned):
        stations, router = Stations.of(n), Router(n, speed=np.ones(len(n)))
        ends = [_ends(n, stations, p) for p in places]
        lengths.append(
            [_shortest(router, n, ends[a], ends[b]) for a, b in permutations(range(len(places)), 2)]
        )
    a, b = (np.array(v) for v in lengths)
    with np.errstate(invalid="ignore"):
        return (b / a)[np.isfinite(a) & (a > 30.0)]


def _ends(n: Network, stations: Stations, place: np.ndarray) -> list[tuple[int, float]]:
    edge = int(nearest_stations(stations, place[None])[0])
    out = []
    for e in (edge, int(n.reverse[edge])):
        if e >= 0:
            at = np.arange(0.0, n.length[e], STEP)
            xy = n.position(np.full(len(at), e, np.int32), at)[:, :2]
            out.append((e, float(at[np.argmin(np.hypot(*(xy - place).T))])))
    return out


def _shortest(router: Router, n: Network, starts: list, ends: list) -> float:
    best = np.inf
    for a, s in starts:
        for b, e in ends:
            if a == b and e >= s:
                best = min(best, e - s)
                continue
            # round a ring, where the end lies behind the start on one edge
            for first in n.successors(a).tolist() if a == b else [a]:
                route = router.route(first, b)
                if route is not None:
                    onward = n.length[a] - s if a == b else -s
                    best = min(best, onward + route.length - n.length[b] + e)
    return float(best)


def matched(dataset: Dataset, truth: Dataset, network: Network) -> float:
    """Share of the rows of trucks that drive along a road of the map which are matched there, in that direction."""
    rows = right = 0
    roads = Stations.of(truth.site.roads())
    for t, true in zip(
        dataset.days(("x", "y", "speed")), truth.days(("x", "y", "heading", "speed")), strict=True
    ):
        true = true[np.isin(true.time, t.time)]
        xy, h = np.column_stack([true.floats("x"), true.floats("y")]), true.floats("heading")
        where = Stations(xy, np.column_stack([np.cos(h), np.sin(h)]), np.zeros(len(h), np.int32))
        use = (true.floats("speed") > 0.3) & where.near(roads, BESIDE, ALONG)
        m = match(t, network)
        edge, offset = np.maximum(m.edge, 0), np.nan_to_num(m.offset)
        gap = np.hypot(*(network.position(edge, offset)[:, :2] - xy).T)
        ok = (m.edge >= 0) & (np.cos(network.heading(edge, offset) - h) > ALIKE) & (gap < NEAR)
        rows, right = rows + int(use.sum()), right + int((ok & use).sum())
    return right / rows


def judged(dataset: Dataset, noise: float, folder: Path) -> str:
    log = noisy(dataset, noise, folder / "log")
    true = dataset.site.roads()
    learned = learn(log)[0].roads()
    driven, count = driven_edges(dataset, true)
    near = driven.near(mine := Stations.of(learned))
    share = np.bincount(driven.line[near], minlength=len(true)) / np.maximum(count, 1)
    some = count * STEP > 2.0
    to_map, to_tracks = mine.near(Stations.of(true)), mine.near(true_tracks(dataset))
    places = np.array([(p.x, p.y) for p in dataset.site.places[:PLACES]]).reshape(-1, 2)
    ratio = route_ratios(true, learned, places if len(places) > 3 else spread_out(driven.xy))
    quantiles = np.quantile(np.nan_to_num(ratio, posinf=9.9), [0.5, 0.1, 0.9])
    right, right_learned = (100.0 * matched(log, dataset, n) for n in (true, learned))
    return (
        f"{dataset.path.name} {noise} m: found {100 * (share[some] >= FOUND).mean():.1f} % of {some.sum()}, "
        f"false {100 * (~to_map).mean():.1f} % ({100 * (~(to_map | to_tracks)).mean():.1f} %), "
        f"routes {quantiles[0]:.3f} ({quantiles[1]:.2f} to {quantiles[2]:.2f}), "
        f"within 2 %: {100 * (np.abs(ratio - 1.0) < 0.02).mean():.0f} %, "
        f"rows right: {right:.1f} % on the map, {right_learned:.1f} % on the learned one"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("datasets", nargs="+")
    parser.add_argument("--noise", type=float, nargs="+", default=[0.3, 1.0])
    options = parser.parse_args()
    for name in options.datasets:
        for noise in options.noise:
            with tempfile.TemporaryDirectory() as folder:
                print(judged(Dataset(name), noise, Path(folder)), flush=True)


if __name__ == "__main__":
    main()

"""The clusters of some hours: a partial result, and what they add up to."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fleetlog.analysis.clusters.steps import Fleet, Index, distance_lists, on_grid
from fleetlog.core.network import Network
from fleetlog.core.trajectory import Floats, Ints
from fleetlog.store import Dataset

HALT = 1.39  # A truck slower than this counts as slow: SUMO's lane-area detector calls it halting [m/s]


@dataclass(frozen=True)
class Rule:
    """What a cluster is: driving distance within which trucks belong together [m], mean speed under which
    it is critical [m/s], time step [us], and whether trucks that stand by count."""

    threshold: float
    limit: float
    step: int
    include_standing: bool


@dataclass(frozen=True)
class Crowds:
    """C clusters of two and more trucks, in order of time; their M members; the A arcs between these.

    Attributes
    ----------
    vehicles : names that ``truck`` (M,) numbers.
    time, label, mean_speed, slow_share : (C,) int64 us, number of the cluster at its step, m/s, share.
    first : (C + 1,) first member of each;  edge, offset, speed : (M,) of the members.
    arc_time, arc_ends, arc_critical : (A,), (A, 2, 2) m and (A,).
    counts : sums over clusters, with standing trucks left out and counted; see ``COUNTS``.
    seen : rows of the time grid with a truck on the roads.
    """

    vehicles: tuple[str, ...]
    time: Ints
    label: Ints
    mean_speed: Floats
    slow_share: Floats
    first: Ints
    truck: Ints
    edge: Index
    offset: Floats
    speed: Floats
    arc_time: Ints
    arc_ends: Floats
    arc_critical: NDArray[np.bool_]
    counts: dict[str, dict[str, float]]
    seen: int

    def __len__(self) -> int:
        return len(self.time)

    @property
    def size(self) -> Ints:
        """(C,) trucks in each."""
        return np.diff(self.first)


COUNTS = ("several", "critical", "trucks", "largest", "mean_speed", "median_speed", "slow_share")
"""Clusters of several trucks; of these the critical ones, their trucks, and sums of their speeds and slow
shares [m/s, m/s, 1]; ``largest`` is a greatest value."""


def find_crowds(dataset: Dataset, date: str, start: int, stop: int, rule: Rule) -> Crowds:
    """The clusters of one day from ``start`` to before ``stop`` (int64 us)."""
    network = dataset.site.roads()
    fleet = on_grid(dataset, date, np.arange(start, stop, rule.step, dtype=np.int64))
    ways = {mask: _clusters(fleet, network, rule, mask=mask) for mask in (True, False)}
    counts = {("moving_only" if mask else "all"): _counts(c, rule.limit) for mask, c in ways.items()}
    return replace(ways[not rule.include_standing], counts=counts)


def _clusters(fleet: Fleet, network: Network, rule: Rule, *, mask: bool) -> Crowds:
    """Clusters at every step; ``mask`` leaves out trucks that stand by."""
    from fleetlog.analysis.clusters.kernels import cluster_steps

    near = distance_lists(network, rule.threshold)
    edge = np.where(fleet.standing_by, np.int32(-1), fleet.edge) if mask else fleet.edge
    labels, arcs, arc_first = cluster_steps(edge, fleet.offset, network.length, *near, rule.threshold)
    trucks = labels.shape[1]
    row, truck = np.nonzero(labels >= 0)
    cluster, speed = row * trucks + labels[row, truck], fleet.speed[row, truck]
    size = np.bincount(cluster, minlength=labels.size)
    each = np.maximum(size, 1)
    mean, slow = (np.bincount(cluster, of, labels.size) / each for of in (speed, speed < HALT))
    several = np.flatnonzero(size >= 2)
    step, label = np.divmod(several, trucks)
    # The members of a cluster stand together, in the order of the trucks.
    order = np.argsort(cluster, kind="stable")
    order = order[size[cluster[order]] >= 2]
    row, truck = row[order], truck[order]
    at = np.repeat(np.arange(len(arc_first) - 1), np.diff(arc_first))
    ends = [network.position(fleet.edge[at, v], fleet.offset[at, v])[:, :2] for v in arcs.T]
    return Crowds(
        fleet.vehicles, fleet.time[step], label, mean[several], slow[several],
        np.concatenate([[0], np.cumsum(size[several])]), truck, fleet.edge[row, truck],
        fleet.offset[row, truck], speed[order], fleet.time[at], np.stack(ends, axis=1),
        mean[at * trucks + labels[at, arcs[:, 0]]] < rule.limit, {},
        int((fleet.edge >= 0).any(axis=1).sum()),
    )  # fmt: skip


def _counts(c: Crowds, limit: float) -> dict[str, float]:
    critical = c.mean_speed < limit
    medians = pd.Series(c.speed).groupby(np.repeat(np.arange(len(c)), c.size)).median().to_numpy()
    values = (
        len(c), int(critical.sum()), int(c.size[critical].sum()), int(c.size.max(initial=0)),
        c.mean_speed[critical].sum(), medians[critical].sum(), c.slow_share[critical].sum(),
    )  # fmt: skip
    return dict(zip(COUNTS, map(float, values), strict=True))


JOINED = (
    "time", "label", "mean_speed", "slow_share", "edge", "offset", "speed", "arc_time", "arc_ends",
    "arc_critical",
)  # fmt: skip


def together(pieces: Sequence[Crowds], vehicles: Sequence[str]) -> Crowds:
    """Pieces, in order of time, as one; trucks are numbered as in ``vehicles``."""
    number = {v: k for k, v in enumerate(vehicles)}
    truck = np.concatenate([np.array([number[v] for v in p.vehicles], np.int64)[p.truck] for p in pieces])
    first = np.concatenate([[0], np.cumsum(np.concatenate([p.size for p in pieces]))])
    joined = {name: np.concatenate([getattr(p, name) for p in pieces]) for name in JOINED}
    counts = {
        way: {n: (max if n == "largest" else sum)(p.counts[way][n] for p in pieces) for n in COUNTS}
        for way in pieces[0].counts
    }
    seen = sum(p.seen for p in pieces)
    return Crowds(vehicles=tuple(vehicles), first=first, truck=truck, counts=counts, seen=seen, **joined)


def as_figures(counts: dict[str, float], step: float) -> dict[str, Any]:
    """Sums over clusters as a summary states them; ``step`` [s]."""
    n = counts["critical"]
    means = {"mean_speed": "mean_speed_m_s", "median_speed": "median_speed_m_s", "slow_share": "slow_share"}
    return {
        "cluster_seconds": step * counts["several"], "critical_cluster_seconds": step * n,
        "critical_vehicle_seconds": step * counts["trucks"], "largest": int(counts["largest"]),
        **{f"critical_{name}": counts[k] / n if n else None for k, name in means.items()},
    }  # fmt: skip

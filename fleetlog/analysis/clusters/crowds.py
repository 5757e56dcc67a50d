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

Columns = dict[str, NDArray[Any]]
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
    """Clusters of two and more trucks, in order of time, as columns of three tables.

    Attributes
    ----------
    vehicles : names that ``truck`` numbers.
    clusters : ``time`` [us], ``label`` (number at its step), ``size``, ``mean_speed`` [m/s], ``slow_share``.
    members : ``truck``, ``edge``, ``offset`` [m], ``speed`` [m/s]; those of one cluster stand together.
    arcs : between trucks: ``time`` [us], ``ends`` (A, 2, 2) m, ``critical``.
    counts : (2, 7) see :func:`_counts`; without standing trucks and with them.
    seen : rows of the time grid with a truck on the roads.
    """

    vehicles: tuple[str, ...]
    clusters: Columns
    members: Columns
    arcs: Columns
    counts: Floats
    seen: int

    @property
    def owner(self) -> Ints:
        """(M,) the cluster of each member."""
        return np.repeat(np.arange(len(self.clusters["size"])), self.clusters["size"])


def find_crowds(dataset: Dataset, date: str, start: int, stop: int, rule: Rule) -> Crowds:
    """The clusters of one day from ``start`` to before ``stop`` (int64 us)."""
    network = dataset.site.roads()
    fleet = on_grid(dataset, date, np.arange(start, stop, rule.step, dtype=np.int64))
    moving = np.where(fleet.standing_by, np.int32(-1), fleet.edge)
    ways = [_clusters(fleet, edge, network, rule) for edge in (moving, fleet.edge)]
    return replace(ways[rule.include_standing], counts=np.array([_counts(c, rule.limit) for c in ways]))


def _clusters(fleet: Fleet, edge: Index, network: Network, rule: Rule) -> Crowds:
    """Clusters at every step of the trucks that have an ``edge`` (T, V)."""
    from fleetlog.analysis.clusters.kernels import cluster_steps

    near = distance_lists(network, rule.threshold)
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
    critical = mean[at * trucks + labels[at, arcs[:, 0]]] < rule.limit
    return Crowds(
        fleet.vehicles,
        {
            "time": fleet.time[step], "label": label, "size": size[several], "mean_speed": mean[several],
            "slow_share": slow[several],
        },
        {
            "truck": truck, "edge": fleet.edge[row, truck], "offset": fleet.offset[row, truck],
            "speed": speed[order],
        },
        {"time": fleet.time[at], "ends": np.stack(ends, axis=1), "critical": critical},
        np.zeros((2, 7)), int((fleet.edge >= 0).any(axis=1).sum()),
    )  # fmt: skip


def _counts(c: Crowds, limit: float) -> tuple[float, ...]:
    """Trucks in the largest cluster, how many clusters there are; of the critical ones how many, their
    trucks, and sums of mean speed, median speed [m/s] and share of slow trucks."""
    size, mean = c.clusters["size"], c.clusters["mean_speed"]
    critical = mean < limit
    medians = pd.Series(c.members["speed"]).groupby(c.owner).median().to_numpy()
    sums = (of[critical].sum() for of in (critical, size, mean, medians, c.clusters["slow_share"]))
    return (size.max(initial=0), len(size), *sums)


def together(pieces: Sequence[Crowds], vehicles: Sequence[str]) -> Crowds:
    """Pieces, in order of time, as one; trucks are numbered as in ``vehicles``."""
    number = {v: k for k, v in enumerate(vehicles)}
    own = [np.array([number[v] for v in p.vehicles], np.int64)[p.members["truck"]] for p in pieces]
    members = _stacked([p.members for p in pieces]) | {"truck": np.concatenate(own)}
    clusters, arcs = _stacked([p.clusters for p in pieces]), _stacked([p.arcs for p in pieces])
    counts = np.array([p.counts for p in pieces])
    total = np.hstack([counts[..., :1].max(axis=0), counts[..., 1:].sum(axis=0)])
    return Crowds(tuple(vehicles), clusters, members, arcs, total, sum(p.seen for p in pieces))


def _stacked(pieces: Sequence[Columns]) -> Columns:
    return {name: np.concatenate([p[name] for p in pieces]) for name in pieces[0]}


def as_figures(counts: Floats, step: float) -> dict[str, Any]:
    """One row of the counts as a summary states them; ``step`` [s]."""
    largest, several, critical, trucks, *sums = counts.tolist()
    means = zip(("mean_speed_m_s", "median_speed_m_s", "slow_share"), sums, strict=True)
    return {
        "cluster_seconds": step * several, "critical_cluster_seconds": step * critical,
        "critical_vehicle_seconds": step * trucks, "largest": int(largest),
        **{f"critical_{name}": total / critical if critical else None for name, total in means},
    }  # fmt: skip

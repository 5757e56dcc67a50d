"""From a dataset to clusters at every time step.

At each step the trucks are vertices of a directed graph whose weights are shortest driving distances

    d(k, m) = s_m - s_k                                  on one edge, m ahead
            = (l_e(k) - s_k) + D[end of e(k), start of e(m)] + s_m   otherwise

Clusters are the weakly connected components of the arcs with d <= threshold: the finest partition that is
closed under "a truck belongs to the cluster of any truck that it can reach within the threshold".  A cluster
of two or more is critical where its mean speed is under the limit."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from fleetlog.analysis.apart import LONGEST
from fleetlog.core.arrays import Array, Floats, Index, Ints, Mask
from fleetlog.core.network import Network
from fleetlog.core.trajectory import Trajectory, concatenate
from fleetlog.store import Dataset
from fleetlog.store.trips import STANDING_SPEED

Columns = dict[str, Array]
Near = tuple[Ints, Ints, Index, Floats]  # See :func:`~fleetlog.analysis.kernels.reachable`

HALT = 1.39  # A truck slower than this counts as slow: SUMO's lane-area detector calls it halting [m/s]
COLUMNS = ("edge_id", "edge_offset", "speed", "trip_id")
BOTH_WAYS = slice(None), slice(None, None, -1)  # Forwards and backwards in time


@dataclass(frozen=True)
class Snapshots:
    """All trucks on one time grid; (T, V) arrays.  ``edge`` is -1 where a truck is off the map or silent;
    ``standing_by``: it has ended a trip, or made none, and not set off: it parks, charges, handles a load."""

    vehicles: tuple[str, ...]
    time: Ints
    edge: Index
    offset: Floats
    speed: Floats
    standing_by: Mask


def standing_by(trajectory: Trajectory) -> Mask:
    """(N,) whether a row belongs to the standstill before or after all motion of its trip: nothing is in the
    way of a truck that has not set off, or has arrived."""
    moving, ids = np.nan_to_num(trajectory.floats("speed")) > STANDING_SPEED, trajectory.trip_ids()
    trip = np.cumsum(np.diff(ids, prepend=ids[:1]) != 0)
    went, goes = (pd.Series(moving[way]).groupby(trip[way]).cummax().to_numpy(bool)[way] for way in BOTH_WAYS)
    return np.asarray(~(went & goes))


def on_grid(dataset: Dataset, date: str, grid: Ints) -> Snapshots:
    """The fleet at the times ``grid`` (T,) int64 us of one day, interpolated along the routes."""
    vehicles = tuple(v for v in dataset.vehicles if dataset.parts(v, date))
    shape = (len(grid), len(vehicles))
    edge, offset = np.full(shape, -1, np.int32), np.zeros(shape)
    speed, idle = np.zeros(shape), np.zeros(shape, np.bool_)
    for v, vehicle in enumerate(vehicles):
        t, arrived = _about(dataset, vehicle, date, int(grid[0]), int(grid[-1]))
        there = slice(*np.searchsorted(grid, [t.time[0], t.time[-1] + 1]))
        found = routed(t, arrived, grid[there], dataset.site.roads())
        edge[there, v], offset[there, v], speed[there, v], idle[there, v] = found
    return Snapshots(vehicles, grid, edge, offset, speed, idle)


def routed(t: Trajectory, arrived: Mask, grid: Ints, network: Network) -> tuple[Index, Floats, Floats, Mask]:
    """(G,) edge (-1: gap), offset, speed and ``arrived`` at times ``grid`` (G,), linear along the route."""
    edge, length = t.labels("edge_id").recode(network.index), network.length
    offset, speed = (np.nan_to_num(t.floats(c)) for c in ("edge_offset", "speed"))
    i = np.searchsorted(t.time, grid, side="right") - 1
    j = np.minimum(i + 1, len(t) - 1)
    step, late = t.time[j] - t.time[i], grid - t.time[i]
    j = np.where(step > LONGEST * 1e6, i, j)
    share = np.where(j > i, late / np.maximum(step, 1), 0.0)
    a, b, k = edge[i], edge[j], np.where(share < 0.5, i, j)
    arcs = np.repeat(np.arange(len(network)), np.diff(network.next_first)) * len(network) + network.next_edges
    onward = (a >= 0) & (b >= 0) & (a != b) & np.isin(a.astype(np.int64) * len(network) + b, arcs)
    same = (a == b) & (a >= 0)
    way = np.where(onward, length[a] - offset[i] + offset[j], offset[j] - offset[i])
    at = np.where(onward | same, offset[i] + share * way, offset[k])
    over = onward & (at > length[a])
    on = np.where(over, b, np.where(onward | same, a, edge[k]))
    on = np.where((j == i) & (late > 0), np.int32(-1), on)
    at = np.where(over, at - length[a], at)
    return on, at, speed[i] + share * (speed[j] - speed[i]), np.where(onward | same, arrived[i], arrived[k])


def _about(dataset: Dataset, vehicle: str, date: str, start: int, stop: int) -> tuple[Trajectory, Mask]:
    """A vehicle's rows from just before ``start`` to just after ``stop``, of any day; which stand by."""
    before, today, after = (str(np.datetime64(date, "D") + k) for k in (-1, 0, 1))
    t = dataset.read(vehicle, today, COLUMNS)
    ids = t.trip_ids()
    first_trip = t.time[np.searchsorted(ids, ids[0], side="right") - 1]
    last_trip = t.time[np.searchsorted(ids, ids[-1])]
    # A truck that stands in a jam at midnight has set off and not arrived: the days beside tell.
    days = [(before, start <= first_trip), (after, stop >= last_trip)]
    earlier, later = ([dataset.read(vehicle, day, COLUMNS)] if asked else [] for day, asked in days)
    t = concatenate([piece for piece in (*earlier, t, *later) if len(piece)])
    a = max(int(np.searchsorted(t.time, start, side="right")) - 1, 0)
    b = int(np.searchsorted(t.time, stop)) + 1
    return t[a:b], standing_by(t)[a:b]


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

    vehicles : names that ``truck`` numbers.
    clusters : ``time`` [us], ``label`` (number at its step), ``size``, ``mean_speed`` [m/s], ``slow_share``.
    members : ``truck``, ``edge``, ``offset`` [m], ``speed`` [m/s]; those of one cluster stand together.
    arcs : between trucks: ``time`` [us], ``ends`` (A, 2, 2) m, ``critical``.
    counts : (2, 7) see :func:`_counts`; without standing trucks and with them.
    seen : rows of the time grid with a truck on the roads."""

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
    from fleetlog.analysis.kernels import reachable

    network = dataset.site.roads()
    fleet = on_grid(dataset, date, np.arange(start, stop, rule.step, dtype=np.int64))
    moving = np.where(fleet.standing_by, np.int32(-1), fleet.edge)
    near = reachable(network, float(rule.threshold))
    ways = [_clusters(fleet, edge, network, near, rule) for edge in (moving, fleet.edge)]
    return replace(ways[rule.include_standing], counts=np.array([_counts(c, rule.limit) for c in ways]))


def _clusters(fleet: Snapshots, edge: Index, network: Network, near: Near, rule: Rule) -> Crowds:
    """Clusters at every step of the trucks that have an ``edge`` (T, V)."""
    from fleetlog.analysis.kernels import cluster_steps

    labels, arcs, arc_first = cluster_steps(edge, fleet.offset, network.length, *near, rule.threshold)
    trucks = labels.shape[1]
    row, truck = np.nonzero(labels >= 0)
    cluster, speed = row * trucks + labels[row, truck], fleet.speed[row, truck]
    size = np.bincount(cluster, minlength=labels.size)
    mean, slow = (np.bincount(cluster, of, labels.size) / np.maximum(size, 1) for of in (speed, speed < HALT))
    several = np.flatnonzero(size >= 2)
    step, label = np.divmod(several, trucks)
    # The members of a cluster stand together, in the order of the trucks.
    order = np.argsort(cluster, kind="stable")
    order = order[size[cluster[order]] >= 2]
    row, truck = row[order], truck[order]
    at = np.repeat(np.arange(len(arc_first) - 1), np.diff(arc_first))
    ends = [network.position(fleet.edge[at, v], fleet.offset[at, v])[:, :2] for v in arcs.T]
    critical = mean[at * trucks + labels[at, arcs[:, 0]]] < rule.limit
    clusters = {"time": fleet.time[step], "label": label, "size": size[several]}
    clusters |= {"mean_speed": mean[several], "slow_share": slow[several]}
    members = {"truck": truck, "edge": fleet.edge[row, truck], "offset": fleet.offset[row, truck]}
    members |= {"speed": speed[order]}
    joining = {"time": fleet.time[at], "ends": np.stack(ends, axis=1), "critical": critical}
    seen = int((fleet.edge >= 0).any(axis=1).sum())
    return Crowds(fleet.vehicles, clusters, members, joining, np.zeros((2, 7)), seen)


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

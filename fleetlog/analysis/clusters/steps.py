"""From a dataset to clusters at every time step.

At each step the trucks are vertices of a directed graph whose weights are shortest driving distances

    d(k, m) = s_m - s_k                                  on one edge, m ahead
            = (l_e(k) - s_k) + D[end of e(k), start of e(m)] + s_m   otherwise

Clusters are the weakly connected components of the arcs with d <= threshold: the finest partition that is
closed under "a truck belongs to the cluster of any truck that it can reach within the threshold".  A cluster
of two or more is critical where its mean speed is under the limit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.network import Network
from fleetlog.core.trajectory import Trajectory, concatenate
from fleetlog.errors import DataError
from fleetlog.store import Dataset
from fleetlog.store.trips import STANDING_SPEED

Floats = NDArray[np.float64]
Index = NDArray[np.int32]

DAY = 86_400_000_000
MOST = 1_000_000_000
"""Steps of all vehicles; one takes 21 bytes."""
COLUMNS = ("edge_id", "edge_offset", "speed", "trip_id", "battery_power", "soc")


@dataclass(frozen=True)
class Fleet:
    """All trucks on one time grid; (T, V) arrays.

    ``edge`` is -1 where a truck is off the map or silent; ``standing_by`` marks trucks that have ended a trip
    and not set off again: parked, charging or handling a load.
    """

    vehicles: tuple[str, ...]
    time: NDArray[np.int64]
    step: float
    edge: Index
    offset: Floats
    speed: Floats
    standing_by: NDArray[np.bool_]


@dataclass(frozen=True)
class Clusters:
    """Clusters of a fleet at every step; see :func:`fleetlog.analysis.clusters.kernels.cluster_steps`."""

    labels: Index
    arcs: Index
    arc_first: NDArray[np.int64]
    size: Index
    mean_speed: Floats
    slow_share: Floats


def standing_by(trajectory: Trajectory) -> NDArray[np.bool_]:
    """(N,) whether a row belongs to the standstill that ends its trip:
    nothing in the way of the truck, it has arrived.
    """
    moving = np.nan_to_num(trajectory.floats("speed")) > STANDING_SPEED
    trips = trajectory.trip_ids()
    n = len(trajectory)
    # Walking backwards, a row has arrived until the first moving row of its trip.
    rows = np.arange(n)
    last_row = np.zeros(n, np.int64)
    ends = np.append(np.flatnonzero(np.diff(trips)), n - 1)
    starts = np.concatenate([[0], ends[:-1] + 1])
    for a, b in zip(starts, ends, strict=True):
        went = np.flatnonzero(moving[a : b + 1])
        last_row[a : b + 1] = a + went[-1] if len(went) else a - 1
    return rows > last_row


def on_grid(dataset: Dataset, network: Network, step: float, max_gap: float, start: int, stop: int) -> Fleet:
    """The fleet from ``start`` to ``stop`` (int64 us) on a grid of ``step`` seconds,
    interpolated along the routes.
    """
    from fleetlog.analysis.clusters.kernels import resample_along

    vehicles, spacing = tuple(dataset.vehicles), round(step * 1e6)
    if (stop - start) // spacing * len(vehicles) > MOST:
        days = (stop - start) / 86_400e6
        what = f"{days:,.0f} days of {len(vehicles)} vehicles in steps of {step:g} s are too many"
        raise DataError(
            what, where=dataset.path, do="choose a larger step, or import it without rows of a wrong time"
        )
    grid = np.arange(start, stop, spacing, dtype=np.int64)
    shape = (len(grid), len(vehicles))
    edge, offset = np.full(shape, -1, np.int32), np.zeros(shape)
    speed, idle = np.zeros(shape), np.zeros(shape, np.bool_)
    for v, vehicle in enumerate(vehicles):
        for t, until in _overlapping(dataset, vehicle, start, stop):
            a = int(np.searchsorted(grid, t.time[0]))
            b = int(np.searchsorted(grid, until, side="right"))
            resample_along(
                t.time, t.labels("edge_id").recode(network.index), np.nan_to_num(t.floats("edge_offset")),
                np.nan_to_num(t.floats("speed")), standing_by(t), grid[a:b], int(max_gap * 1e6),
                network.length, network.next_first, network.next_edges,
                edge[a:b, v], offset[a:b, v], speed[a:b, v], idle[a:b, v],
            )  # fmt: skip
    return Fleet(vehicles, grid, step, edge, offset, speed, idle)


def _overlapping(dataset: Dataset, vehicle: str, start: int, stop: int) -> Iterator[tuple[Trajectory, int]]:
    """Days of a vehicle, each with the day after it behind, and the time (us) up to which it counts: the next
    day's first row.

    A truck that stands in a jam at midnight has not arrived, and the step at midnight lies between rows of
    two days.
    """
    today: Trajectory | None = None
    for date in dataset.dates:
        day = int(np.datetime64(date, "us").astype(np.int64))
        if day >= stop or day + DAY <= start:
            continue
        after = dataset.read(vehicle, date, COLUMNS)
        if not len(after):
            continue
        if today is not None:
            yield concatenate([today, after]), int(after.time[0])
        today = after
    if today is not None:
        yield today, int(today.time[-1])


def find_clusters(fleet: Fleet, network: Network, threshold: float, slow: float, *, mask: bool) -> Clusters:
    """Clusters at every step; ``mask`` leaves out trucks that stand by."""
    from fleetlog.analysis.clusters.kernels import cluster_speeds, cluster_steps

    near = distance_lists(network, threshold)
    edge = np.where(fleet.standing_by, np.int32(-1), fleet.edge) if mask else fleet.edge
    labels, arcs, arc_first = cluster_steps(edge, fleet.offset, network.length, *near, threshold)
    size, mean, share = cluster_speeds(labels, fleet.speed, slow)
    return Clusters(labels, arcs, arc_first, size, mean, share)


def distance_lists(network: Network, threshold: float) -> tuple[NDArray[np.int64], Index, Floats, Index]:
    """For every edge the edges that begin within ``threshold`` metres of its end;
    see :func:`kernels.reachable`.
    """
    from fleetlog.analysis.clusters.kernels import reachable

    lists: tuple[NDArray[np.int64], Index, Floats, Index] = reachable(
        network.length, network.next_first, network.next_edges, float(threshold)
    )
    return lists

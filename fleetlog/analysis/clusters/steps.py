"""From a dataset to clusters at every time step.

At each step the trucks are vertices of a directed graph whose weights are shortest driving distances

    d(k, m) = s_m - s_k                                  on one edge, m ahead
            = (l_e(k) - s_k) + D[end of e(k), start of e(m)] + s_m   otherwise

Clusters are the weakly connected components of the arcs with d <= threshold: the finest partition that is
closed under "a truck belongs to the cluster of any truck that it can reach within the threshold".  A cluster
of two or more is critical where its mean speed is under the limit.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.network import Network
from fleetlog.core.trajectory import Floats, Ints, Trajectory, concatenate
from fleetlog.store import Dataset
from fleetlog.store.trips import STANDING_SPEED

Index = NDArray[np.int32]

DAY = 86_400_000_000
MAX_GAP = 15_000_000  # A truck that has been silent for longer is absent [us]
COLUMNS = ("edge_id", "edge_offset", "speed", "trip_id")


@dataclass(frozen=True)
class Fleet:
    """All trucks on one time grid; (T, V) arrays.

    ``edge`` is -1 where a truck is off the map or silent; ``standing_by`` marks trucks that have ended a trip
    and not set off again: parked, charging or handling a load.
    """

    vehicles: tuple[str, ...]
    time: Ints
    edge: Index
    offset: Floats
    speed: Floats
    standing_by: NDArray[np.bool_]


def standing_by(trajectory: Trajectory) -> NDArray[np.bool_]:
    """(N,) whether a row belongs to the standstill that ends its trip: nothing is in its way."""
    moving = np.nan_to_num(trajectory.floats("speed")) > STANDING_SPEED
    trips, rows = trajectory.trip_ids(), np.arange(len(trajectory))
    trip = np.cumsum(np.diff(trips, prepend=trips[:1]) != 0)
    went = np.full(int(trip[-1]) + 1 if len(trip) else 0, -1)
    np.maximum.at(went, trip[moving], rows[moving])
    return np.asarray(rows > went[trip])


def on_grid(dataset: Dataset, date: str, grid: Ints) -> Fleet:
    """The fleet at the times ``grid`` (T,) int64 us of one day, interpolated along the routes."""
    from fleetlog.analysis.clusters.kernels import resample_along

    network = dataset.site.roads()
    vehicles = tuple(v for v in dataset.vehicles if dataset.parts(v, date))
    shape = (len(grid), len(vehicles))
    edge, offset = np.full(shape, -1, np.int32), np.zeros(shape)
    speed, idle = np.zeros(shape), np.zeros(shape, np.bool_)
    for v, vehicle in enumerate(vehicles):
        t, arrived = _about(dataset, vehicle, date, int(grid[0]), int(grid[-1]))
        a, b = np.searchsorted(grid, t.time[0]), np.searchsorted(grid, t.time[-1], side="right")
        resample_along(
            t.time, t.labels("edge_id").recode(network.index), np.nan_to_num(t.floats("edge_offset")),
            np.nan_to_num(t.floats("speed")), arrived, grid[a:b], MAX_GAP,
            network.length, network.next_first, network.next_edges,
            edge[a:b, v], offset[a:b, v], speed[a:b, v], idle[a:b, v],
        )  # fmt: skip
    return Fleet(vehicles, grid, edge, offset, speed, idle)


def _about(
    dataset: Dataset, vehicle: str, date: str, start: int, stop: int
) -> tuple[Trajectory, NDArray[np.bool_]]:
    """The rows of a vehicle from just before ``start`` to just after ``stop``, and which are standing by.

    A truck that stands in a jam at midnight has not arrived: the next day tells; and the steps at midnight
    lie between rows of two days.
    """
    t = dataset.read(vehicle, date, COLUMNS)
    if start < t.time[0] and len(before := _beside(dataset, vehicle, date, -1)):
        t = concatenate([before[-1:], t])
    last_trip = t.time[np.searchsorted(t.trip_ids(), t.trip_ids()[-1])]
    if stop >= min(last_trip, t.time[-1]) and len(after := _beside(dataset, vehicle, date, 1)):
        t = concatenate([t, after])
    a = max(int(np.searchsorted(t.time, start, side="right")) - 1, 0)
    b = int(np.searchsorted(t.time, stop)) + 1
    return t[a:b], standing_by(t)[a:b]


def _beside(dataset: Dataset, vehicle: str, date: str, days: int) -> Trajectory:
    """The rows of a vehicle on a day before or after."""
    return dataset.read(vehicle, str(np.datetime64(date, "D") + days), COLUMNS)


def distance_lists(network: Network, threshold: float) -> tuple[Ints, Index, Floats, Index]:
    """For every edge the edges that begin within ``threshold`` metres of its end; see ``reachable``."""
    from fleetlog.analysis.clusters.kernels import reachable

    lists: tuple[Ints, Index, Floats, Index] = reachable(
        network.length, network.next_first, network.next_edges, float(threshold)
    )
    return lists

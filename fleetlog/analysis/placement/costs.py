"""What a drive from vertex to vertex costs: metres, seconds, or energy."""

from typing import Literal

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from fleetlog.core.arrays import Floats
from fleetlog.core.network import Network
from fleetlog.core.truck import Truck
from fleetlog.errors import DataError

Metric = Literal["distance", "time", "energy"]
UNITS = {"distance": "m", "time": "s", "energy": "Wh"}
USUAL_SPEED = 2.5  # Where a road states no limit and no truck is given [m/s]
PIECE = 2.0  # Length over which speed and slope are taken as constant [m]


def driving_costs(network: Network, metric: Metric, truck: Truck | None = None) -> Floats:
    """(n, n) cheapest drive from vertex (row) to vertex (column) in m, s or Wh; inf where there is none."""
    if metric == "distance":
        return vertex_distances(network)
    if metric == "time":
        return vertex_distances(network, network.length / edge_speeds(network, truck))
    if truck is None:
        raise DataError("the metric energy needs a truck", do="name one with --truck")
    return vertex_distances(network, edge_energies(network, truck))


def edge_speeds(network: Network, truck: Truck | None = None) -> Floats:
    """(E,) speed limit [m/s], under the truck's own where one is given."""
    top = USUAL_SPEED if truck is None else truck.drive.max_speed
    limit = np.where(np.isfinite(network.speed_limit), network.speed_limit, top)
    return limit if truck is None else np.minimum(limit * truck.drive.speed_factor, top)


def edge_energies(network: Network, truck: Truck) -> Floats:
    """(E,) Wh that the empty truck takes from its battery over an edge at steady speed, by the nominal model.

    Direction and grade count, since the slope of an edge is taken along its own direction.  An edge on which
    more comes back than is spent counts as nothing: a drive is never chosen for what it gives back.
    """
    from fleetlog.core.motion import Motion
    from fleetlog.physics.power import Physics, battery_power

    pieces = np.maximum(1, np.ceil(network.length / PIECE)).astype(np.int64)
    edge = np.repeat(np.arange(len(network), dtype=np.int32), pieces)
    number = np.arange(len(edge)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    size = (network.length / pieces)[edge]
    offset = (number + 0.5) * size
    speed = edge_speeds(network, truck)[edge]
    slope = network.slope(edge, offset)
    motion = Motion.of(len(edge), speed=speed, dt=size / speed, slope=slope, edge=edge, edge_offset=offset)
    watts = battery_power(motion, Physics(truck))
    return np.maximum(np.bincount(edge, watts * motion.dt, len(network)), 0.0) / 3600.0


def vertex_distances(network: Network, weight: Floats | None = None) -> Floats:
    """(n, n) shortest driving distance from vertex i (row) to vertex j (column); inf where there is no way.

    ``weight`` (E,) replaces length: seconds or joules an edge.
    """
    w = network.length if weight is None else weight
    n = len(network.node_ids)
    # Of parallel edges the shortest counts; a sparse constructor would add them up.
    order = np.lexsort((w, network.end, network.start))
    s, e = network.start[order], network.end[order]
    keep = np.r_[True, (np.diff(s) != 0) | (np.diff(e) != 0)]
    graph = sparse.csr_array((np.maximum(w[order][keep], 1e-9), (s[keep], e[keep])), shape=(n, n))
    return np.asarray(dijkstra(graph))

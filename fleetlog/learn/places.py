"""Places and slow zones of a recording."""

from dataclasses import replace

import numpy as np
import pandas as pd
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull

from fleetlog.core.arrays import Mask
from fleetlog.core.network import Network
from fleetlog.core.site import Site, Zone
from fleetlog.simulate.places import clusters, find_stands, mined_site, place_table, with_room
from fleetlog.store.dataset import Dataset

SLOW = 0.7  # roads driven at less than this share of the usual speed are a zone
SHORTEST = 8.0  # a zone has this many metres of road at least
RIM = 2.0  # a zone reaches this far about its roads [m]
OPEN = 4.0  # an outline this many times as large as its roads says little


def with_places(site: Site, dataset: Dataset, min_visits: int) -> tuple[Site, pd.DataFrame]:
    """The site with the places where trucks stood again and again, and the table of their evidence."""
    stands = find_stands(dataset)
    cluster = clusters(stands, min_visits)
    table = place_table(stands, cluster)
    site, names = mined_site(site, table)
    site = with_room(site, stands, cluster, names)
    room = {p.id: p.plugs for p in site.places}
    table["place"] = names
    table["plugs"] = [room[n] for n in names]
    return site, table


def slow_zones(network: Network) -> tuple[Zone, ...]:
    """Where roads that meet are all driven slowly: their outline, with the highest speed driven in it. An
    outline that a faster road enters would slow that one down: it is left out."""
    known = np.isfinite(network.speed_limit)
    if not known.any():
        return ()
    usual = float(np.average(network.speed_limit[known], weights=network.length[known]))
    slow = known & (network.speed_limit < SLOW * usual)
    meet = coo_matrix((slow.astype(float), (network.start, network.end)), shape=(len(network.node_ids),) * 2)
    _, group = connected_components(meet, directed=False)
    names = np.unique(group[network.start[slow]])
    found = (_zone(network, slow & (group[network.start] == name)) for name in names)
    zones = (zone for zone in found if zone is not None)
    return tuple(replace(zone, id=f"slow-{k}") for k, zone in enumerate(zones, 1))


def _zone(network: Network, mine: Mask) -> Zone | None:
    if network.length[mine].sum() < SHORTEST:
        return None
    owner = np.repeat(mine, np.diff(network.first))
    points = network.points[owner, :2]
    around = np.array([[-RIM, -RIM], [-RIM, RIM], [RIM, -RIM], [RIM, RIM]])
    rim = (points[:, None] + around[None]).reshape(-1, 2)
    hull = ConvexHull(rim)
    if hull.volume > OPEN * 2.0 * RIM * float(network.length[mine].sum()):
        return None
    zone = Zone("", rim[hull.vertices], float(np.ceil(network.speed_limit[mine].max() * 10) / 10))
    others = network.points[~owner, :2]
    near_end = np.hypot(*(others[:, None] - points[None]).transpose(2, 0, 1)).min(axis=1) < 2 * RIM
    return None if (zone.contains(*others.T) & ~near_end).any() else zone

"""Places of a recording: where its trucks stand again and again, and what they do there."""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fleetlog.core.arrays import Floats, Ints
from fleetlog.core.site import Place, Site
from fleetlog.errors import DataError
from fleetlog.store.dataset import Dataset
from fleetlog.store.days import each_day
from fleetlog.store.trips import MAX_GAP, MIN_LOAD_CHANGE, STANDING_SPEED, runs

COLUMNS = ("x", "y", "speed", "payload", "soc", "fork_height")
MIN_DWELL = 8.0  # A shorter standstill is a wait on the way, unless the load changes [s]
REACH = 2.0  # Stands so far apart, or over others between them, belong to one place [m]
MANY = 30  # With more neighbours than this a point, pairs are not listed
CLOSE = 1.0  # Others so near make a stand firm: a lone one between two places does not join them [m]
MOVED, MOTION = 1.5, 50  # Motion before and after a stop is that of so many metres, within so many rows
ENDS = ("begins", "ends")  # Whether a day begins, and whether it ends, with a standstill
MERGED = dict(end="last", after="last", out="last", x="median", y="median", charged="sum", height="max")
MIN_VISITS = 3  # A place was visited this often at least
MIN_CHARGE = 0.005  # A state of charge that rises by more than this at a stand was charged
KNOWN = 6.0  # A mined place this close to one of the site is that one [m]
SWAPS = 3.0 / 3600.0  # A battery that gains more of its charge a second is swapped: chargers give two an hour
FASTEST_SWAP = 30.0  # Nobody swaps a battery in less, and a charge that leaps then was corrected [s]
MAJORITY = 0.3  # A place where loads (or charge) change in more than this share of the visits is one for that


@dataclass(frozen=True)
class Stands:
    """N standstills of all trucks, in order of vehicle and time.

    ``vehicle`` codes; ``start``, ``end`` microseconds; ``x``, ``y`` m; ``before``, ``after`` kg on the
    forks; ``charged`` change of the state of charge; ``height`` m, the highest of the forks; ``into``,
    ``out`` rad, the direction of motion before and after, NaN where that is not known."""

    vehicle: Ints
    start: Ints
    end: Ints
    x: Floats
    y: Floats
    before: Floats
    after: Floats
    charged: Floats
    height: Floats
    into: Floats
    out: Floats

    def __len__(self) -> int:
        return len(self.x)

    @property
    def dwell(self) -> Floats:
        """(N,) seconds."""
        return np.asarray((self.end - self.start) * 1e-6)


def find_stands(dataset: Dataset) -> Stands:
    """All standstills of a dataset; one pass over its rows."""
    code = {v: float(i) for i, v in enumerate(dataset.vehicles)}
    days = each_day(dataset, _stands, kinds=(Stands,), cost=0.5e-6)
    if not (found := [np.insert(table, 0, code[vehicle], axis=1) for vehicle, table in days]):
        raise DataError("the dataset has no rows", where=dataset.path)
    t = pd.DataFrame(np.concatenate(found), columns=[*(names := [f.name for f in fields(Stands)]), *ENDS])
    # A truck that stands at midnight stands once.
    on = (t.vehicle.diff() == 0.0) & (t.start - t.end.shift() <= MAX_GAP * 1e6)
    on &= (t.begins > 0.0) & (t.ends.shift() > 0.0)
    t = t.groupby((~on).cumsum()).agg({**dict.fromkeys(names, "first"), **MERGED})
    lasts = (t.end - t.start) * 1e-6 >= MIN_DWELL
    t = t[lasts | ((t.after - t.before).abs() > MIN_LOAD_CHANGE)]
    return Stands(*(t[k].to_numpy(np.int64) for k in names[:3]), *(t[k].to_numpy(float) for k in names[3:]))


def _stands(dataset: Dataset, vehicle: str, date: str) -> tuple[str, Floats]:
    """The truck, and its (n, 12) standstills on one day, in the order of :class:`Stands`; last, whether the
    day begins, and whether it ends, with it: then however short."""
    t = dataset.read(vehicle, date, COLUMNS)
    gap = np.diff(t.time, prepend=t.time[:1]) * 1e-6 > MAX_GAP
    load, height = np.nan_to_num(t.floats("payload")), np.nan_to_num(t.floats("fork_height"))
    x, y, soc = t.floats("x"), t.floats("y"), t.floats("soc")
    out = []
    for a, b in runs(np.nan_to_num(t.floats("speed"), nan=1.0) <= STANDING_SPEED):
        first, last = max(a - 1, 0), min(b, len(t) - 1)
        counts = abs(load[last] - load[first]) > MIN_LOAD_CHANGE or a == 0 or b == len(t)
        if gap[a + 1 : b].any() or ((t.time[b - 1] - t.time[a]) * 1e-6 < MIN_DWELL and not counts):
            continue
        at = np.nanmedian(x[a:b]), np.nanmedian(y[a:b])
        rise = np.nan_to_num(soc[b - 1] - soc[a])
        row = (t.time[a], t.time[b - 1], *at, load[first], load[last], rise, height[a:b].max())
        before, after = slice(max(a - MOTION, 0), a), slice(b, b + MOTION)
        into = _direction(x[before][::-1], y[before][::-1]) + np.pi
        out.append((*row, into, _direction(x[after], y[after]), a == 0, b == len(t)))
    return vehicle, np.array(out, dtype=np.float64).reshape(-1, 12)


def _direction(x: Floats, y: Floats) -> float:
    """Direction from the first of some positions to the next that is ``MOVED`` away [rad]; NaN: none is."""
    far = np.flatnonzero(np.hypot(x - x[:1], y - y[:1]) > MOVED)
    return float(np.arctan2(y[far[0]] - y[0], x[far[0]] - x[0])) if len(far) else float("nan")


def joined(points: NDArray[Any], reach: float = REACH) -> Ints:
    """(N,) label of each of (N, 2) points: those within ``reach``, directly or over others, have the same.
    Where pairs are many, Delaunay's triangles are few, and hold the shortest tree over all points."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import Delaunay, cKDTree

    if not (n := len(points)):
        return np.zeros(0, np.int64)
    tree = cKDTree(points)
    if tree.count_neighbors(tree, reach) <= MANY * n:
        links = tree.query_pairs(reach, output_type="ndarray")
    else:
        # With three points far away there are triangles also where all others lie on a line.
        own, wide = points - points[0], float(np.ptp(points, axis=0).max()) + reach
        net = Delaunay(np.concatenate([own, wide * np.array([[-4.0, -3.0], [4.0, -3.1], [0.1, 5.0]])]))
        # A point on another is in no triangle, but coplanar: beside that one.
        links = np.concatenate([*(net.simplices[:, [k, k - 1]] for k in range(3)), net.coplanar[:, [0, 2]]])
        links = links[(links < n).all(axis=1)]
        links = links[np.hypot(*(own[links[:, 0]] - own[links[:, 1]]).T) <= reach]
    graph = coo_matrix((np.ones(len(links)), links.T), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def clusters(stands: Stands, min_visits: int = MIN_VISITS, loads: bool = False) -> Ints:
    """(N,) place of every stand, from west to east, -1: under ``min_visits``; see :func:`joined`. With
    ``loads`` one stand is enough where a load changed; such places come last."""
    from scipy.spatial import cKDTree

    at, number = np.column_stack([stands.x, stands.y]), np.full(len(stands), -1)
    if len(at):
        firm = cKDTree(at).query_ball_point(at, CLOSE, return_length=True) >= max(2, min_visits // 2)
        if firm.any():
            gap, nearest = cKDTree(at[firm]).query(at)
            number = np.where(gap <= REACH, joined(at[firm])[nearest], -1)
    places = pd.DataFrame(at, columns=["x", "y"]).assign(label=number)[number >= 0].groupby("label")
    middle = places.median()[places.size() >= min_visits]
    out = middle.sort_values(["x", "y"], kind="stable").index.get_indexer(pd.Index(number))
    lone = np.flatnonzero((out < 0) & (np.abs(stands.after - stands.before) > MIN_LOAD_CHANGE) & loads)
    out[lone] = len(middle) + joined(at[lone])
    return np.asarray(out, dtype=np.int64)


def place_table(stands: Stands, cluster: Ints) -> pd.DataFrame:
    """One row a place: id, kind, x, y, spread [m], visits, vehicles, dwell [s], shares of visits."""
    change, here = stands.after - stands.before, cluster >= 0
    t = pd.DataFrame({
        "x": stands.x, "y": stands.y, "vehicle": stands.vehicle, "dwell": stands.dwell,
        "pick": change > MIN_LOAD_CHANGE, "drop": change < -MIN_LOAD_CHANGE,
        "charge": stands.charged > MIN_CHARGE,
    })[here]  # fmt: skip
    middle = t[["x", "y"]].groupby(cluster[here]).transform("median")
    of = t.assign(spread=np.hypot(t.x - middle.x, t.y - middle.y)).groupby(cluster[here])
    out = of[["x", "y", "spread"]].median().assign(
        visits=of.size(), vehicles=of.vehicle.nunique(), dwell_median=of.dwell.median(),
        dwell_total=of.dwell.sum(), picks=of.pick.mean(), drops=of["drop"].mean(), charges=of.charge.mean(),
    )  # fmt: skip
    # Where the log has neither loads nor charge, a place is one to park.
    works = np.where(out.picks >= out.drops, "pick", "drop")
    kinds = [out.charges > MAJORITY, out.picks + out.drops <= MAJORITY]
    out.insert(0, "kind", np.select(kinds, ["charge", "park"], works))
    number = out.groupby("kind").cumcount() + 1
    out.insert(0, "place", out.kind + "-" + number.astype(str))
    return out.reset_index(drop=True)


def mined_site(site: Site, table: pd.DataFrame, reach: float = KNOWN) -> tuple[Site, list[str]]:
    """The site with the mined places that it does not have yet; and the place of every row of ``table``."""
    places, names = list(site.places), []
    for first, kind, x, y in table[["place", "kind", "x", "y"]].itertuples(index=False, name=None):
        if (gaps := [float(np.hypot(p.x - x, p.y - y)) for p in site.places]) and min(gaps) <= reach:
            names.append(site.places[int(np.argmin(gaps))].id)
            continue
        name = str(first)
        while name in {p.id for p in places}:
            name = f"{name}m"
        names.append(name)
        places.append(Place(name, kind, x, y))
    return replace(site, places=tuple(places)), names


def with_room(site: Site, stands: Stands, cluster: Ints, names: list[str]) -> Site:
    """The site with room at each place, chargers apart, for as many trucks as were seen there at one time.
    Chargers of no stated power at which batteries gained charge as fast as that swap them, in that time."""
    most, swap = dict[str, int](), dict[str, float]()
    for k, name in enumerate(names):
        mine = cluster == k
        gains = mine & (stands.charged > MIN_CHARGE) & (stands.dwell >= FASTEST_SWAP)
        if gains.any() and np.median(stands.charged[gains] / stands.dwell[gains]) > SWAPS:
            swap[name] = float(np.median(stands.dwell[gains]))
        time = np.concatenate([stands.start[mine], stands.end[mine]])
        step = np.repeat([1, -1], mine.sum())
        # Who leaves as another comes makes room for it.
        together = np.cumsum(step[np.lexsort((step, time))])
        most[name] = max(most.get(name, 1), int(together.max(initial=1)))
    seen = {p.id: 0 if p.kind == "charge" else most.get(p.id, 1) for p in site.places}
    swap = {p.id: swap[p.id] if p.id in swap and np.isnan(p.power) else p.swap for p in site.places}
    places = (replace(p, plugs=max(p.plugs, seen[p.id]), swap=swap[p.id]) for p in site.places)
    return replace(site, places=tuple(places))

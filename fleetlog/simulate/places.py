"""Places of a recording: where its trucks stand again and again, and what they do there."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.arrays import Floats, Ints
from fleetlog.core.site import Place, PlaceKind, Site
from fleetlog.errors import DataError
from fleetlog.store.dataset import Dataset
from fleetlog.store.days import each_day
from fleetlog.store.trips import MAX_GAP, MIN_LOAD_CHANGE, STANDING_SPEED, runs

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ("x", "y", "speed", "payload", "soc", "fork_height")
MIN_DWELL = 8.0  # A shorter standstill is a wait on the way, unless the load changes [s]
CELL = 2.0  # Stands in the same or in touching cells of this size belong to one place [m]
MOVED, MOTION = 1.5, 50  # Motion before and after a stop is that of so many metres, within so many rows
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
    table = np.concatenate(found)
    ints = table[:, :3].astype(np.int64)
    return Stands(ints[:, 0], ints[:, 1], ints[:, 2], *table[:, 3:].T)


def _stands(dataset: Dataset, vehicle: str, date: str) -> tuple[str, Floats]:
    """The truck, and its (n, 10) standstills on one day."""
    t = dataset.read(vehicle, date, COLUMNS)
    gap = np.diff(t.time, prepend=t.time[:1]) * 1e-6 > MAX_GAP
    load, height = np.nan_to_num(t.floats("payload")), np.nan_to_num(t.floats("fork_height"))
    x, y, soc = t.floats("x"), t.floats("y"), t.floats("soc")
    out = []
    for a, b in runs(np.nan_to_num(t.floats("speed"), nan=1.0) <= STANDING_SPEED):
        first, last = max(a - 1, 0), min(b, len(t) - 1)
        changes = abs(load[last] - load[first]) > MIN_LOAD_CHANGE
        if gap[a + 1 : b].any() or ((t.time[b - 1] - t.time[a]) * 1e-6 < MIN_DWELL and not changes):
            continue
        at = np.nanmedian(x[a:b]), np.nanmedian(y[a:b])
        rise = np.nan_to_num(soc[b - 1] - soc[a])
        row = (t.time[a], t.time[b - 1], *at, load[first], load[last], rise, height[a:b].max())
        before, after = slice(max(a - MOTION, 0), a), slice(b, b + MOTION)
        into = _direction(x[before][::-1], y[before][::-1]) + np.pi
        out.append((*row, into, _direction(x[after], y[after])))
    return vehicle, np.array(out, dtype=np.float64).reshape(-1, 10)


def _direction(x: Floats, y: Floats) -> float:
    """Direction from the first of some positions to the next that is ``MOVED`` away [rad]; NaN: none is."""
    far = np.flatnonzero(np.hypot(x - x[:1], y - y[:1]) > MOVED)
    return float(np.arctan2(y[far[0]] - y[0], x[far[0]] - x[0])) if len(far) else float("nan")


def touching(cells: NDArray[Any]) -> Ints:
    """(N,) label of each of (N, 2) cells: those that touch, also at a corner, have the same."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    a, b = (cKDTree(cells).query_pairs(1.5, output_type="ndarray") if len(cells) else np.zeros((0, 2), int)).T
    graph = coo_matrix((np.ones(len(a)), (a, b)), shape=(len(cells), len(cells)))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def clusters(stands: Stands, min_visits: int = MIN_VISITS, loads: bool = False) -> Ints:
    """(N,) place of every stand, from west to east, -1: under ``min_visits``; cells that touch are one. With
    ``loads`` one stand is enough where a load changed; such places come last."""
    cell = np.floor(np.column_stack([stands.x, stands.y]) / CELL)
    cells, of, count = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    of = of.ravel()
    # A lone stand between two places must not join them.
    firm = count >= max(2, min_visits // 2)
    label = np.full(len(cells), -1)
    label[firm] = touching(cells[firm])
    names, code, visits = np.unique(label[of], return_inverse=True, return_counts=True)
    kept = np.flatnonzero((names >= 0) & (visits >= min_visits)).tolist()
    centre = {k: (np.median(stands.x[code == k]), np.median(stands.y[code == k])) for k in kept}
    number = np.full(len(names), -1, dtype=np.int64)
    number[sorted(kept, key=lambda k: (*centre[k], k))] = np.arange(len(kept))
    out = number[code]
    lone = np.flatnonzero((out < 0) & (np.abs(stands.after - stands.before) > MIN_LOAD_CHANGE) & loads)
    out[lone] = len(kept) + touching(cells[of[lone]])
    return np.asarray(out)


def place_table(stands: Stands, cluster: Ints) -> pd.DataFrame:
    """One row a place: id, kind, x, y, spread [m], visits, vehicles, dwell [s], shares of visits."""
    import pandas as pd

    rows, counts = [], Counter[str]()
    for k in range(int(cluster.max(initial=-1)) + 1):
        mine = cluster == k
        change, dwell = stands.after[mine] - stands.before[mine], stands.dwell[mine]
        shares = change > MIN_LOAD_CHANGE, change < -MIN_LOAD_CHANGE, stands.charged[mine] > MIN_CHARGE
        picks, drops, charges = (float(np.mean(share)) for share in shares)
        # Where the log has neither loads nor charge, a place is one to park.
        works: PlaceKind = "park" if picks + drops <= MAJORITY else "pick" if picks >= drops else "drop"
        kind: PlaceKind = "charge" if charges > MAJORITY else works
        counts[kind] += 1
        x, y = float(np.median(stands.x[mine])), float(np.median(stands.y[mine]))
        spread = float(np.median(np.hypot(stands.x[mine] - x, stands.y[mine] - y)))
        rows.append((
            f"{kind}-{counts[kind]}", kind, x, y, spread, int(mine.sum()),
            len(np.unique(stands.vehicle[mine])), float(np.median(dwell)), float(dwell.sum()),
            picks, drops, charges,
        ))  # fmt: skip
    names = "place kind x y spread visits vehicles dwell_median dwell_total picks drops charges"
    return pd.DataFrame(rows, columns=names.split())


def mined_site(site: Site, table: pd.DataFrame) -> tuple[Site, list[str]]:
    """The site with the mined places that it does not have yet; and the place of every row of ``table``."""
    places, names = list(site.places), []
    for first, kind, x, y in table[["place", "kind", "x", "y"]].itertuples(index=False, name=None):
        if (gaps := [float(np.hypot(p.x - x, p.y - y)) for p in site.places]) and min(gaps) <= KNOWN:
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
        most[name] = max(most.get(name, 1), int(np.cumsum(step[np.lexsort((step, time))]).max(initial=1)))
    seen = {p.id: 0 if p.kind == "charge" else most.get(p.id, 1) for p in site.places}
    swap = {p.id: swap[p.id] if p.id in swap and np.isnan(p.power) else p.swap for p in site.places}
    places = (replace(p, plugs=max(p.plugs, seen[p.id]), swap=swap[p.id]) for p in site.places)
    return replace(site, places=tuple(places))

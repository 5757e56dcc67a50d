"""Places and demand of a recording: where its trucks stand again and again, and who carries what when."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from fleetlog.core.site import Place, PlaceKind, Site
from fleetlog.core.truck import Truck
from fleetlog.errors import DataError
from fleetlog.simulate.arrays import Flags, Floats, Ints
from fleetlog.simulate.tasks import Task
from fleetlog.store.dataset import Dataset
from fleetlog.store.days import each_day
from fleetlog.store.trips import MAX_GAP, MIN_LOAD_CHANGE, STANDING_SPEED

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ("x", "y", "speed", "payload", "soc", "fork_height")
MIN_DWELL = 8.0
"""A shorter standstill is a wait on the way, unless the load changes [s]."""
CELL = 2.0
"""Stands in the same or in touching cells of this size belong to one place [m]."""
MIN_VISITS = 3
"""A place was visited this often at least."""
MIN_CHARGE = 0.005
"""A state of charge that rises by more than this at a stand was charged."""
KNOWN = 6.0
"""A mined place this close to one of the site is that one [m]."""
MAJORITY = 0.3
"""A place where loads (or charge) change in more than this share of the visits is one for that."""
JITTER = 120.0
"""A drawn task comes this much earlier or later than the recorded one at most [s]."""

BETWEEN, LONGEST_GAP = 60.0, 900.0
"""From when one task of a truck begins to when its next one does [s]."""


@dataclass(frozen=True)
class Stands:
    """N standstills of all trucks, in order of vehicle and time.

    ``vehicle`` codes; ``start``, ``end`` microseconds; ``x``, ``y`` m; ``before``, ``after`` kg on the forks;
    ``charged`` change of the state of charge; ``height`` m, the highest of the forks.
    """

    vehicle: Ints
    start: Ints
    end: Ints
    x: Floats
    y: Floats
    before: Floats
    after: Floats
    charged: Floats
    height: Floats

    def __len__(self) -> int:
        return len(self.x)

    @property
    def dwell(self) -> Floats:
        """(N,) seconds."""
        return np.asarray((self.end - self.start) * 1e-6)


def find_stands(dataset: Dataset) -> Stands:
    """All standstills of a dataset; one pass over its rows."""
    code = {v: float(i) for i, v in enumerate(dataset.vehicles)}
    found = [
        np.insert(table, 0, code[vehicle], axis=1)
        for vehicle, table in each_day(dataset, _stands, kinds=(Stands,), cost=0.5e-6)
    ]
    if not found:
        raise DataError("the dataset has no rows", where=dataset.path)
    table = np.concatenate(found)
    ints = table[:, :3].astype(np.int64)
    return Stands(ints[:, 0], ints[:, 1], ints[:, 2], *table[:, 3:].T)


def _stands(dataset: Dataset, vehicle: str, date: str) -> tuple[str, Floats]:
    """The truck, and its (n, 8) standstills on one day."""
    t = dataset.read(vehicle, date, COLUMNS)
    still = np.nan_to_num(t.floats("speed"), nan=1.0) <= STANDING_SPEED
    gap = np.diff(t.time, prepend=t.time[:1]) * 1e-6 > MAX_GAP
    edge = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
    load, height = np.nan_to_num(t.floats("payload")), np.nan_to_num(t.floats("fork_height"))
    x, y, soc = t.floats("x"), t.floats("y"), t.floats("soc")
    out = []
    for a, b in edge.reshape(-1, 2):
        first, last = max(a - 1, 0), min(b, len(t) - 1)
        changes = abs(load[last] - load[first]) > MIN_LOAD_CHANGE
        if gap[a + 1 : b].any() or ((t.time[b - 1] - t.time[a]) * 1e-6 < MIN_DWELL and not changes):
            continue
        rise = soc[b - 1] - soc[a]
        out.append(
            (
                t.time[a],
                t.time[b - 1],
                np.nanmedian(x[a:b]),
                np.nanmedian(y[a:b]),
                load[first],
                load[last],
                rise if np.isfinite(rise) else 0.0,
                height[a:b].max(),
            )
        )
    return vehicle, np.array(out, dtype=np.float64).reshape(-1, 8)


def clusters(stands: Stands, min_visits: int = MIN_VISITS) -> Ints:
    """(N,) cluster of every stand, -1 where there are fewer than ``min_visits``: touching occupied cells are
    one.

    Time and memory grow linearly with the stands.  Clusters are numbered from west to east, then from south
    to north.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    cell = np.column_stack([np.floor(stands.x / CELL), np.floor(stands.y / CELL)]).astype(np.int64)
    cells, of, count = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    of = of.ravel()
    # A lone stand between two places must not join them.
    firm = count >= max(2, min_visits // 2)
    index = {(int(i), int(j)): k for k, (i, j) in enumerate(cells) if firm[k]}
    pairs = [
        (k, index[i + di, j + dj])
        for (i, j), k in index.items()
        for di in (-1, 0, 1)
        for dj in (-1, 0, 1)
        if (i + di, j + dj) in index
    ]
    a, b = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    graph = coo_matrix((np.ones(len(a)), (a, b)), shape=(len(cells), len(cells)))
    _, label = connected_components(graph, directed=False)
    of_stand = np.where(firm[of], label[of], -1).astype(np.int64)
    names, code, visits = np.unique(of_stand, return_inverse=True, return_counts=True)
    keep = (names >= 0) & (visits >= min_visits)
    centre = [
        (float(np.median(stands.x[code == k])), float(np.median(stands.y[code == k])), int(k))
        for k in np.flatnonzero(keep)
    ]
    number = np.full(len(names), -1, dtype=np.int64)
    for new, (_, _, k) in enumerate(sorted(centre)):
        number[k] = new
    return np.asarray(number[code])


def kind_of(stands: Stands, mine: Flags) -> PlaceKind:
    """What a place is for, from loads and charge; ``park`` where neither changes or the log has neither."""
    up = float(np.mean(stands.after[mine] - stands.before[mine] > MIN_LOAD_CHANGE))
    down = float(np.mean(stands.before[mine] - stands.after[mine] > MIN_LOAD_CHANGE))
    if float(np.mean(stands.charged[mine] > MIN_CHARGE)) > MAJORITY:
        return "charge"
    if up + down > MAJORITY:
        return "pick" if up >= down else "drop"
    return "park"


def place_table(stands: Stands, cluster: Ints) -> pd.DataFrame:
    """One row a place: id, kind, x, y, spread [m], visits, vehicles, dwell [s], shares of visits."""
    import pandas as pd

    rows, counts = [], {"pick": 0, "drop": 0, "park": 0, "charge": 0}
    for k in range(int(cluster.max(initial=-1)) + 1):
        mine = cluster == k
        kind = kind_of(stands, mine)
        counts[kind] += 1
        x, y = float(np.median(stands.x[mine])), float(np.median(stands.y[mine]))
        change = stands.after[mine] - stands.before[mine]
        rows.append({
            "place": f"{kind}-{counts[kind]}", "kind": kind, "x": x, "y": y,
            "spread": float(np.median(np.hypot(stands.x[mine] - x, stands.y[mine] - y))),
            "visits": int(mine.sum()), "vehicles": len(np.unique(stands.vehicle[mine])),
            "dwell_median": float(np.median(stands.dwell[mine])),
            "dwell_total": float(stands.dwell[mine].sum()), "picks": float(np.mean(change > MIN_LOAD_CHANGE)),
            "drops": float(np.mean(change < -MIN_LOAD_CHANGE)),
            "charges": float(np.mean(stands.charged[mine] > MIN_CHARGE)),
        })  # fmt: skip
    names = "place kind x y spread visits vehicles dwell_median dwell_total picks drops charges"
    return pd.DataFrame(rows, columns=names.split())


def mined_site(site: Site, table: pd.DataFrame) -> tuple[Site, list[str]]:
    """The site with the mined places that it does not have yet; and the place of every row of ``table``."""
    places, names = list(site.places), []
    used = {p.id for p in places}
    spots = table[["x", "y"]].to_numpy(float)
    for k, (first, kind) in enumerate(zip(table["place"].tolist(), table["kind"].tolist(), strict=True)):
        x, y = float(spots[k, 0]), float(spots[k, 1])
        gaps = [float(np.hypot(p.x - x, p.y - y)) for p in site.places]
        if gaps and min(gaps) <= KNOWN:
            names.append(site.places[int(np.argmin(gaps))].id)
            continue
        name = str(first)
        while name in used:
            name = f"{name}m"
        used.add(name)
        names.append(name)
        places.append(Place(name, kind, x, y))
    return replace(site, places=tuple(places)), names


def with_room(site: Site, stands: Stands, cluster: Ints, names: list[str]) -> Site:
    """The site with room at each place, chargers apart, for as many trucks as were seen there at one time."""
    most: dict[str, int] = {}
    for k, name in enumerate(names):
        mine = cluster == k
        time = np.concatenate([stands.start[mine], stands.end[mine]])
        step = np.repeat([1, -1], mine.sum())
        # Who leaves as another comes makes room for it.
        together = np.cumsum(step[np.lexsort((step, time))])
        most[name] = max(most.get(name, 1), int(together.max(initial=1)))
    places = (
        p if p.kind == "charge" else replace(p, plugs=max(p.plugs, most.get(p.id, 1))) for p in site.places
    )
    return replace(site, places=tuple(places))


def carried(stands: Stands, cluster: Ints, names: list[str]) -> list[Task]:
    """Every load that the recording shows: taken up at one place, set down at another by the same truck.

    ``earliest`` is the time of day [s] at which the truck set off to fetch it.  Recorded trucks mostly stood
    on the road, so the way into a bay and out of it counts as time at the place.
    """
    tasks: list[Task] = []
    held: tuple[int, int] | None = None
    for i in range(len(stands)):
        change = stands.after[i] - stands.before[i]
        if change > MIN_LOAD_CHANGE:
            held = (i, int(stands.vehicle[i]))
        elif change < -MIN_LOAD_CHANGE and held is not None:
            k, vehicle = held
            held = None
            a, b = int(cluster[k]), int(cluster[i])
            if vehicle != stands.vehicle[i] or a < 0 or b < 0 or names[a] == names[b]:
                continue
            known = k > 0 and stands.vehicle[k - 1] == vehicle
            day = float((stands.end[k - 1] if known else stands.start[k]) % 86_400_000_000) * 1e-6
            origin = names[cluster[k - 1]] if known and cluster[k - 1] >= 0 else None
            load = float(stands.after[k] - stands.before[k])
            dwell, height = ((float(v[k]), float(v[i])) for v in (stands.dwell, stands.height))
            tasks.append(Task(None, names[a], names[b], load, day, dwell, height, True, origin))
    return tasks


def demand_like(
    carried_tasks: list[Task], hours: Floats, start_of_day: float, duration: float, share: float, truck: Truck, seed: int
) -> list[Task]:  # fmt: skip
    """Tasks drawn like the recorded ones.

    Parameters
    ----------
    carried_tasks : of :func:`carried`.
    hours : (24,) hours of the day that the recording covers, each as often as it occurs.
    start_of_day : time of day at which the simulation starts [s];  duration : of it [s].
    share : trucks simulated over trucks recorded; demand grows with the fleet.

    Notes
    -----
    Each hour has a Poisson number of tasks with the recorded mean of that hour of day (of the whole recording
    where that hour was not recorded); places, payload, dwell times and heights of each are drawn together
    from one recorded task, so that they keep their joint distribution.  A task comes within ``JITTER`` of the
    time of day of that one, so that lulls and rushes come again, and at any time where the recording covers
    less of the hour than is simulated.
    """
    rng = np.random.Generator(np.random.PCG64([seed, 7]))
    hour = np.array([int(t.earliest // 3600) % 24 for t in carried_tasks])
    mean = len(carried_tasks) / max(float(hours.sum()), 1e-9)
    out: list[Task] = []
    begin = 0.0
    while begin < duration:
        now = int((start_of_day + begin) // 3600) % 24
        end = min(begin + 3600.0 - (start_of_day + begin) % 3600.0, duration)
        here = np.flatnonzero(hour == now)
        rate = len(here) / hours[now] if hours[now] > 0.1 else mean
        pool = here if len(here) else np.arange(len(carried_tasks))
        covered = len(here) > 0 and 3600.0 * hours[now] >= 0.95 * (end - begin)
        drawn = rng.choice(pool, rng.poisson(rate * share * (end - begin) / 3600.0))
        for like in (carried_tasks[int(i)] for i in drawn):
            in_hour = like.earliest % 3600.0 - (start_of_day + begin) % 3600.0
            at = in_hour + begin + rng.uniform(-JITTER, JITTER)
            if not covered or at >= end:
                at = rng.uniform(begin, end)
            load = min(like.payload, truck.chassis.rated_load)
            out.append(replace(like, payload=load, earliest=float(max(at, begin))))
        begin = end
    return sorted(out, key=lambda t: t.earliest)


def chained(tasks: list[Task]) -> list[Task]:
    """The tasks in order of time, numbered, each after one that ends where its truck set off in the recording.

    Of those that end there and nobody follows yet, the last one that began at least ``BETWEEN`` earlier; a task after
    another one may begin ``JITTER`` earlier, as it is known no better than that when it did.
    """
    ends: dict[str, list[Task]] = {}
    out: list[Task] = []
    for number, task in enumerate(tasks):
        found = [
            t for t in ends.get(task.origin or "", ()) if BETWEEN <= task.earliest - t.earliest <= LONGEST_GAP
        ]
        after = found[-1].number if found else -1
        if found:
            ends[task.origin or ""].remove(found[-1])
        earliest = max(task.earliest - JITTER, 0.0) if found else task.earliest
        out.append(replace(task, number=number, after=after, earliest=earliest))
        ends.setdefault(task.target, []).append(replace(task, number=number))
    return sorted(out, key=lambda t: (t.earliest, t.number))


def _seconds(iso: str) -> float:
    return float(np.datetime64(iso.removesuffix("Z"), "us").astype(np.int64)) * 1e-6


def recorded_hours(stands: Stands, dataset: Dataset) -> Floats:
    """(24,) how many hours of recording fall on each hour of the day."""
    start, end = (_seconds(str(dataset.meta[k])) for k in ("start", "end"))
    out = np.zeros(24)
    at = start
    while at < end:
        until = min((at // 3600.0 + 1.0) * 3600.0, end)
        out[int(at // 3600.0) % 24] += (until - at) / 3600.0
        at = until
    return out


def like(
    dataset: Dataset, site: Site, truck: Truck, vehicles: int, start: int, duration: float, seed: int,
    assigned: bool = False,
) -> tuple[Site, list[Task], list[str]]:  # fmt: skip
    """The site with a recording's places, tasks like its own (``assigned``: also whose they were), notes."""
    stands = find_stands(dataset)
    cluster = clusters(stands)
    table = place_table(stands, cluster)
    site, names = mined_site(site, table)
    site = with_room(site, stands, cluster, names)
    known = carried(stands, cluster, names)
    kinds = ", ".join(f"{n} {k}" for k, n in table.kind.value_counts().items())
    notes = [f"{len(table)} places mined from {len(stands)} stops ({kinds})"]
    if not known:
        notes.append("the recording shows no load carried between two places: tasks are random")
        return site, [], notes
    day = float(start % 86_400_000_000) * 1e-6
    share = vehicles / max(len(dataset.vehicles), 1)
    tasks = demand_like(known, recorded_hours(stands, dataset), day, duration, share, truck, seed)
    tasks = chained(tasks) if assigned else [replace(t, origin=None) for t in tasks]
    notes.append(f"{len(tasks)} tasks drawn like the {len(known)} recorded ones")
    return site, tasks, notes

"""Demand like a recording's: who carried what when, what trucks did next, and tasks drawn like that."""

from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace

import numpy as np

from fleetlog.core.arrays import Floats, Ints
from fleetlog.core.site import Site
from fleetlog.core.truck import Truck
from fleetlog.core.words import count
from fleetlog.simulate.doors import recorded_stands
from fleetlog.simulate.places import Stands, clusters, find_stands, mined_site, place_table, with_room
from fleetlog.simulate.tasks import Demand, Task, Visit
from fleetlog.simulate.ways import recorded_turns, with_turns
from fleetlog.store.dataset import Dataset
from fleetlog.store.trips import MIN_LOAD_CHANGE

JITTER = 120.0  # A drawn task comes this much earlier or later than the recorded one at most [s]
DAY = 86_400.0
NEARBY = 3600.0  # What was done within this time of day is drawn first [s]


def carried(stands: Stands, cluster: Ints, names: list[str]) -> list[Task]:
    """Every load that the recording shows: taken up at one place, set down at another by the same truck.

    ``earliest`` is the time of day [s] at which the truck set off to fetch it.  Recorded trucks mostly stood
    on the road, so the way into a bay and out of it counts as time at the place.
    """
    tasks: list[Task] = []
    change, held = stands.after - stands.before, -1
    for i in np.flatnonzero(np.abs(change) > MIN_LOAD_CHANGE).tolist():
        k, held, vehicle = held, i if change[i] > 0.0 else -1, stands.vehicle[i]
        if held >= 0 or k < 0 or stands.vehicle[k] != vehicle:
            continue
        a, b = int(cluster[k]), int(cluster[i])
        if a >= 0 and b >= 0 and names[a] != names[b]:
            known = k > 0 and stands.vehicle[k - 1] == vehicle
            day = float((stands.end[k - 1] if known else stands.start[k]) % 86_400_000_000) * 1e-6
            dwell, height = ((float(v[k]), float(v[i])) for v in (stands.dwell, stands.height))
            tasks.append(Task(None, names[a], names[b], float(change[k]), day, dwell, height, True))
    return tasks


def demand_like(
    carried_tasks: list[Task], hours: Floats, start_of_day: float, duration: float, share: float,
    truck: Truck, seed: int,
) -> list[Task]:  # fmt: skip
    """Tasks drawn like those of :func:`carried`, for ``duration`` [s] from ``start_of_day`` [s] on.

    Each hour has a Poisson number of tasks: the recorded mean of that hour of day (of the whole recording
    where it was not recorded; ``hours`` (24,) says how many were), times ``share``, trucks over recorded.
    Each is one recorded task within ``JITTER`` of its time of day, so that places, loads, dwells and lulls
    keep their joint distribution; at any time where less of the hour was recorded than is simulated.
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


def recorded_hours(dataset: Dataset) -> Floats:
    """(24,) how many hours of recording fall on each hour of the day."""
    start, end = (np.datetime64(str(dataset.meta[k]).removesuffix("Z"), "us") for k in ("start", "end"))
    at, last = (float(t.astype(np.int64)) * 1e-6 for t in (start, end))
    hour = np.arange(at // 3600.0, -(-last // 3600.0) + 1.0)
    hours = np.diff(np.clip(3600.0 * hour, at, last)) / 3600.0
    return np.asarray(np.bincount(hour[:-1].astype(int) % 24, hours, 24), dtype=np.float64)


def like(
    dataset: Dataset, site: Site, truck: Truck, vehicles: int, start: int, duration: float, seed: int,
    same: bool = False,
) -> tuple[Site, Demand, list[str]]:  # fmt: skip
    """The site with a recording's places, demand like its own, and notes.

    The ``same`` fleet goes from place to place as the recorded one; any other shares out tasks like its.
    """
    stands = find_stands(dataset)
    cluster = clusters(stands)
    table = place_table(stands, cluster)
    site, names = mined_site(site, table)
    site = with_room(site, stands, cluster, names)
    turns = recorded_turns(dataset, site.roads())
    site = replace(site, network=with_turns(site.roads(), turns))
    kinds = ", ".join(f"{n} {k}" for k, n in table.kind.value_counts().items())
    notes = [f"{len(table)} places found from {len(stands)} recorded stops ({kinds})"]
    if turns:
        notes.append(f"trucks turn round at the end of {count(len(turns), 'lane')}, as recorded")
    visits = visits_of(stands, cluster, names, [p.id for p in site.places if p.kind == "charge"])
    if same and any(v.next >= 0 for v in visits):
        notes.append(f"trucks choose their next place as after {count(len(visits), 'recorded visit')}")
        along = recorded_stands(stands, cluster, names)
        return site, Demand(visits=visits, stands=along, endless=False), notes
    known = carried(stands, cluster, names)
    if not known:
        notes.append("the recording shows no load carried between two places: tasks are random")
        return site, Demand(), notes
    day = float(start % 86_400_000_000) * 1e-6
    share = vehicles / max(len(dataset.vehicles), 1)
    tasks = demand_like(known, recorded_hours(dataset), day, duration, share, truck, seed)
    notes.append(f"{len(tasks)} tasks drawn like the {len(known)} recorded ones")
    return site, Demand(tasks, endless=False), notes


def visits_of(stands: Stands, cluster: Ints, names: Sequence[str], apart: Iterable[str]) -> tuple[Visit, ...]:
    """The visits of all trucks, in order of truck and time.

    Stops at the places ``apart`` are none (chargers: trucks charge when they must), nor are those with a load
    that stays on the forks.
    """
    taken = np.where(stands.after > MIN_LOAD_CHANGE, stands.after - stands.before, 0.0)
    taken = np.where((stands.before > MIN_LOAD_CHANGE) & (taken <= 0.0), -stands.before, taken)
    carried = (stands.before > MIN_LOAD_CHANGE) & (stands.after > MIN_LOAD_CHANGE)
    left_out = np.isin(cluster, [k for k, name in enumerate(names) if name in set(apart)])
    kept = np.flatnonzero((cluster >= 0) & ~carried & ~left_out)
    same = np.append(np.diff(stands.vehicle[kept]) == 0, False)
    begin = (stands.start[kept] * 1e-6) % DAY
    return tuple(
        Visit(
            names[cluster[i]], float(begin[k]), float(stands.dwell[i]), float(stands.height[i]),
            float(taken[i]), k + 1 if same[k] else -1,
        )
        for k, i in enumerate(kept)
    )  # fmt: skip


def at_places(visits: Sequence[Visit], known: Collection[str]) -> tuple[Visit, ...]:
    """The visits at ``known`` places; after one that is left out comes none."""
    kept = [k for k, visit in enumerate(visits) if visit.place in known]
    number = {k: i for i, k in enumerate(kept)}
    return tuple(replace(visits[k], next=number.get(visits[k].next, -1)) for k in kept)


class Itineraries:
    """Draws the next visit of each truck from what recorded trucks did next at the same place, with as much
    on the forks.

    Of those that are possible now it is one that was drawn least, so that every recorded trip is driven
    about equally often; first of those at this time of day.  ``of`` (V,) is the visit of each truck.
    """

    def __init__(self, visits: Sequence[Visit], trucks: int, seed: int, start: float) -> None:
        self.visits, self.start = visits, start
        self.of = np.full(trucks, -1, np.int64)
        self._rng = np.random.Generator(np.random.PCG64([seed, 7]))
        self._begin, self._drawn = np.array([v.begin for v in visits]), np.zeros(len(visits), np.int64)
        self._after = defaultdict[tuple[str, bool], list[int]](list)
        self._any = {
            laden: [k for k, v in enumerate(visits) if (v.taken < 0.0) == laden] for laden in (False, True)
        }
        for visit in visits:
            if visit.next >= 0 and (visits[visit.next].taken < 0.0) == visit.loads:
                self._after[visit.place, visit.loads].append(visit.next)

    def first(self, v: int, is_open: Callable[[str], bool]) -> Visit | None:
        """Where truck ``v`` begins, and how long it still stays there."""
        empty = [k for k in self._any[False] if not self.visits[k].loads]
        return self._draw(v, 0.0, empty, is_open)

    def next(self, v: int, now: float, is_open: Callable[[str], bool]) -> Visit | None:
        """The next visit of truck ``v``, ``now`` [s] after the start; None while no place of one is open."""
        return self._draw(v, now, self._options(v), is_open)

    def places(self, v: int) -> set[str]:
        """Where truck ``v`` may go next."""
        return {self.visits[k].place for k in self._options(v)}

    def _options(self, v: int) -> list[int]:
        here = self.visits[self.of[v]] if self.of[v] >= 0 else None
        found = self._after[here.place, here.loads] if here is not None else []
        return found or self._any[here is not None and here.loads]

    def _draw(self, v: int, now: float, options: list[int], is_open: Callable[[str], bool]) -> Visit | None:
        possible = np.array([k for k in options if is_open(self.visits[k].place)], dtype=np.int64)
        if not len(possible):
            return None
        gap = np.abs(self._begin[possible] - (self.start + now) % DAY)
        far, chance = np.minimum(gap, DAY - gap) > NEARBY, self._rng.random(len(possible))
        drawn = int(possible[np.lexsort((chance, self._drawn[possible], far))[0]])
        self.of[v] = drawn
        self._drawn[drawn] += 1
        return self.visits[drawn]

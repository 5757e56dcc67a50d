"""A fleet like a recording's: who carried what when, what trucks did next, how they were driven."""

import itertools
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fleetlog.core.arrays import Floats, Ints, Mask
from fleetlog.core.motion import Motion
from fleetlog.core.site import Site
from fleetlog.core.truck import Truck
from fleetlog.core.words import count
from fleetlog.physics.motion import measured_channels, reconstruct
from fleetlog.physics.motion.legs import speed_limits
from fleetlog.simulate.doors import ALONG, Stand, recorded_stands
from fleetlog.simulate.places import Stands, clusters, find_stands, mined_site, place_table, with_room
from fleetlog.simulate.state import DRIVER, PLAN
from fleetlog.simulate.tasks import Demand, Task, Visit
from fleetlog.simulate.track import SWING, Track, build_track
from fleetlog.simulate.ways import recorded_turns, with_turns
from fleetlog.store.dataset import Dataset
from fleetlog.store.trips import MIN_LOAD_CHANGE, STANDING_SPEED, runs

JITTER = 120.0  # A drawn task comes this much earlier or later than the recorded one at most [s]
DAY = 86_400.0
NEARBY = 3600.0  # What was done within this time of day is drawn first [s]
LEAST = 30.0  # Seconds of cruising, of speeding up, of braking, of turning that tell what a driver does there
STEADY, CHANGES = 0.08, 0.15  # Below the first a truck keeps its speed, above the second it changes it [m/s2]
STRAIGHT, TURNS = 0.03, 0.1  # Less curved roads are straight; on more curved ones a truck turns [1/m]
NEAR, FEW = 2.0, 10
"""A truck is slowest within so many seconds of where it goes over to the next edge; turns that are enough."""
CLOSE, LATE = 2.0, 10.0
"""Who stands at most twice so far behind another [m] stands for it; so long after it it may set off [s]."""
SHARE = 0.6  # A little above the middle: rows once a second round off the highest values
MOST = 16  # Drivers that are told apart; of more, neighbours in speed are one


def carried(stands: Stands, cluster: Ints, names: list[str]) -> list[Task]:
    """Every load that the recording shows: taken up at one place, set down at another by the same truck.
    ``earliest``: the time of day [s] when it set off for it. Ways into bays count as time at the place."""
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
    keep their joint distribution; at any time where less of the hour was recorded than is simulated."""
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


def like(
    dataset: Dataset, site: Site, truck: Truck, vehicles: int, start: int, duration: float, seed: int,
    same: bool = False,
) -> tuple[Site, Demand, list[str]]:  # fmt: skip
    """The site with a recording's places, demand like its own (of the ``same`` fleet its ways), and notes."""
    stands = find_stands(dataset)
    cluster = clusters(stands, loads=True)
    table = place_table(stands, cluster)
    site, names = mined_site(site, table)
    along = dict[str, Stand]()
    if same:
        site, cluster, names, along = recorded_stands(site, stands, cluster, names)
    site = with_room(site, stands, cluster, names)
    turns = recorded_turns(dataset, site.roads())
    site = replace(site, network=with_turns(site.roads(), turns))
    kinds = ", ".join(f"{n} {k}" for k, n in table.kind.value_counts().items())
    found, stops, asked = count(len(table), "place"), count(len(stands), "recorded stop"), list[str]()
    notes = [f"{found} found from {stops} ({kinds})"]
    if turns:
        notes.append(f"trucks turn round at the end of {count(len(turns), 'lane')}, as recorded")
    loads = (dataset.read(v, columns=("payload",)).floats("payload") for v in dataset.vehicles)
    told, trucks = sum(bool(np.isfinite(load).any()) for load in loads), len(dataset.vehicles)
    if 0 < told < trucks:
        what = "they carry none here" if same else "they are taken to carry as much as the others"
        asked.append(f"{trucks - told} of {trucks} trucks log no loads: {what}")
    chargers = [p.id for p in site.places if p.kind == "charge"]
    visits = visits_of(stands, cluster, names, chargers, driven_edges(dataset, stands))
    if same and any(v.next >= 0 for v in visits):
        asked.append(f"trucks go on from a place as after {count(len(visits), 'recorded visit')}")
        return site, Demand(visits=visits, stands=along, endless=False, notes=asked), notes
    if not (known := carried(stands, cluster, names)):
        asked.append("the recording shows no load carried between two places: tasks are random")
        return site, Demand(notes=asked), notes
    day = float(start % 86_400_000_000) * 1e-6
    share = vehicles / max(told, 1)
    at, last = (t * 1e-6 for t in dataset.span or (0, 0))
    hour = np.arange(at // 3600.0, -(-last // 3600.0) + 1.0)
    lasted = np.diff(np.clip(3600.0 * hour, at, last)) / 3600.0
    hours = np.bincount(hour[:-1].astype(int) % 24, lasted, 24).astype(np.float64)
    tasks = demand_like(known, hours, day, duration, share, truck, seed)
    asked.append(f"{len(tasks):,} tasks drawn like the {len(known):,} recorded ones")
    return site, Demand(tasks, endless=False, notes=asked), notes


def visits_of(
    stands: Stands, cluster: Ints, names: Sequence[str], apart: Iterable[str], ways: list[tuple[str, ...]]
) -> tuple[Visit, ...]:
    """The visits of all trucks, by truck and time; none ``apart`` (chargers), none with a load that stays."""
    taken = np.where(stands.after > MIN_LOAD_CHANGE, stands.after - stands.before, 0.0)
    taken = np.where((stands.before > MIN_LOAD_CHANGE) & (taken <= 0.0), -stands.before, taken)
    carried = (stands.before > MIN_LOAD_CHANGE) & (stands.after > MIN_LOAD_CHANGE)
    left_out = np.isin(cluster, [k for k, name in enumerate(names) if name in set(apart)])
    kept = np.flatnonzero((cluster >= 0) & ~carried & ~left_out)
    same = np.append(np.diff(stands.vehicle[kept]) == 0, False)[: len(kept)]
    onward = np.where(same, np.arange(1, len(kept) + 1), -1).tolist()
    begin, before = (stands.start[kept] * 1e-6) % DAY, np.append(-1, kept[:-1]) + 1
    numbers = np.array([begin, stands.dwell[kept], stands.height[kept], taken[kept]]).tolist()
    over = (tuple(itertools.chain(*ways[a : i + 1])) for a, i in zip(before, kept, strict=False))
    return tuple(map(Visit, [names[k] for k in cluster[kept]], *numbers, onward, over))


def driven_edges(dataset: Dataset, stands: Stands) -> list[tuple[str, ...]]:
    """Of every stand the edges over which the truck came from the one before."""
    out: list[tuple[str, ...]] = [()] * len(stands)
    for k, vehicle in enumerate(dataset.vehicles):
        t = dataset.read(vehicle, columns=("edge_id",))
        edge, mine = t.labels("edge_id"), np.flatnonzero(stands.vehicle == k).tolist()
        for before, here in itertools.pairwise(mine):
            low, high = np.searchsorted(t.time, (stands.end[before], stands.start[here]))
            out[here] = tuple(edge.names[c] for c in np.unique(edge.codes[low:high]) if c >= 0)
    return out


def at_places(visits: Sequence[Visit], known: Collection[str]) -> tuple[Visit, ...]:
    """The visits at ``known`` places; after one that is left out comes none."""
    kept = [k for k, visit in enumerate(visits) if visit.place in known]
    number = {k: i for i, k in enumerate(kept)}
    return tuple(replace(visits[k], next=number.get(visits[k].next, -1)) for k in kept)


class Itineraries:
    """Draws a truck's next visit from those that recorded trucks made next, as laden, from the same place.
    The possible one that was drawn least, so that every recorded trip is driven about equally often; first
    those at this time of day. ``of`` (V,) is the visit of each truck."""

    def __init__(self, visits: Sequence[Visit], trucks: int, seed: int, start: float) -> None:
        self.visits, self.start = visits, start
        self.of = np.full(trucks, -1, np.int64)
        self._rng = np.random.Generator(np.random.PCG64([seed, 7]))
        self._begin, self._drawn = np.array([v.begin for v in visits]), np.zeros(len(visits), np.int64)
        self._after = defaultdict[tuple[str, bool], list[int]](list)
        drops = [v.taken < 0.0 for v in visits]
        self._any = {laden: [k for k, d in enumerate(drops) if d == laden] for laden in (False, True)}
        for visit in visits:
            if visit.next >= 0 and drops[visit.next] == (visit.taken > 0.0):
                self._after[visit.place, visit.taken > 0.0].append(visit.next)

    def first(self, v: int, is_open: Callable[[str], bool]) -> Visit | None:
        """Where truck ``v`` begins, and how long it still stays there."""
        return self._draw(v, 0.0, [k for k in self._any[False] if self.visits[k].taken <= 0.0], is_open)

    def next(self, v: int, now: float, is_open: Callable[[str], bool]) -> Visit | None:
        """The next visit of truck ``v``, ``now`` [s] after the start; None while no place of one is open."""
        return self._draw(v, now, self._options(v), is_open)

    def places(self, v: int) -> set[str]:
        """Where truck ``v`` may go next."""
        return {self.visits[k].place for k in self._options(v)}

    def _options(self, v: int) -> list[int]:
        here = self.visits[self.of[v]] if self.of[v] >= 0 else None
        found = self._after[here.place, here.taken > 0.0] if here is not None else []
        return found or self._any[here is not None and here.taken > 0.0]

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


def recorded_drivers(dataset: Dataset, truck: Truck) -> tuple[tuple[Truck, ...], list[str]]:
    """The truck as each vehicle of a recording was driven; and what the recording does not tell."""
    track = build_track(dataset.site.roads(), truck, dataset.site.traffic)
    found = [truck] * len(dataset.vehicles)
    for k, vehicle in enumerate(dataset.vehicles):
        if len(rows := measured_channels(dataset.read(vehicle), dataset.meta)) > 1:
            motion = reconstruct(rows, dataset.site.network, truck).motion
            found[k] = driven(motion, dataset.site, truck, track)
    late = delays(dataset, truck.chassis.length)
    every = np.concatenate(late)
    for k, mine in enumerate(late if len(every) >= FEW else ()):
        typical = float(np.median(mine if len(mine) >= FEW else every))
        found[k] = found[k].with_value("drive.reaction", round(typical, 2))
    by_speed = np.argsort([t.drive.speed_factor for t in found], kind="stable")
    for group in np.array_split(by_speed, min(len(found), MOST)):
        drives = [found[k].drive for k in group]
        mean: dict[str, Any] = {n: float(np.mean([getattr(d, n) for d in drives])) for n in DRIVER}
        for k in group:
            found[k] = replace(truck, drive=replace(truck.drive, **mean))
    untold = f"reaction times of drivers are unknown (starts right behind a truck: {len(every)})"
    return tuple(found), [untold] if len(every) < FEW else []


def delays(dataset: Dataset, length: float) -> list[Floats]:
    """How long [s] each vehicle stood on after the one of a ``length`` [m] right before it had set off."""
    found, out = list[list[float]](), [list[float]() for _ in dataset.vehicles]
    for v, vehicle in enumerate(dataset.vehicles):
        t = dataset.read(vehicle, columns=("x", "y", "heading", "speed"))
        time, speed = t.time * 1e-6, t.floats("speed")
        k = np.array([end for begin, end in runs(speed <= STANDING_SPEED) if end - begin > 1], np.int64)
        k = k[k + 1 < len(t)]
        # It had gathered its first speed as it gathers the next.
        rate = np.maximum(speed[k + 1] - speed[k], 1e-3) / (time[k + 1] - time[k])
        at, where = np.maximum(time[k] - speed[k] / rate, time[k - 1]), ("x", "y", "heading")
        found += np.column_stack([at, np.full(len(k), v), *(t.floats(name)[k] for name in where)]).tolist()
    table = np.array(sorted(found)).reshape(-1, 5)
    for at, v, x, y, heading in table:
        earlier = table[slice(*np.searchsorted(table[:, 0], (at - LATE, at)))]
        gap = (earlier[:, 2] - x + 1j * (earlier[:, 3] - y)) * np.exp(-1j * heading)
        leads = (earlier[:, 1] != v) & (np.cos(earlier[:, 4] - heading) > np.cos(ALONG))
        leads &= (np.abs(gap.imag) < 0.5 * length) & (np.abs(gap.real - length - CLOSE) < CLOSE)
        out[int(v)] += (at - earlier[leads, 0][-1:]).tolist()
    return [np.array(late) for late in out]


def driven(motion: Motion, site: Site, truck: Truck, track: Track) -> Truck:
    """The truck with the typical speed, acceleration and braking of a recorded motion."""
    speed, change = motion.speed, motion.acceleration
    limit = np.minimum(speed_limits(site, motion), truck.drive.max_speed)
    straight = (speed > 0.5) & (motion.dt > 0.0) & (np.abs(motion.curvature) < STRAIGHT)
    steady, slow = straight & (np.abs(change) < STEADY), straight & (speed < 0.8 * limit)
    asked = {
        "speed_factor": _typical(speed / limit, steady & (speed > 0.6 * limit), motion.dt),
        "max_acceleration": _typical(change, slow & (change > CHANGES), motion.dt),
        "max_deceleration": _typical(-change / PLAN, slow & (change < -CHANGES), motion.dt),
        "max_lateral_acceleration": _in_turns(motion, track),
    }
    known = {name: value for name, value in asked.items() if value is not None}
    return replace(truck, drive=replace(truck.drive, **known))


def _in_turns(motion: Motion, track: Track) -> float | None:
    """The lateral acceleration [m/s2] that the turns as they are drawn take at the recorded speeds."""
    changes = np.flatnonzero((np.diff(motion.edge) != 0) & (motion.edge[1:] >= 0) & (motion.edge[:-1] >= 0))
    found = []
    for k in changes.tolist():
        piece = track.by_turn.get((int(motion.edge[k]), int(motion.edge[k + 1])), -1)
        near = slice(*np.searchsorted(motion.time, motion.time[k] + np.array([-NEAR, NEAR])))
        if piece >= 0:
            path = track.curvature[track.first[piece] : track.first[piece + 1]]
            bend, turn = float(np.abs(path).max()), abs(float(path.sum()) * track.spacing[piece])
            if bend > TURNS and turn < SWING:
                found.append(float(motion.speed[near].min()) ** 2 * bend)
    # Who has just set off, or waits, is slower than the turn asks for.
    return round(float(np.quantile(found, 0.85)), 3) if len(found) >= FEW else None


def _typical(values: Floats, chosen: Mask, weight: Floats) -> float | None:
    """What was chosen is below this for ``SHARE`` of its time; None where it is too little."""
    if weight[chosen].sum() < LEAST:
        return None
    return round(float(np.quantile(values[chosen], SHARE, weights=weight[chosen], method="inverted_cdf")), 3)

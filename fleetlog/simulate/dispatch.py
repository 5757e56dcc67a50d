"""Who does what next: tasks, places that are free, charging, and trucks that wait for one another."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from fleetlog.core.truck import Truck
from fleetlog.simulate.state import (
    AT_BAY,
    CHARGING,
    DRIVING,
    HANDLING,
    LEAVING,
    PARKED,
    WANTS_OUT,
    Fleet,
    creep_speed,
)
from fleetlog.simulate.taskbook import TaskBook
from fleetlog.simulate.tasks import ENGAGE, Demand, Task, random_dwell, random_height, random_load
from fleetlog.simulate.untangle import Count, Untangler
from fleetlog.simulate.world import World

YIELD = 5.0
"""A truck that waits this long for a place asks whoever stands idle there to leave [s]."""
ASIDE = 30.0
"""A truck that waits this long for a place, at a place that another truck waits for, makes room itself [s]."""
DUE = 50
"""Due tasks that a truck looks at."""


@dataclass(frozen=True)
class Policy:
    """When trucks charge: below ``low`` always, below ``chance`` when there is nothing else to do, up to ``full``."""

    low: float = 0.3
    chance: float = 0.8
    full: float = 0.95


@dataclass
class Job:
    """What a truck is about: a stage, its task and where it goes."""

    stage: str = "idle"
    task: Task | None = None
    goal: int = -1
    since: float = 0.0


class Dispatcher(Untangler):
    """Takes over whenever a truck needs attention; once a second."""

    def __init__(
        self,
        world: World,
        fleet: Fleet,
        names: list[str],
        demand: Demand,
        policy: Policy,
        rng: np.random.Generator,
    ) -> None:
        super().__init__(world, fleet)
        self.names, self.demand, self.policy, self.rng = names, demand, policy, rng
        self.truck: Truck = world.truck
        self.jobs = [Job() for _ in names]
        self.book = TaskBook(names)
        self.home = np.full(len(names), -1, np.int64)
        self.owner = np.full(len(world.bays), -1, np.int64)
        self.queue: deque[int] = deque()
        self.pending: list[Task] = list(demand.given)
        self.given = 0
        self._due: list[Task] = []
        self._wanted: list[tuple[int, list[int]]] = []
        self._wanted_now: list[tuple[int, list[int]]] = []
        self.bays_of = world.by_place
        kinds = [b.place.kind for b in world.bays]
        self.kind = np.array(kinds)
        self.of_kind = {k: self.kind == k for k in ("pick", "drop")}
        self.work = self.of_kind["pick"] | self.of_kind["drop"]
        if not self.work.any():
            self.work = self.kind != "charge"
        self.where = np.array([b.path[-1, :2] for b in world.bays])
        self.soc = np.ones(len(names))
        creep, drive = creep_speed(self.truck), self.truck.drive
        change = 0.5 * creep * (1.0 / drive.max_acceleration + 1.0 / drive.max_deceleration)
        self.spur_time = np.array([d.length for d in world.doors]) / creep + change

    def settle(self) -> None:
        """Put every truck into a bay: parking places first, then any but chargers, in the site's order."""
        order = [b for b in range(len(self.kind)) if self.kind[b] == "park"]
        order += [b for b in range(len(self.kind)) if self.kind[b] not in ("park", "charge")]
        for v, b in enumerate(order[: len(self.names)]):
            self.fleet.door[v] = self.home[v] = b
            self.fleet.spur[v] = self.world.bays[b].length
            self.owner[b] = v

    def tick(self, now: float) -> None:
        """One second's decisions."""
        f = self.fleet
        for v in np.flatnonzero(f.attention):
            f.attention[v] = False
            if f.mode[v] == DRIVING:
                self.owner[self.home[v]] = -1
            elif f.mode[v] == PARKED:
                self._parked(int(v), now)
        while self.given < len(self.pending) and self.pending[self.given].earliest <= now:
            self._due.append(self.pending[self.given])
            self.book.give(self.pending[self.given])
            self.given += 1
            self.count.tasks_given += 1
        self._charging(now)
        self._wanted, self._wanted_now = self._wanted_now, []
        # Who has waited longest chooses first, so that nobody waits for ever for a place.
        for u in sorted(np.flatnonzero(f.mode == PARKED), key=lambda u: (self.jobs[u].since, u)):
            self._idle(int(u), now)
        if round(now) % 5 == 0:
            self._untangle(now)

    # -- stages of a job

    def _parked(self, v: int, now: float) -> None:
        job, f = self.jobs[v], self.fleet
        if job.stage in ("fetch", "bring", "charge", "park"):
            self.home[v] = job.goal
        job.since = now
        if job.stage == "fetch":
            assert job.task is not None
            self._handle(v, now, job.task.payload, 0)
            job.stage = "picking"
        elif job.stage == "bring":
            self._handle(v, now, 0.0, 1)
            job.stage = "dropping"
        elif job.stage == "picking":
            job.stage = "loaded"
            self.book.picked(v, now)
        elif job.stage == "dropping":
            self.count.tasks_done += 1
            self.book.dropped(v, now)
            job.task, job.stage = None, "idle"
            job.since = now + float(self.rng.exponential(self.demand.pause)) if self.demand.endless else now
        elif job.stage == "charge":
            f.mode[v] = CHARGING
            self.count.charges += 1
        elif job.stage == "park":
            begun = "loaded" if f.load[v] > 0.0 else "assigned"
            job.stage = begun if job.task is not None else "idle"

    def _handle(self, v: int, now: float, after: float, which: int) -> None:
        f, lift, task = self.fleet, self.truck.lift, self.jobs[v].task
        assert task is not None
        height = task.height[which]
        times = (height / lift.raise_speed, ENGAGE, height / lift.lower_speed)
        f.hand_start[v], f.hand_height[v], f.hand_times[v] = now, height, times
        f.hand_before[v], f.hand_after[v] = f.load[v], after
        spurs = 2.0 * self.spur_time[f.door[v]] if task.on_road else 0.0
        f.until[v] = now + max(task.dwell[which] - spurs, sum(times))
        f.mode[v] = HANDLING

    def _idle(self, v: int, now: float) -> None:
        """What a truck that stands in a bay with nothing running does next."""
        job = self.jobs[v]
        if self.soc[v] <= 0.0:
            return
        if job.stage == "loaded":
            self._bring(v, now)
        elif job.stage == "assigned":
            self._fetch(v, now)
        elif job.stage == "idle":
            if self.soc[v] < self.policy.low and self._wants_charge(v):
                return
            if now >= job.since and self._new_task(v, now):
                self._fetch(v, now)
            elif job.task is None:
                self._rest(v, now)

    def _new_task(self, v: int, now: float) -> bool:
        job = self.jobs[v]
        task = self._due_task(v, now)
        if task is not None:
            self._due.remove(task)
            job.task, job.stage = task, "assigned"
            self.book.assign(v, task, now)
            return True
        if not self.demand.endless:
            return False
        source = self._free_place("pick")
        if source is None and self.kind[self.home[v]] == "pick":
            source = self.world.bays[int(self.home[v])].place.id
        if source is None:
            return False
        rng = self.rng
        job.task = Task(
            None, source, "", random_load(rng, self.truck), now, (random_dwell(rng), random_dwell(rng)),
            (random_height(rng), random_height(rng)),
        )  # fmt: skip
        job.stage = "assigned"
        self.count.tasks_given += 1
        self.book.give(job.task)
        self.book.assign(v, job.task, now)
        return True

    def _due_task(self, v: int, now: float) -> Task | None:
        """The nearest of the due tasks that this truck can do now, of those that have waited at least half as long as the first."""
        best: tuple[float, Task] | None = None
        patience = 0.0
        for task in self._due[:DUE]:
            if task.vehicle not in (None, self.names[v]):
                continue
            if best is not None and now - task.earliest < patience:
                break
            if not self._open(task.source, v):
                # Who stands idle there does it himself, if he may and can.
                self._send_away(v, self.bays_of[task.source], task.vehicle is None)
                continue
            if self._nearest(task, v):
                cost = min(self._cost(v, b) for b in self.bays_of[task.source] if self.owner[b] in (-1, v))
                patience = patience or 0.5 * (now - task.earliest)
                if best is None or cost < best[0]:
                    best = (cost, task)
        return None if best is None else best[1]

    def _open(self, place: str, v: int) -> bool:
        """Whether a bay of a place is free, or this truck's own."""
        return any(self.owner[b] in (-1, v) for b in self.bays_of[place])

    def _nearest(self, task: Task, v: int) -> bool:
        """Whether no other truck with nothing to do stands nearer to the task's source."""
        if task.vehicle is not None:
            return True
        spot = self.where[self.bays_of[task.source][0]]
        mine = float(np.hypot(*(self.where[self.home[v]] - spot)))
        for u in np.flatnonzero(self.fleet.mode == PARKED):
            if u != v and self.jobs[u].stage == "idle" and self.soc[u] > self.policy.low:
                other = float(np.hypot(*(self.where[self.home[u]] - spot)))
                if (other, u) < (mine, v):
                    return False
        return True

    def _free_place(self, kind: str) -> str | None:
        """An unoccupied place of that kind, at random; any working place where there is none of that kind."""
        able = self.of_kind[kind] & self.work
        if not able.any():
            able = self.work
        spots = np.flatnonzero((self.owner < 0) & able)
        return self.world.bays[int(spots[self.rng.integers(len(spots))])].place.id if len(spots) else None

    def _fetch(self, v: int, now: float) -> None:
        task = self.jobs[v].task
        assert task is not None
        self._to_place(v, task.source, "fetch", now)

    def _bring(self, v: int, now: float) -> None:
        job = self.jobs[v]
        assert job.task is not None
        target = job.task.target or self._free_place("drop")
        if target is not None:
            self._to_place(v, target, "bring", now)
            self.book.heads_for(v, target)
            return
        drops = np.flatnonzero(self.work & self.of_kind["drop"])
        self._wait_for(v, (drops if len(drops) else np.flatnonzero(self.work)).tolist(), now)

    def _to_place(self, v: int, place: str, stage: str, now: float) -> None:
        bays = self.bays_of[place]
        job = self.jobs[v]
        if int(self.home[v]) in bays:
            job.stage, job.goal = stage, int(self.home[v])
            self._parked(v, now)
            return
        free = [b for b in bays if self.owner[b] < 0]
        if free:
            self._go(v, min(free, key=lambda b: self._cost(v, b)), stage)
        else:
            self._wait_for(v, bays, now)

    def _cost(self, v: int, b: int) -> float:
        """Seconds to bay ``b``."""
        way = self.world.ways.between(int(self.home[v]), b)
        return np.inf if way is None else way.cost

    def _wait_for(self, v: int, bays: list[int], now: float) -> None:
        """Stand until one of the bays is free: the idle are asked to leave them; who is in the way of others goes aside."""
        job, here = self.jobs[v], int(self.home[v])
        self._wanted_now.append((v, bays))
        if now - job.since > YIELD:
            self._send_away(v, bays)
        if now - job.since > ASIDE and any(here in w for u, w in self._wanted if u != v):
            b = self._spare_bay(v)
            if b is not None:
                if self.fleet.load[v] <= 0.0 and job.task is not None and job.task.target:
                    # Not begun: somebody else may do it from where it is nearer.
                    self._due.insert(0, job.task)
                    self.book.give_back(v, job.task)
                    job.task = None
                self.count.made_room += 1
                self._go(v, b, "park")

    def _send_away(self, v: int, bays: list[int], only_low: bool = False) -> None:
        """One idle truck leaves one of the bays, unless one is being left; with ``only_low`` one that has to charge."""
        holders = [int(self.owner[b]) for b in bays]
        if any(self.home[u] in bays and self.jobs[u].goal not in bays and self._leaves(u) for u in holders):
            return
        for u in holders:
            idle = self.fleet.mode[u] == PARKED and self.jobs[u].stage == "idle"
            if u == v or not idle or (only_low and self.soc[u] >= self.policy.low):
                continue
            b = self._spare_bay(u)
            if b is not None:
                self.count.made_room += 1
                self._go(u, b, "park")
            return

    def _leaves(self, u: int) -> bool:
        return bool(self.fleet.mode[u] in (WANTS_OUT, LEAVING))

    def _rest(self, v: int, now: float) -> None:
        """Nothing to do: charge if that is worth while, else clear a working place that is not one's own."""
        if self.soc[v] < self.policy.chance and self._wants_charge(v):
            return
        job = self.jobs[v]
        if self.kind[self.home[v]] != "park" and not self.demand.endless and now - job.since > ASIDE:
            b = self._spare_bay(v, only_park=True)
            if b is not None:
                self._go(v, b, "park")

    def _spare_bay(self, v: int, only_park: bool = False) -> int | None:
        free = np.flatnonzero((self.owner < 0) & (self.kind == "park"))
        if not len(free) and not only_park:
            free = np.flatnonzero((self.owner < 0) & (self.kind != "charge"))
        if not len(free):
            return None
        gap = np.hypot(*(self.where[free] - self.where[self.home[v]]).T)
        return int(free[np.argmin(gap)])

    def _go(self, v: int, b: int, stage: str) -> None:
        f, job = self.fleet, self.jobs[v]
        ways, home = self.world.ways, int(self.home[v])
        way = ways.between(home, b, self._closed()) or ways.between(home, b)
        assert way is not None
        self.owner[b] = v
        job.stage, job.goal = stage, b
        self._take(v, way)
        f.mode[v] = WANTS_OUT
        f.waits[v] = np.inf

    # -- charging

    def _wants_charge(self, v: int) -> bool:
        """Queue for a charger; False where the site has none."""
        if not (self.kind == "charge").any():
            return False
        if v not in self.queue:
            self.queue.append(v)
        return True

    def _charging(self, now: float) -> None:
        f = self.fleet
        for v in np.flatnonzero(f.mode == CHARGING):
            busy = bool(self._due) and self.soc[v] >= max(self.policy.chance, self.policy.low)
            if self.soc[v] >= self.policy.full or busy:
                f.mode[v] = PARKED
                self.jobs[v].stage = "idle"
                self.jobs[v].since = now
        free = [int(b) for b in np.flatnonzero((self.kind == "charge") & (self.owner < 0))]
        while self.queue and free:
            first = self.queue.popleft()
            if f.mode[first] != PARKED or self.jobs[first].stage != "idle" or self.soc[first] <= 0.0:
                continue
            gap = [float(np.hypot(*(self.where[b] - self.where[self.home[first]]))) for b in free]
            self._go(first, free.pop(int(np.argmin(gap))), "charge")
        if self.queue and not free:
            self._send_away(self.queue[0], [int(b) for b in np.flatnonzero(self.kind == "charge")])


__all__ = ["AT_BAY", "Count", "Dispatcher", "Policy"]

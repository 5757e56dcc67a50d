"""Who does what next: tasks, places that are free, charging, and trucks that wait for one another."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fleetlog.core.truck import Truck
from fleetlog.errors import InputError, nearest
from fleetlog.simulate.arrays import Floats
from fleetlog.simulate.state import CHARGER, DROP_PLACE, PICK_PLACE, Fleet, Mode, creep_speed
from fleetlog.simulate.taskbook import TaskBook
from fleetlog.simulate.tasks import ENGAGE, Demand, Drawn, Task, TaskStream
from fleetlog.simulate.untangle import Count, Untangler
from fleetlog.simulate.world import World

YIELD = 5.0
"""A truck that waits this long for a place asks whoever stands idle there to leave [s]."""
ASIDE = 30.0
"""A truck that waits this long for a place, at a place that another truck waits for, makes room itself [s]."""
KEPT = 240.0
"""A task that follows another one is kept so long for the truck that did that [s]."""
DUE = 50
"""Due tasks that a truck looks at."""


@dataclass(frozen=True)
class Policy:
    """When trucks charge: below ``low``, when idle below ``chance``, up to ``full``, ``enough`` if tasks wait."""

    low: float = 0.3
    chance: float = 0.8
    full: float = 0.95
    enough: float = 0.8

    @classmethod
    def named(cls, name: str, low: float = 0.3) -> Policy:
        """``opportunity`` charges also when there is nothing else to do, ``threshold`` only below ``low``."""
        known = {"opportunity": cls(low), "threshold": cls(low, chance=low, enough=cls.full)}
        if name not in known:
            raise InputError(f"unknown charging policy {name!r}", do=nearest(name, known))
        return known[name]


@dataclass
class Job:
    """What a truck is about: a stage, its task and where it goes."""

    stage: str = "idle"
    task: Task | None = None
    drawn: Drawn | None = None
    """Where the task was drawn and not given."""
    goal: int = -1
    since: float = 0.0


class Dispatcher(Untangler):
    """Takes over whenever a truck needs attention; once a second."""

    def __init__(
        self, world: World, fleet: Fleet, names: list[str], demand: Demand, policy: Policy, seed: int
    ) -> None:
        super().__init__(world, fleet)
        self.names, self.demand, self.policy = names, demand, policy
        self.truck: Truck = world.truck
        self.jobs = [Job() for _ in names]
        self.book = TaskBook(names)
        self.home = np.full(len(names), -1, np.int64)
        self.done = np.full(len(names), -1, np.int64)
        """(V,) number of the last task that each truck has done."""
        self.owner = np.full(len(world.bays), -1, np.int64)
        self.queue: deque[int] = deque()
        self.pending: list[Task] = list(demand.given)
        self.given = 0
        self._due: list[Task] = []
        self._wanted: list[tuple[int, list[int]]] = []
        self._wanted_now: list[tuple[int, list[int]]] = []
        self.bays_of = world.by_place
        self.places = list(self.bays_of)
        self.place_of = np.array([self.places.index(b.place.id) for b in world.bays])
        self.stream = TaskStream(seed, self.truck, len(self.places), demand.pause)
        self.lacks = np.zeros(len(names), np.int8)
        """(V,) what a truck that stands in a bay waits for: see ``state.PICK_PLACE``."""
        self.wants: dict[int, Sequence[int]] = {}
        """The bays, one of which such a truck waits for."""
        kinds = [b.place.kind for b in world.bays]
        self.kind = np.array(kinds)
        self._blocked: list[Task] = []
        work = np.isin(self.kind, ("pick", "drop"))
        work = work if work.any() else self.kind != "charge"
        self.working = {
            k: np.flatnonzero(work & (self.kind == k) if (self.kind == k).any() else work)
            for k in ("pick", "drop")
        }
        """Bays of the places of either kind; of any working place where there is none of that kind."""
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
        self.lacks[:] = 0
        self.wants.clear()
        for v in np.flatnonzero(f.attention):
            f.attention[v] = False
            if f.mode[v] == Mode.DRIVING:
                self.owner[self.home[v]] = -1
            elif f.mode[v] == Mode.PARKED:
                self._parked(int(v), now)
        while self.given < len(self.pending) and self.pending[self.given].earliest <= now:
            self._due.append(self.pending[self.given])
            self.book.give(self.pending[self.given])
            self.given += 1
            self.count.tasks_given += 1
        self._charging(now)
        self._wanted, self._wanted_now = self._wanted_now, []
        self._blocked = []
        # Who has waited longest chooses first, so that nobody waits for ever for a place.
        for u in sorted(np.flatnonzero(f.mode == Mode.PARKED), key=lambda u: (self.jobs[u].since, u)):
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
            self.done[v] = -1 if job.task is None else job.task.number
            job.since = now + (job.drawn.pause if job.drawn is not None else 0.0)
            job.task, job.drawn, job.stage = None, None, "idle"
        elif job.stage == "charge":
            f.mode[v] = Mode.CHARGING
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
        f.mode[v] = Mode.HANDLING

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
        picks = self.working["pick"]
        if self.kind[self.home[v]] != "pick" and (self.owner[picks] >= 0).all():
            self._lack(v, PICK_PLACE, picks.tolist())
            return False
        job.drawn = self.stream.draw(now)
        source = self._free_place("pick", job.drawn.ranks) or self.places[self.place_of[self.home[v]]]
        job.task, job.stage = replace(job.drawn.task, source=source), "assigned"
        self.count.tasks_given += 1
        self.book.give(job.task)
        self.book.assign(v, job.task, now)
        return True

    def _due_task(self, v: int, now: float) -> Task | None:
        """The due task that this truck can do now and whose start is nearest, of those that have waited half as long as the first."""
        mine = next((t for t in self._due if self._follows(t, v) and self._open(t.source, v)), None)
        if mine is not None:
            return mine
        best: tuple[float, Task] | None = None
        blocked: Task | None = None
        patience = 0.0
        for task in self._due[:DUE]:
            kept = task.after >= 0 and now - task.earliest < KEPT
            if task.vehicle not in (None, self.names[v]) or kept:
                continue
            if best is not None and now - task.earliest < patience:
                break
            if not self._open(task.source, v):
                # Who stands idle there does it himself, if he may and can.
                self._send_away(v, self.bays_of[task.source], task.vehicle is None)
                if blocked is None and not any(task is other for other in self._blocked):
                    blocked = task
                continue
            if self._nearest(task, v):
                cost = min(self._cost(v, b) for b in self._start(task))
                patience = patience or 0.5 * (now - task.earliest)
                if best is None or cost < best[0]:
                    best = (cost, task)
        if best is None and blocked is not None:
            # One truck waits for each task whose source is taken; the others have nothing to do.
            self._blocked.append(blocked)
            self._lack(v, PICK_PLACE, self.bays_of[blocked.source])
        return None if best is None else best[1]

    def _follows(self, task: Task, v: int) -> bool:
        """Whether a truck's last task was the one that this task follows."""
        return task.after >= 0 and task.after == self.done[v]

    def _lack(self, v: int, what: int, bays: Sequence[int]) -> None:
        self.lacks[v], self.wants[v] = what, bays

    def _open(self, place: str, v: int) -> bool:
        """Whether a bay of a place is free, or this truck's own."""
        return any(self.owner[b] in (-1, v) for b in self.bays_of[place])

    def _start(self, task: Task) -> list[int]:
        """Bays of the place near which a truck takes a task: where the recorded truck set off, else the source."""
        return self.bays_of.get(task.origin or task.source) or self.bays_of[task.source]

    def _nearest(self, task: Task, v: int) -> bool:
        """Whether no other truck with nothing to do stands nearer to where the task is begun from."""
        if task.vehicle is not None:
            return True
        spot = self.where[self._start(task)[0]]
        mine = float(np.hypot(*(self.where[self.home[v]] - spot)))
        for u in np.flatnonzero(self.fleet.mode == Mode.PARKED):
            if u != v and self.jobs[u].stage == "idle" and self.soc[u] > self.policy.low:
                other = float(np.hypot(*(self.where[self.home[u]] - spot)))
                if (other, u) < (mine, v):
                    return False
        return True

    def _free_place(self, kind: str, ranks: Floats) -> str | None:
        """The unoccupied place of that kind that ranks lowest."""
        bays = self.working[kind]
        free = np.unique(self.place_of[bays[self.owner[bays] < 0]])
        return self.places[int(free[np.argmin(ranks[free])])] if len(free) else None

    def _fetch(self, v: int, now: float) -> None:
        task = self.jobs[v].task
        assert task is not None
        self._to_place(v, task.source, "fetch", now)

    def _bring(self, v: int, now: float) -> None:
        job = self.jobs[v]
        assert job.task is not None
        ranks = np.zeros(len(self.places)) if job.drawn is None else job.drawn.ranks
        target = job.task.target or self._free_place("drop", ranks)
        if target is not None:
            self._to_place(v, target, "bring", now)
            self.book.heads_for(v, target)
            return
        self._wait_for(v, self.working["drop"].tolist(), now)

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
        self._lack(v, DROP_PLACE if self.fleet.load[v] > 0.0 else PICK_PLACE, bays)
        if now - job.since > YIELD:
            self._send_away(v, bays)
        if now - job.since > ASIDE and any(here in w for u, w in self._wanted if u != v):
            b = self._spare_bay(v)
            if b is not None:
                if self.fleet.load[v] <= 0.0 and job.task is not None and job.task.target:
                    # Not begun: somebody else may do it from where it is nearer.
                    self._due.insert(0, job.task)
                    self.book.give_back(v, job.task)
                    job.task, job.drawn = None, None
                self.count.made_room += 1
                self._go(v, b, "park")

    def _send_away(self, v: int, bays: list[int], only_low: bool = False) -> None:
        """One idle truck leaves one of the bays, unless one is being left; with ``only_low`` one that has to charge."""
        holders = [int(self.owner[b]) for b in bays]
        if any(self.home[u] in bays and self.jobs[u].goal not in bays and self._leaves(u) for u in holders):
            return
        for u in holders:
            idle = self.fleet.mode[u] == Mode.PARKED and self.jobs[u].stage == "idle"
            if u == v or not idle or (only_low and self.soc[u] >= self.policy.low):
                continue
            b = self._spare_bay(u)
            if b is not None:
                self.count.made_room += 1
                self._go(u, b, "park")
            return

    def _leaves(self, u: int) -> bool:
        return bool(self.fleet.mode[u] in (Mode.WANTS_OUT, Mode.LEAVING))

    def _rest(self, v: int, now: float) -> None:
        """Nothing to do: charge if that is worth while, else clear a working place that is not one's own."""
        if self.soc[v] < self.policy.chance and self._wants_charge(v):
            return
        job = self.jobs[v]
        stays = self.demand.endless or self.demand.stay or self.kind[self.home[v]] == "park"
        if not stays and now - job.since > ASIDE:
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
        self.lacks[v] = 0
        self.wants.pop(v, None)
        job.stage, job.goal = stage, b
        self._take(v, way)
        f.mode[v] = Mode.WANTS_OUT
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
        for v in np.flatnonzero(f.mode == Mode.CHARGING):
            busy = bool(self._due) and self.soc[v] >= max(self.policy.enough, self.policy.low)
            if self.soc[v] >= self.policy.full or busy:
                f.mode[v] = Mode.PARKED
                self.jobs[v].stage = "idle"
                self.jobs[v].since = now
        chargers: list[int] = np.flatnonzero(self.kind == "charge").tolist()
        free = [b for b in chargers if self.owner[b] < 0]
        while self.queue and free:
            first = self.queue.popleft()
            if f.mode[first] != Mode.PARKED or self.jobs[first].stage != "idle" or self.soc[first] <= 0.0:
                continue
            gap = [float(np.hypot(*(self.where[b] - self.where[self.home[first]]))) for b in free]
            self._go(first, free.pop(int(np.argmin(gap))), "charge")
        if self.queue and not free:
            self._send_away(self.queue[0], chargers)
        for u in self.queue:
            # Who could go on does the next task; only who must charge waits.
            if f.mode[u] == Mode.PARKED and self.soc[u] < self.policy.low:
                self._lack(u, CHARGER, chargers)


__all__ = ["Count", "Dispatcher", "Policy"]

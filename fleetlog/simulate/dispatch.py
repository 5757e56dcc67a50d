"""Who does what next: tasks, and places that are free for them."""

from collections import deque
from dataclasses import replace

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.physics.cycles import run
from fleetlog.simulate.demand import Itineraries
from fleetlog.simulate.occupancy import Occupancy, Policy
from fleetlog.simulate.state import DROP_PLACE, PICK_PLACE, Fleet, Mode, creep_speed
from fleetlog.simulate.tasks import ENGAGE, Demand, Task, TaskBook, Visit, endless_tasks
from fleetlog.simulate.world import World

YIELD = 5.0  # A truck that waits this long for a place asks whoever stands idle there to leave [s]
ASIDE = 30.0  # A truck that waits this long for a place, where another wants to be, makes room itself [s]
DUE = 50  # Due tasks that a truck looks at


def spur_times(world: World) -> Floats:
    """(D,) seconds on every spur, from rest to rest."""
    slow = min(world.trucks.kinds, key=creep_speed)
    pace = creep_speed(slow), slow.drive.max_acceleration, slow.drive.max_deceleration
    return np.array([sum(piece.duration for piece in run(d.length, *pace)) for d in world.doors])


class Dispatcher(Occupancy):
    """Takes over whenever a truck needs attention, once a second."""

    def __init__(
        self, world: World, fleet: Fleet, names: list[str], demand: Demand, policy: Policy, seed: int,
        start: float = 0.0,
    ) -> None:  # fmt: skip
        super().__init__(world, fleet, policy)
        self.names, self.demand, self.trucks, self.book = names, demand, world.trucks, TaskBook(names)
        self.pending, self.start, self.resting = deque(demand.given), start, False
        self._due: list[Task] = []
        self._blocked: list[Task] = []
        self._wanted: list[tuple[int, list[int]]] = []
        self._wanted_now: list[tuple[int, list[int]]] = []
        self.stream = endless_tasks(seed, world.truck, len(self.places), demand.pause)
        times = spur_times(world)
        ways_in = enumerate(world.ways.of_bay)
        spurs = [0.0 if world.doors[b].passed else times[b] + times[d].max() for b, d in ways_in]
        self.manoeuvre = np.array(spurs)  # (B,) seconds that the ways into a bay and out of it take
        self.itineraries = Itineraries(demand.visits, len(names), seed, start) if demand.visits else None
        self.settle(self._first)

    def _first(self, v: int) -> str | None:
        """The place where a truck begins."""
        visit = self.itineraries.first(v, lambda place: self._open(place, v)) if self.itineraries else None
        if visit is None:
            return None
        self.jobs[v].stage, self.jobs[v].since = "staying", visit.dwell
        return visit.place

    def tick(self, now: float) -> None:
        """One second's decisions."""
        f = self.fleet
        self.resting = bool(self.world.site.breaks) and self.world.site.on_break(self.start + now)
        self.lacks[:] = 0
        self.wants.clear()
        for v in np.flatnonzero(f.attention).tolist():
            f.attention[v] = False
            if f.mode[v] == Mode.DRIVING:
                self.owner[self.home[v]] = -1
            elif f.mode[v] == Mode.PARKED:
                self._parked(v, now)
        while self.pending and self.pending[0].earliest <= now:
            self._due.append(self.pending.popleft())
            self.book.give(self._due[-1])
        self._charging(now, (bool(self._due) or self.demand.endless) and not self.resting)
        self._wanted, self._wanted_now, self._blocked = self._wanted_now, [], []
        # Who has waited longest chooses first, so that nobody waits for ever for a place.
        parked: list[int] = np.flatnonzero(f.mode == Mode.PARKED).tolist()
        for u in sorted(parked, key=lambda u: (self.jobs[u].since, u)):
            self._next(u, now)
        if round(now) % 5 == 0:
            self._untangle(now)

    # -- stages of a job

    def _parked(self, v: int, now: float) -> None:
        """What a truck does that has come to its bay, or is done there."""
        job, f = self.jobs[v], self.fleet
        if job.stage in ("fetch", "bring", "charge", "park", "visit"):
            self.home[v] = job.goal
        job.since = now
        if job.stage in ("fetch", "bring"):
            self._handle(v, now, bring=job.stage == "bring")
        elif job.stage == "picking":
            job.stage = "loaded"
            self.book.note(v, status="loaded", picked=now)
        elif job.stage == "dropping":
            self.book.note(v, status="done", dropped=now)
            job.since = now + (job.task.pause if job.task is not None else 0.0)
            job.task, job.stage = None, "idle"
        elif job.stage == "charge":
            f.mode[v] = Mode.CHARGING
            self.count.charges += 1
        elif job.stage == "visit":
            job.stage, job.since = "staying", now + max(job.stay - self.manoeuvre[self.home[v]], 0.0)
        elif job.stage == "park":
            job.stage = ("loaded" if f.load[v] > 0.0 else "assigned") if job.task is not None else "idle"

    def _handle(self, v: int, now: float, bring: bool) -> None:
        """Take the load, or set it down."""
        f, lift, job = self.fleet, self.trucks[v].lift, self.jobs[v]
        task = job.task
        assert task is not None
        job.stage = "dropping" if bring else "picking"
        height = task.height[bring]
        times = (height / lift.raise_speed, ENGAGE, height / lift.lower_speed)
        f.hand_start[v], f.hand_height[v], f.hand_times[v] = now, height, times
        f.hand_before[v], f.hand_after[v] = f.load[v], 0.0 if bring else task.payload
        spurs = self.manoeuvre[self.home[v]] if task.on_road else 0.0
        f.until[v] = now + max(task.dwell[bring] - spurs, sum(times))
        f.mode[v] = Mode.HANDLING

    def _next(self, v: int, now: float) -> None:
        """What a truck that stands in a bay with nothing running does next."""
        job = self.jobs[v]
        if self.soc[v] <= 0.0:
            return
        if job.stage == "staying" and now >= job.since:
            job.stage = "idle"
        if job.stage == "idle":
            if self.soc[v] < self.policy.low and self._wants_charge(v):
                return
            if self.resting:
                self._rest(v, now)
            elif self.itineraries is not None:
                self._next_visit(v, now)
            elif now < job.since or not self._new_task(v, now):
                self._rest(v, now)
        if job.stage == "loaded":
            self._bring(v, now)
        elif job.stage == "assigned" and job.task is not None:
            self._to_place(v, job.task.source, "fetch", now)

    def _visit(self, v: int, now: float) -> Visit | None:
        """Where a truck goes on to as recorded ones did; None while it waits for a place there."""
        assert self.itineraries is not None
        if (visit := self.itineraries.next(v, now, lambda place: self._open(place, v))) is None:
            self._wait_for(v, [b for place in self.itineraries.places(v) for b in self.bays_of[place]], now)
        return visit

    def _next_visit(self, v: int, now: float) -> None:
        """An empty truck goes to fetch a load, or to stand somewhere."""
        visit, job = self._visit(v, now), self.jobs[v]
        if visit is None:
            return
        if visit.taken > 0.0:
            load = min(visit.taken, self.trucks[v].chassis.rated_load)
            job.task = Task(None, visit.place, "", load, now, (visit.dwell, 0.0), (visit.height, 0.0), True)
            job.stage = "assigned"
            self.book.give(job.task)
            self.book.assign(v, job.task, now)
        else:
            job.stay = visit.dwell
            self._to_place(v, visit.place, "visit", now)

    def _bring(self, v: int, now: float) -> None:
        job = self.jobs[v]
        assert job.task is not None
        if self.itineraries is not None and not job.task.target:
            if (visit := self._visit(v, now)) is None:
                return
            dwell, height = (job.task.dwell[0], visit.dwell), (job.task.height[0], visit.height)
            job.task = replace(job.task, target=visit.place, dwell=dwell, height=height)
        if (target := job.task.target or self._free_place("drop", job.task.ranks)) is None:
            self._wait_for(v, self.working["drop"].tolist(), now)
            return
        self._to_place(v, target, "bring", now)
        self.book.note(v, to_place=target)

    def _to_place(self, v: int, place: str, stage: str, now: float) -> None:
        bays, job = self.bays_of[place], self.jobs[v]
        if int(self.home[v]) in bays:
            job.stage, job.goal = stage, int(self.home[v])
            self._parked(v, now)
            return
        if free := [b for b in bays if self.owner[b] < 0]:
            own = self.itineraries.visits[self.itineraries.of[v]].way if self.itineraries else ()
            self._go(v, min(free, key=lambda b: self._cost(v, b)) if free[1:] else free[0], stage, own)
        else:
            self._wait_for(v, bays, now)

    def _wait_for(self, v: int, bays: list[int], now: float) -> None:
        """Stand until a bay is free: the idle are asked to leave; who is in the way of others goes aside."""
        job, here = self.jobs[v], int(self.home[v])
        self._wanted_now.append((v, bays))
        self.lacks[v], self.wants[v] = DROP_PLACE if self.fleet.load[v] > 0.0 else PICK_PLACE, bays
        if now - job.since > YIELD:
            self._send_away(v, bays)
        in_the_way = now - job.since > ASIDE and any(here in w for u, w in self._wanted if u != v)
        if in_the_way and self._make_room(v) and self.fleet.load[v] <= 0.0 and job.task and job.task.target:
            # Not begun: somebody else may do it from where it is nearer.
            self._due.insert(0, job.task)
            self.book.give_back(v, job.task)
            job.task = None

    def _rest(self, v: int, now: float) -> None:
        """Nothing to do: charge if that is worth while, else clear a working place that is not one's own."""
        has_time = self.resting or not self.demand.endless  # Between endless tasks there are seconds
        if has_time and self.soc[v] < self.policy.chance and self._wants_charge(v):
            return
        stays = self.demand.endless or self.kind[self.home[v]] == "park" or now - self.jobs[v].since <= ASIDE
        if not stays:
            self._make_room(v, only_park=True)

    # -- choosing a task

    def _new_task(self, v: int, now: float) -> bool:
        job, picks = self.jobs[v], self.working["pick"]
        if (task := self._due_task(v, now)) is not None:
            self._due.remove(task)
        elif not self.demand.endless:
            return False
        elif self.kind[self.home[v]] != "pick" and (self.owner[picks] >= 0).all():
            self.lacks[v], self.wants[v] = PICK_PLACE, picks.tolist()
            return False
        else:
            task, here = next(self.stream), self.places[self.place_of[self.home[v]]]
            load = min(task.payload, self.trucks[v].chassis.rated_load)
            source = self._free_place("pick", task.ranks) or here
            task = replace(task, source=source, payload=load, earliest=now)
            self.book.give(task)
        job.task, job.stage = task, "assigned"
        self.book.assign(v, task, now)
        return True

    def _due_task(self, v: int, now: float) -> Task | None:
        """The nearest task that this truck can do now, of those due half as long as the first or longer."""
        best: tuple[float, Task] | None = None
        blocked: Task | None = None
        patience = 0.0
        for task in self._due[:DUE]:
            waited = now - task.earliest
            if not self._can(v, task):
                continue
            if best is not None and waited < patience:
                break
            if not self._open(task.source, v):
                # Who stands idle there does it himself, if he may and can.
                self._send_away(v, self.bays_of[task.source], task.vehicle is None)
                if blocked is None and not any(task is other for other in self._blocked):
                    blocked = task
            elif self._nearest(task, v):
                cost = min(self._cost(v, b) for b in self.bays_of[task.source])
                patience = patience or 0.5 * waited
                if best is None or cost < best[0]:
                    best = (cost, task)
        if best is None and blocked is not None:
            # One truck waits for each task whose source is taken; the others have nothing to do.
            self._blocked.append(blocked)
            self.lacks[v], self.wants[v] = PICK_PLACE, self.bays_of[blocked.source]
        return None if best is None else best[1]

    def unserved(self) -> Task | None:
        """The first due task that no truck with nothing to do may and can do, if there is one."""
        trucks = range(len(self.names) if self._due and not self.resting else 0)
        spare = [v for v in trucks if self._idles(v) and not self.lacks[v]]
        return next((t for t in self._due[:DUE] if not any(self._can(v, t) for v in spare)), None)

    def _can(self, v: int, task: Task) -> bool:
        """Whether a truck may do a task, and can carry the load."""
        return task.vehicle in (None, self.names[v]) and task.payload <= self.trucks[v].chassis.rated_load

    def _nearest(self, task: Task, v: int) -> bool:
        """Whether no other truck with nothing to do stands nearer to its source."""
        if task.vehicle is not None:
            return True
        start, parked = self.bays_of[task.source][:1], np.flatnonzero(self.fleet.mode == Mode.PARKED).tolist()
        rivals = (u for u in parked if self._idles(u) and self.soc[u] > self.policy.low)
        mine = (self._gaps(start, v)[0], v)
        return not any((self._gaps(start, u)[0], u) < mine for u in rivals if self._can(u, task))

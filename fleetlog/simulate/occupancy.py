"""Who stands in which bay, who leaves one for whom, and who charges."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fleetlog.core.arrays import Floats, Ints
from fleetlog.errors import InputError, nearest
from fleetlog.simulate.state import CHARGER, Fleet, Mode
from fleetlog.simulate.tasks import Task
from fleetlog.simulate.watch import Untangler
from fleetlog.simulate.world import World

GIVES_WAY = 0.8  # From here on a charger gives less and less: a truck leaves it to one that has to charge


@dataclass(frozen=True)
class Policy:
    """When trucks charge: below ``low``, with nothing else to do below ``chance``, up to ``full``; from
    ``enough`` on a truck leaves the charger when tasks wait."""

    low: float = 0.3
    chance: float = 0.8
    full: float = 0.95
    enough: float = 0.8

    @classmethod
    def named(cls, name: str, low: float = 0.3) -> "Policy":
        """``opportunity`` charges also when there is nothing else to do, ``threshold`` only below ``low``."""
        known = {"opportunity": cls(low), "threshold": cls(low, chance=low, enough=cls.full)}
        if name not in known:
            raise InputError(f"unknown charging policy {name!r}", do=nearest(name, known))
        return known[name]


@dataclass
class Job:
    """A truck's stage, task, bay, since when [s]; ``stay``: how long it stands at its goal without work."""

    stage: str = "idle"
    task: Task | None = None
    goal: int = -1
    since: float = 0.0
    stay: float = 0.0


class Occupancy(Untangler):
    """The part of a dispatcher that gives bays to trucks.

    home : (V,) the bay that a truck stands in, or stood in last;  soc : (V,) state of charge.
    lacks : (V,) what a truck that stands in a bay waits for, see ``state.PICK_PLACE``; ``wants``: its bays.
    owner : (B,) the truck that stands in a bay or goes there, -1: none;  place_of, kind, where : of each bay.
    working : the bays of pick and of drop places; of any working place where there is none of that kind."""

    def __init__(self, world: World, fleet: Fleet, policy: Policy) -> None:
        super().__init__(world, fleet)
        trucks, self.policy, self.queue = len(fleet.mode), policy, deque[int]()
        self.jobs = [Job() for _ in range(trucks)]
        self.home, self.soc = np.full(trucks, -1, np.int64), np.ones(trucks)
        self.lacks, self.wants = np.zeros(trucks, np.int8), dict[int, Sequence[int]]()
        self.owner = np.full(len(world.bays), -1, np.int64)
        self.places = list(dict.fromkeys(b.place.id for b in world.bays))
        self.place_of = np.array([self.places.index(b.place.id) for b in world.bays])
        bays_of = (np.flatnonzero(self.place_of == k).tolist() for k in range(len(self.places)))
        self.bays_of: dict[str, list[int]] = dict(zip(self.places, bays_of, strict=True))
        self.kind = np.array([b.place.kind for b in world.bays])
        self.where = np.array([b.door.path[-1, :2] for b in world.bays])
        work = np.isin(self.kind, ("pick", "drop"))
        work = work if work.any() else self.kind != "charge"
        own = {k: self.kind == k for k in ("pick", "drop")}
        self.working = {k: np.flatnonzero(work & mine if mine.any() else work) for k, mine in own.items()}
        self.chargers: list[int] = np.flatnonzero(self.kind == "charge").tolist()
        self.swap = np.array([b.place.swap for b in world.bays])  # (B,) seconds; NaN: batteries stay there
        self.swapped_wh = 0.0

    def settle(self, wanted: Callable[[int], str | None]) -> None:
        """Put every truck into a bay of the place it wants, else to park, else anywhere but at a charger."""
        bays = np.flatnonzero(self.kind != "charge").tolist()
        order = sorted(bays, key=lambda b: bool(self.kind[b] != "park"))
        for v in range(len(self.jobs)):
            own = self.bays_of.get(wanted(v) or "", ())
            b = next(b for b in (*own, *order) if self.owner[b] < 0)
            self.fleet.door[v] = self.home[v] = b
            self.fleet.spur[v] = self.world.bays[b].door.length
            self.owner[b] = v

    def _idles(self, v: int) -> bool:
        """Whether a truck stands with nothing to do."""
        return bool(self.fleet.mode[v] == Mode.PARKED) and self.jobs[v].stage == "idle"

    def _open(self, place: str, v: int) -> bool:
        """Whether a bay of a place is free, or this truck's own."""
        return any(self.owner[b] in (-1, v) for b in self.bays_of[place])

    def _gaps(self, bays: Sequence[int] | Ints, v: int) -> Floats:
        """Metres as the crow flies from where truck ``v`` stands."""
        dx, dy = (self.where[bays] - self.where[self.home[v]]).T
        return np.asarray(np.hypot(dx, dy))

    def _free_place(self, kind: str, ranks: Floats) -> str | None:
        """The unoccupied place of that kind that ranks lowest."""
        bays = self.working[kind]
        free = np.unique(self.place_of[bays[self.owner[bays] < 0]])
        return self.places[int(free[np.argmin(ranks[free])])] if len(free) else None

    def _cost(self, v: int, b: int) -> float:
        """Seconds to bay ``b``."""
        way = self.world.ways.between(int(self.home[v]), b)
        return np.inf if way is None else way.cost

    def _go(self, v: int, b: int, stage: str, over: Sequence[str] = ()) -> None:
        """Send a truck to bay ``b``, ``over`` some edges alone if they lead there."""
        f, home, ways, shut = self.fleet, int(self.home[v]), self.world.ways, self._closed()
        others = [k for edge, k in self.world.track.network.index.items() if edge not in over]
        closed = [[*others, *shut], shut, ()] if over else [shut, ()]
        way = next(way for c in closed if (way := ways.between(home, b, c)) is not None)
        self.owner[b], self.lacks[v] = v, 0
        self.wants.pop(v, None)
        self.jobs[v].stage, self.jobs[v].goal = stage, b
        self._take(v, way)
        f.mode[v], f.waits[v] = Mode.WANTS_OUT, np.inf

    # -- making room

    def _make_room(self, v: int, only_park: bool = False) -> bool:
        """Let a truck go to the nearest spare bay, with ``only_park`` of those to park, if there is one."""
        if not len(free := np.flatnonzero((self.owner < 0) & (self.kind == "park"))) and not only_park:
            free = np.flatnonzero((self.owner < 0) & (self.kind != "charge"))
        if len(free):
            self.count.made_room += not only_park
            self._go(v, int(free[np.argmin(self._gaps(free, v))]), "park")
        return len(free) > 0

    def _send_away(self, v: int, bays: Sequence[int], only_low: bool = False) -> None:
        """One idle truck, with ``only_low`` one that must charge, leaves a bay, unless one is being left."""
        holders, leaving = [int(self.owner[b]) for b in bays], (Mode.WANTS_OUT, Mode.LEAVING)
        for u in holders:
            if self.home[u] in bays and self.jobs[u].goal not in bays and self.fleet.mode[u] in leaving:
                return
        for u in holders:
            if u != v and self._idles(u) and not (only_low and self.soc[u] >= self.policy.low):
                self._make_room(u)
                return

    # -- charging

    def _suits(self, v: int, b: int) -> bool:
        """Whether a charger is for truck ``v`` now: a battery is swapped when it has to be, not before."""
        return bool(np.isnan(self.swap[b]) or self.soc[v] < self.policy.low)

    def _wants_charge(self, v: int) -> bool:
        """Queue for a charger; False where the site has none for this truck."""
        if (suits := any(self._suits(v, b) for b in self.chargers)) and v not in self.queue:
            self.queue.append(v)
        return suits

    def _charging(self, now: float, tasks_wait: bool) -> None:
        """Who has enough leaves its charger; of the queue who has to charge takes it first."""
        f, queue = self.fleet, sorted(self.queue, key=lambda u: bool(self.soc[u] >= self.policy.low))
        enough = self.policy.enough if tasks_wait else self.policy.full
        if queue and self.soc[queue[0]] < self.policy.low:
            enough = min(enough, GIVES_WAY)
        for v in np.flatnonzero(f.mode == Mode.CHARGING).tolist():
            if now - self.jobs[v].since >= self.swap[self.home[v]]:
                self.swapped_wh += (1.0 - self.soc[v]) * self.world.trucks[v].battery.capacity_wh
                self.soc[v] = 1.0
            if self.soc[v] >= max(enough, self.policy.low):
                f.mode[v] = Mode.PARKED
                self.jobs[v].stage, self.jobs[v].since = "idle", now
        free = [b for b in self.chargers if self.owner[b] < 0]
        for v in queue if free else ():
            waits = self._idles(v) and self.soc[v] > 0.0
            suits = [b for b in free if self._suits(v, b)]
            if not waits or suits:
                self.queue.remove(v)
            if waits and suits:
                nearest = suits[int(np.argmin(self._gaps(suits, v)))]
                free.remove(nearest)
                self._go(v, nearest, "charge")
        if self.queue and not free:
            self._send_away(self.queue[0], self.chargers)
        for u in self.queue:
            # Who could go on does the next task; only who must charge waits.
            if f.mode[u] == Mode.PARKED and self.soc[u] < self.policy.low:
                self.lacks[u], self.wants[u] = CHARGER, self.chargers

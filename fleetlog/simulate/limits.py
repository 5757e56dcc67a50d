"""What a simulation came to, and what limits the fleet: how busy its trucks, places and junctions are."""

import json
from collections import Counter
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from fleetlog.core.words import Sentences, percent
from fleetlog.simulate.dispatch import Dispatcher
from fleetlog.simulate.state import CHARGER, DROP_PLACE, PICK_PLACE, STANDS, Mode
from fleetlog.simulate.watch import Count

SAID = Sentences(__file__)
MATERIAL = 0.1  # What a fleet waits for during more than this share of its time limits it
SHORT = 0.5  # Trucks limit a fleet where tasks wait for want of one for more than this share of the time
PLACES = {  # The kind of each, and what trucks that wait for it lack
    "pick places": ("pick", PICK_PLACE), "drop places": ("drop", DROP_PLACE), "chargers": ("charge", CHARGER),
}  # fmt: skip


@dataclass(frozen=True)
class Resource:
    """Something that trucks, or tasks, wait for."""

    kind: str  # trucks, pick places, drop places, chargers or junctions
    count: int  # Trucks, bays, plugs, or junctions
    name: str | None  # The place, node or truck that is waited for most; None where it is none or any
    utilisation: float  # Share of the time for which the named one is taken, or all where none is named
    queue: float  # Trucks (for trucks: tasks) that wait on average because of it


@dataclass(frozen=True)
class Limits:
    """How busy everything was; ``bottleneck`` is None where nothing but the demand limits the fleet."""

    bottleneck: Resource | None
    resources: tuple[Resource, ...]
    waiting_s: dict[str, float]  # Truck seconds by cause: traffic, pick places, drop places, chargers
    task_wait_s: dict[str, float]
    """Mean, p95 and longest time from when a task may be done until a truck takes it, or the end [s]."""


def told_limits(told: dict[str, Any]) -> str:
    """The bottleneck in words, of :class:`Limits` as a dictionary."""
    wait, b = told["task_wait_s"], told["bottleneck"]
    tasks = SAID("tasks_wait", **wait)
    if b is None:
        return SAID("no_bottleneck", tasks=tasks)
    name, kind, several = b["name"], b["kind"], f"{b['count']} trucks" if b["count"] > 1 else "only truck"
    what = f"{kind} ({b['count']})" + (f", above all {name}" if name else "")
    if kind == "trucks":
        what = f"truck {name}" if name else f"the {several}"
    if kind == "junctions":  # Who waits behind others on a road waits at a junction that may be empty.
        what = f"traffic, above all before {name}"
    busy = "" if kind == "junctions" else f", busy for {percent(b['utilisation'])} of the time"
    parts = [f"bottleneck: {what}{busy}"]
    if b["queue"] > 0.0:
        parts.append(f"{b['queue']:.1f} {'tasks' if kind == 'trucks' else 'trucks'} wait on average")
    return "; ".join([*parts, tasks] if wait["longest"] else parts)


class Tally:
    """Counts, once a second, who waits for what and what is taken."""

    def __init__(self, dispatcher: Dispatcher) -> None:
        self.dispatcher = d = dispatcher
        track, network = d.world.track, d.world.track.network
        self.lane = np.where(track.source >= 0, track.source, np.arange(len(track)))
        self.node = network.end[self.lane]  # (P,) the junction that each piece leads to or crosses
        self.names = network.node_ids
        self.seconds, self.working, self.idle = 0, 0, np.zeros(len(d.names))
        self.short = Counter[str | None]()  # Seconds for which a task waited for a truck: which, None: any
        self.lacking, self.caused = np.zeros(4), np.zeros(4)
        self.held = np.zeros(len(d.owner))
        self.wanted = np.zeros(len(d.places))
        self.before, self.crossed = np.zeros(len(network)), np.zeros(len(self.names))

    def tick(self) -> None:
        """After the decisions of a second."""
        d, f = self.dispatcher, self.dispatcher.fleet
        self.seconds += 1
        self.held += d.owner >= 0
        self.lacking += np.bincount(d.lacks, minlength=4)
        if not d.resting:
            self.working += 1
            self.idle += (f.mode == Mode.PARKED) & (d.lacks == 0) & (d.book.of < 0)
        if (task := d.unserved()) is not None:
            self.short[task.vehicle] += 1
        for v, bays in d.wants.items():
            places = np.unique(d.place_of[bays])
            self.wanted[places] += 1.0 / len(places)
            # Who stands where another wants to go, and itself waits for something else, passes the blame on.
            causes = d.lacks[d.owner[bays]]
            causes[(causes == 0) | (d.owner[bays] < 0)] = d.lacks[v]
            self.caused += np.bincount(causes, minlength=4) / len(causes)
        drives = f.mode == Mode.DRIVING
        self.crossed[self.node[f.piece[drives & (f.piece >= len(d.world.roads.clear))]]] += 1.0
        stands = np.flatnonzero(drives & (f.v < STANDS))
        # Who waits for room on a lane waits for the junction at its end.
        full = f.why[stands] == 2
        ahead = [f.route[v, d.watch.end(v)] for v in stands[full].tolist()]
        np.add.at(self.before, self.lane[[*f.piece[stands[~full]].tolist(), *ahead]], 1.0)

    def limits(self, traffic: float) -> Limits:
        """What the run came to; ``traffic`` truck seconds of waiting on the road and before bays."""
        d = self.dispatcher
        waiting = {"traffic": traffic, **{k: float(self.lacking[code]) for k, (_, code) in PLACES.items()}}
        earliest, assigned = d.book.numbers("earliest"), d.book.numbers("assigned")
        tasks = np.where(assigned < 0.0, float(self.seconds), assigned) - earliest
        found = [self._places(name, *of) for name, of in PLACES.items() if of[0] in d.kind]
        who, _ = max(self.short.items(), key=lambda item: item[1], default=(None, 0))
        idle = self.idle if who is None else self.idle[d.names.index(who)]
        busy = 1.0 - float(np.mean(idle)) / max(self.working, 1)
        trucks = Resource("trucks", len(d.names), who, busy, float(tasks.sum()) / self.seconds)
        network, count = d.world.track.network, int((self.crossed > 0.0).sum())
        before = np.bincount(network.end, self.before, len(self.names))
        most = int(np.argmax(before))
        name = self.names[most] if before[most] else None
        if name and name.startswith("@"):  # The map has no name for it
            road = np.argmax(self.before * (before[network.end] == before.max()))
            name = f"the end of {network.edge_ids[road]}"
        taken = min(float(self.crossed[most]) / self.seconds, 1.0)
        found += [Resource("junctions", count, name, taken, traffic / self.seconds), trucks]
        worst = max(found[:-1], key=lambda r: r.queue)
        scarce = d.demand.endless or self.short.total() > SHORT * self.seconds
        fleet = trucks if scarce else None
        bottleneck = worst if worst.queue > MATERIAL * trucks.count else fleet
        some = tasks if len(tasks) else np.zeros(1)
        waits = (some.mean(), np.quantile(some, 0.95), some.max())
        summary = dict(zip(("mean", "p95", "longest"), map(float, waits), strict=True))
        return Limits(bottleneck, tuple(found), waiting, summary)

    def _places(self, what: str, kind: str, lack: int) -> Resource:
        d = self.dispatcher
        bays = np.flatnonzero(d.kind == kind)
        places = np.unique(d.place_of[bays])
        most = int(places[np.argmax(self.wanted[places])])
        name = d.places[most] if self.wanted[most] > 0.0 else None
        taken = self.held[bays if name is None else np.flatnonzero(d.place_of == most)].mean() / self.seconds
        return Resource(what, len(bays), name, float(taken), float(self.caused[lack] / self.seconds))


@dataclass
class Summary:
    """What was simulated."""

    vehicles: int
    duration_s: float
    rows: int
    vehicle_steps: int
    count: Count
    distance_m: float
    energy_wh: float
    charged_wh: float
    soc_end: list[float]
    soc_lowest: float
    soc_mean: float
    limits: Limits
    longest_wait_s: float  # Longest time that a truck which wanted to move stood on end
    notes: list[str]
    one_more: dict[str, Any] = field(default_factory=dict)
    """What one more of what limits brings; empty where that was not simulated."""

    @property
    def unfinished(self) -> int:
        """Tasks that were given and are not done at the end."""
        return self.count.tasks_given - self.count.tasks_done

    @property
    def waiting_s(self) -> float:
        """Truck seconds of waiting of every kind."""
        return sum(self.limits.waiting_s.values())

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        told = asdict(self)
        told |= told.pop("count") | {"tasks_unfinished": self.unfinished, "waiting_s": self.waiting_s}
        told["limits"]["one_more"] = told.pop("one_more")
        out: dict[str, Any] = json.loads(json.dumps(told), parse_float=lambda digits: round(float(digits), 5))
        return out

    def lines(self) -> list[str]:
        """For the terminal."""
        c, waits = self.count, {k: round(s / 3600.0, 2) for k, s in self.limits.waiting_s.items()}
        kinds = ", ".join(f"{kind} {hours:.2f}" for kind, hours in waits.items())
        told = {
            "hours": self.duration_s / 3600.0, "km": self.distance_m / 1000.0,
            "used": self.energy_wh / 1000.0, "charged": self.charged_wh / 1000.0,
            "later": f", {c.tasks_later:,} due after the end" if c.tasks_later else "",
            "waiting": sum(waits.values()), "kinds": kinds,
        }  # fmt: skip
        out = [SAID(name, run=self, **told) for name in ("fleet", "tasks", "energy", "waiting", "traffic")]
        out.append(told_limits(asdict(self.limits)))
        out += [str(self.one_more["statement"])] if self.one_more else []
        return out + ([f"battery empty: {', '.join(c.empty)}"] if c.empty else [])

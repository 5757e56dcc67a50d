"""What limits a simulated fleet: how busy trucks, places, chargers and junctions are, and their queues."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from fleetlog.simulate.arrays import Floats
from fleetlog.simulate.dispatch import Dispatcher
from fleetlog.simulate.state import CHARGER, DROP_PLACE, PICK_PLACE, STANDS, Mode

MATERIAL = 0.1
"""Places, chargers or traffic limit a fleet that spends more than this share of its time waiting for them."""
BUSY = 0.85
"""Trucks limit a fleet that has work for more than this share of its time."""
PLACES = {"pick places": PICK_PLACE, "drop places": DROP_PLACE, "chargers": CHARGER}
KIND_OF = {"pick places": "pick", "drop places": "drop", "chargers": "charge"}


@dataclass(frozen=True)
class Resource:
    """Something that trucks, or tasks, wait for."""

    kind: str
    """trucks, pick places, drop places, chargers or junctions."""
    count: int
    """Trucks, bays, plugs, or junctions."""
    name: str | None
    """The place or node that is waited for most; None where nobody waits."""
    utilisation: float
    """Share of the time for which the named one is taken, or all where none is named."""
    queue: float
    """Trucks (for trucks: tasks) that wait on average because of it."""


@dataclass(frozen=True)
class Limits:
    """How busy everything was; ``bottleneck`` is None where nothing but the demand limits the fleet."""

    resources: tuple[Resource, ...]
    bottleneck: Resource | None
    waiting_s: dict[str, float]
    """Truck seconds by cause: traffic, pick places, drop places, chargers."""
    task_wait_s: dict[str, float]
    """Mean, p95 and longest time from when a task may be done until a truck takes it, or the end [s]."""

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        return {
            "bottleneck": None if self.bottleneck is None else _rounded(asdict(self.bottleneck)),
            "resources": [_rounded(asdict(r)) for r in self.resources],
            "waiting_s": _rounded(self.waiting_s), "task_wait_s": _rounded(self.task_wait_s),
        }  # fmt: skip

    def lines(self) -> list[str]:
        """For the terminal."""
        wait, b = self.task_wait_s, self.bottleneck
        tasks = f"tasks wait {wait['mean']:.0f} s for a truck on average, {wait['longest']:.0f} s at most"
        if b is None:
            return [f"bottleneck: none, the fleet does what is asked of it; {tasks}"]
        what = f"the {b.count} trucks" if b.kind == "trucks" else f"{b.kind} ({b.count}), above all {b.name}"
        parts = [f"bottleneck: {what}, busy for {100 * b.utilisation:.0f} % of the time"]
        if b.queue > 0.0:
            parts.append(f"{b.queue:.1f} {'tasks' if b.kind == 'trucks' else 'trucks'} wait on average")
        return ["; ".join([*parts, tasks] if wait["longest"] else parts)]


class Tally:
    """Counts, once a second, who waits for what and what is taken."""

    def __init__(self, dispatcher: Dispatcher) -> None:
        self.dispatcher = d = dispatcher
        track, network = d.world.track, d.world.track.network
        lane_of = np.where(track.source >= 0, track.source, np.arange(len(track)))
        self.node = network.end[lane_of]
        """(P,) the junction that each piece leads to or crosses."""
        self.names = network.node_ids
        self.seconds, self.idle = 0, 0
        self.lacking, self.caused = np.zeros(4), np.zeros(4)
        self.held = np.zeros(len(d.owner))
        self.wanted = np.zeros(len(d.places))
        self.before, self.crossed = np.zeros(len(self.names)), np.zeros(len(self.names))

    def tick(self) -> None:
        """After the decisions of a second."""
        d, f = self.dispatcher, self.dispatcher.fleet
        self.seconds += 1
        self.held += d.owner >= 0
        self.lacking += np.bincount(d.lacks, minlength=4)
        self.idle += int(((f.mode == Mode.PARKED) & (d.lacks == 0) & (d.book.of < 0)).sum())
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
        ahead = [d.watch.next_lane(v) for v in stands[full].tolist()]
        np.add.at(self.before, self.node[[*f.piece[stands[~full]].tolist(), *ahead]], 1.0)

    def limits(self, traffic: float) -> Limits:
        """What the run came to; ``traffic`` truck seconds of waiting on the road and before bays."""
        d = self.dispatcher
        waiting = {"traffic": traffic, **{k: float(self.lacking[code]) for k, code in PLACES.items()}}
        tasks = self._task_waits()
        found = [self._places(kind) for kind in PLACES if (d.kind == KIND_OF[kind]).any()]
        found += [self._junctions(traffic), self._trucks(tasks)]
        some = tasks if len(tasks) else np.zeros(1)
        waits = {"mean": some.mean(), "p95": np.quantile(some, 0.95), "longest": some.max()}
        summary = {name: float(seconds) for name, seconds in waits.items()}
        return Limits(tuple(found), self._bottleneck(found), waiting, summary)

    def _task_waits(self) -> Floats:
        earliest, assigned = self.dispatcher.book.taken()
        return np.where(assigned < 0.0, float(self.seconds), assigned) - earliest

    def _places(self, kind: str) -> Resource:
        d = self.dispatcher
        bays = np.flatnonzero(d.kind == KIND_OF[kind])
        places = np.unique(d.place_of[bays])
        most = int(places[np.argmax(self.wanted[places])])
        name = d.places[most] if self.wanted[most] > 0.0 else None
        taken = self.held[bays if name is None else np.flatnonzero(d.place_of == most)].mean() / self.seconds
        return Resource(kind, len(bays), name, float(taken), float(self.caused[PLACES[kind]] / self.seconds))

    def _junctions(self, traffic: float) -> Resource:
        most = int(np.argmax(self.before))
        name = self.names[most] if self.before[most] > 0.0 else None
        taken = min(self.crossed[most] / self.seconds, 1.0)
        count = int((self.crossed > 0.0).sum())
        return Resource("junctions", count, name, float(taken), traffic / self.seconds)

    def _trucks(self, tasks: Floats) -> Resource:
        trucks = len(self.dispatcher.names)
        busy = 1.0 - self.idle / (trucks * self.seconds)
        return Resource("trucks", trucks, None, busy, float(tasks.sum()) / self.seconds)

    def _bottleneck(self, found: list[Resource]) -> Resource | None:
        *others, trucks = found
        worst = max(others, key=lambda r: r.queue)
        if worst.queue > MATERIAL * trucks.count:
            return worst
        return trucks if trucks.utilisation > BUSY else None


def _rounded(values: dict[str, Any]) -> dict[str, Any]:
    return {k: round(v, 4) if isinstance(v, float) else v for k, v in values.items()}

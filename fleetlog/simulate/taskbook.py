"""What became of every task: given, taken by a truck, picked, dropped."""

import bisect
from array import array
from collections.abc import Iterable, Sequence

import numpy as np

from fleetlog.core.trajectory import Labels
from fleetlog.simulate.arrays import Floats, Ints
from fleetlog.simulate.tasks import Task
from fleetlog.store.events import Columns

NONE = -1.0
"""A time that has not come [s after the start]."""
STATUS = ("waiting", "assigned", "loaded", "done", "later", "left out")
WAITING, ASSIGNED, LOADED, DONE, LATER, LEFT_OUT = range(6)


class TaskBook:
    """One line a task, numbered as given; ``of`` (V,) is the number that each truck has, -1: none."""

    def __init__(self, vehicles: Sequence[str]) -> None:
        self.vehicles = tuple(vehicles)
        self.of = np.full(len(vehicles), -1, np.int64)
        self._places: dict[str, int] = {}
        self._open: dict[Task, list[int]] = {}
        self._text = {name: array("i") for name in ("vehicle_id", "from_place", "to_place", "status")}
        self._numbers = {
            name: array("d") for name in ("payload", "earliest", "assigned", "picked", "dropped")
        }

    def __len__(self) -> int:
        return len(self._text["status"])

    def give(self, task: Task, status: int = WAITING) -> None:
        """A task can be done from now on."""
        self._open.setdefault(task, []).append(len(self))
        places = {"from_place": self._place(task.source), "to_place": self._place(task.target)}
        for text, code in {"vehicle_id": -1, **places, "status": status}.items():
            self._text[text].append(code)
        for name, column in self._numbers.items():
            column.append(getattr(task, name, NONE))

    def assign(self, v: int, task: Task, now: float) -> None:
        """Truck ``v`` takes it."""
        numbers = self._open[task]
        n = numbers.pop(0)
        if not numbers:
            del self._open[task]
        self.of[v] = n
        self._text["vehicle_id"][n], self._text["status"][n] = v, ASSIGNED
        self._numbers["assigned"][n] = now

    def give_back(self, v: int, task: Task) -> None:
        """Truck ``v`` leaves it, not begun, to others."""
        n = int(self.of[v])
        bisect.insort(self._open.setdefault(task, []), n)
        self.of[v] = -1
        self._text["vehicle_id"][n], self._text["status"][n] = -1, WAITING
        self._numbers["assigned"][n] = NONE

    def heads_for(self, v: int, place: str) -> None:
        """Truck ``v`` brings its load to a place."""
        self._text["to_place"][int(self.of[v])] = self._place(place)

    def picked(self, v: int, now: float) -> None:
        """Truck ``v`` has its load."""
        n = int(self.of[v])
        self._text["status"][n], self._numbers["picked"][n] = LOADED, now

    def dropped(self, v: int, now: float) -> None:
        """Truck ``v`` has set its load down."""
        n = int(self.of[v])
        self._text["status"][n], self._numbers["dropped"][n] = DONE, now
        self.of[v] = -1

    def never(self, tasks: Iterable[Task], status: int) -> None:
        """Tasks that no truck was asked to do."""
        for task in tasks:
            self.give(task, status)

    def taken(self) -> tuple[Floats, Floats]:
        """When each task might be done and when a truck took it, negative: not yet [s]."""
        return np.array(self._numbers["earliest"]), np.array(self._numbers["assigned"])

    def columns(self, start: int) -> Columns:
        """The table of tasks; ``start`` of the simulation [us]."""

        def text(name: str, names: Iterable[str]) -> Labels:
            return Labels(np.array(self._text[name], dtype=np.int32), tuple(names))

        def time(name: str) -> Ints:
            seconds = np.array(self._numbers[name])
            return np.where(seconds < 0.0, -1, start + np.rint(seconds * 1e6).astype(np.int64))

        return {
            "task": np.arange(len(self)), "vehicle_id": text("vehicle_id", self.vehicles),
            "from_place": text("from_place", self._places), "to_place": text("to_place", self._places),
            "payload": np.array(self._numbers["payload"]), "status": text("status", STATUS),
            **{name: time(name) for name in ("earliest", "assigned", "picked", "dropped")},
        }  # fmt: skip

    def _place(self, place: str) -> int:
        return self._places.setdefault(place, len(self._places)) if place else -1

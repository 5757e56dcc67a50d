"""What a recorded fleet did next: simulated trucks go from place to place as recorded ones went."""

from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fleetlog.simulate.arrays import Ints
from fleetlog.simulate.places import Stands
from fleetlog.store.trips import MIN_LOAD_CHANGE

DAY = 86_400.0
NEAR = 3600.0
"""What was done within this time of day is drawn first [s]."""


@dataclass(frozen=True)
class Visit:
    """A recorded truck stood at a place.

    ``begin`` time of day [s], ``dwell`` [s], ``height`` of the forks [m]; ``taken`` is the load that it took
    up there [kg], negative where it set one down; ``next`` is the number of the visit that the same truck
    made after it, -1: none.
    """

    place: str
    begin: float
    dwell: float
    height: float
    taken: float
    next: int = -1

    @property
    def loads(self) -> bool:
        """Whether the truck leaves with a load."""
        return self.taken > 0.0


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
        self._drawn = np.zeros(len(visits), np.int64)
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
        possible = [k for k in options if is_open(self.visits[k].place)]
        if not possible:
            return None
        time, chance = (self.start + now) % DAY, self._rng.random(len(possible))

        def rank(i: int) -> tuple[bool, int, float]:
            k = possible[i]
            gap = abs(self.visits[k].begin - time)
            return min(gap, DAY - gap) > NEAR, int(self._drawn[k]), float(chance[i])

        drawn = possible[min(range(len(possible)), key=rank)]
        self.of[v] = drawn
        self._drawn[drawn] += 1
        return self.visits[drawn]

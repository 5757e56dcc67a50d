"""The model at a stage of the search: its numbers, whom and when they concern, and its fields over cells."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.core.motion import Motion
from fleetlog.core.truck import Truck
from fleetlog.discovery.hypotheses.cells import Cells
from fleetlog.physics.power import Own, Physics, all_terms, share
from fleetlog.physics.term import Parameter, Term, Values


@dataclass(frozen=True, order=True)
class Scope:
    """``vehicles``: codes, none for all; from ``begin`` to ``until`` [s since 1970], or growing over that."""

    vehicles: tuple[int, ...] = ()
    begin: float = -np.inf
    until: float = np.inf
    drift: bool = False

    @property
    def whole(self) -> bool:
        """Whether it is the fleet, always."""
        return self is FLEET or self == FLEET

    @property
    def timed(self) -> bool:
        """Whether it is a part of the time only."""
        return self.begin > -np.inf or self.until < np.inf

    @property
    def one(self) -> int | None:
        """The one vehicle that it is, always; its columns are the fleet's, in the rows of the vehicle."""
        return self.vehicles[0] if len(self.vehicles) == 1 and not self.timed else None

    def covers(self, vehicle: int) -> bool:
        """Return whether a vehicle belongs to it."""
        return not self.vehicles or vehicle in self.vehicles

    def share(self, vehicle: int, time: Floats) -> Floats:
        """Return how far it holds for a vehicle at some times, (N,): 0 to 1."""
        if not self.covers(vehicle):
            return np.zeros(len(time))
        return share(time, self.begin, self.until, self.drift)


FLEET = Scope()


@dataclass(frozen=True, order=True)
class Knob:
    """A number of a term: the fleet's, or the deviation from it within a scope."""

    term: str
    parameter: str
    scope: Scope = FLEET

    @property
    def definition(self) -> Parameter:
        """The parameter that it turns."""
        return all_terms()[self.term].by_name[self.parameter]

    @property
    def fleet(self) -> Knob:
        """The fleet's number."""
        return self if self.scope is FLEET else replace(self, scope=FLEET)

    @property
    def column(self) -> Knob:
        """The knob whose column serves: that of one vehicle is the fleet's, in the rows of the vehicle."""
        return self if self.scope.one is None else self.fleet


@dataclass(frozen=True)
class Model:
    """``at[knob]`` in the coordinate in which the model is linear; ``fields[term]`` (C,) deviations from
    neutral in it, and ``when[term]`` the part of the time that they are there, where it is not all."""

    truck: Truck
    at: dict[Knob, float] = field(default_factory=dict)
    fields: dict[str, Floats] = field(default_factory=dict)
    when: dict[str, Scope] = field(default_factory=dict)
    _told: dict[int | None, dict[str, dict[str, float]]] = field(default_factory=dict, init=False)

    def moved(self, steps: dict[Knob, float]) -> Model:
        """Return the model with knobs turned by steps of their coordinates."""
        return replace(self, at={**self.at, **{k: self.coordinate(k) + s for k, s in steps.items()}})

    def with_field(self, term: str, deviation: Floats, when: Scope = FLEET) -> Model:
        """Return the model with one field set."""
        return replace(self, fields={**self.fields, term: deviation}, when={**self.when, term: when})

    def without(self, knobs: set[Knob], terms: set[str]) -> Model:
        """Return the model in which these knobs, and the fields of these terms, are nominal again."""
        at = {k: v for k, v in self.at.items() if k not in knobs}
        return replace(self, at=at, fields={k: v for k, v in self.fields.items() if k not in terms})

    def coordinate(self, knob: Knob) -> float:
        """Return where a knob stands; zero for the deviation of a scope where nothing was found."""
        if not knob.scope.whole:
            return self.at.get(knob, 0.0)
        return self.at.get(knob, knob.definition.scaled(knob.definition.nominal(self.truck)))

    def total(self, knob: Knob) -> float:
        """Return the coordinate in force within the knob's scope: the fleet's and its own deviation."""
        fleet = self.coordinate(knob.fleet)
        return fleet if knob.scope.whole else fleet + self.coordinate(knob)

    def of_vehicle(self, knob: Knob, vehicle: int) -> float:
        """Return the coordinate of one vehicle's number at all times, whatever holds for a while."""
        return self.coordinate(knob.fleet) + self._own[knob.term, knob.parameter, vehicle]

    def in_force(self, knob: Knob, vehicle: int) -> float:
        """Return the coordinate of one vehicle's number in the knob's part of the time."""
        return self.of_vehicle(knob, vehicle) + (self.coordinate(knob) if knob.scope.timed else 0.0)

    @cached_property
    def _own(self) -> dict[tuple[str, str, int], float]:
        """Deviations of single vehicles at all times, by number and vehicle."""
        out: dict[tuple[str, str, int], float] = defaultdict(float)
        for knob, at in self.at.items():
            for v in () if knob.scope.timed else knob.scope.vehicles:
                out[knob.term, knob.parameter, v] += at
        return out

    def value(self, knob: Knob) -> float:
        """Return the number in force within the knob's scope."""
        return knob.definition.value_of(self.total(knob))

    def values(self, vehicle: int | None = None) -> dict[str, dict[str, float]]:
        """Return all numbers not nominal at all times, by term and parameter, of a vehicle or the fleet."""
        if vehicle not in self._told:
            out = self._told.setdefault(vehicle, {})
            for k in self.at:
                if k.scope.whole or (vehicle is not None and k.scope.covers(vehicle) and not k.scope.timed):
                    at = self.coordinate(k) if vehicle is None else self.of_vehicle(k, vehicle)
                    out.setdefault(k.term, {})[k.parameter] = k.definition.value_of(at)
        return self._told[vehicle]

    def own(self, vehicle: int) -> list[Own]:
        """Return what one vehicle has for itself, and what holds for a while."""
        fleet, always = self.values(), dict[str, Values]()
        for name, values in self.values(vehicle).items():
            if other := {k: v for k, v in values.items() if fleet.get(name, {}).get(k) != v}:
                always[name] = other
        return [*([Own(always)] if always else []), *self._timed(vehicle)]

    def _timed(self, vehicle: int) -> Iterator[Own]:
        """What one vehicle has for a while."""
        for knob in self.at:
            s = knob.scope
            if s.timed and s.covers(vehicle):
                value = knob.definition.value_of(self.in_force(knob, vehicle))
                yield Own({knob.term: {knob.parameter: value}}, None, s.begin, s.until, s.drift)

    def share(self, term: str, vehicle: int, time: Floats) -> Floats:
        """Return how far the field of a term is there at some times of a vehicle, (N,)."""
        return self.when.get(term, FLEET).share(vehicle, time)

    def physics(self, vehicle: int, motion: Motion, cells: Callable[[Term], Cells | None]) -> Physics:
        """Return the sum of terms along a motion of one vehicle, fields looked up in their cells."""
        values: dict[str, Values] = dict(self.values(vehicle))
        for name, deviation in self.fields.items():
            term = all_terms()[name]
            where = cells(term)
            if term.acts in ("wait", "traffic") or where is None:
                continue
            first = term.parameters[0]
            here = where.along(motion, deviation) * self.share(name, vehicle, motion.time)
            values[name] = {**values.get(name, {}), first.name: field_values(first, here)}
        return Physics(self.truck, values, own=tuple(self._timed(vehicle)))


def field_values(parameter: Parameter, deviation: Floats) -> Floats:
    """Return the values of a field's parameter where its coordinate deviates so from neutral."""
    if not parameter.inverse:
        return np.clip(parameter.neutral + deviation, parameter.low, parameter.high)
    scaled = np.maximum(parameter.scaled(parameter.neutral) + deviation, 1.0 / parameter.high)
    return np.maximum(1.0 / scaled, parameter.low)

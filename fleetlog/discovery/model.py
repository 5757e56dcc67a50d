"""The model at a stage of the search: coordinates of the terms' numbers, by fleet and by vehicle, and
fields over the cells."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.motion import Motion
from fleetlog.core.truck import Truck
from fleetlog.discovery.hypotheses.stretches import Cells, along
from fleetlog.physics.power import Physics, all_terms
from fleetlog.physics.term import Parameter, Term, Values

Floats = NDArray[np.float64]


@dataclass(frozen=True, order=True)
class Knob:
    """A number of a term: the fleet's, or the deviation of one vehicle's from it."""

    term: str
    parameter: str
    vehicle: int | None = None

    @property
    def definition(self) -> Parameter:
        """The parameter that it turns."""
        return all_terms()[self.term].by_name[self.parameter]


@dataclass(frozen=True)
class Model:
    """``at[knob]`` in the coordinate in which the model is linear; ``fields[term]`` (C,) deviations from
    neutral in it."""

    truck: Truck
    at: dict[Knob, float] = field(default_factory=dict)
    fields: dict[str, Floats] = field(default_factory=dict)

    def moved(self, steps: dict[Knob, float]) -> Model:
        """Return the model with knobs turned by steps of their coordinates."""
        return replace(self, at={**self.at, **{k: self.coordinate(k) + s for k, s in steps.items()}})

    def with_at(self, values: dict[Knob, float]) -> Model:
        """Return the model with knobs at given coordinates."""
        return replace(self, at={**self.at, **values})

    def with_field(self, term: str, deviation: Floats) -> Model:
        """Return the model with one field set."""
        return replace(self, fields={**self.fields, term: deviation})

    def without(self, knobs: set[Knob], terms: set[str]) -> Model:
        """Return the model in which these knobs, and the fields of these terms, are nominal again."""
        return replace(
            self,
            at={k: v for k, v in self.at.items() if k not in knobs},
            fields={k: v for k, v in self.fields.items() if k not in terms},
        )

    def coordinate(self, knob: Knob) -> float:
        """Return where a knob stands; a vehicle's knob at zero where nothing was found."""
        if knob.vehicle is not None:
            return self.at.get(knob, 0.0)
        return self.at.get(knob, knob.definition.scaled_nominal(self.truck))

    def value(self, term: Term, parameter: str, vehicle: int | None = None) -> float:
        """Return the number of a parameter, for one vehicle or the fleet."""
        total = self.coordinate(Knob(term.name, parameter))
        if vehicle is not None:
            total += self.at.get(Knob(term.name, parameter, vehicle), 0.0)
        return term.by_name[parameter].value_of(total)

    def values(self, vehicle: int | None) -> dict[str, dict[str, float]]:
        """Return every number that is not nominal, by term and parameter."""
        out: dict[str, dict[str, float]] = {}
        for knob in self.at:
            if knob.vehicle in (None, vehicle):
                term = all_terms()[knob.term]
                out.setdefault(knob.term, {})[knob.parameter] = self.value(term, knob.parameter, vehicle)
        return out

    def own_values(self, vehicle: int) -> dict[str, dict[str, float]]:
        """Return the numbers of one vehicle that differ from the fleet's."""
        out: dict[str, dict[str, float]] = {}
        for knob in self.at:
            if knob.vehicle == vehicle:
                value = self.value(all_terms()[knob.term], knob.parameter, vehicle)
                out.setdefault(knob.term, {})[knob.parameter] = value
        return out

    def physics(self, vehicle: int, motion: Motion, cells: Callable[[Term], Cells | None]) -> Physics:
        """Return the sum of terms along a motion of one vehicle, fields looked up in their cells."""
        values: dict[str, Values] = {k: dict(v) for k, v in self.values(vehicle).items()}
        for name, deviation in self.fields.items():
            term = all_terms()[name]
            where = cells(term)
            if term.acts in ("wait", "traffic") or where is None:
                continue
            first = term.parameters[0]
            found = field_values(first, along(where, motion, deviation, term.odd))
            values[name] = {**values.get(name, {}), first.name: found}
        return Physics(self.truck, values)


def field_values(parameter: Parameter, deviation: Floats) -> Floats:
    """Return the values of a field's parameter where its coordinate deviates so from neutral."""
    if not parameter.inverse:
        return np.clip(parameter.neutral + deviation, parameter.low, parameter.high)
    scaled = np.maximum(parameter.scaled(parameter.neutral) + deviation, 1.0 / parameter.high)
    return np.maximum(1.0 / scaled, parameter.low)

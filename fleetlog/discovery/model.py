"""The physics found so far: numbers of terms, and fields over the stretches; one place that turns them into a power."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.motion import Motion
from fleetlog.core.truck import Truck
from fleetlog.discovery.replay import Block
from fleetlog.discovery.stretches import Cells, along
from fleetlog.physics.power import Physics, all_terms, battery_power, cell_power
from fleetlog.physics.term import Term, Values

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Found:
    """``values[term][parameter]`` numbers; ``fields[term]`` deviations from neutral, value by value of the cells."""

    truck: Truck
    values: dict[str, dict[str, float]] = field(default_factory=dict)
    fields: dict[str, Floats] = field(default_factory=dict)

    def with_value(self, term: str, parameter: str, value: float) -> Found:
        """A copy with one number set."""
        return replace(self, values={**self.values, term: {**self.values.get(term, {}), parameter: value}})

    def with_field(self, term: str, deviation: Floats) -> Found:
        """A copy with one field set."""
        return replace(self, fields={**self.fields, term: deviation})

    def without(self, term: str) -> Found:
        """A copy in which the term is nominal again."""
        return replace(
            self,
            values={k: v for k, v in self.values.items() if k != term},
            fields={k: v for k, v in self.fields.items() if k != term},
        )

    def value(self, term: Term, parameter: str) -> float:
        """The number of a parameter, nominal where nothing was found."""
        nominal = term.by_name[parameter].nominal(self.truck)
        return self.values.get(term.name, {}).get(parameter, nominal)

    def physics(self, motion: Motion, cells: Cells | None) -> Physics:
        """The power sum along a motion, fields looked up."""
        values: dict[str, Values] = {k: dict(v) for k, v in self.values.items()}
        if cells is not None:
            for name, deviation in self.fields.items():
                term = all_terms()[name]
                if term.acts == "speed":
                    continue
                first = term.parameters[0]
                moved = along(cells, motion, deviation, term.odd)
                values[name] = {**values.get(name, {}), first.name: first.neutral + moved}
        return Physics(self.truck, values)


def channel_power(block: Block, physics: Physics, channel: str, measured: bool) -> Floats:
    """(samples,) power that a channel should show [W]: at the terminals, or what the state of charge pays.

    ``measured``: the terminals' power is itself recorded, so the state of charge is judged against that.
    """
    if channel == "battery_power":
        return battery_power(block.motion, physics)
    terminal = block.motion.power if measured else battery_power(block.motion, physics)
    return cell_power(terminal, physics.actual_truck())

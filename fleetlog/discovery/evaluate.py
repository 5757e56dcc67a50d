"""The power of one block under a model, and how it changes when one term is set otherwise."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.motion import Motion
from fleetlog.core.truck import Truck
from fleetlog.discovery.model import Found, channel_power
from fleetlog.discovery.replay import Block
from fleetlog.discovery.stretches import Cells
from fleetlog.physics.power import Physics, cell_power
from fleetlog.physics.term import Floats, Term, Values

Index = NDArray[np.int32]


@dataclass(frozen=True)
class Evaluation:
    """One block under one model, for one energy channel (``measured``: see :func:`channel_power`).

    A changed force or power needs one term evaluated anew, not the whole sum; only a changed truck or load needs that.
    """

    block: Block
    found: Found
    cells: Cells | None
    channel: str
    measured: bool = False

    @cached_property
    def physics(self) -> Physics:
        """The sum."""
        return self.found.physics(self.block.motion, self.cells)

    @cached_property
    def truck(self) -> Truck:
        """With replaced values."""
        return self.physics.actual_truck()

    @cached_property
    def motion(self) -> Motion:
        """With the load that acts."""
        return self.physics.actual_motion(self.block.motion)

    @cached_property
    def force(self) -> Floats:
        """(N,) total force against the motion [N]."""
        return self._sum("force")

    @cached_property
    def gain(self) -> Floats:
        """(N,) W at the battery for each newton of extra resistance."""
        drive = self.truck.drive
        return np.where(self.force >= 0.0, 1.0 / drive.efficiency, drive.regeneration) * self.motion.speed

    @cached_property
    def power(self) -> Floats:
        """(N,) the channel's power [W]."""
        return self._seen(
            self.block.motion.power if self.measured else self._driven(self.force) + self._powers
        )

    @cached_property
    def mass(self) -> Floats:
        """(N,) truck and load [kg]."""
        return self.truck.chassis.mass + self.motion.payload

    def _sum(self, acts: str) -> Floats:
        total = np.zeros(len(self.motion))
        for term in self.physics.active():
            if term.acts == acts and term.function is not None:
                total = total + term.function(self.motion, self.truck, self.physics.values.get(term.name, {}))
        return total

    def change(self, term: Term, setting: Values) -> Floats:
        """(N,) channel power with ``term`` set to ``setting`` (its other parameters as they are) minus that without [W]."""
        before = self.physics.values.get(term.name, {})
        after = {**before, **setting}
        simple = term.acts in ("force", "power") and all(p.truck_key is None for p in term.parameters)
        if simple and term.function is not None and not self.measured:
            return self._swapped(term, before, after)
        physics = Physics(self.physics.truck, {**self.physics.values, term.name: after})
        return channel_power(self.block, physics, self.channel, self.measured) - self.power

    def _driven(self, force: Floats) -> Floats:
        """(N,) W at the terminals for a force."""
        drive = self.truck.drive
        conversion = np.where(force >= 0.0, 1.0 / drive.efficiency, drive.regeneration)
        return np.asarray(force * conversion * self.motion.speed)

    def _seen(self, terminal: Floats) -> Floats:
        """(N,) what the channel shows of a power at the terminals [W]."""
        return terminal if self.channel == "battery_power" else cell_power(terminal, self.truck)

    @cached_property
    def _powers(self) -> Floats:
        return self._sum("power")

    def _swapped(self, term: Term, before: Values, after: Values) -> Floats:
        assert term.function is not None
        new = term.function(self.motion, self.truck, after)
        active = term.nominal or term.name in self.physics.values
        old = term.function(self.motion, self.truck, before) if active else np.zeros(len(new))
        if term.acts == "power" and self.channel == "battery_power":
            return new - old
        if term.acts == "force":
            return self._seen(self._driven(self.force + new - old) + self._powers) - self.power
        return self._seen(self._driven(self.force) + self._powers + new - old) - self.power

    def slope(self, term: Term) -> Floats:
        """(N,) derivative of the channel's power with respect to a field term's first parameter, where it is now."""
        parameter = term.parameters[0]
        delta = 1e-3 * (parameter.high - parameter.low)
        now = self.physics.values.get(term.name, {}).get(parameter.name, parameter.neutral)
        up = self.change(term, {parameter.name: now + delta})
        down = self.change(term, {parameter.name: now - delta})
        return np.asarray((up - down) / (2.0 * delta))

"""The power of one block under a model, and how it changes when one term is set otherwise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fleetlog.core.motion import Motion
from fleetlog.core.truck import Truck
from fleetlog.physics.power import Physics, cell_power, drive_powers
from fleetlog.physics.term import Floats, Term, Values


@dataclass(frozen=True)
class Evaluation:
    """A motion under the physics of a model; where that changes with time, a mean over its phases.

    ``charge``: the channel is what the state of charge pays, not the power at the terminals; ``measured``
    (n,): that power where it is recorded too, so that the state of charge is judged against it.
    """

    recorded: Motion
    physics: Physics
    charge: bool = False
    measured: Floats | None = None

    @cached_property
    def phases(self) -> list[tuple[Floats, Evaluation]]:
        """Shares (n,) and the evaluations of what holds at one time or another."""
        found = self.physics.phases(self.recorded.time)
        return [(share, replace(self, physics=physics)) for share, physics in found]

    def _mean(self, value: Callable[[Evaluation], Floats]) -> Floats:
        return np.asarray(sum(share * value(e) for share, e in self.phases))

    @cached_property
    def truck(self) -> Truck:
        """With replaced values."""
        return self.physics.actual_truck()

    @cached_property
    def motion(self) -> Motion:
        """With the load that acts."""
        return self.physics.actual_motion(self.recorded)

    @cached_property
    def force(self) -> Floats:
        """(n,) total force against the motion [N]."""
        return self._mean(lambda e: e.force) if self.physics.own else self._sum("force")

    @cached_property
    def gain(self) -> Floats:
        """(n,) W at the battery for each newton of extra resistance."""
        drive = self.truck.drive
        return np.where(self.force >= 0.0, 1.0 / drive.efficiency, drive.regeneration) * self.motion.speed

    @cached_property
    def power(self) -> Floats:
        """(n,) the channel's power [W]."""
        if self.physics.own:
            return self._mean(lambda e: e.power)
        if self.measured is not None:
            return self._seen(self.measured)
        return self._seen(self._driven(self.force) + self._powers)

    @cached_property
    def mass(self) -> Floats:
        """(n,) truck and load [kg]."""
        return self.truck.chassis.mass + self.motion.payload

    @cached_property
    def _powers(self) -> Floats:
        return self._sum("power")

    def _sum(self, acts: str) -> Floats:
        total = np.zeros(len(self.motion))
        for term in self.physics.active():
            if term.acts == acts and term.function is not None:
                total = total + term.function(self.motion, self.truck, self.physics.values.get(term.name, {}))
        return total

    def _driven(self, force: Floats) -> Floats:
        drive = self.truck.drive
        conversion = np.where(force >= 0.0, 1.0 / drive.efficiency, drive.regeneration)
        by_force = drive_powers(self.recorded, self.physics, force).values()
        return np.asarray(sum(by_force, force * conversion * self.motion.speed))

    def _seen(self, terminal: Floats) -> Floats:
        """(n,) what the channel shows of terminal power: the charge is scaled to the nominal capacity."""
        if not self.charge:
            return terminal
        nominal = self.physics.truck.battery.capacity_wh
        return cell_power(terminal, self.truck) * (nominal / self.truck.battery.capacity_wh)

    def change(self, term: Term, setting: Values) -> Floats:
        """Return the channel's power with ``term`` set so (the rest as it is) minus that without."""
        if self.physics.own:
            return self._mean(lambda e: e.change(term, setting))
        before = self.physics.values.get(term.name, {})
        after = {**before, **setting}
        simple = term.acts in ("force", "power", "drive") and all(
            p.truck_key is None for p in term.parameters
        )
        if simple and term.function is not None and self.measured is None:
            return self._swapped(term, before, after)
        physics = Physics(self.physics.truck, {**self.physics.values, term.name: after})
        return Evaluation(self.recorded, physics, self.charge, self.measured).power - self.power

    def _swapped(self, term: Term, before: Values, after: Values) -> Floats:
        """Return the same where one term's force or power is all that changes: no need of the whole sum."""
        assert term.function is not None
        given = {"force": self.force} if term.acts == "drive" else {}
        new = term.function(self.motion, self.truck, {**after, **given})
        active = term.nominal or term.name in self.physics.values
        old = term.function(self.motion, self.truck, {**before, **given}) if active else np.zeros(len(new))
        if term.acts != "force":
            if not self.charge:
                return new - old
            return self._seen(self._driven(self.force) + self._powers + new - old) - self.power
        return self._seen(self._driven(self.force + new - old) + self._powers) - self.power

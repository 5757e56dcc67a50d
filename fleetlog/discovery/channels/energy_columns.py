"""The power of a block under a model, and how a window's energy changes with each number, field and curve."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.ndimage import uniform_filter1d
from scipy.special import ndtr

from fleetlog.core.arrays import Index
from fleetlog.core.motion import Motion
from fleetlog.core.truck import Truck, Watched
from fleetlog.discovery.channels.base import About
from fleetlog.discovery.hypotheses.cells import Stretches
from fleetlog.discovery.hypotheses.sources import UNIT, ErrorSource, FieldSource, FreeCurve, KnobSource
from fleetlog.discovery.recording.blocks import Cut, by_window
from fleetlog.physics.motion.reconstruction import SQUARE
from fleetlog.physics.power import ByTerm, Physics, acting, all_terms, cell_power
from fleetlog.physics.term import GRAVITY, Floats, Term, Values

STEP = 0.01  # Finite differences, of a range: large against rounding, small against the switch to braking


@dataclass(frozen=True)
class Evaluation:
    """A motion under the physics of a model; where that changes with time, a mean over its phases.
    ``charge``: the channel is what the state of charge pays, not the power at the terminals; ``measured``
    (n,): that power where it is recorded too, so that the state of charge is judged against it; ``known``
    what terms return, (n,) each, and the sections of the truck file that they read for it."""

    recorded: Motion
    physics: Physics
    charge: bool = False
    measured: Floats | None = None
    known: dict[str, tuple[Floats, set[str]]] = field(default_factory=dict)

    @cached_property
    def phases(self) -> list[tuple[Floats, Evaluation]]:
        """Shares (n,) and the evaluations of what holds at one time or another."""
        found = self.physics.phases(self.recorded.time)
        return [(share, replace(self, physics=physics, known={})) for share, physics in found]

    def _mean(self, value: Callable[[Evaluation], Floats]) -> Floats:
        return np.asarray(sum(share * value(e) for share, e in self.phases))

    @cached_property
    def truck(self) -> Truck:
        """With replaced values."""
        return self.physics.actual_truck

    @cached_property
    def motion(self) -> Motion:
        """With the load that acts."""
        return self.physics.actual_motion(self.recorded)

    @cached_property
    def force(self) -> Floats:
        """(n,) total force against the motion [N]."""
        return self._mean(lambda e: e.force) if self.physics.own else self._sum(self._forces)

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
        return self._seen(self._drawn + self._beside)

    @cached_property
    def mass(self) -> Floats:
        """(n,) truck and load [kg]."""
        return self.truck.chassis.mass + self.motion.payload

    @cached_property
    def _forces(self) -> ByTerm:
        return self._acting("force")

    @cached_property
    def _powers(self) -> ByTerm:
        return self._acting("power")

    def _acting(self, acts: str) -> ByTerm:
        terms = [(t.name, t, t.function) for t in self.physics.active if t.acts == acts and t.function]
        for name, term, function in (t for t in terms if t[0] not in self.known):
            truck = Watched(**vars(self.truck))
            told = function(self.motion, truck, self.physics.values_along(term, self.motion))
            self.known[name] = told, truck.read
        return {name: self.known[name][0] for name, *_ in terms}

    @cached_property
    def _drawn(self) -> Floats:
        return self._driven(self.force)

    @cached_property
    def _beside(self) -> Floats:
        return self._sum(self._powers)

    def _sum(self, by_term: ByTerm) -> Floats:
        total = np.zeros(len(self.recorded))
        for values in by_term.values():
            total += values
        return total

    def _driven(self, force: Floats) -> Floats:
        drive = self.truck.drive
        conversion = np.where(force >= 0.0, 1.0 / drive.efficiency, drive.regeneration)
        by_force = acting(self.motion, self.truck, self.physics, "drive", {"force": force}).values()
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
        simple = term.acts in ("force", "power", "drive") and not any(p.truck_key for p in term.parameters)
        if not simple or term.function is None or self.measured is not None:
            physics = Physics(self.physics.truck, {**self.physics.values, term.name: after})
            # A term that reads no section which changes returns what it did.
            parts = {p.truck_key.split(".")[0] for p in term.parameters if p.truck_key}
            same = {n: k for n, k in self.known.items() if n != term.name and not parts & k[1]}
            same = {} if term.acts == "load" else same
            return Evaluation(self.recorded, physics, self.charge, self.measured, same).power - self.power
        # One term's force or power is all that changes: no need of the whole sum.
        given = {"force": self.force} if term.acts == "drive" else {}
        new = term.function(self.motion, self.truck, {**after, **given})
        known = {"force": self._forces, "power": self._powers}.get(term.acts, {})
        active = term.nominal or term.name in self.physics.values
        if active and term.name not in known:
            known = {term.name: term.function(self.motion, self.truck, {**before, **given})}
        change = new - known[term.name] if active else new
        if term.acts == "force":
            return self._seen(self._driven(self.force + change) + self._beside) - self.power
        return self._seen(self._drawn + self._beside + change) - self.power if self.charge else change


@dataclass
class EnergyAbout(About):
    """What a model says of the energy of a block's windows, (W,) [kJ], and columns about it."""

    own: Cut
    e: Evaluation

    @cached_property
    def modelled(self) -> Floats:
        """The modelled energy, (W,) [kJ]."""
        return self.own.energy(self.e.power)

    def _knob(self, source: KnobSource) -> Floats:
        """Derivative where the vehicle's own number stands; of an effect with a shape, where it has none."""
        knob = source.knob
        term, parameter = all_terms()[knob.term], knob.definition
        now = self.model.in_force(knob, self.vehicle)
        low, high = sorted((parameter.scaled(parameter.low), parameter.scaled(parameter.high)))
        step = STEP * (high - low)
        step = -step if now + step > high else step
        change = self.e.change(term, {**dict(source.setting), parameter.name: parameter.value_of(now + step)})
        if source.setting and term.name in self.e.physics.values:
            change = change - self.e.change(term, dict(source.setting))
        elif self.e.physics.own:
            change = change - self.e.change(term, {parameter.name: parameter.value_of(now)})
        return self.own.energy(self._shared(knob.scope, change))[:, None] / step

    def _field(self, source: FieldSource) -> Floats:
        term, motion = source.physics, self.own.motion
        cells = self.channel.cells(term)
        slope = self._slope(term) if term else UNIT["moving"] * (motion.speed > 0.0).astype(float)
        energy = self._shared(source.scope, slope) * motion.dt * 1e-3
        total = sparse.csr_array((self.own.count, cells.size))  # A window touches few cells
        for number, weight in cells.parts(motion):
            on = number >= 0
            total += sparse.csr_array(((energy * weight)[on], (self.own.of[on], number[on])), total.shape)
        return np.asarray(total @ cells.root)

    def _slope(self, term: Term) -> Floats:
        """(n,) derivative of the channel's power with respect to a field's coordinate, where it is now."""
        first = term.parameters[0]
        delta = 1e-3 * abs(first.scaled(first.high) - first.scaled(first.low))
        now = np.asarray(self.e.physics.values.get(term.name, {}).get(first.name, first.neutral), dtype=float)
        at = 1.0 / now if first.inverse else now
        up, down = ((1.0 / (at + s * delta)) if first.inverse else at + s * delta for s in (1.0, -1.0))
        return (self.e.change(term, {first.name: up}) - self.e.change(term, {first.name: down})) / 2.0 / delta

    def _curve(self, curve: FreeCurve) -> Floats:
        weight, total = self._weights[curve.mode], np.zeros((self.own.count, curve.width))
        for column, share in curve.hats(self.state):
            total += by_window(self.own.of_row, column, weight * share, *total.shape)
        return total

    @cached_property
    def _weights(self) -> dict[str, Floats]:
        """(rows,) kJ that a coefficient of one adds, by the mode of a curve."""
        e, block, m = self.e, self.own.block, self.own.motion
        moving = (m.speed > 0.0).astype(float)
        power = {
            "force": UNIT["force"] * GRAVITY * e.mass * e.gain,
            "drive": UNIT["drive"] * np.maximum(e.force * e.gain, 0.0),
            "power": np.full(len(m), UNIT["power"]),
            "moving": UNIT["moving"] * moving,
            "still": UNIT["still"] * (1.0 - moving),
        }
        return {k: np.asarray(np.bincount(block.row, p * m.dt, len(block)) * 1e-3) for k, p in power.items()}

    def _error(self, source: ErrorSource) -> Floats:
        if source.vehicle not in (None, self.vehicle):
            return np.zeros((self.own.count, 1))
        change: Floats = getattr(self, f"_{source.name}")
        if source.road is not None:
            change = change * (self._road == source.road)
        return self.own.energy(change)[:, None]

    @cached_property
    def _road(self) -> Index:
        """(n,) the road of every sample."""
        cells = self.channel.cells(None)
        assert isinstance(cells, Stretches)
        return cells.road(self.own.motion.edge)

    @cached_property
    def _lag(self) -> Floats:
        """(n,) W that a clock one second late adds."""
        time = self.own.motion.time
        step = np.maximum(np.diff(time, prepend=time[0] - 1.0), 1e-3)
        return np.asarray(-np.diff(self.e.power, prepend=self.e.power[:1]) / step)

    @cached_property
    def _sampling(self) -> Floats:
        """(n,) W that the likeliest motion lacks of the expected power: braking at unseen accelerations."""
        return Evaluation(self.own.block.likeliest, self.e.physics, self.e.charge).power - self.e.power

    @cached_property
    def _load(self) -> Floats:
        """(n,) W that a kilogram of load adds."""
        heavier = self.own.motion.replaced(payload=self.own.motion.payload + 1.0)
        return Evaluation(heavier, self.e.physics, self.e.charge).power - self.e.power

    @cached_property
    def _doubt(self) -> Floats:
        """(n,) W less that the battery gives if no acceleration is real that is smaller than its error."""
        likeliest = self.own.block.likeliest.acceleration
        # Of the eight samples in turn that lie above and below it by its error
        variance = uniform_filter1d((self.own.motion.acceleration - likeliest) ** 2, 8) / SQUARE
        small = likeliest * np.exp(-0.5 * likeliest**2 / np.maximum(variance, 1e-12))
        return np.asarray(-self.e.mass * small * self.e.gain)

    @cached_property
    def _rounding(self) -> Floats:
        """(n,) 1 W at rest, forks going down: power is the same for long, and so is what rounding adds."""
        return np.asarray((self.own.motion.speed == 0.0) & (self.own.motion.lift_speed <= 0.0), float)

    @cached_property
    def _ripple(self) -> Floats:
        """(n,) W that the convex switch between traction and braking adds where power swings within rows."""
        drive = self.e.truck.drive
        swing = np.maximum(jumps(self.own, self.e)[self.own.of] * drive.efficiency, 1e-6)
        z = np.abs(self.e.force * self.e.motion.speed) / swing
        bend = (1.0 / drive.efficiency - drive.regeneration) * swing
        bend = bend * (np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi) - z * ndtr(-z))
        return np.asarray(np.where(self.e.motion.speed > 0.0, bend, 0.0))


def jumps(c: Cut, e: Evaluation) -> Floats:
    """Return the (windows,) root mean square of the residual power's second difference, scaled to that of
    white noise [W]; of three rows of one window each, as its neighbours may be held out."""
    r = np.nan_to_num(c.block.power - c.block.rows(e.power))
    inside = c.of_row[2:] == c.of_row[:-2]
    window, bend = c.of_row[1:-1][inside], (r[2:] - 2.0 * r[1:-1] + r[:-2])[inside] / np.sqrt(6.0)
    count = np.maximum(np.bincount(window, minlength=c.count), 1)
    return np.asarray(np.sqrt(np.bincount(window, bend**2, c.count) / count))

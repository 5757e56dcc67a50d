"""Columns of the energy channels: how a window's energy changes with each number, field and free curve."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import ndtr

from fleetlog.core.arrays import Floats
from fleetlog.discovery.channels.base import Channel, Columns, side_by_side
from fleetlog.discovery.channels.evaluate import Evaluation
from fleetlog.discovery.hypotheses.curves import UNIT, FreeCurve
from fleetlog.discovery.hypotheses.sources import ErrorSource, FieldSource, KnobSource, Source
from fleetlog.discovery.hypotheses.stretches import Stretches
from fleetlog.discovery.model import Model
from fleetlog.discovery.recording.blocks import Block
from fleetlog.discovery.recording.windows import Cut
from fleetlog.physics.power import all_terms
from fleetlog.physics.term import GRAVITY, Term

STEP = 0.01
"""Finite differences, as a share of a range: large against rounding, small against the switch to braking."""


@dataclass
class About:
    """Columns of a block about a model."""

    channel: Channel
    block: Block
    cut: Cut
    e: Evaluation
    model: Model

    def columns(self, sources: Sequence[Source]) -> Columns:
        """Return the columns of sources, (W, P)."""
        return side_by_side(sources, self._knob, self._field, self._curve, self._error)

    def _knob(self, source: KnobSource) -> Floats:
        """Derivative where the vehicle's own number stands; of an effect with a shape, where it has none."""
        knob, vehicle = source.knob, self.block.vehicle
        term, parameter = all_terms()[knob.term], knob.definition
        now = self.model.in_force(knob, vehicle)
        low, high = sorted((parameter.scaled(parameter.low), parameter.scaled(parameter.high)))
        step = STEP * (high - low)
        step = -step if now + step > high else step
        moved = {**dict(source.setting), parameter.name: parameter.value_of(now + step)}
        change = self.e.change(term, moved)
        if source.setting and term.name in self.e.physics.values:
            change = change - self.e.change(term, dict(source.setting))
        elif self.e.physics.own:
            change = change - self.e.change(term, {parameter.name: parameter.value_of(now)})
        if not knob.scope.whole:
            change = change * knob.scope.share(vehicle, self.block.motion.time)
        return self.cut.energy(self.block, change)[:, None] / step

    def _field(self, source: FieldSource) -> Floats:
        term, motion = source.physics, self.block.motion
        cells = self.channel.cells(term)
        slope = UNIT["moving"] * (motion.speed > 0.0) if term is None else self._slope(term)
        slope = slope * source.scope.share(self.block.vehicle, motion.time)
        total = np.zeros((self.cut.count, cells.size))
        for number, weight in cells.parts(motion):
            total += self.cut.energies(self.block, number, cells.size, slope * weight)
        return np.asarray(total @ cells.root)

    def _slope(self, term: Term) -> Floats:
        """(n,) derivative of the channel's power with respect to a field's coordinate, where it is now."""
        first = term.parameters[0]
        delta = 1e-3 * abs(first.scaled(first.high) - first.scaled(first.low))
        now = np.asarray(self.e.physics.values.get(term.name, {}).get(first.name, first.neutral), dtype=float)
        at = 1.0 / now if first.inverse else now
        up, down = ((1.0 / (at + s * delta)) if first.inverse else at + s * delta for s in (1.0, -1.0))
        return (self.e.change(term, {first.name: up}) - self.e.change(term, {first.name: down})) / (
            2.0 * delta
        )

    def _curve(self, curve: FreeCurve) -> Floats:
        weight = self._weights[curve.mode]
        total = np.zeros(self.cut.count * curve.width)
        for column, share in curve.hats(self._state):
            total += np.bincount(self.cut.of_row * curve.width + column, weight * share, len(total))
        return total.reshape(self.cut.count, curve.width)

    @cached_property
    def _state(self) -> dict[str, Floats]:
        return self.channel.state((self.block, self.cut))

    @cached_property
    def _weights(self) -> dict[str, Floats]:
        """(rows,) kJ that a coefficient of one adds, by the mode of a curve."""
        e, m = self.e, self.block.motion
        moving = (m.speed > 0.0).astype(float)
        power = {
            "force": UNIT["force"] * GRAVITY * e.mass * e.gain,
            "drive": UNIT["drive"] * np.maximum(e.force * e.gain, 0.0),
            "power": np.full(len(m), UNIT["power"]),
            "moving": UNIT["moving"] * moving,
            "still": UNIT["still"] * (1.0 - moving),
        }
        row, rows = self.block.row, len(self.block)
        return {k: np.asarray(np.bincount(row, p * m.dt, rows) * 1e-3, float) for k, p in power.items()}

    def _error(self, source: ErrorSource) -> Floats:
        change = {"lag": self._lagging, "ripple": self._rectified, "sampling": self._unseen}[source.name]()
        if source.road is not None:
            cells = self.channel.cells(None)
            assert isinstance(cells, Stretches)
            change = change * (cells.road(self.block.motion.edge) == source.road)
        return self.cut.energy(self.block, change)[:, None]

    def _lagging(self) -> Floats:
        """(n,) W that a clock one second late adds."""
        time = self.block.motion.time
        step = np.maximum(np.diff(time, prepend=time[0] - 1.0), 1e-3)
        return np.asarray(-np.diff(self.e.power, prepend=self.e.power[:1]) / step)

    def _unseen(self) -> Floats:
        """(n,) W that the likeliest motion lacks of the expected power: braking at unseen accelerations."""
        return Evaluation(self.block.likeliest, self.e.physics, self.e.charge).power - self.e.power

    def _rectified(self) -> Floats:
        """(n,) W that the convex switch between traction and braking adds where power swings within rows."""
        drive = self.e.truck.drive
        swing = np.maximum(jumps(self.block, self.cut, self.e)[self.cut.of_sample] * drive.efficiency, 1e-6)
        z = np.abs(self.e.force * self.e.motion.speed) / swing
        bend = (1.0 / drive.efficiency - drive.regeneration) * swing
        bend = bend * (np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi) - z * ndtr(-z))
        return np.asarray(np.where(self.e.motion.speed > 0.0, bend, 0.0))


def jumps(block: Block, c: Cut, e: Evaluation) -> Floats:
    """Return the (windows,) root mean square of the residual power's second difference, scaled to that of
    white noise [W]; of three rows of one window each, as its neighbours may be held out."""
    r = np.nan_to_num(block.power - block.rows(e.power))
    inside = c.of_row[2:] == c.of_row[:-2]
    window, bend = c.of_row[1:-1][inside], (r[2:] - 2.0 * r[1:-1] + r[:-2])[inside] / np.sqrt(6.0)
    count = np.maximum(np.bincount(window, minlength=c.count), 1)
    return np.asarray(np.sqrt(np.bincount(window, bend**2, c.count) / count))

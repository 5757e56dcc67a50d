"""The energy channels: what battery power, or the state of charge, adds up to over windows of some ten seconds."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from fleetlog.core.truck import Truck
from fleetlog.discovery.channels.base import Columns, Unit
from fleetlog.discovery.channels.evaluate import Evaluation
from fleetlog.discovery.hypotheses import curves
from fleetlog.discovery.hypotheses.curves import UNIT, FreeCurve
from fleetlog.discovery.hypotheses.sources import (
    CurveSource,
    ErrorSource,
    FieldSource,
    KnobSource,
    PlaceSource,
    Source,
)
from fleetlog.discovery.hypotheses.stretches import Cells
from fleetlog.discovery.model import Knob, Model
from fleetlog.discovery.recording import windows
from fleetlog.discovery.recording.blocks import Block
from fleetlog.discovery.recording.fleet import Fleet
from fleetlog.discovery.recording.windows import Cut
from fleetlog.physics.power import all_terms, battery_power
from fleetlog.physics.term import GRAVITY, Term

Floats = NDArray[np.float64]

STANDS, PASSING, LIFTS, LOADED = 0.9, 0.15, 250.0, 0.3
"""Share of a window from which on it is a standstill, and up to which it is none; power above the usual that shows
hydraulics [W]; a usual load that nobody weighed, as a share of the truck at most."""
UNUSUAL, SWING = 3.0, 0.03
"""Power that jumps by this many times what is usual leaves this share of a window's energy open, and its fourth power."""
CHARGING, LEAP = -300.0, 0.005
"""Power at a standstill below which a battery is being charged [W], and a rise of its charge from row to row."""
STEP = 0.01
"""Finite differences, as a share of a parameter's range: large against rounding, small against the switch to braking."""
ERRORS = (ErrorSource("sampling", 0.5), ErrorSource("ripple", 2.0), ErrorSource("lag", 0.15))
"""What sampling hides: accelerations between rows (0: what is expected, 1: what is likeliest), power that swings
within them (1: as far as from row to row), and a clock a little late [s]."""


@dataclass
class EnergyChannel:
    """One energy channel of a fleet; see :class:`fleetlog.discovery.channels.base.Channel`.

    ``measured``: the state of charge is judged against the recorded power; ``seconds`` of a window.
    """

    name: str
    fleet: Fleet
    base: Model
    seconds: float
    places: Cells | None
    measured: bool = False
    model_error: float = 0.01
    charge_step: float = 0.0
    """Step in which the state of charge is logged."""
    _kept: list[Unit] = field(default_factory=list)
    _passes: dict[str, NDArray[np.int64]] = field(default_factory=dict)
    _knots: dict[str, tuple[float, ...]] | None = None

    @property
    def metric(self) -> str:
        """What the error is."""
        return f"rms error of energy per {self.seconds:.0f} s window, over rms energy"

    @property
    def truck(self) -> Truck:
        """The nominal truck."""
        return self.fleet.truck

    @property
    def vehicles(self) -> tuple[str, ...]:
        """Names by code."""
        return self.fleet.vehicles

    def moments(self, count: int) -> Floats:
        """Return the (count + 1,) ends of as many slots of equal recorded time [s since 1970]."""
        return self.fleet.moments(count)

    def units(self) -> Iterator[Unit]:
        """Yield blocks with their windows; they stay in memory where the recording is small."""
        if self._kept:
            yield from self._kept
            return
        keep = self.fleet.rows <= self.fleet.most_in_memory
        made = []
        for block in self.fleet.each_block():
            unit = self._unit(block)
            if keep:
                made.append(unit)
            yield unit
        self._kept = made

    def _unit(self, block: Block) -> Unit:
        if self.measured:
            block = self._on_the_clock_of_charge(block)
        c = windows.cut(block, self.seconds)
        energy = _recorded(block, c, self.name, 3600.0 * self.truck.battery.capacity_wh)
        frame = windows.describe(block, c)
        whole = np.isfinite(energy) & self._seen_lifts(block, c, frame.duration, energy)
        # Both ends of a window are rounded to a step: its drop scatters by a sixth of the step's square.
        coarse = (self.charge_step * 3.6 * self.truck.battery.capacity_wh) ** 2 / 6.0
        noise = coarse + (np.zeros(c.count) if self.measured else self._uncertain(block, c))
        unit = Unit(frame, np.where(whole, energy, 0.0), whole, noise, energy, (block, c))
        return replace(unit, level=np.abs(self.predict(unit, self.base)))

    def _seen_lifts(self, block: Block, c: Cut, seconds: Floats, energy: Floats) -> NDArray[np.bool_]:
        """(W,) windows without hydraulics that nothing shows: a log without fork height has lifts at standstill all the same.

        Then only windows with hardly any standstill count, and standstills with their usual power.
        """
        lifting = self.truck.chassis.rated_load > 0.0 and not self.fleet.has("fork_height")
        if self.measured or not lifting:
            return np.ones(c.count, bool)
        share = c.energy(block, np.where(block.motion.speed <= 0.0, 1e3, 0.0)) / np.maximum(seconds, 1e-6)
        rate = 1e3 * np.nan_to_num(energy) / np.maximum(seconds, 1e-6)
        still = (share > STANDS) & np.isfinite(energy)
        if not still.any():
            return np.asarray(share < PASSING)
        # Lifting only adds to the power of a standstill.
        off = np.abs(rate - np.quantile(rate[still], 0.25))
        return np.asarray((share < PASSING) | (still & (off < LIFTS)))

    def _on_the_clock_of_charge(self, block: Block) -> Block:
        """The block with its power moved by its lag, where the state of charge then follows it better."""
        lag = self.fleet.lag.get(block.vehicle, 0.0)
        moved = np.interp(block.time + lag, block.time, block.power)
        paid = -np.diff(block.soc) * 3600.0 * self.truck.battery.capacity_wh
        off = [
            float(np.nansum((paid - 0.5 * (p[1:] + p[:-1]) * np.diff(block.time)) ** 2))
            for p in (block.power, moved)
        ]
        if lag == 0.0 or off[0] <= off[1]:
            return block
        return replace(block, power=moved, motion=block.motion.replaced(power=moved[block.row]))

    def _uncertain(self, block: Block, c: Cut) -> Floats:
        """(W,) variance that the uncertainty of the motion leaves to the nominal model [kJ2]."""
        e = self.evaluation(block, self.base)
        known = block.known.window_variance(lambda m: battery_power(m, e.physics), c.of_sample) * 1e-6
        known += self._unknown_load(block, c, e) ** 2
        if self.name == "soc":
            return known
        # Where power jumps from row to row far more than usual, the truck moves faster than the log resolves.
        jumps, moving = _jumps(block, c, e), c.energy(block, e.motion.speed) > 0.0
        usual = float(np.median(jumps[moving])) if moving.any() else 0.0
        wild = np.maximum(jumps / max(UNUSUAL * usual, 1e-9), 1.0) ** 4 if usual > 0.0 else np.ones(c.count)
        return np.asarray(known + (wild - 1.0) * (SWING * c.energy(block, e.power)) ** 2)

    def _unknown_load(self, block: Block, c: Cut, e: Evaluation) -> Floats:
        """(W,) what a usual load adds [kJ], where trucks carry loads that nobody recorded."""
        chassis = self.truck.chassis
        if self.fleet.has("payload") or not chassis.rated_load:
            return np.zeros(c.count)
        usual = min(0.5 * chassis.rated_load, LOADED * chassis.mass)
        heavier = block.motion.replaced(payload=block.motion.payload + usual)
        return c.energy(block, battery_power(heavier, e.physics) - battery_power(block.motion, e.physics))

    def evaluation(self, block: Block, model: Model) -> Evaluation:
        """Return a block under a model."""
        physics = model.physics(block.vehicle, block.motion, self.cells)
        measured = np.nan_to_num(block.motion.power) if self.measured else None
        return Evaluation(block.motion, physics, self.name == "soc", measured)

    def predict(self, unit: Unit, model: Model) -> Floats:
        """Return the modelled energy, (W,) [kJ]."""
        block, c = unit.own
        return np.asarray(c.energy(block, self.evaluation(block, model).power))

    def columns(self, unit: Unit, model: Model, sources: Sequence[Source]) -> tuple[Floats, Columns]:
        """Return the modelled energy, (W,), and kJ per unit of every source's coefficients, (W, P)."""
        block, c = unit.own
        e = self.evaluation(block, model)
        about = _About(self, block, c, e, model)
        parts = [about.columns(s) for s in sources]
        return c.energy(block, e.power), np.concatenate(parts, axis=1).astype(np.float32)

    def width(self, source: Source) -> int:
        """Return the number of columns of a source."""
        if isinstance(source, FieldSource):
            assert self.places is not None
            return int(self.places.root(all_terms()[source.term].odd).shape[1])
        if isinstance(source, PlaceSource):
            assert self.places is not None
            return int(self.places.root(False).shape[1])
        if isinstance(source, CurveSource):
            return source.curve.width
        return 1

    def cells(self, term: Term | None) -> Cells | None:
        """Return the cells of a field: the same for all; free power by place says nothing where power is measured."""
        return None if term is None and self.measured else self.places

    def terms(self) -> list[Term]:
        """Return the terms that change the energy of this channel."""
        acting = {"loss"} if self.measured else {"force", "power", "load", "truck"}
        if self.name == "soc":
            acting.add("loss")
        return [t for t in all_terms().values() if t.acts in acting and t.parameters and self._can_act(t)]

    def _can_act(self, term: Term) -> bool:
        return not term.field or self.places is not None

    def adjustable(self) -> list[Knob]:
        """Return every knob with a tolerance."""
        return [
            Knob(t.name, p.name)
            for t in self.terms()
            for p in t.parameters
            if p.allowance(self.truck) > 0.0 and not p.shape
        ]

    def errors(self) -> list[ErrorSource]:
        """Return what sampling hides; nothing where power is measured itself."""
        return [] if self.measured else list(ERRORS)

    def curves(self) -> list[FreeCurve]:
        """Return the free curves that the recording can carry."""
        if self._knots is None:
            self._knots = self._spans()
        if self.measured:
            return curves.charge_curves(self._knots, len(self.vehicles))
        return curves.energy_curves(
            self._knots, len(self.vehicles), len(self.fleet.dates), self.fleet.trip_names
        )

    def _spans(self) -> dict[str, tuple[float, ...]]:
        pooled: dict[str, list[Floats]] = {}
        for unit in self.units():
            for name, values in self.state(unit.own[0]).items():
                if name not in ("vehicle_id", "day", "trip_id", "heading"):
                    pooled.setdefault(name, []).append(values[::4])
        found = {n: curves.knots_of(np.concatenate(v), n) for n, v in pooled.items()}
        return {n: k for n, k in found.items() if k}

    def state(self, block: Block) -> dict[str, Floats]:
        """Return the recorded variables that a mismatch may follow, by row."""
        m = block.motion
        first = block.first
        return {
            "speed": block.rows(m.speed), "payload": m.payload[first], "acceleration": block.rows(m.acceleration),
            "curvature": block.rows(np.abs(m.curvature)), "ambient_temperature": m.ambient_temperature[first],
            "soc": block.soc, "time": (block.time / 3600.0) % 24.0,
            "time since start": (block.time - self.fleet.begins[block.vehicle, block.day]) / 3600.0,
            "lift_speed": block.rows(m.lift_speed), "heading": m.heading[first],
            "vehicle_id": np.full(len(block), float(block.vehicle)),
            "day": np.full(len(block), float(self.fleet.dates.index(block.day))),
            "trip_id": np.searchsorted(np.array(self.fleet.own_trips, np.int64), block.trip).astype(float),
        }  # fmt: skip

    def passes(self, term: Term) -> NDArray[np.int64]:
        """Return how many windows touch each value of a field, (C,)."""
        if term.name not in self._passes:
            self._passes[term.name] = self._touched(term)
        return self._passes[term.name]

    def _touched(self, term: Term) -> NDArray[np.int64]:
        assert self.places is not None
        size = self.places.size(term.odd)
        total = np.zeros(size, np.int64)
        for unit in self.units():
            block, c = unit.own
            for number, _ in self.places.parts(block.motion, term.odd):
                pairs = np.unique(c.of_sample[number >= 0] * size + number[number >= 0])
                total += np.bincount(pairs % size, minlength=size)
        return total

    def lost(self, model: Model) -> None:
        """Return nothing: energy does not tell who was in the way."""

    def features(self, unit: Unit, model: Model) -> Floats:
        """Return place, direction, load, pace, time and the nominal energy of every window: what makes two passes alike."""
        block, c = unit.own
        m, w = block.motion, unit.windows
        sample = (c.begin + np.append(c.begin[1:], len(m)) - 1) // 2
        moving = (w.distance > 0.2 * w.duration) * 1.0
        wide = np.maximum(w.duration, 1.0)
        lift = c.energy(block, np.maximum(m.lift_speed, 0.0) * (m.payload + 300.0) * GRAVITY)
        rise = c.energy(block, (self.truck.chassis.mass + m.payload) * m.acceleration * m.speed)
        tried = c.energy(block, (self.truck.chassis.mass + m.payload) * np.abs(m.acceleration) * m.speed)
        scale = max(float(np.sqrt(np.mean(unit.recorded**2))), 1e-9)
        return np.column_stack([
            np.nan_to_num(w.x) / 4.0 * moving, np.nan_to_num(w.y) / 4.0 * moving, np.cos(m.heading[sample])
            * moving,
            np.sin(m.heading[sample]) * moving, m.payload[sample] / 500.0, w.distance / wide / 0.5, wide / self.seconds * 3.0,
            rise / scale * 2.0, tried / scale * 2.0, lift / scale * 2.0,
            np.nan_to_num(m.ambient_temperature[sample]) / 4.0, w.time / (self.fleet.moments(1) @ [-1.0, 1.0]) * 3.0, w.vehicle * 3.0,
        ])  # fmt: skip


@dataclass
class _About:
    """Columns of a block about a model."""

    channel: EnergyChannel
    block: Block
    cut: Cut
    e: Evaluation
    model: Model

    def columns(self, source: Source) -> Floats:
        kinds: dict[type, Callable[[], Floats]] = {
            KnobSource: lambda: self._knob(source),  # type: ignore[arg-type]
            FieldSource: lambda: self._field(source),  # type: ignore[arg-type]
            CurveSource: lambda: self._curve(source.curve),  # type: ignore[union-attr]
            PlaceSource: self._place,
            ErrorSource: lambda: self._error(source),  # type: ignore[arg-type]
        }
        return kinds[type(source)]()

    def _knob(self, source: KnobSource) -> Floats:
        """Derivative about where the vehicle's own number stands; of an effect with a shape, about nothing at another shape."""
        knob, vehicle = source.knob, self.block.vehicle
        term, parameter = all_terms()[knob.term], knob.definition
        now = self.model.of_vehicle(knob, vehicle) + (
            self.model.coordinate(knob) if knob.scope.timed else 0.0
        )
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
        term, cells = all_terms()[source.term], self.channel.places
        assert cells is not None
        slope = self._slope(term) * source.scope.share(self.block.vehicle, self.block.motion.time)
        total = np.zeros((self.cut.count, cells.size(term.odd)))
        for number, weight in cells.parts(self.block.motion, term.odd):
            total += self.cut.energies(self.block, number, cells.size(term.odd), slope * weight)
        return np.asarray(total @ cells.root(term.odd))

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

    def _place(self) -> Floats:
        cells = self.channel.places
        assert cells is not None
        m = self.block.motion
        moving = np.asarray(UNIT["moving"] * (m.speed > 0.0), dtype=np.float64)
        total = np.zeros((self.cut.count, cells.size(False)))
        for number, weight in cells.parts(m, False):
            total += self.cut.energies(self.block, number, cells.size(False), moving * weight)
        return np.asarray(total @ cells.root(False))

    def _curve(self, curve: FreeCurve) -> Floats:
        weight = self._weights[curve.mode]
        total = np.zeros(self.cut.count * curve.width)
        for column, share in curve.hats(self._state):
            total += np.bincount(self.cut.of_row * curve.width + column, weight * share, len(total))
        return total.reshape(self.cut.count, curve.width)

    @property
    def _state(self) -> dict[str, Floats]:
        if not hasattr(self, "_states"):
            self._states = self.channel.state(self.block)
        return self._states

    @property
    def _weights(self) -> dict[str, Floats]:
        """(rows,) kJ that a coefficient of one adds, by the mode of a curve."""
        if not hasattr(self, "_by_mode"):
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
            self._by_mode = {
                k: np.asarray(np.bincount(row, p * m.dt, rows) * 1e-3, float) for k, p in power.items()
            }
        return self._by_mode

    def _error(self, source: ErrorSource) -> Floats:
        change = {"lag": self._lagging, "ripple": self._rectified, "sampling": self._unseen}[source.name]()
        return self.cut.energy(self.block, change)[:, None]

    def _lagging(self) -> Floats:
        """(n,) W that a clock one second late adds."""
        time = self.block.motion.time
        step = np.maximum(np.diff(time, prepend=time[0] - 1.0), 1e-3)
        return np.asarray(-np.diff(self.e.power, prepend=self.e.power[:1]) / step)

    def _unseen(self) -> Floats:
        """(n,) W that the likeliest motion lacks of the expected power: what the switch to braking makes of unseen accelerations."""
        return Evaluation(self.block.likeliest, self.e.physics, self.e.charge).power - self.e.power

    def _rectified(self) -> Floats:
        """(n,) W that the convex switch between traction and braking adds where power swings within rows."""
        drive = self.e.truck.drive
        swing = np.maximum(_jumps(self.block, self.cut, self.e)[self.cut.of_sample] * drive.efficiency, 1e-6)
        z = np.abs(self.e.force * self.e.motion.speed) / swing
        bend = (1.0 / drive.efficiency - drive.regeneration) * swing
        bend = bend * (np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi) - z * ndtr(-z))
        return np.asarray(np.where(self.e.motion.speed > 0.0, bend, 0.0))


def _jumps(block: Block, c: Cut, e: Evaluation) -> Floats:
    """(windows,) root mean square of the residual power's second difference, scaled to that of white noise [W]."""
    r = np.nan_to_num(block.power - block.rows(e.power))
    bend = np.zeros(len(r))
    bend[1:-1] = (r[2:] - 2.0 * r[1:-1] + r[:-2]) / np.sqrt(6.0)
    count = np.maximum(np.bincount(c.of_row, minlength=c.count), 1)
    return np.asarray(np.sqrt(np.bincount(c.of_row, bend**2, c.count) / count))


def _recorded(block: Block, c: Cut, channel: str, capacity: float) -> Floats:
    """(windows,) kJ that the channel shows; NaN where a row is missing or the battery was charged or swapped."""
    charged = _charged(block, c)
    if channel == "battery_power":
        energy = np.bincount(c.of_row, block.power * block.seconds, c.count) * 1e-3
        return np.asarray(np.where(charged, np.nan, energy), dtype=np.float64)
    first = np.flatnonzero(np.concatenate([[True], np.diff(c.of_row) != 0]))
    soc = block.soc
    # A row stands for the time around its stamp, so a window begins half way between two stamps.
    border = np.concatenate([soc[:1], 0.5 * (soc[first[1:] - 1] + soc[first[1:]]), soc[-1:]])
    return np.where(charged, np.nan, -np.diff(border) * capacity * 1e-3)


def _charged(block: Block, c: Cut) -> NDArray[np.bool_]:
    """(windows,) whether the battery took energy that no wheel gave: at a standstill, or by a leap of its charge."""
    m = block.motion
    still = (block.rows(m.speed) <= 0.0) & (np.abs(block.rows(m.lift_speed)) <= 0.0)
    leap = np.diff(block.soc, prepend=block.soc[:1]) > LEAP
    # The border of two windows lies between the rows of a leap: neither knows its end.
    taken = (still & (block.power < CHARGING)) | leap | np.append(leap[1:], False)
    return np.asarray(np.bincount(c.of_row, taken, c.count) > 0)

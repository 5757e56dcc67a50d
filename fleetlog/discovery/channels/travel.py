"""The speed channel: the time that stretches of a path took, against the quickest drive that limits, turns and truck allow."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.motion import Motion, join
from fleetlog.core.truck import Truck
from fleetlog.discovery.channels.base import Columns, Unit
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
from fleetlog.discovery.hypotheses.stretches import Stretches, make_stretches
from fleetlog.discovery.model import Knob, Model
from fleetlog.discovery.recording.blocks import Block
from fleetlog.discovery.recording.fleet import Fleet
from fleetlog.discovery.recording.windows import Windows
from fleetlog.discovery.settings import Settings
from fleetlog.physics.motion.legs import Leg, legs
from fleetlog.physics.power import Physics, all_terms, allowed_speed
from fleetlog.physics.term import Term

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]

SHORTEST = 8.0
"""A shorter leg says nothing of how fast one drives [m]."""
PURPOSE = 90.0
"""A longer standstill has a purpose of its own [s]."""
LOAD, LIFT = 25.0, 0.08
"""Change of payload [kg] and fork height [m] that show a purpose."""
SLOWEST = 0.05
"""Speed that every cap leaves [m/s]."""
STEP = 0.02
"""Finite differences, as a share of a parameter's range."""
ERRORS = (ErrorSource("setting off", 0.25), ErrorSource("stopping", 0.25), ErrorSource("slowing down", 0.25))
"""Nobody sets off, stops or takes a slow corner with the sharp bends of a profile of constant accelerations [s each]."""


@dataclass(frozen=True)
class Path:
    """Legs of a vehicle-day laid end to end: G nodes.

    ``motion`` (G,) with ``speed`` that road and truck allow; ``s`` (G,) [m]; ``inside`` (G,) whether the
    node has a
    predecessor in its leg; ``of`` (G,) window.
    """

    motion: Motion
    s: Floats
    inside: Mask
    of: Ints
    share: Floats
    """(G,) part of the passage of its lane that belongs to a step."""

    @property
    def last(self) -> Mask:
        """(G,) whether the node is the last of its leg."""
        return np.append(~self.inside[1:], True)


@dataclass
class TravelChannel:
    """Travel times of a fleet on its map; see :class:`fleetlog.discovery.channels.base.Channel`."""

    fleet: Fleet
    base: Model
    length: float
    roads: Stretches
    lanes: Stretches
    model_error: float
    name: str = "speed"
    _kept: list[Unit] = field(default_factory=list)
    _passes: dict[str, NDArray[np.int64]] = field(default_factory=dict)
    _knots: dict[str, tuple[float, ...]] | None = None

    @property
    def metric(self) -> str:
        """What the error is."""
        return f"rms error of the time for {self.length:.0f} m of path, over rms time"

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
        """Yield vehicle-days; their paths are small and stay in memory."""
        if not self._kept:
            made = (self._unit(block) for block in self.fleet.each_block())
            self._kept = [u for u in made if u is not None]
        yield from self._kept

    def _unit(self, block: Block) -> Unit | None:
        found = [(leg, _wait(block, leg, after)) for leg, after in _with_next(legs(block.known))]
        good = [
            (leg, wait)
            for leg, wait in found
            if leg.whole and leg.distance[-1] >= SHORTEST and (leg.path.edge >= 0).all()
        ]
        if not good:
            return None
        path, windows, recorded = self._laid_out(block, good)
        unit = Unit(windows, recorded, recorded > 0.0, np.zeros(len(recorded)), recorded, path)
        return replace(unit, level=self.predict(unit, self.base))

    def _laid_out(self, block: Block, found: list[tuple[Leg, float]]) -> tuple[Path, Windows, Floats]:
        size = np.array([len(leg.distance) for leg, _ in found])
        motion = join([leg.path for leg, _ in found])
        inside = np.ones(len(motion), bool)
        inside[np.concatenate([[0], np.cumsum(size)[:-1]])] = False
        base = np.cumsum([0.0, *(leg.distance[-1] + 1.0 for leg, _ in found)])
        s = np.concatenate([leg.distance + b for (leg, _), b in zip(found, base, strict=False)])
        of = _windows(found, self.length)
        network = self.fleet.network
        assert network is not None
        limit = np.nan_to_num(network.speed_limit, nan=np.inf)[motion.edge]
        seconds = np.where(inside, np.diff(motion.time, prepend=motion.time[:1]), 0.0)
        recorded = np.asarray(np.bincount(of, seconds), dtype=np.float64)
        ends = of[np.cumsum(size) - 1]
        np.add.at(recorded, ends, np.array([w for _, w in found]))
        motion = motion.replaced(
            speed=limit, time=motion.time + block.time[0], vehicle=np.full(len(motion), block.vehicle)
        )
        metres = np.asarray(
            np.bincount(of, np.where(inside, np.diff(s, prepend=s[:1]), 0.0)), dtype=np.float64
        )
        middle = np.searchsorted(of, np.arange(len(recorded))) + np.bincount(of) // 2
        windows = Windows(
            trip=block.trip[np.concatenate([leg.row for leg, _ in found])[middle]],
            vehicle=motion.vehicle[middle],
            day=np.full(len(middle), block.day), edge=motion.edge[middle].astype(np.int64), duration=np.maximum(metres, 0.5),
            distance=metres, x=motion.x[middle], y=motion.y[middle], time=motion.time[middle],
        )  # fmt: skip
        share = _shares(
            self.lanes,
            motion,
            np.where(inside, np.diff(s, prepend=s[:1]), 0.0),
            inside,
            [w for _, w in found],
        )
        return Path(motion, s, inside, of, share), windows, recorded

    def seconds(self, path: Path, physics: Physics) -> tuple[Floats, Mask]:
        """Return the time of the step to each node, (G,) [s], and whether a cap holds the speed down there."""
        from fleetlog.physics.motion.kernels.profile import clock, passes

        if physics.own:
            parts = [(w, *self.seconds(path, p)) for w, p in physics.phases(path.motion.time)]
            held = np.any([capped & (w > 0.5) for w, _, capped in parts], axis=0)
            return np.asarray(sum(w * time for w, time, _ in parts)), held
        truck = physics.actual_truck()
        drive = truck.drive
        allowed = np.minimum(path.motion.speed * drive.speed_factor, drive.max_speed)
        cap = np.maximum(
            np.minimum(allowed, allowed_speed(path.motion.replaced(speed=allowed), physics)), SLOWEST
        )
        ends = ~path.inside | path.last
        mass = truck.chassis.mass + path.motion.payload
        speed = passes(
            path.s, np.where(ends, 0.0, cap), path.motion.slope, mass, drive.max_acceleration,
            drive.max_deceleration,
            drive.max_power, truck.resistance.rolling,
        )  # fmt: skip
        time = clock(path.s, speed, np.zeros(len(cap)), drive.max_acceleration, drive.max_deceleration)
        return np.where(path.inside, np.diff(time, prepend=0.0), 0.0), (speed > 0.97 * cap) & path.inside

    def predict(self, unit: Unit, model: Model) -> Floats:
        """Return the modelled time, (W,) [s]."""
        path = unit.own
        seconds, _ = self.seconds(path, model.physics(int(path.motion.vehicle[0]), path.motion, self.cells))
        return _summed(path, seconds + self._waits(path, model))

    def _waits(self, path: Path, model: Model) -> Floats:
        total = np.zeros(len(path.s))
        for name, deviation in model.fields.items():
            term = all_terms()[name]
            if term.acts == "wait":
                m = path.motion
                there = model.share(name, int(m.vehicle[0]), m.time)
                total += np.maximum(deviation, 0.0)[self.lanes.at(m)[0]] * path.share * there
        return total

    def columns(self, unit: Unit, model: Model, sources: Sequence[Source]) -> tuple[Floats, Columns]:
        """Return the modelled time, (W,), and seconds per unit of every source's coefficients, (W, P)."""
        path = unit.own
        vehicle = int(path.motion.vehicle[0])
        physics = model.physics(vehicle, path.motion, self.cells)
        about = _About(self, path, model, physics, vehicle, *self.seconds(path, physics))
        parts = [about.columns(s) for s in sources]
        modelled = _summed(path, about.seconds + self._waits(path, model))
        return modelled, np.concatenate(parts, axis=1).astype(np.float32)

    def width(self, source: Source) -> int:
        """Return the number of columns of a source."""
        if isinstance(source, FieldSource):
            return len(self.cells(all_terms()[source.term]))
        if isinstance(source, PlaceSource):
            return len(self.roads)
        return source.curve.width if isinstance(source, CurveSource) else 1

    def cells(self, term: Term | None) -> Stretches:
        """Return the cells of a field: of roads, or of each direction of them."""
        return self.lanes if term is not None and term.one_way else self.roads

    def terms(self) -> list[Term]:
        """Return the terms that change travel times."""
        return [t for t in all_terms().values() if t.acts in ("speed", "wait") and t.parameters]

    def adjustable(self) -> list[Knob]:
        """Return every knob with a tolerance."""
        return [
            Knob(t.name, p.name) for t in self.terms() for p in t.parameters if p.allowance(self.truck) > 0.0
        ]

    def errors(self) -> list[ErrorSource]:
        """Return what a profile of constant accelerations misses."""
        return list(ERRORS)

    def curves(self) -> list[FreeCurve]:
        """Return the free curves that the recording can carry."""
        if self._knots is None:
            pooled: dict[str, list[Floats]] = {}
            for unit in self.units():
                for name, values in self.state(unit.own).items():
                    if name not in ("vehicle_id", "heading"):
                        pooled.setdefault(name, []).append(values[::4])
            found = {n: curves.knots_of(np.concatenate(v), n) for n, v in pooled.items()}
            self._knots = {n: k for n, k in found.items() if k}
        return curves.time_curves(self._knots, len(self.vehicles))

    def state(self, path: Path) -> dict[str, Floats]:
        """Return the recorded variables that a mismatch may follow, by node."""
        m = path.motion
        return {
            "payload": m.payload, "time": (m.time / 3600.0) % 24.0, "soc": m.soc,
            "ambient_temperature": m.ambient_temperature, "speed": np.minimum(m.speed, self.truck.drive.max_speed),
            "curvature": np.abs(m.curvature), "heading": m.heading, "vehicle_id": m.vehicle.astype(float),
        }  # fmt: skip

    def passes(self, term: Term) -> NDArray[np.int64]:
        """Return how many windows touch each value of a field, (C,)."""
        if term.name not in self._passes:
            self._passes[term.name] = self._touched(term)
        return self._passes[term.name]

    def _touched(self, term: Term) -> NDArray[np.int64]:
        cells = self.cells(term)
        total = np.zeros(len(cells), np.int64)
        for unit in self.units():
            number = cells.at(unit.own.motion)[0]
            pairs = np.unique(unit.own.of * len(cells) + number)
            total += np.bincount(pairs % len(cells), minlength=len(cells))
        return total

    def features(self, unit: Unit, model: Model) -> Floats:
        """Return place, direction, load and the modelled time of every window: what makes two passes alike."""
        path, w = unit.own, unit.windows
        middle = np.searchsorted(path.of, np.arange(len(w))) + np.bincount(path.of) // 2
        m = path.motion
        time = self.predict(unit, model)
        return np.column_stack([
            w.x / 2.0, w.y / 2.0, 2.0 * np.cos(m.heading[middle]), 2.0 * np.sin(m.heading[middle]),
            m.payload[middle] / 500.0,
            time / max(float(np.sqrt(np.mean(time**2))), 1e-9) * 4.0, w.vehicle * 3.0,
        ])  # fmt: skip


@dataclass
class _About:
    """Columns of a path about a model."""

    channel: TravelChannel
    path: Path
    model: Model
    physics: Physics
    vehicle: int
    seconds: Floats
    capped: Mask

    def columns(self, source: Source) -> Floats:
        kinds: dict[type, Callable[[], Floats]] = {
            KnobSource: lambda: self._knob(source),  # type: ignore[arg-type]
            FieldSource: lambda: self._field(source),  # type: ignore[arg-type]
            CurveSource: lambda: self._curve(source.curve),  # type: ignore[union-attr]
            PlaceSource: self._place,
            ErrorSource: lambda: self._moments(source.name),  # type: ignore[union-attr]
        }
        return kinds[type(source)]()

    def _knob(self, source: KnobSource) -> Floats:
        knob = source.knob
        term, p = all_terms()[knob.term], knob.definition
        now = self.model.of_vehicle(knob, self.vehicle)
        now += self.model.coordinate(knob) if knob.scope.timed else 0.0
        low, high = sorted((p.scaled(p.low), p.scaled(p.high)))
        step = STEP * min(high - low, 4.0 * abs(now))
        times = [
            self._set(term, {**dict(source.setting), p.name: p.value_of(now + s * step)}) for s in (1.0, -1.0)
        ]
        change = times[0] - times[1]
        if not knob.scope.whole:
            change = change * knob.scope.share(self.vehicle, self.path.motion.time)
        return _summed(self.path, change)[:, None] / (2.0 * step)

    def _set(self, term: Term, setting: dict[str, float]) -> Floats:
        phases = self.physics.phases(self.path.motion.time)
        return np.asarray(
            sum(w * self.channel.seconds(self.path, p.changed({term.name: setting}))[0] for w, p in phases)
        )

    def _field(self, source: FieldSource) -> Floats:
        term = all_terms()[source.term]
        cells, there = self.channel.cells(term), source.scope.share(self.vehicle, self.path.motion.time)
        if term.acts == "wait":
            return self._by_cell(cells, self.path.share * there) @ cells.root(False)
        first = term.parameters[0]
        now = np.asarray(self.physics.values.get(term.name, {}).get(first.name, first.neutral), dtype=float)
        # Where a cap binds, time goes with the inverse of the share of it that is driven.
        slope = np.where(self.capped, self.seconds * now, 0.0)
        return np.asarray(self._by_cell(cells, slope * there) @ cells.root(term.odd))

    def _place(self) -> Floats:
        roads = self.channel.roads
        return np.asarray(self._by_cell(roads, UNIT["time"] * self.seconds) @ roads.root(False))

    def _by_cell(self, cells: Stretches, values: Floats) -> Floats:
        return self._sorted(cells.at(self.path.motion)[0].astype(np.int64), len(cells), values)

    def _sorted(self, column: Ints, count: int, values: Floats) -> Floats:
        windows = int(self.path.of[-1]) + 1
        total = np.bincount(self.path.of * count + column, values, windows * count)
        return np.asarray(total.reshape(windows, count), dtype=np.float64)

    def _curve(self, curve: FreeCurve) -> Floats:
        parts = [
            self._sorted(column, curve.width, UNIT["time"] * self.seconds * share)
            for column, share in curve.hats(self.channel.state(self.path))
        ]
        return np.asarray(np.sum(parts, axis=0))

    def _moments(self, name: str) -> Floats:
        step = np.diff(self.path.s, prepend=self.path.s[:1])
        pace = np.where(self.path.inside, self.seconds / np.maximum(step, 1e-9), 0.0)
        dip = (
            self.path.inside
            & (pace >= np.roll(pace, 1))
            & (pace > np.roll(pace, -1))
            & ~np.roll(~self.path.inside, 1)
        )
        which = {
            "setting off": ~self.path.inside,
            "stopping": self.path.last,
            "slowing down": dip & ~self.path.last,
        }[name]
        return _summed(self.path, which.astype(float))[:, None]


def _shares(lanes: Stretches, motion: Motion, step: Floats, inside: Mask, waits: list[float]) -> Floats:
    """(G,) part of the passage of a lane that each step is; the parts of a passage add up to one.

    Of a passage with a stop on the way all belongs to the window that ends in the stop, whose time has the wait.
    """
    lane = lanes.at(motion)[0]
    begin = np.flatnonzero(~inside)
    run = np.cumsum((np.diff(lane, prepend=-1) != 0) | ~inside) - 1
    passage, stop = np.arange(int(run[-1]) + 1), np.full(int(run[-1]) + 1, -1)
    for k in range(len(begin) - 1):
        start, end = begin[k + 1], begin[k + 1] - 1
        if waits[k] > 0.0 and lane[start] == lane[end]:
            passage[run[start]] = passage[run[end]]
            stop[passage[run[end]]] = end
    of = passage[run]
    share = step / np.maximum(np.bincount(of, step, len(passage)), 1e-9)[of]
    share[stop[of] >= 0] = 0.0
    share[stop[stop >= 0]] = 1.0
    return np.asarray(share)


def _summed(path: Path, values: Floats) -> Floats:
    return np.asarray(np.bincount(path.of, values, int(path.of[-1]) + 1), dtype=np.float64)


def _windows(found: list[tuple[Leg, float]], length: float) -> Ints:
    """(G,) window of each node: ``length`` metres of one leg; the last takes the rest."""
    out, base = [], 0
    for leg, _ in found:
        parts = max(int(leg.distance[-1] // length), 1)
        out.append(base + np.minimum((leg.distance // length).astype(np.int64), parts - 1))
        base += parts
    return np.concatenate(out)


def _with_next(found: list[Leg]) -> Iterator[tuple[Leg, Leg | None]]:
    yield from zip(found, [*found[1:], None], strict=True)


def _wait(block: Block, leg: Leg, after: Leg | None) -> float:
    """Seconds of the standstill after a leg; 0 where it served a purpose, or nothing tells whether it did."""
    if after is None or not np.isfinite(leg.wait) or leg.wait > PURPOSE:
        return 0.0
    m = block.motion
    if not m.payload.any() and not m.fork_height.any():
        return 0.0
    rows = block.first[leg.row[-1] : after.row[0] + 2]
    worked = len(rows) and (np.ptp(m.payload[rows]) > LOAD or np.ptp(m.fork_height[rows]) > LIFT)
    return 0.0 if worked else float(leg.wait)


def travel_channel(fleet: Fleet, base: Model, settings: Settings) -> TravelChannel:
    """Return the travel times of a fleet with a map."""
    assert fleet.network is not None
    return TravelChannel(
        fleet,
        base,
        settings.stretch,
        make_stretches(fleet.network),
        make_stretches(fleet.network, apart=True),
        settings.profile_error,
    )

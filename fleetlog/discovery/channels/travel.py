"""The speed channel: the time that stretches of a path took, against the quickest drive allowed; and how that
time changes with each number, field and free curve."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from fleetlog.core.arrays import Floats, Index, Ints, Mask
from fleetlog.core.words import count
from fleetlog.discovery.channels import paths
from fleetlog.discovery.channels.base import About, Channel, Columns, R, Unit
from fleetlog.discovery.channels.paths import Laid, Lost, Passed, Path
from fleetlog.discovery.channels.waits import Waits, stands
from fleetlog.discovery.hypotheses import sources
from fleetlog.discovery.hypotheses.cells import Stretches, make_stretches
from fleetlog.discovery.hypotheses.sources import UNIT, ErrorSource, FieldSource, FreeCurve, KnobSource
from fleetlog.discovery.model import Model
from fleetlog.discovery.recording.blocks import Block, by_window
from fleetlog.discovery.recording.conflicts import route
from fleetlog.discovery.recording.shelf import Shelf
from fleetlog.discovery.recording.splits import HELD_OUT
from fleetlog.discovery.recording.turns import Pass, Turns, Way, crossings, measure
from fleetlog.discovery.settings import Settings
from fleetlog.physics.motion.legs import quickest
from fleetlog.physics.power import Physics, all_terms
from fleetlog.physics.term import Term

GATHERS = 2.5  # The profile's error makes up so much more at some places: 6 % at most on clean recordings
ERRORS = (
    *(ErrorSource(name, 0.25, unit="s") for name in ("setting off", "stopping", "slowing down")),
    *(ErrorSource(name, 0.5) for name in ("kinks", "limits")),
)
"""Nobody sets off, stops or takes a slow corner as sharply as constant accelerations would [s each].  How far
trucks follow the kinks of the map's line no positions show (0: they drive curves, 1: every kink), nor where
about a junction one limit gives way to the next (0: where the lines meet, 1: their mean holds all across)."""
Told = tuple[list[tuple[Way, Pass]], Floats]
STEP = 0.02  # Finite differences, as a share of a parameter's range


def drive_times(path: Path, physics: Physics) -> tuple[Floats, Mask]:
    """Return the time of the step to each node, (G,) [s], and whether a cap holds the speed down there."""
    if physics.own:
        parts = [(w, *drive_times(path, p)) for w, p in physics.phases(path.motion.time)]
        held = np.any([capped & (w > 0.5) for w, _, capped in parts], axis=0)
        return np.asarray(sum(w * time for w, time, _ in parts)), held
    ends = ~path.inside | path.last
    speed, time, cap = quickest(path.s, path.motion, physics, ends, np.zeros(len(ends)))
    return np.where(path.inside, np.diff(time, prepend=0.0), 0.0), (speed > 0.97 * cap) & path.inside


@dataclass
class TravelAbout(About):
    """What a model says of the time that the windows of a path take, (W,) [s], and columns about it."""

    channel: "TravelChannel"
    own: Path
    physics: Physics
    waits: Floats  # (G,) seconds of standing at every node that belong to the place

    @cached_property
    def modelled(self) -> Floats:
        """The modelled time, (W,) [s]; of windows in which only the standing counts, that."""
        return self.own.summed(np.where(self.own.apart[self.own.of], 0.0, self.seconds) + self.waits)

    def columns(self, sources: Sequence[sources.Source]) -> Columns:
        """Return the columns of sources, (W, P): where only the standing counts, waits alone."""
        out, terms = super().columns(sources), [getattr(s, "physics", None) for s in sources]
        waits = [t is not None and t.waits for t in terms]
        out[np.ix_(self.own.apart, ~np.repeat(waits, [self.channel.width(s) for s in sources]))] = 0.0
        return out

    @property
    def seconds(self) -> Floats:
        """The time of the step to each node, (G,) [s], waits left out."""
        return self._times[0]

    @cached_property
    def _times(self) -> tuple[Floats, Mask]:
        return drive_times(self.own, self.physics)

    def _knob(self, source: KnobSource) -> Floats:
        knob = source.knob
        term, p = all_terms()[knob.term], knob.definition
        now = self.model.in_force(knob, self.vehicle)
        low, high = sorted((p.scaled(p.low), p.scaled(p.high)))
        ends = [now + STEP * min(high - low, 4.0 * abs(now)), now]
        if p.reach and now == p.scaled(p.neutral):
            ends[0] = p.scaled(p.neutral - p.reach)
        there, here = ({**dict(source.setting), p.name: p.value_of(e)} for e in ends)
        # What holds now is known, but where other numbers or hours have their own.
        known = self._set(term, here) if source.setting or self.physics.own else self.seconds
        change = self._shared(knob.scope, self._set(term, there) - known)
        return np.asarray(self.own.summed(change)[:, None] / (ends[0] - ends[1]))

    def _set(self, term: Term, given: dict[str, float]) -> Floats:
        phases = self.physics.phases(self.own.motion.time)
        return np.asarray(sum(w * drive_times(self.own, p.changed({term.name: given}))[0] for w, p in phases))

    def _field(self, source: FieldSource) -> Floats:
        term, cells = source.physics, self.channel.cells(source.physics)
        place: Index | Ints = cells.at(self.own.motion)[0]
        if term is None:
            slope = UNIT["time"] * self.seconds
        elif term.waits:
            place = self.channel.waits.place[place]
            slope = self._shared(source.scope, np.asarray(self.own.share, float))
        else:
            first = term.parameters[0]
            now = np.asarray(self.physics.values.get(term.name, {}).get(first.name, first.neutral), float)
            # Where a cap binds, time goes with the inverse of the share of it that is driven.
            slope = self._shared(source.scope, np.where(self._times[1], self.seconds * now, 0.0))
        return by_window(self.own.of, place, slope, self.own.count, len(cells)) @ cells.root

    def _curve(self, curve: FreeCurve) -> Floats:
        time, total = UNIT["time"] * self.seconds, np.zeros((self.own.count, curve.width))
        for column, share in curve.hats(self.state):
            total += by_window(self.own.of, column, time * share, *total.shape)
        return total

    def _error(self, source: ErrorSource) -> Floats:
        if source.name in ("kinks", "limits"):
            return self._otherwise(source.name == "kinks")[:, None]
        step = np.diff(self.own.s, prepend=self.own.s[:1])
        pace = np.where(self.own.inside, self.seconds / np.maximum(step, 1e-9), 0.0)
        inside, last = self.own.inside, self.own.last
        dip = inside & np.roll(inside, 1) & (pace >= np.roll(pace, 1)) & (pace > np.roll(pace, -1))
        which = {"setting off": ~inside, "stopping": last, "slowing down": dip & ~last}[source.name]
        return self.own.summed(which.astype(float))[:, None]

    def _otherwise(self, kinks: bool) -> Floats:
        """(W,) seconds that following every kink of the map's line adds, or sharing limits at junctions."""
        motion, limit = self.own.motion, self.own.across
        if not (self.own.kink.any() if kinks else (limit != motion.speed).any()):
            return np.zeros(self.own.count)
        bend = np.maximum(np.abs(motion.curvature), self.own.kink)
        other = motion.replaced(curvature=bend) if kinks else motion.replaced(speed=limit)
        return self.own.summed(drive_times(replace(self.own, motion=other), self.physics)[0] - self.seconds)


@dataclass
class TravelChannel(Channel):
    """Travel times of a fleet on its map; see :class:`fleetlog.discovery.channels.base.Channel`."""

    settings: Settings
    turns: Turns = field(default_factory=lambda: Turns({}, 0.0), init=False)
    waits: Waits = field(init=False)
    driven: Shelf = field(default_factory=Shelf, init=False)  # The paths of dates, and then their units
    _learnt: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        network = self.fleet.network
        assert network is not None
        self.roads, self.lanes = make_stretches(network), make_stretches(network, apart=True)
        self.metric = f"rms error of the time for {self.settings.stretch:.0f} m of path, over rms time"
        self.errors = list(ERRORS)
        # Who gathers speed is off an even course by a dt^2 / 8 between rows, half of it on average.
        unseen = self.fleet.truck.drive.max_acceleration * self.fleet.steps**2 / 16.0
        self.own_error = np.maximum(self.settings.profile_error, unseen / self.settings.stretch)
        self.gathers, self.sparse = GATHERS, self.fleet.sparse(self.settings.window)
        self.bends = False  # Travel times are linear in the coordinates of their numbers

    def look(self, number: int, block: Block) -> None:
        """Keep the route of a vehicle-day."""
        if (r := route(block)) is not None:
            self.shelf.put(str(block.day), number, r)

    def prepare(self) -> None:
        """Have the windows of all dates at hand, and know how turns are driven and where trucks wait."""
        super().prepare()
        if not self._learnt:
            self.learn(list(self.fleet.each(self.close)))

    def close(self, date: int) -> Told:
        """Keep the paths of a date; return what trucks show of turns and of places where they wait."""
        numbers = super().numbers(date)
        turns, found = list[tuple[Way, Pass]](), list[Laid]()
        group = [self.shelf.get(str(date), number) for number in numbers]
        own = self.settings
        share = own.sample * own.window / self.fleet.seconds  # So many windows tell how turns are driven
        ways = paths.laid_out(group, self.fleet, self.split, self.lanes, own.stretch, share) if group else ()
        for number, (laid, undisturbed) in zip(numbers, ways, strict=True):
            if self.fleet.days[number].vehicle in self.sparse:
                continue
            turns += crossings(undisturbed)
            if laid is not None:
                found.append(laid)
                self.driven.put(str(date), number, laid)
        self.driven.end(str(date))
        self.shelf.drop(str(date))
        seen = [(whole | p.apart) & (self.split.fold(w) != HELD_OUT) for p, w, _, whole in found]
        return turns, stands(found, seen, self.lanes)

    def learn(self, told: list[Any]) -> None:
        """Learn how turns are driven, where trucks wait, and how waits scatter."""
        self.turns = measure([one for turns, _ in told for one in turns], self.fleet.truck)
        stops, *by_place = np.sum([stood for _, stood in told], axis=0)
        self.waits = Waits(self.lanes, stops, np.array(by_place))
        if alone := int(stops[~self.waits.here[self.waits.place]].sum()):
            self.notes = [f"speed: left out at least {count(alone, 'stop')} where others do not wait"]
        self._learnt = True

    def numbers(self, date: int) -> list[int]:
        """Return the numbers of its vehicle-days that have paths."""
        if not self.driven.has(str(date)):  # Of a worker on another machine
            self.close(date)
        return self.driven.numbers(str(date))

    def of(self, date: int) -> Iterator[Unit]:
        """Yield the units of a date, made of its paths once turns and places to wait are known."""
        for number in self.numbers(date):
            if not isinstance(unit := self.driven.get(str(date), number), Unit):
                self.driven.put(str(date), number, unit := self._unit(unit))
            yield unit

    def _unit(self, laid: Laid) -> Unit:
        path, windows, recorded, whole = laid
        place = self.waits.at(path)
        noise, here = np.zeros(len(recorded)), self.waits.here[place]
        np.maximum.at(noise, path.of, np.where(here, self.waits.scatter[place], 0.0))
        m, back = path.motion, self.roads.network.reverse
        driven = self.turns.along(path.s, m.edge, m.curvature, path.inside, back)
        share = path.passages(place, self.waits.size)[2] * here
        alone, waiting = path.alone(place), path.summed(here.astype(float)) > 0.0
        # Driving slowly is no standing: where trucks wait, of who stood only that counts.
        stood = whole & (path.summed(path.standing * here) > 0.0)
        # Where nobody else waits, it is no time of the road.
        whole = whole & (stood | (path.summed(path.standing) == 0.0)) & (alone | ~waiting)
        apart = (path.apart & waiting | stood) & alone
        path = replace(path, motion=path.motion.replaced(curvature=driven), share=share, apart=apart)
        nominal = self.about(path, self.base)
        level = path.summed(nominal.seconds + nominal.waits)
        recorded = np.where(apart, path.summed(path.standing), recorded)
        swing, fold = np.ones(len(recorded)), self.split.fold(windows)
        return Unit(windows, recorded, whole | apart, noise, level, swing, fold, path)

    def about(self, own: Path, model: Model) -> TravelAbout:
        """Return what a model says of a path, (W,) [s], and columns about it."""
        vehicle, m, waits = int(own.motion.vehicle[0]), own.motion, np.zeros(len(own.s))
        for name, deviation in model.fields.items():
            if all_terms()[name].waits:
                there = model.share(name, vehicle, m.time)
                waits += np.maximum(deviation, 0.0)[self.waits.at(own)] * own.share * there
        return TravelAbout(self, own, model, model.physics(vehicle, m, self.cells), waits)

    def cells(self, term: Term | None) -> Stretches:
        """Return the cells of a field: of roads, or of each direction of them."""
        found = self.lanes if term is not None and term.one_way else self.roads
        return replace(found, odd=term is not None and term.odd)

    def terms(self) -> list[Term]:
        """Return the terms that change travel times."""
        return [t for t in all_terms().values() if t.acts in ("speed", "wait") and t.parameters]

    def curves(self) -> list[FreeCurve]:
        """Return the free curves that the recording can carry."""
        return sources.time_curves(self.knots(self.units()), len(self.fleet.vehicles))

    def state(self, own: Path) -> dict[str, Floats]:
        """Return the recorded variables that a mismatch may follow, by node."""
        m = own.motion
        return {
            "payload": m.payload, "time": (m.time / 3600.0) % 24.0, "soc": m.soc,
            "ambient_temperature": m.ambient_temperature, "speed": np.minimum(m.speed,
            self.fleet.truck.drive.max_speed),
            "curvature": np.abs(m.curvature), "heading": m.heading, "vehicle_id": m.vehicle.astype(float),
        }  # fmt: skip

    def lost(self, model: Model) -> Lost | None:
        """Return what other vehicles cost beyond a model."""
        usual = np.sum(list(self.each(partial(_told, self, model, paths.usual_time))), axis=0)
        term = next((t.name for t in all_terms().values() if t.acts == "traffic"), "")
        lost = partial(paths.lost_time, usual=usual, known=self.base.fields.get(term))
        parts = list(self.each(partial(_told, self, model, lost)))
        return paths.lost(*(np.sum(list(p), axis=0) for p in zip(*parts, strict=True)))

    def passed(self, units: Iterable[Unit], model: Model) -> Iterator[Passed]:
        """Yield what the time lost is told from."""
        drive = self.fleet.truck.drive
        pace = 0.5 / drive.max_acceleration + 0.5 / drive.max_deceleration
        for u in units:
            about = self.about(u.own, model)
            # Trucks wait here or there on a road: what they stood there is of its waits, and ends a leg.
            road = np.cumsum(np.diff(u.own.motion.edge, prepend=-1) != 0)
            stops, usual = self.waits.usual(u.own)
            waits = np.maximum(about.waits, usual)
            wait, stood = (np.bincount(road, v) for v in (waits, u.own.standing))
            left = waits * np.maximum(1.0 - stood / np.maximum(wait, 1e-9), 0.0)[road]
            left += (stood == 0.0)[road] * stops * pace * paths.free_speed(u.own.motion.edge, self.fleet)
            yield u.own, ~u.own.behind, u.windows.trip, left, about.seconds

    def features(self, unit: Unit, model: Model) -> Floats:
        """Return place, direction, load and modelled time of every window: what makes two passes alike."""
        path, w = unit.own, unit.windows
        middle = np.searchsorted(path.of, np.arange(len(w))) + np.bincount(path.of) // 2
        m = path.motion
        time = self.predict(unit, model)
        return np.column_stack([
            w.x / 2.0, w.y / 2.0, 2.0 * np.cos(m.heading[middle]), 2.0 * np.sin(m.heading[middle]),
            m.payload[middle] / 500.0,
            time / max(float(np.sqrt(np.mean(time**2))), 1e-9) * 4.0, w.vehicle * 3.0,
        ])  # fmt: skip


def _told(own: TravelChannel, model: Model, what: Callable[..., R], units: Iterable[Unit]) -> R:
    return what(own.passed(units, model), own.lanes)

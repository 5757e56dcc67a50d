"""What the search needs of a channel, energy over windows or time over stretches, and what both do alike."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.arrays import Floats, Ints, Mask
from fleetlog.discovery.channels.paths import Lost
from fleetlog.discovery.hypotheses.cells import Cells, Stretches
from fleetlog.discovery.hypotheses.sources import ErrorSource, FieldSource, FreeCurve, Source, knots_of
from fleetlog.discovery.model import FLEET, Knob, Model, Scope
from fleetlog.discovery.recording.blocks import Block, Windows, picked, stacked
from fleetlog.discovery.recording.fleet import Fleet
from fleetlog.discovery.recording.shelf import Shelf
from fleetlog.discovery.recording.splits import HELD_OUT, Split
from fleetlog.physics.term import Term

Columns = NDArray[np.float32]
R = TypeVar("R")

MAKERS = dict(zip(get_args(Source), ("_knob", "_field", "_curve", "_error"), strict=True))
SAMPLE = "sample"  # Group of what is drawn from all dates
CODES = ("vehicle_id", "day", "trip_id", "heading")  # Without knots: codes, and an angle, which goes round


@dataclass(frozen=True)
class Unit:
    """Windows that are computed together, with the recorded quantity of each and which of them can be used.

    ``own`` is the channel's: a ``motion`` (n,), the window ``of`` each of its samples, and how to take a
    ``part`` or to put several ``joined``; ``noise`` (W,) the variance that the uncertainty of the motion
    leaves to any model; ``level`` (W,) what the nominal model says, and ``swing`` (W,) how far rows scatter
    about it, above zero: noise grows with both; ``fold`` (W,) that each is dealt to."""

    windows: Windows
    recorded: Floats
    whole: Mask
    noise: Floats
    level: Floats
    swing: Floats
    fold: Ints
    own: Any

    @property
    def key(self) -> tuple[int, float]:
        """Tells it from all others of the channel."""
        return int(self.windows.vehicle[0]), float(self.windows.time[0])

    def part(self, keep: Mask) -> "Unit":
        """Return some of the windows, (W,), which are all of some trips."""
        mine, own = self.own.part(keep)
        return Unit(**picked(self, mine, "own"), own=own)


@dataclass
class Channel(ABC):
    """A recorded quantity of a fleet by window, and what models say of it. ``base`` is what everything is
    measured from: the nominal truck, or what a simulation holds beyond it."""

    name: str
    fleet: Fleet
    base: Model
    split: Split
    metric: str = field(default="", init=False)  # What the error is
    own_error: Floats = field(default_factory=lambda: np.zeros(0), init=False)
    """(V,) share of a window's quantity that any model may miss: every truck has its own logger."""
    gathers: float = field(default=1.0, init=False)  # Times so much at some places
    off_height: float = field(default=0.0, init=False)  # Share that the heights of a map may be off there
    unsteady: frozenset[int] = field(default=frozenset(), init=False)
    """Vehicles in whose hours the model's own error is not alike."""
    sparse: frozenset[int] = field(default=frozenset(), init=False)
    """Vehicles that are not judged, as their motion between rows is not known."""
    bends: bool = field(default=True, init=False)  # Whether effects bend it: trucks begin to brake
    by_place: bool = field(default=True, init=False)  # Whether free power (or time) by place can be told
    errors: list[ErrorSource] = field(default_factory=list, init=False)  # What sampling hides
    notes: list[str] = field(default_factory=list, init=False)
    """What a reader should know of what the recording hides from the channel."""
    shelf: Shelf = field(default_factory=Shelf, init=False)
    share: float | None = field(default=None, init=False)  # Of what is not held out, in a sample
    _laid: bool = field(default=False, init=False)
    _held: list[Unit] = field(default_factory=list, init=False)
    _passes: dict[str | None, Ints] = field(default_factory=dict, init=False)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_held": []}

    def error_of(self, scope: Scope) -> float:
        """Return the share that any model may miss of what trucks say together: who misses less says more."""
        days = [d.vehicle for d in self.fleet.days if scope.covers(d.vehicle)]
        own = self.own_error[[v for v in days if v not in self.sparse] or days]
        return float(np.sum(1.0 / own) / np.sum(own**-2.0))

    @property
    def model_error(self) -> float:
        """Share of a window's quantity that any model may miss of all trucks together."""
        return self.error_of(FLEET)

    @property
    def plain_error(self) -> float:
        """The same where all trucks weigh alike, whatever they miss."""
        return float(np.sqrt(np.mean([self.own_error[d.vehicle] ** 2 for d in self.fleet.days])))

    @property
    def place_error(self) -> float:
        """The same share at some places, where it gathers."""
        return self.gathers * self.model_error + self.off_height

    @abstractmethod
    def look(self, number: int, block: Block) -> None:
        """Keep what is needed of a vehicle-day."""

    def prepare(self) -> None:
        """Have the windows of all dates at hand."""
        if not self._laid:
            lay_out([self])

    def of(self, date: int) -> Iterator[Unit]:
        """Yield the units of a date."""
        return (self.shelf.get(str(date), number) for number in self.numbers(date))

    def numbers(self, date: int) -> list[int]:
        """Return the numbers of its vehicle-days."""
        if not self.shelf.has(str(date)):  # Of a worker on another machine
            lay([self], date)
        return self.shelf.numbers(str(date))

    def units(self) -> Iterator[Unit]:
        """Yield the recording, piece by piece."""
        if self.share is not None:
            yield from self._sample()
            return
        self.prepare()
        for date in self.fleet.dates:
            yield from self.of(date)

    def each(self, work: Callable[[Iterable[Unit]], R]) -> Iterator[R]:
        """Yield what a function makes of the units of every date, in their order, on the engine in use; of a
        sample what it makes of all."""
        if self.share is not None:
            yield work(self._sample())
            return
        self.prepare()
        yield from self.fleet.each(partial(self._on, work))

    def _on(self, work: Callable[[Iterable[Unit]], R], date: int) -> R:
        return work(self.of(date))

    @abstractmethod
    def about(self, own: Any, model: Model) -> "About":
        """Return what a model says of a unit's own, and columns about it."""

    def predict(self, unit: Unit, model: Model) -> Floats:
        """Return what a model says, (W,)."""
        return self.about(unit.own, model).modelled

    def columns(self, unit: Unit, model: Model, sources: Sequence[Source]) -> tuple[Floats, Columns]:
        """Return what the model says, (W,), and the sources' columns, (W, P): change per unit of each."""
        about = self.about(unit.own, model)
        return about.modelled, about.columns(sources)

    @abstractmethod
    def cells(self, term: Term | None) -> Cells:
        """Return the cells of a field term, or of places (None)."""

    @abstractmethod
    def terms(self) -> list[Term]:
        """Return the terms that can act on the channel."""

    @abstractmethod
    def curves(self) -> list[FreeCurve]:
        """Return the free curves that the recording can carry."""

    def lost(self, model: Model) -> Lost | None:
        """Return what other vehicles cost beyond a model; None where the channel cannot see that."""
        return None

    def rests(self, unit: Unit) -> Mask:
        """Return the windows, (W,), in which nothing moves; none where the channel cannot tell."""
        return np.zeros(len(unit.windows), bool)

    @abstractmethod
    def features(self, unit: Unit, model: Model) -> Floats:
        """Return what makes windows alike, (W, features), for the noise floor; no candidate looks at it."""

    @abstractmethod
    def state(self, own: Any) -> dict[str, Floats]:
        """Return the recorded variables that a mismatch may follow, from a unit's own."""

    def width(self, source: Source) -> int:
        """Return the number of columns of a source."""
        if isinstance(source, FieldSource):
            return int(self.cells(source.physics).root.shape[1])
        return source.width if isinstance(source, FreeCurve) else 1

    def sampled(self, share: float) -> "Channel":
        """Return the channel with such a share of what is held out together, evenly drawn; or all."""
        drawn = copy(self)
        drawn.share, drawn._held, drawn._passes = share, [], {}
        return drawn

    def _sample(self) -> list[Unit]:
        assert self.share is not None
        if not self._held:
            whole = copy(self)
            whole.share = None
            self._held = list(whole.units()) if self.share >= 1.0 else self._drawn(whole, self.share)
        return self._held

    def put_back(self) -> None:
        """Keep nothing of a sample in memory."""
        self._held = []

    def _drawn(self, whole: "Channel", share: float) -> list[Unit]:
        if not self.shelf.has(SAMPLE):
            by_vehicle: dict[int, list[Unit]] = {}
            for unit in whole.units():
                use = self.split.drawn(unit.windows, share) & (unit.fold != HELD_OUT)
                if use.any():
                    by_vehicle.setdefault(int(unit.windows.vehicle[0]), []).append(unit.part(use))
            for vehicle, parts in by_vehicle.items():
                # A few long arrays cost less than many short ones.
                windows = Windows(**stacked([p.windows for p in parts]))
                own = parts[0].own.joined([p.own for p in parts])
                self.shelf.put(SAMPLE, vehicle, Unit(windows, **stacked(parts, "windows", "own"), own=own))
            self.shelf.end(SAMPLE)
        return [self.shelf.get(SAMPLE, k) for k in self.shelf.numbers(SAMPLE)]

    def adjustable(self) -> list[Knob]:
        """Return every knob with a tolerance: the fleet's that may be a little off."""
        known = ((t, p) for t in self.terms() for p in t.parameters if not p.shape)
        return [Knob(t.name, p.name) for t, p in known if p.allowance(self.fleet.truck) > 0.0]

    def knots(self, units: Iterable[Unit]) -> dict[str, tuple[float, ...]]:
        """Return the knots of every variable that moves in some units."""
        pooled: dict[str, list[Floats]] = {}
        for unit in units:
            for name, values in self.state(unit.own).items():
                if name not in CODES:
                    pooled.setdefault(name, []).append(values[::4])
        return {n: k for n, v in pooled.items() if (k := knots_of(np.concatenate(v), n))}

    def passes(self, term: Term | None) -> Ints:
        """Return how many windows that count touch each value of a field, or of places (None), (C,); none
        touches a stretch of which vehicles drive less than half, on their way over a junction."""
        if (name := term.name if term else None) not in self._passes:
            cells = self.cells(term)
            count, entered, metres = np.sum(list(self.each(partial(_touched, cells))), axis=0)
            if isinstance(cells, Stretches) and not (term and term.waits):
                count *= metres > 0.5 * entered * (cells.end - cells.start)
            self._passes[name] = count.astype(np.int64)
        return self._passes[name]


def lay(channels: Sequence[Channel], date: int) -> None:
    """Put what channels need of a date on their shelves, the motion made once."""
    for number, block in channels[0].fleet.each_block(date):
        for channel in channels:
            channel.look(number, block)
    for channel in channels:
        channel.shelf.end(str(date))


def lay_out(channels: Sequence[Channel]) -> None:
    """Put what channels of one fleet need of all dates on their shelves."""
    list(channels[0].fleet.each(partial(lay, channels)))
    for channel in channels:
        channel._laid = True


def _touched(cells: Cells, units: Iterable[Unit]) -> Floats:
    """(3, C) windows that touch each value, how often vehicles enter it, and how far they drive on it [m]."""
    size = cells.size
    total = np.zeros((3, size))
    for unit in units:
        m, of = unit.own.motion, unit.own.of
        step = np.nan_to_num(np.hypot(np.diff(m.x), np.diff(m.y)))
        around = 0.5 * (np.append(step, 0.0) + np.append(0.0, step))
        for number, _ in cells.parts(m):
            on = (number >= 0) & unit.whole[of]
            total[0] += np.bincount(np.unique(of[on] * size + number[on]) % size, minlength=size)
            total[1] += np.bincount(number[on & (np.diff(number, prepend=-1) != 0)], minlength=size)
            total[2] += np.bincount(number[on], around[on], size)
    return total


@dataclass
class About(ABC):
    """What a model says of a unit's own, and columns about it."""

    channel: Channel
    own: Any
    model: Model

    @property
    @abstractmethod
    def modelled(self) -> Floats:
        """What the model says, (W,)."""

    @cached_property
    def vehicle(self) -> int:
        """Code of the one vehicle."""
        return int(self.own.motion.vehicle[0])

    @cached_property
    def state(self) -> dict[str, Floats]:
        """The recorded variables that a mismatch may follow."""
        return self.channel.state(self.own)

    def columns(self, sources: Sequence[Source]) -> Columns:
        """Return the columns of sources, (W, P), by the methods that are named after their kinds."""
        parts = [getattr(self, MAKERS[type(s)])(s) for s in sources]
        return np.concatenate(parts, axis=1).astype(np.float32)

    def _shared(self, scope: Scope, change: Floats) -> Floats:
        """A change along the motion, (n,), as far as a scope holds."""
        return change if scope.whole else change * scope.share(self.vehicle, self.own.motion.time)

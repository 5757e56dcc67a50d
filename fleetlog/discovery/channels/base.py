"""What the search needs of a channel, energy over windows or time over stretches, and what both do alike."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.arrays import Floats, Ints, Mask
from fleetlog.core.motion import Motion
from fleetlog.core.truck import Truck
from fleetlog.discovery.channels.lost import Lost
from fleetlog.discovery.hypotheses.cells import Cells
from fleetlog.discovery.hypotheses.sources import ErrorSource, FieldSource, FreeCurve, Source, knots_of
from fleetlog.discovery.model import Knob, Model
from fleetlog.discovery.recording.blocks import Windows, picked, stacked
from fleetlog.discovery.recording.fleet import Fleet
from fleetlog.discovery.recording.splits import Split
from fleetlog.physics.term import Term

Columns = NDArray[np.float32]

CODES = ("vehicle_id", "day", "trip_id", "heading")
"""Variables without knots: codes, and an angle, which goes round."""


@dataclass(frozen=True)
class Unit:
    """Windows that are computed together, with the recorded quantity of each and which of them can be used.

    ``own`` is the channel's; ``noise`` (W,) the variance that the uncertainty of the motion leaves to any
    model; ``level`` (W,) what the nominal model says, and ``swing`` (W,) how far rows scatter about it,
    above zero: noise grows with both.
    """

    windows: Windows
    recorded: Floats
    whole: Mask
    noise: Floats
    level: Floats
    swing: Floats
    own: Any

    @property
    def key(self) -> tuple[int, float]:
        """Tells it from all others of the channel."""
        return int(self.windows.vehicle[0]), float(self.windows.time[0])

    def part(self, keep: Mask, own: Any) -> "Unit":
        """Return some of the windows, (W,), with the channel's ``own`` of these."""
        return Unit(**picked(self, keep, "own"), own=own)


@dataclass
class Channel(ABC):
    """A recorded quantity of a fleet by window, and what models say of it.

    ``base`` is what everything is measured from: the nominal truck, or what a simulation holds beyond it.
    """

    name: str
    fleet: Fleet
    base: Model
    model_error: float = field(default=0.0, init=False)
    """Share of a window's quantity that any model may miss."""
    place_error: float = field(default=0.0, init=False)  # The same share at some places, where it gathers
    _kept: list[Unit] = field(default_factory=list, init=False)
    _passes: dict[str, Ints] = field(default_factory=dict, init=False)

    @property
    @abstractmethod
    def metric(self) -> str:
        """What the error is."""

    @abstractmethod
    def units(self) -> Iterator[Unit]:
        """Yield the recording, piece by piece."""

    @abstractmethod
    def predict(self, unit: Unit, model: Model) -> Floats:
        """Return what a model says, (W,)."""

    @abstractmethod
    def columns(self, unit: Unit, model: Model, sources: Sequence[Source]) -> tuple[Floats, Columns]:
        """Return what the model says, (W,), and the columns of the sources about it, (W, P)."""

    @abstractmethod
    def cells(self, term: Term | None) -> Cells:
        """Return the cells of a field term, or of places (None)."""

    @property
    def steady(self) -> bool:
        """Whether the model's own error is alike in all trucks and hours."""
        return True

    @property
    def by_place(self) -> bool:
        """Whether free power (or time) by place can be told."""
        return True

    @abstractmethod
    def terms(self) -> list[Term]:
        """Return the terms that can act on the channel."""

    @abstractmethod
    def curves(self) -> list[FreeCurve]:
        """Return the free curves that the recording can carry."""

    @abstractmethod
    def errors(self) -> list[ErrorSource]:
        """Return what sampling hides."""

    def notes(self) -> list[str]:
        """Return what a reader should know of what the recording hides from the channel."""
        return []

    @abstractmethod
    def lost(self, model: Model) -> Lost | None:
        """Return what other vehicles cost beyond a model; None where the channel cannot see that."""

    @abstractmethod
    def features(self, unit: Unit, model: Model) -> Floats:
        """Return what makes windows alike, (W, features), for the noise floor; no candidate looks at it."""

    @abstractmethod
    def state(self, own: Any) -> dict[str, Floats]:
        """Return the recorded variables that a mismatch may follow, from a unit's own."""

    @abstractmethod
    def samples(self, unit: Unit) -> tuple[Motion, Ints]:
        """Return the motion of a unit, and the window of each of its samples."""

    @abstractmethod
    def part(self, unit: Unit, keep: Mask) -> Unit:
        """Return some of the windows of a unit, (W,), which are all of some trips."""

    @abstractmethod
    def joined(self, own: list[Any]) -> Any:
        """Return the own of several units of one vehicle as that of one."""

    @property
    def truck(self) -> Truck:
        """The nominal truck."""
        return self.fleet.truck

    @property
    def vehicles(self) -> tuple[str, ...]:
        """Names by code."""
        return self.fleet.vehicles

    def width(self, source: Source) -> int:
        """Return the number of columns of a source."""
        if isinstance(source, FieldSource):
            return int(self.cells(source.physics).root.shape[1])
        return source.width if isinstance(source, FreeCurve) else 1

    def sampled(self, split: Split, share: float) -> "Channel":
        """Return the channel with such a share of what is held out together, evenly drawn."""
        by_vehicle: dict[int, list[Unit]] = {}
        for unit in self.units():
            part = self.part(unit, split.drawn(unit.windows, share))
            if len(part.windows):
                by_vehicle.setdefault(int(part.windows.vehicle[0]), []).append(part)
        drawn = copy(self)
        drawn._kept, drawn._passes = [self._joined(parts) for parts in by_vehicle.values()], {}
        return drawn

    def _joined(self, parts: list[Unit]) -> Unit:
        """Several units of one vehicle as one: a few long arrays cost less than many short ones."""
        windows = Windows(**stacked([p.windows for p in parts]))
        return Unit(windows, **stacked(parts, "windows", "own"), own=self.joined([p.own for p in parts]))

    def adjustable(self) -> list[Knob]:
        """Return every knob with a tolerance: the fleet's that may be a little off."""
        return [
            Knob(t.name, p.name)
            for t in self.terms()
            for p in t.parameters
            if p.allowance(self.truck) > 0.0 and not p.shape
        ]

    @cached_property
    def knots(self) -> dict[str, tuple[float, ...]]:
        """Knots of every variable that moves."""
        pooled: dict[str, list[Floats]] = {}
        for unit in self.units():
            for name, values in self.state(unit.own).items():
                if name not in CODES:
                    pooled.setdefault(name, []).append(values[::4])
        found = {n: knots_of(np.concatenate(v), n) for n, v in pooled.items()}
        return {n: k for n, k in found.items() if k}

    def passes(self, term: Term) -> Ints:
        """Return how many windows touch each value of a field, (C,)."""
        if term.name not in self._passes:
            cells = self.cells(term)
            size = cells.size
            total = np.zeros(size, np.int64)
            for motion, window in map(self.samples, self.units()):
                for number, _ in cells.parts(motion):
                    pairs = np.unique(window[number >= 0] * size + number[number >= 0])
                    total += np.bincount(pairs % size, minlength=size)
            self._passes[term.name] = total
        return self._passes[term.name]


def side_by_side(sources: Sequence[Source], *makers: Callable[[Any], Floats]) -> Columns:
    """Return the columns of sources, (W, P); ``makers`` of each kind, in the order of ``Source``."""
    of = dict(zip(get_args(Source), makers, strict=True))
    return np.concatenate([of[type(s)](s) for s in sources], axis=1).astype(np.float32)

"""What both kinds of channel do alike: knobs, knots and passages of a fleet, and a column for every
source."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.motion import Motion
from fleetlog.core.truck import Truck
from fleetlog.discovery.channels.base import Unit
from fleetlog.discovery.hypotheses.curves import FreeCurve, knots_of
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
from fleetlog.discovery.recording.fleet import Fleet
from fleetlog.physics.term import Term

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CODES = ("vehicle_id", "day", "trip_id", "heading")
"""Variables without knots: codes, and an angle, which goes round."""


@dataclass
class FleetChannel(ABC):
    """A channel of a fleet; see :class:`fleetlog.discovery.channels.base.Channel`."""

    name: str
    fleet: Fleet
    base: Model
    _kept: list[Unit] = field(default_factory=list, init=False)
    _passes: dict[str, Ints] = field(default_factory=dict, init=False)
    _knots: dict[str, tuple[float, ...]] | None = field(default=None, init=False)

    @abstractmethod
    def units(self) -> Iterator[Unit]:
        """Yield the recording, piece by piece."""

    @abstractmethod
    def terms(self) -> list[Term]:
        """Return the terms that can act on the channel."""

    @abstractmethod
    def cells(self, term: Term | None) -> Cells | None:
        """Return the cells of a field term, or of places (None)."""

    @abstractmethod
    def _samples(self, unit: Unit) -> tuple[Motion, Ints]:
        """The motion of a unit, and the window of each of its samples."""

    @abstractmethod
    def _variables(self, unit: Unit) -> dict[str, Floats]:
        """The recorded variables that a mismatch may follow."""

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

    def adjustable(self) -> list[Knob]:
        """Return every knob with a tolerance."""
        return [
            Knob(t.name, p.name)
            for t in self.terms()
            for p in t.parameters
            if p.allowance(self.truck) > 0.0 and not p.shape
        ]

    def knots(self) -> dict[str, tuple[float, ...]]:
        """Return the knots of every variable that moves."""
        if self._knots is None:
            pooled: dict[str, list[Floats]] = {}
            for unit in self.units():
                for name, values in self._variables(unit).items():
                    if name not in CODES:
                        pooled.setdefault(name, []).append(values[::4])
            found = {n: knots_of(np.concatenate(v), n) for n, v in pooled.items()}
            self._knots = {n: k for n, k in found.items() if k}
        return self._knots

    def passes(self, term: Term) -> Ints:
        """Return how many windows touch each value of a field, (C,)."""
        if term.name not in self._passes:
            self._passes[term.name] = self._touched(term)
        return self._passes[term.name]

    def _touched(self, term: Term) -> Ints:
        cells = self.cells(term)
        assert cells is not None
        size = cells.size(term.odd)
        total = np.zeros(size, np.int64)
        for unit in self.units():
            motion, window = self._samples(unit)
            for number, _ in cells.parts(motion, term.odd):
                pairs = np.unique(window[number >= 0] * size + number[number >= 0])
                total += np.bincount(pairs % size, minlength=size)
        return total


class SourceColumns(ABC):
    """Columns about a model, by source: each (W, k) for the k coefficients of the source."""

    def columns(self, source: Source) -> Floats:
        """Return the columns of one source."""
        match source:
            case KnobSource():
                return self._knob(source)
            case FieldSource():
                return self._field(source)
            case CurveSource():
                return self._curve(source.curve)
            case PlaceSource():
                return self._place()
            case ErrorSource():
                return self._error(source.name)

    @abstractmethod
    def _knob(self, source: KnobSource) -> Floats: ...

    @abstractmethod
    def _field(self, source: FieldSource) -> Floats: ...

    @abstractmethod
    def _curve(self, curve: FreeCurve) -> Floats: ...

    @abstractmethod
    def _place(self) -> Floats: ...

    @abstractmethod
    def _error(self, name: str) -> Floats: ...

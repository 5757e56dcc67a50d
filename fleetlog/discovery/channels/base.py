"""What the search needs of a channel, be it energy over windows or time over stretches of path."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.truck import Truck
from fleetlog.discovery.channels.lost import Lost
from fleetlog.discovery.hypotheses.curves import FreeCurve
from fleetlog.discovery.hypotheses.sources import ErrorSource, Source
from fleetlog.discovery.hypotheses.stretches import Cells
from fleetlog.discovery.model import Knob, Model
from fleetlog.discovery.recording.windows import Windows
from fleetlog.physics.term import Term

Floats = NDArray[np.float64]
Columns = NDArray[np.float32]


@dataclass(frozen=True)
class Unit:
    """Windows that are computed together, with the recorded quantity of each and which of them can be used.

    ``own`` is the channel's; ``noise`` (W,) the variance that the uncertainty of the motion leaves to any
    model;
    ``level`` (W,) what the nominal model says, and ``swing`` (W,) how far rows scatter about it, above zero:
    noise grows with both.
    """

    windows: Windows
    recorded: Floats
    whole: NDArray[np.bool_]
    noise: Floats
    level: Floats
    swing: Floats
    own: Any


class Channel(Protocol):
    """A recorded quantity by window, and what models say of it."""

    name: str

    @property
    def metric(self) -> str:
        """What the error is."""
        ...

    model_error: float
    """Share of a window's quantity that any model may miss."""
    base: Model
    """What everything is measured from: the nominal truck, or what a simulation holds beyond it."""

    @property
    def place_error(self) -> float:
        """The same share at some places, where it gathers."""
        ...

    @property
    def truck(self) -> Truck:
        """The nominal truck."""
        ...

    @property
    def vehicles(self) -> tuple[str, ...]:
        """Names by code."""
        ...

    def moments(self, count: int) -> Floats:
        """Return the (count + 1,) ends of as many slots of equal recorded time [s since 1970]."""
        ...

    def units(self) -> Iterator[Unit]:
        """Yield the recording, piece by piece."""
        ...

    def predict(self, unit: Unit, model: Model) -> Floats:
        """Return what a model says, (W,)."""
        ...

    def columns(self, unit: Unit, model: Model, sources: Sequence[Source]) -> tuple[Floats, Columns]:
        """Return what the model says, (W,), and the columns of the sources about it, (W, P)."""
        ...

    def width(self, source: Source) -> int:
        """Return the number of columns of a source."""
        ...

    def cells(self, term: Term | None) -> Cells | None:
        """Return the cells of a field term, or of places (None); None where the recording has no
        positions."""
        ...

    def terms(self) -> list[Term]:
        """Return the terms that can act on the channel."""
        ...

    def adjustable(self) -> list[Knob]:
        """Return the fleet's knobs that may be a little off."""
        ...

    def curves(self) -> list[FreeCurve]:
        """Return the free curves that the recording can carry."""
        ...

    def errors(self) -> list[ErrorSource]:
        """Return what sampling hides."""
        ...

    def passes(self, term: Term) -> NDArray[np.int64]:
        """Return how many windows touch each value of a field."""
        ...

    def lost(self, model: Model) -> Lost | None:
        """Return what other vehicles cost beyond a model; None where the channel cannot see that."""
        ...

    def features(self, unit: Unit, model: Model) -> Floats:
        """Return what makes two windows alike, (W, features), for the noise floor; no candidate looks at
        it."""
        ...

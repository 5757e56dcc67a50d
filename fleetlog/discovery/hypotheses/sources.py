"""Where a column of the regression comes from: what a channel is asked to compute for every window."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from fleetlog.discovery.hypotheses.curves import FreeCurve
from fleetlog.discovery.hypotheses.scope import FLEET, Scope
from fleetlog.discovery.model import Knob


@dataclass(frozen=True)
class KnobSource:
    """The derivative with respect to a knob's coordinate, the term's shape parameters being as in
    ``setting``."""

    knob: Knob
    setting: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class FieldSource:
    """The derivatives with respect to a field term's values within a scope, in the basis of the cells'
    prior."""

    term: str
    scope: Scope = FLEET


@dataclass(frozen=True)
class CurveSource:
    """A free curve, one column a knot."""

    curve: FreeCurve


@dataclass(frozen=True)
class PlaceSource:
    """Free power (or time) by cell, in the basis of the cells' prior."""


@dataclass(frozen=True)
class ErrorSource:
    """What sampling hides from any model; ``spread`` is the standard deviation of its coefficient."""

    name: str
    spread: float


Source = KnobSource | FieldSource | CurveSource | PlaceSource | ErrorSource


@dataclass(frozen=True)
class Layout:
    """Columns of several sources, side by side; the recorded quantity comes last."""

    sources: tuple[Source, ...]
    starts: tuple[int, ...]
    width: int

    def at(self, source: Source) -> range:
        """Return the columns of a source."""
        i = self.index[source]
        end = self.starts[i + 1] if i + 1 < len(self.starts) else self.width
        return range(self.starts[i], end)

    @cached_property
    def index(self) -> dict[Source, int]:
        """Number of each source."""
        return {s: i for i, s in enumerate(self.sources)}


def lay_out(sources: Sequence[Source], widths: Sequence[int]) -> Layout:
    """Return the layout of sources with so many columns each."""
    starts, total = [], 0
    for width in widths:
        starts.append(total)
        total += width
    return Layout(tuple(sources), tuple(starts), total)

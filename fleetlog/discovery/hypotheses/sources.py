"""Where a column of the regression comes from: what a channel is asked to compute for every window."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate

from fleetlog.discovery.hypotheses.curves import FreeCurve
from fleetlog.discovery.hypotheses.scope import FLEET, Scope
from fleetlog.discovery.model import Knob
from fleetlog.physics.power import all_terms
from fleetlog.physics.term import Term


@dataclass(frozen=True)
class KnobSource:
    """The derivative with respect to a knob's coordinate, the term's shape parameters as in ``setting``."""

    knob: Knob
    setting: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class FieldSource:
    """The derivatives with respect to a field term's values within a scope, in the basis of the cells' prior;
    without a term free power (or time) by cell."""

    term: str | None = None
    scope: Scope = FLEET

    @property
    def physics(self) -> Term | None:
        """The term."""
        return None if self.term is None else all_terms()[self.term]


@dataclass(frozen=True)
class ErrorSource:
    """What sampling hides from any model, everywhere or on one ``road`` (an edge, counted in its direction);
    ``spread`` is the standard deviation of its coefficient."""

    name: str
    spread: float
    road: int | None = None

    @property
    def most(self) -> float:
        """How large its coefficient may be."""
        return 2.0 * self.spread


Source = KnobSource | FieldSource | FreeCurve | ErrorSource  # A free curve has one column a knot


@dataclass(frozen=True)
class Layout:
    """Columns of several sources, each from its start to the next: numbers first, cells last."""

    sources: tuple[Source, ...]
    starts: tuple[int, ...]

    @property
    def width(self) -> int:
        """Number of columns but the last."""
        return self.starts[-1]

    @property
    def numbers(self) -> int:
        """Number of columns of numbers."""
        return self.starts[sum(isinstance(s, KnobSource) for s in self.sources)]

    @property
    def core(self) -> int:
        """Number of columns that are not over cells."""
        return self.starts[sum(not isinstance(s, FieldSource) for s in self.sources)]

    def at(self, source: Source) -> range:
        """Return the columns of a source."""
        i = self._index[source]
        return range(self.starts[i], self.starts[i + 1])

    @cached_property
    def _index(self) -> dict[Source, int]:
        return {s: i for i, s in enumerate(self.sources)}


def lay_out(sources: Sequence[Source], widths: Sequence[int]) -> Layout:
    """Return the layout of sources with so many columns each."""
    return Layout(tuple(sources), tuple(accumulate(widths, initial=0)))

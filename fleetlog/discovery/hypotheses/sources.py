"""Where a column of the regression comes from: what a channel is asked to compute for every window.

Free curves are force or power as any smooth function of a recorded variable.  They keep the named hypotheses
honest, which must say what the best curve says, and they say what an unknown mismatch follows."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate, product
from typing import Literal

import numpy as np

from fleetlog.core.arrays import Floats, Ints
from fleetlog.discovery.model import FLEET, Knob, Scope
from fleetlog.physics.power import all_terms
from fleetlog.physics.term import Term

Mode = Literal["force", "drive", "power", "moving", "still", "time"]

UNIT = dict(force=0.01, drive=0.1, power=300.0, moving=300.0, still=300.0, time=0.1)
"""Of a coefficient: shares of the weight, of the drive's power, watts, shares of the time."""
SLOW = frozenset({"ambient_temperature", "time", "soc", "day", "time since start"})
"""Variables that change over hours: whole stretches of hours are their independent samples, not trips."""
LEAST_RANGE = {"payload": 50.0, "soc": 0.02, "ambient_temperature": 1.5}  # Less is none; 0.1 of others
PLACED = {
    "acceleration": (-0.8, -0.4, -0.1, 0.1, 0.4, 0.8), "lift_speed": (-0.5, -0.25, 0.0, 0.25, 0.5),
    "time since departure": (0.0, 5.0, 10.0, 20.0, 40.0, 80.0),
}  # fmt: skip
"""Knots of variables that are near zero most of the time, or fade; even ones for the others."""
KNOTS = 6


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
    """What sampling hides from any model, everywhere, on one ``road`` (an edge, counted in its direction) or
    of one ``vehicle``; ``spread`` is the standard deviation of its coefficient."""

    name: str
    spread: float
    road: int | None = None
    vehicle: int | None = None
    unit: str = "1"

    @property
    def most(self) -> float:
        """How large its coefficient may be."""
        return 2.0 * self.spread


@dataclass(frozen=True)
class FreeCurve:
    """Hat functions over ``knots`` of each of its variables (cubic ones would swing beside steps); codes (the
    vehicle) have classes.

    By ``mode`` it acts through the drive (``force``), on what the drive draws (``drive``), on the battery
    (``power``), on it while the truck moves or stands (``moving``, ``still``), or on the travel ``time``."""

    mode: Mode
    variables: tuple[str, ...]
    knots: tuple[tuple[float, ...], ...]
    harmonics: int = 0
    classes: tuple[str, ...] = ()
    """Names of the codes, where each class may have a value of its own that is told."""

    @property
    def width(self) -> int:
        """Number of columns."""
        return 2 * self.harmonics or int(np.prod([len(k) for k in self.knots]))

    def hats(self, state: Mapping[str, Floats]) -> Iterator[tuple[Ints, Floats]]:
        """Yield (rows,) column and weight: where rows stand between knots; unknown values weigh nothing."""
        if self.harmonics:
            heading = state[self.variables[0]]
            for k in range(self.harmonics):
                yield np.full(len(heading), 2 * k), np.cos((k + 1) * heading)
                yield np.full(len(heading), 2 * k + 1), np.sin((k + 1) * heading)
            return
        parts = [(np.zeros(len(next(iter(state.values()))), np.int64), np.ones(1))]
        for name, knots in zip(self.variables, self.knots, strict=True):
            ends = product(parts, _between(state[name], np.array(knots)))
            parts = [(column * len(knots) + at, weight * share) for (column, weight), (at, share) in ends]
        yield from parts


def _between(values: Floats, knots: Floats) -> tuple[tuple[Ints, Floats], tuple[Ints, Floats]]:
    if len(knots) == 1:
        at = np.zeros(len(values), np.int64)
        return (at, np.ones(len(values))), (at, np.zeros(len(values)))
    x = np.clip(np.nan_to_num(values, nan=knots[0]), knots[0], knots[-1])
    j = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, len(knots) - 2)
    w = (x - knots[j]) / (knots[j + 1] - knots[j])
    known = np.isfinite(values)
    return (j, np.where(known, 1.0 - w, 0.0)), (j + 1, np.where(known, w, 0.0))


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

    def holds(self, other: "Layout") -> bool:
        """Return whether all sources of another are here."""
        return self._index.keys() >= set(other.sources)

    @cached_property
    def _index(self) -> dict[Source, int]:
        return {s: i for i, s in enumerate(self.sources)}


def lay_out(sources: Sequence[Source], widths: Sequence[int]) -> Layout:
    """Return the layout of sources with so many columns each."""
    return Layout(tuple(sources), tuple(accumulate(widths, initial=0)))


def knots_of(values: Floats, name: str) -> tuple[float, ...]:
    """Return knots that span a variable evenly; none where it hardly moves or is hardly known."""
    known = values[np.isfinite(values)]
    if len(known) < 100:
        return ()
    low, high = np.quantile(known, [0.005, 0.995])
    if high - low < LEAST_RANGE.get(name, 0.1):
        return ()
    return PLACED.get(name, tuple(np.linspace(low, high, KNOTS).tolist()))


def energy_curves(
    knots: Mapping[str, tuple[float, ...]], vehicles: int, days: int, trips: tuple[str, ...]
) -> list[FreeCurve]:
    """Return the free curves of an energy channel; ``trips`` names those with a value of their own."""
    out = [FreeCurve("force", ("heading",), (), 4), FreeCurve("still", (), ())]
    for name, k in knots.items():
        if name == "time since departure":
            out.append(FreeCurve("moving", (name,), (k,)))
            continue
        if name not in ("lift_speed", "fork_height"):
            out.append(FreeCurve("force", (name,), (k,)))
        if name in SLOW:
            out.append(FreeCurve("drive", (name,), (k,)))
        if name in ("speed", "payload", "curvature"):
            out.append(FreeCurve("moving", (name,), (k,)))
        if name not in ("speed", "curvature", "acceleration"):
            out.append(FreeCurve("power", (name,), (k,)))
    for mode, a, b in (("moving", "payload", "speed"), ("force", "ambient_temperature", "speed")):
        if a in knots and b in knots:
            few = (tuple(np.linspace(knots[v][0], knots[v][-1], 4).tolist()) for v in (a, b))
            out.append(FreeCurve(mode, (a, b), tuple(few)))  # type: ignore[arg-type]
    out += _by_class(("force", "power"), vehicle_id=vehicles, day=days)
    return out + [replace(c, classes=trips) for c in _by_class(("force", "power"), trip_id=len(trips))]


def charge_curves(knots: Mapping[str, tuple[float, ...]], vehicles: int) -> list[FreeCurve]:
    """Return the free curves of a state of charge whose power is measured: what the battery does with it."""
    slow = [FreeCurve("power", (n,), (k,)) for n, k in knots.items() if n in ("ambient_temperature", "soc")]
    return slow + _by_class(("power",), vehicle_id=vehicles)


def power_curves(knots: Mapping[str, tuple[float, ...]], vehicles: int) -> tuple[FreeCurve, ...]:
    """Return the curves by which recorded power may differ from the model's: first the fleet's two."""
    who = (((), ()), (("vehicle_id",), (tuple(map(float, range(vehicles))),)))
    modes: tuple[Mode, ...] = ("drive", "power")
    slow = (FreeCurve("power", (name,), (k,)) for name, k in knots.items() if name in SLOW)
    return (*(FreeCurve(m, names, k) for names, k in who for m in modes), *slow)


def time_curves(knots: Mapping[str, tuple[float, ...]], vehicles: int) -> list[FreeCurve]:
    """Return the free curves of travel time: a share of it by each variable."""
    by_state = (FreeCurve("time", (name,), (k,)) for name, k in knots.items())
    return [FreeCurve("time", ("heading",), (), 2), *by_state, *_by_class(("time",), vehicle_id=vehicles)]


def _by_class(modes: tuple[Mode, ...], **counts: int) -> list[FreeCurve]:
    """A value for each of so many classes of a code, where there are several."""
    several = [(name, tuple(map(float, range(n)))) for name, n in counts.items() if n > 1]
    return [FreeCurve(m, (name,), (codes,)) for name, codes in several for m in modes]

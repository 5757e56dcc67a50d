"""One explanation of a mismatch, and the list of all that a channel allows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.discovery.channels.base import Channel
from fleetlog.discovery.hypotheses.sources import SLOW, FieldSource, FreeCurve, KnobSource, Source
from fleetlog.discovery.model import FLEET, Knob, Scope
from fleetlog.physics.power import all_terms
from fleetlog.physics.term import Parameter, Term

SHAPES = 13  # Values of a shape parameter that are scanned, off its bounds; steps between refine the best
TIME = 4.0  # Logarithm of the number of moments at which something may begin, or end


def scanned(p: Parameter) -> float:
    """Return the step between the values of a shape parameter that are scanned."""
    return (p.high - p.low) / (SHAPES + 1)


@dataclass(frozen=True)
class Pattern:
    """A field that is one number times a map: ``weights`` by cell (bytes of float64, to be hashed)."""

    data: bytes
    label: str

    @property
    def weights(self) -> Floats:
        """(C,) the field where the number is one."""
        return np.frombuffer(self.data)


@dataclass(frozen=True)
class Hypothesis:
    """One explanation.

    ``knobs`` turn together (numbers of a term, of the fleet or one vehicle, with the ``setting`` of its
    shape parameters); ``patterns`` or the whole ``field`` over the cells, of a term or of free power; or a
    free ``curve``. ``variance`` is that of the prior of a field's or curve's coefficients."""

    term: str | None = None
    knobs: tuple[Knob, ...] = ()
    setting: tuple[tuple[str, float], ...] = ()
    patterns: tuple[Pattern, ...] = ()
    field: bool = False
    curve: FreeCurve | None = None
    variance: float = 1.0
    when: Scope = FLEET  # Of a field: the part of the time that it is there

    @property
    def places(self) -> bool:
        """Whether it is free power by place."""
        return self.field and self.term is None

    @property
    def kind(self) -> Hypothesis:
        """The same without regard to the variance of its prior."""
        return replace(self, variance=1.0)

    @property
    def alike(self) -> Hypothesis:
        """The same for all, at all times, and in any shape."""
        of_all, placed = tuple(k.fleet for k in self.knobs), self.field or bool(self.patterns)
        return Hypothesis(self.term, of_all, field=placed, curve=self.curve)

    @property
    def physics(self) -> Term | None:
        """The term, None of what has no name."""
        return all_terms()[self.term] if self.term else None

    @property
    def waits(self) -> bool:
        """Whether it is time that vehicles stand still."""
        return bool(self.physics and self.physics.waits)

    @property
    def scope(self) -> Scope:
        """Whom and when it is about."""
        return self.knobs[0].scope if self.knobs else self.when

    def of(self, scope: Scope) -> Hypothesis:
        """Return the same of other trucks, or of another part of the time."""
        knobs = tuple(replace(k, scope=scope) for k in self.knobs)
        return replace(self, knobs=knobs) if knobs else replace(self, when=scope)

    @property
    def sources(self) -> tuple[Source, ...]:
        """Where its columns come from."""
        if self.knobs:
            return tuple(KnobSource(k.column, self.setting) for k in self.knobs)
        return (self.curve,) if self.curve is not None else (FieldSource(self.term, self.when),)

    @property
    def shapes(self) -> dict[Knob, float]:
        """The numbers that its setting fixes."""
        return {Knob(self.term or "", name): value for name, value in self.setting}

    def nearby(self, share: float) -> Iterator[Hypothesis]:
        """Yield the same with one shape parameter moved by a share of the step in which it is scanned."""
        for i, (name, value) in enumerate(self.setting):
            p = all_terms()[self.term or ""].by_name[name]
            for step in (-share * scanned(p), share * scanned(p)):
                moved = value + step
                if p.low < moved < p.high:
                    yield replace(self, setting=(*self.setting[:i], (name, moved), *self.setting[i + 1 :]))

    @property
    def name(self) -> str:
        """What ``diagnosis.json`` calls it."""
        return self.physics.name if self.physics and self.physics.in_vocabulary else "unknown"

    @property
    def depends_on(self) -> tuple[str, ...]:
        """The variables that the mismatch follows."""
        if self.curve is not None:
            return self.curve.variables or ("standing" if self.curve.mode == "still" else "driving",)
        own = self.physics.depends_on if self.physics else ("x", "y")
        if self.scope.vehicles:
            own = (*(v for v in own if v != "driving"), "vehicle_id")
        return (*own, "time") if self.scope.timed and "time" not in own else own

    @property
    def placed(self) -> bool:
        """Whether it follows the place."""
        return bool({"x", "y"} & set(self.depends_on))

    @property
    def slow(self) -> bool:
        """Whether it follows something that changes over hours; of some trucks it is told by the others,
        at the same hours."""
        of_trucks = bool(self.scope.vehicles) and not self.scope.timed
        return bool(SLOW & set(self.depends_on)) and not (self.field or self.patterns or of_trucks)

    @property
    def numbers(self) -> int:
        """How many numbers it adds that the prior does not hold."""
        return len(self.knobs) + len(self.setting) + len(self.patterns)

    @property
    def choices(self) -> float:
        """Logarithm of the number of like hypotheses that it was picked from."""
        s = self.scope
        scopes = 2.0 * min(len(s.vehicles), 2) + TIME * (np.isfinite(s.begin) + np.isfinite(s.until))
        if self.patterns:
            return float(5.0 * len(self.patterns) + scopes)
        if self.knobs:
            return float(np.log(SHAPES) * len(self.setting) + np.log(15.0) + scopes)
        return float(1.0 + scopes) if self.field and self.term else float(np.log(35.0))


Chosen = tuple[Hypothesis, ...]  # Hypotheses of one model, in the order in which they were added


def hypotheses(channel: Channel, only: tuple[str, ...] = ()) -> Iterator[Hypothesis]:
    """Yield every explanation of a channel but the patterns of places, which are found in its sums."""
    terms = [t for t in channel.terms() if t.told and (not only or t.name in only)]
    count = len(channel.fleet.vehicles)
    each = [Scope((v,)) for v in range(count)] if count > 1 else []
    for term in terms:
        if term.field:
            yield Hypothesis(term.name, field=True)
        else:
            for scope in (FLEET, *each):
                yield from _numbers(term, scope)
    for curve in channel.curves():
        yield Hypothesis(curve=curve)
    if channel.by_place:
        yield Hypothesis(field=True)


def _numbers(term: Term, scope: Scope) -> Iterator[Hypothesis]:
    """The numbers of a term: a vector's together, else one or two with every setting of the shapes."""
    amplitudes = [p for p in term.parameters if not p.shape]
    if term.vector:
        yield Hypothesis(term.name, tuple(Knob(term.name, p.name, scope) for p in amplitudes))
        return
    grid: list[tuple[tuple[str, float], ...]] = [()]
    for p in (p for p in term.parameters if p.shape):
        # No threshold is told at its bound; but a load may well go out as soon as the truck stands.
        values = np.linspace(p.low, p.high, SHAPES + 2)[int(p.bounds is not None) : -1].tolist()
        grid = [(*g, (p.name, v)) for g in grid for v in values]
    knobs = [Knob(term.name, p.name, scope) for p in amplitudes]
    for some in (*((k,) for k in knobs), *combinations(knobs, 2)):
        for setting in grid:
            yield Hypothesis(term.name, some, setting)

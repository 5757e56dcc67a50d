"""What may have been left out: every term of the folder of terms, and free dependences that keep the named ones honest.

A named candidate's column is the finite difference of the physics sum with respect to its parameter, so a user's own term file
becomes a candidate by being there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetlog.discovery.model import Found
from fleetlog.physics.power import all_terms
from fleetlog.physics.term import Parameter, Term

Floats = NDArray[np.float64]

ENERGY = ("force", "power", "load", "truck")
"""Kinds of term that change the power at the terminals."""
MECHANISM = {
    "rolling_resistance": 0.0012, "drivetrain_efficiency": 0.02, "auxiliary_load": 40.0, "lift_efficiency": 0.05,
    "payload": 0.05, "rotational_inertia": 0.03, "regeneration": 0.04,
}  # fmt: skip
"""How far a truck file may honestly be off (one standard deviation, in the parameter's unit)."""
SLOW = frozenset({"ambient_temperature", "time", "soc", "day", "time since start"})
"""Variables that change over hours: whole vehicle-days, not trips, are their independent samples."""


@dataclass(frozen=True)
class Knob:
    """A parameter to move, and the settings of the shape parameters beside it."""

    parameter: str
    shape: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class Candidate:
    """One explanation.

    ``kind``: ``scalar`` (numbers of a term), ``field`` (a term over the stretches), ``generic`` (a free dependence).
    ``knobs`` are what a scan of a scalar turns, one column each; ``variant``: only one of them is to be used.
    """

    name: str
    kind: str
    term: Term | None = None
    depends_on: tuple[str, ...] = ()
    knobs: tuple[Knob, ...] = ()
    slow: bool = False
    internal: bool = False

    @property
    def place(self) -> bool:
        """Whether it is tied to places, so that it cannot be asked to predict unseen ones."""
        return self.kind == "field" or self.depends_on[:2] == ("x", "y")

    @property
    def named(self) -> bool:
        """Whether it is physics with a name."""
        return self.term is not None

    @property
    def variant(self) -> bool:
        """Whether the knobs are alternatives."""
        return len(self.knobs) > 1 and self.term is not None and not is_vector(self.term)


def named_candidates(
    channel: str, measured: bool, with_map: bool, only: tuple[str, ...] = ()
) -> list[Candidate]:
    """Terms that can act on an energy channel; ``only`` restricts them by name."""
    out = []
    for name, term in sorted(all_terms().items()):
        if (only and name not in only) or not term.parameters or not _acts(term, channel, measured):
            continue
        if term.field and not with_map:
            continue
        slow = bool(SLOW & set(term.depends_on))
        kind = "field" if term.field else "scalar"
        out.append(Candidate(name, kind, term, term.depends_on, () if term.field else knobs(term), slow))
    return out


def _acts(term: Term, channel: str, measured: bool) -> bool:
    if channel == "battery_power":
        return term.acts in ENERGY
    return term.acts == "loss" or (not measured and term.acts in ENERGY)


def knobs(term: Term) -> tuple[Knob, ...]:
    """What a scan moves of a term.

    A term of one parameter has one knob.  The components of a vector (parameters of one unit and range) are knobs that are
    turned together.  Otherwise each parameter that is neutral at zero is an amplitude, tried with every value of the ones
    that only give it shape.
    """
    parameters = term.parameters
    if len(parameters) == 1 or is_vector(term):
        return tuple(Knob(p.name) for p in parameters)
    shapes = [p for p in parameters if p.neutral != 0.0 and p.truck_key is None]
    amplitudes = [p for p in parameters if p not in shapes]
    grid: list[dict[str, float]] = [{}]
    for shape in shapes:
        grid = [{**g, shape.name: float(v)} for g in grid for v in np.linspace(shape.low, shape.high, 13)]
    return tuple(Knob(a.name, tuple(g.items())) for a in amplitudes for g in grid)


def is_vector(term: Term) -> bool:
    """Whether the parameters are components of one quantity."""
    return len(term.parameters) > 1 and len({(p.unit, p.low, p.high) for p in term.parameters}) == 1


def step(parameter: Parameter, now: float) -> float:
    """A step for a finite difference, small against the plausible range and pointing into it."""
    size = 1e-3 * (parameter.high - parameter.low)
    return -size if now + size > parameter.high else size


def moved(found: Found, term: Term, setting: dict[str, float]) -> Found:
    """The model with a term set so."""
    for name, value in setting.items():
        found = found.with_value(term.name, name, value)
    return found


def tilted(found: Found, term: Term, knob: Knob) -> tuple[dict[str, float], float]:
    """The setting with a knob turned by a small step, and that step; shapes are those of the knob."""
    parameter = term.by_name[knob.parameter]
    now = found.value(term, knob.parameter)
    size = step(parameter, now)
    return {**dict(knob.shape), knob.parameter: now + size}, size

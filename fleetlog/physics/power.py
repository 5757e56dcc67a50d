"""The sum of the terms: battery power of a motion, and its ledger.

    F        = sum of force terms                       [N]
    P_drive  = F v / efficiency where F v >= 0, F v regeneration where F v < 0
    P        = P_drive + sum of power and drive terms   [W] at the battery terminals, > 0 when discharging
    P_cell   = P + internal_resistance (P / voltage)^2  what the state of charge pays

``ledger`` splits P_drive among the forces in proportion, so its rows add up to P exactly."""

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, lru_cache, reduce
from itertools import chain
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from fleetlog.core.motion import Motion
from fleetlog.core.truck import Truck
from fleetlog.physics import formulas
from fleetlog.physics.field import Field
from fleetlog.physics.term import Floats, Parameter, Term, Values
from fleetlog.registry import parts

ByTerm = dict[str, Floats]  # Newtons, watts or shares of every sample, (N,)


@cache
def all_terms() -> dict[str, Term]:
    """Every term by name: those of the table, files in the folder of terms, and those of other packages."""
    table = Path(__file__).with_name("terms") / "terms.toml"
    own = {name: _term(name, told) for name, told in tomllib.loads(table.read_text(encoding="utf-8")).items()}
    return dict(sorted({**own, **parts("fleetlog.physics.terms", "TERM")}.items()))


def _term(name: str, told: dict[str, Any]) -> Term:
    """The term of an entry of the table, with the formula of its name."""
    told["parameters"] = tuple(Parameter(**p) for p in told.get("parameters", ()))
    told["depends_on"] = tuple(told.get("depends_on", ()))
    return Term(name, function=getattr(formulas, name, None), **told)


def cause(name: str) -> str:
    """What the energy of a term is spent on, in words."""
    return all_terms()[name].cause or name.replace("_", " ")


@dataclass(frozen=True)
class Own:
    """``values[term]`` and ``fields[term]`` of some vehicles, or of some time."""

    values: dict[str, Values]
    vehicles: tuple[str, ...] | None = None  # Names; None: all
    begin: float = -np.inf  # [s since 1970]
    until: float = np.inf
    drift: bool = False  # They come in evenly from ``begin`` to ``until``, and hold after it
    fields: dict[str, Field] = field(default_factory=dict)

    @property
    def timed(self) -> bool:
        """Whether they hold for a time only."""
        return bool(np.isfinite(self.begin) or np.isfinite(self.until))


def share(time: Floats, begin: float, until: float, drift: bool) -> Floats:
    """Return how far something holds at times, (N,): 1 from ``begin`` to ``until``, or growing to that."""
    if drift:
        return np.asarray(np.clip((time - begin) / (until - begin), 0.0, 1.0))
    return np.asarray((time >= begin) & (time < until), dtype=float)


@dataclass(frozen=True)
class Physics:
    """The nominal truck and the values of the terms that were added or changed; the one list of terms."""

    truck: Truck
    values: dict[str, Values] = field(default_factory=dict)
    """By term: its parameters as numbers, or as (N,) arrays along a given motion."""
    off: frozenset[str] = frozenset()  # Terms left out of the sum, nominal or not
    fields: dict[str, Field] = field(default_factory=dict)
    """By term: its first parameter where it varies over the roads of the network that the motions lie on."""
    intervals: dict[str, dict[str, tuple[float, float]]] = field(default_factory=dict)  # Low and high
    own: tuple[Own, ...] = ()  # What some vehicles, or hours, have instead; see :meth:`of`, :meth:`phases`

    def of(self, vehicle: str, start: float = 0.0) -> "Physics":
        """Return the physics of one vehicle, by its name; times count from ``start`` [s since 1970]."""
        mine = [o for o in self.own if o.vehicles is None or vehicle in o.vehicles]
        physics = self
        for o in mine:
            physics = physics if o.timed else physics.changed(o.values, o.fields)
        timed = [replace(o, begin=o.begin - start, until=o.until - start) for o in mine if o.timed]
        return replace(physics, own=tuple(timed))

    @property
    def fleet(self) -> "Physics":
        """What holds for all vehicles at all times."""
        return replace(self, own=()) if self.own else self

    def changed(self, values: Mapping[str, Values], fields: Mapping[str, Field] | None = None) -> "Physics":
        """Return the physics with some values and fields in place of what it has."""
        new = {n: {**self.values.get(n, {}), **v} for n, v in values.items()}
        return replace(self, values={**self.values, **new}, fields={**self.fields, **(fields or {})})

    def phases(self, time: Floats) -> list[tuple[Floats, "Physics"]]:
        """Return what holds along the (N,) times of one vehicle's motion: shares (N,), summing to 1, each
        with a physics; a drift by its two ends, so that power in between is a mean of both."""
        out = [(np.ones(len(time)), self.fleet)]
        for o in self.own:
            part = share(time, o.begin, o.until, o.drift)
            split = [[(w * (1.0 - part), p), (w * part, p.changed(o.values, o.fields))] for w, p in out]
            out = [(w, p) for w, p in chain.from_iterable(split) if w.any()]
        return out

    def at(self, time: float) -> "Physics":
        """Return what holds most at a time."""
        return max(self.phases(np.array([time])), key=lambda phase: float(phase[0][0]))[1]

    @cached_property
    def active(self) -> list[Term]:
        """Nominal terms and added ones, in the order of their names."""
        used = {*self.values, *self.fields}
        return [t for n, t in all_terms().items() if (t.nominal or n in used) and n not in self.off]

    @property
    def waits(self) -> list[Field]:
        """Where trucks stand, of every term that acts so."""
        return [self.fields[t.name] for t in self.active if t.waits and t.name in self.fields]

    def values_along(self, term: Term, motion: Motion) -> Values:
        """The values of a term's parameters, its field looked up along the motion."""
        values = self.values.get(term.name, {})
        if term.name not in self.fields:
            return values
        first = term.parameters[0]
        neutral = float(np.asarray(values.get(first.name, first.nominal(self.truck))))
        return {**values, first.name: self.fields[term.name].along(motion, neutral)}

    @cached_property
    def actual_truck(self) -> Truck:
        """The truck with every value that a term replaces."""
        given = ((t.by_name[name], v) for t in self.active for name, v in self.values.get(t.name, {}).items())
        return _with_values(self.truck, tuple((p.truck_key, float(v)) for p, v in given if p.truck_key))

    def actual_motion(self, motion: Motion) -> Motion:
        """The motion with the load that acts, where a term replaces it."""
        for term in self.active:
            if term.acts == "load" and term.function is not None:
                load = term.function(motion, self.truck, self.values_along(term, motion))
                motion = motion.replaced(payload=load)
        return motion


@lru_cache(1024)
def _with_values(truck: Truck, values: tuple[tuple[str, float], ...]) -> Truck:
    return reduce(lambda changed, one: changed.with_value(*one), values, truck)


def term_forces(motion: Motion, physics: Physics) -> ByTerm:
    """Force at the wheel by term, (N,) newtons each, > 0 resisting."""
    return evaluated(motion, physics, "force")


def ledger(motion: Motion, physics: Physics, forces: ByTerm | None = None) -> ByTerm:
    """Battery power by term, (N,) watts each; the sum over terms is the model's power.  ``forces`` are the
    :func:`term_forces` where they are at hand already."""
    if physics.own:
        return _over_phases(motion, physics, lambda p: ledger(motion, p))
    forces = term_forces(motion, physics) if forces is None else forces
    powers = evaluated(motion, physics, "power")
    drive = physics.actual_truck.drive
    total = sum(forces.values(), np.zeros(len(motion)))
    conversion = np.where(total >= 0.0, 1.0 / drive.efficiency, drive.regeneration) * motion.speed
    driven = evaluated(motion, physics, "drive", {"force": total})
    return {**{n: f * conversion for n, f in forces.items()}, **powers, **driven}


def _over_phases(motion: Motion, physics: Physics, of: Callable[[Physics], ByTerm]) -> ByTerm:
    """The mean over the phases of a motion, by their shares."""
    total: ByTerm = {}
    for weight, phase in physics.phases(motion.time):
        for name, values in of(phase).items():
            total[name] = total.get(name, 0.0) + weight * values
    return total


def evaluated(motion: Motion, physics: Physics, acts: str, given: Values = MappingProxyType({})) -> ByTerm:
    """What the functions of all terms that act so return, (N,) each, ``given`` further values."""
    if physics.own:
        return _over_phases(motion, physics, lambda p: evaluated(motion, p, acts, given))
    return acting(physics.actual_motion(motion), physics.actual_truck, physics, acts, given)


def acting(
    motion: Motion, truck: Truck, physics: Physics, acts: str, given: Values = MappingProxyType({})
) -> ByTerm:
    """The same of a physics without own values, for its actual motion and truck."""
    terms = ((t, t.function) for t in physics.active if t.acts == acts and t.function is not None)
    return {t.name: f(motion, truck, {**physics.values_along(t, motion), **given}) for t, f in terms}


def battery_power(motion: Motion, physics: Physics) -> Floats:
    """(N,) power at the battery terminals [W], > 0 when discharging."""
    return np.asarray(sum(ledger(motion, physics).values(), np.zeros(len(motion))))


def allowed_speed(motion: Motion, physics: Physics) -> Floats:
    """(N,) highest speed [m/s] that all terms leave of ``motion.speed``, which road and truck allow."""
    return np.asarray(np.min([motion.speed, *evaluated(motion, physics.fleet, "speed").values()], axis=0))


def cell_power(terminal: Floats, truck: Truck) -> Floats:
    """(N,) power that the state of charge pays [W]: P + R (P / V)^2."""
    if not truck.battery.internal_resistance:
        return terminal
    return terminal + truck.battery.internal_resistance * (terminal / truck.battery.voltage) ** 2


def soc_change(terminal: Floats, dt: Floats, truck: Truck) -> Floats:
    """(N,) change of the state of charge in each sample."""
    return -cell_power(terminal, truck) * dt / (3600.0 * truck.battery.capacity_wh)

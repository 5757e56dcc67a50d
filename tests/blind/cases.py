"""Cases of the benchmark: what is concealed, on which site, by which logger; lists of cases by family.

A case is written as ``TERM+TERM@STRENGTH,key=value,...``, for example
``grade+wind@0.5,site=ring,logger=uneven,seed=7``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from effects import OUTSIDE, POWER, SPEED, TERMS
from loggers import LOGGERS
from sites import KINDS

SCOPES = ("fleet", "truck", "type", "period", "drift", "place")
STRENGTHS = (1.0, 0.5, 0.25, 0.125)
WRONG = ("mass+", "mass-", "efficiency+", "efficiency-")


@dataclass(frozen=True)
class Case:
    """One recording; everything else follows from it."""

    terms: tuple[str, ...] = ()
    strength: float = 1.0
    site: str = "plant"
    logger: str = "clean"
    scope: str = "fleet"
    together: str = ""
    """``road``: placed terms share a road; ``opposite``: the first goes up, the second down."""
    wrong: str = ""
    """The truck file's mass is 5 % or its efficiency 3 % too high (+) or too low (-)."""
    seed: int = 0
    vehicles: int = 4
    hours: float = 2.5
    days: int = 1
    by: str = ""
    """``engine``: driven by rigid bodies in place of a balance of forces."""
    family: str = ""

    @property
    def name(self) -> str:
        """The case as it is written, without its family."""
        what = "+".join(self.terms) or "none"
        if self.strength != 1.0:
            what += f"@{self.strength:g}"
        plain = Case()
        keys = ("site", "logger", "scope", "together", "wrong", "seed", "vehicles", "hours", "days", "by")
        for key in keys:
            if getattr(self, key) != getattr(plain, key):
                what += f",{key}={getattr(self, key)}"
        return what

    @classmethod
    def parse(cls, text: str) -> Case:
        """Read what ``name`` writes."""
        what, *rest = text.split(",")
        terms, _, strength = what.partition("@")
        given: dict[str, object] = dict(part.split("=", 1) for part in rest)
        kinds = {"seed": int, "vehicles": int, "hours": float, "days": int}
        return cls(
            () if terms == "none" else tuple(terms.split("+")),
            float(strength or 1.0),
            **{k: kinds.get(k, str)(v) for k, v in given.items()},  # type: ignore[arg-type, operator]
        )


def clean(seed: int) -> Iterator[Case]:
    """Nothing is concealed: every logger once a seed, the sites in turn."""
    for k, logger in enumerate(LOGGERS):
        yield _fit(Case(logger=logger, site=KINDS[(seed + k) % len(KINDS)], seed=seed))


def ladders(seed: int) -> Iterator[Case]:
    """Every term at four strengths, and effects that no term describes at two."""
    for strength in STRENGTHS:
        for term in TERMS:
            yield Case((term,), strength, seed=seed)
    for strength in STRENGTHS[:2]:
        for term in OUTSIDE:
            yield Case((term,), strength, seed=seed)


def mixtures(seed: int) -> Iterator[Case]:
    """Two and three at once, two on one road, opposite signs."""
    rng = np.random.default_rng([seed, 2])

    def some(of: tuple[str, ...], count: int) -> tuple[str, ...]:
        return tuple(str(t) for t in rng.choice(of, count, replace=False))

    for _ in range(3):
        yield Case(some(POWER, 2), seed=seed)
        yield Case(some(POWER, 3), seed=seed)
    yield Case(some(POWER, 2) + some(SPEED, 1), seed=seed)
    yield Case(some(POWER, 1) + some(SPEED, 2), seed=seed)
    for pair in (
        ("grade", "surface_resistance"),
        ("surface_resistance", "speed_zone"),
        ("speed_zone", "waiting"),
        ("grade", "waiting"),
    ):
        yield Case(pair, together="road", seed=seed)
    for up_and_down in (
        ("auxiliary_load", "rolling_resistance"),
        ("payload", "mass"),
        ("regeneration", "payload"),
        ("viscous_drag", "rolling_resistance"),
    ):
        yield Case(up_and_down, together="opposite", seed=seed)


def loggers(seed: int) -> Iterator[Case]:
    """Every logger with three terms, drawn anew for each seed."""
    for k, logger in enumerate(LOGGERS):
        rng = np.random.default_rng([seed, 3, k])
        for term in rng.choice(_suited(logger), 3, replace=False):
            yield _fit(Case((str(term),), logger=logger, seed=seed))


def sites(seed: int) -> Iterator[Case]:
    """Every site with four terms, drawn anew for each seed."""
    for k, site in enumerate(KINDS):
        rng = np.random.default_rng([seed, 4, k])
        terms = [t for t in TERMS if not (site == "none" and t in SPEED)]
        for term in rng.choice(terms, 4, replace=False):
            yield Case((str(term),), site=site, seed=seed)


SCOPED: dict[str, tuple[str, ...]] = {
    "truck": ("rolling_resistance", "viscous_drag", "auxiliary_load", "regeneration", "acceleration_limit"),
    "type": ("mass", "rolling_resistance", "lift_efficiency", "auxiliary_load", "laden_speed"),
    "period": (
        "rolling_resistance",
        "auxiliary_load",
        "drivetrain_efficiency",
        "payload",
        "acceleration_limit",
    ),
    "drift": (
        "rolling_resistance",
        "drivetrain_efficiency",
        "auxiliary_load",
        "lift_efficiency",
        "battery_resistance",
    ),
    "place": ("surface_resistance", "grade", "viscous_drag", "speed_zone", "waiting"),
}
"""Five terms a scope; ``place``: there, and from a time on."""


def scopes(seed: int) -> Iterator[Case]:
    """One truck, one type, a period, a drift, a place in a period."""
    for scope, terms in SCOPED.items():
        for term in terms:
            yield Case((term,), scope=scope, seed=seed, vehicles=6, hours=2.0)


def wrong_truck(seed: int) -> Iterator[Case]:
    """The truck file is wrong within its tolerances: with nothing concealed, and with one term."""
    rng = np.random.default_rng([seed, 5])
    for wrong in WRONG:
        yield Case(wrong=wrong, seed=seed)
        for term in rng.choice([*POWER, *SPEED], 2, replace=False):
            yield Case((str(term),), wrong=wrong, seed=seed)


def traffic(seed: int) -> Iterator[Case]:
    """Fleets of 4 to 20 trucks in traffic: clean, with each effect on speed, and with two on power."""
    rng = np.random.default_rng([seed, 11])
    fleet = Case(site="grid", seed=seed, vehicles=int(rng.integers(4, 21)), hours=1.0)
    yield fleet
    for term in (*SPEED, *map(str, rng.choice(POWER, 2, replace=False))):
        yield replace(fleet, terms=(term,))


def engine(seed: int) -> Iterator[Case]:
    """Trucks as rigid bodies: clean on three sites, and every effect on power, named or not."""
    fleet = Case(logger="2hz", seed=seed, vehicles=3, hours=1.6, by="engine")
    for site in ("plant", "yard", "none"):
        yield replace(fleet, site=site)
    for term in (*POWER, *OUTSIDE):
        # An hour that the recording does not outlast would rightly be told as a change since it began.
        yield replace(fleet, terms=(term,), hours=2.5 if term == "hour" else fleet.hours)


FAMILIES: dict[str, Callable[[int], Iterator[Case]]] = {
    f.__name__: f for f in (clean, ladders, mixtures, loggers, sites, scopes, wrong_truck, traffic, engine)
}


def family(name: str, seeds: range) -> list[Case]:
    """Cases of one family, seed by seed."""
    return [replace(case, family=name) for seed in seeds for case in FAMILIES[name](seed)]


def _suited(logger: str) -> list[str]:
    """Terms that a log of this kind has the columns for."""
    lacks = LOGGERS[logger].without
    out = [t for t in TERMS if not (t == "averaging" and LOGGERS[logger].mean)]
    if "latitude" in lacks:
        out = [
            "auxiliary_load",
            "enabled_load",
            "thermal_load",
            "drivetrain_efficiency",
            "battery_capacity",
            "rolling_resistance",
        ]
    if "payload" in lacks:
        out = [t for t in out if t not in ("payload", "lift_efficiency", "laden_speed", "mass")]
    if "speed" in lacks:
        out = [t for t in out if t != "speed_scale"]
    if "battery_power" in lacks:
        out = [t for t in out if t not in ("clock_offset", "averaging", "battery_resistance")]
    return out


def _fit(case: Case) -> Case:
    """Longer recordings for rare rows, shorter for many."""
    hours = {"0.2hz": 5.0, "uneven": 5.0, "mean_5s": 5.0, "5hz": 2.0, "10hz": 1.5, "20hz": 1.0}
    return replace(case, hours=hours.get(case.logger, case.hours))

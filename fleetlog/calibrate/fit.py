"""The fit: most probable truck given the runs and what was known before, and what the runs cannot tell.

In units of the prior's deviation, z = (p - p0) / spread, the fit minimises |(y - f(z)) / sigma|^2 + |z|^2
within the bounds of a truck file (Gauss-Newton, trust region).  With J = d(f / sigma) / dz at the optimum the
posterior covariance of z is (J'J + 1)^-1 (Tarantola, Inverse Problem Theory, 2005, section 3.2; doi
10.1137/1.9780898717921).  Where the motion is estimated from a log, each term of the ledger may be wrong in
form by a few per cent: the shift that this would make is added.

Which numbers do the runs carry?  Columns of J are taken greedily, the most telling first, each as far as
those before do not explain it (pivoted QR).  Where less than one prior deviation of information is left, the
rest is *held* at its prior.  A free number whose posterior is still wide, or wide for the most part because a
held one can stand in for it, is *tied*: the runs carry a combination of both.  The others are *fitted*."""

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fleetlog.calibrate.observe import Observations, observations, together
from fleetlog.core.arrays import Floats, Mask
from fleetlog.core.files import located
from fleetlog.core.truck import SECTIONS, Truck
from fleetlog.physics.power import Physics

LEAST_INFORMATION = 1.0  # Of a free number, given more telling ones: with less the prior says more
CARRIED = 0.25  # A number is fitted if the runs leave at most this share of its prior variance ..
BORROWED = 0.5  # ... and at most this share of what they leave is doubt about the held ones.
CONFIDENCE = 0.95  # That all intervals hold at once
STEP = 1e-3  # Of the numerical derivatives, in prior deviations
COMPANION = 0.2  # A number stands in for a held one if it moves by this when that moves by one (deviations)


@dataclass(frozen=True)
class Unknown:
    """One number of the truck file. The prior is normal about the truck file's value with standard deviation
    ``spread`` (``relative``: a share of the value, at least ``floor``), cut off at what a truck file allows.
    ``run`` is what to measure where it stays unknown."""

    key: str
    words: str
    spread: float
    run: str
    relative: bool = False
    floor: float = 0.0

    def deviation(self, truck: Truck) -> float:
        """Standard deviation of the prior, in the parameter's unit."""
        return max(self.spread * truck.value(self.key), self.floor) if self.relative else self.spread

    @property
    def in_file(self) -> Mapping[str, Any]:
        """What a truck file allows: ``unit``, ``low`` and ``high``."""
        section, name = self.key.split(".")
        return next(f.metadata for f in fields(SECTIONS[section]) if f.name == name)


_TEXT = tomllib.loads(Path(__file__).with_name("unknowns.toml").read_text(encoding="utf-8"))
UNKNOWNS: tuple[Unknown, ...] = tuple(Unknown(key, *told) for key, told in _TEXT.items())


@dataclass(frozen=True)
class Estimate:
    """One number after the fit; ``low`` to ``high`` hold at once for all with probability ``CONFIDENCE``.
    ``value`` goes into the truck file: fitted, or tied to the held ones at their prior, or the prior.
    ``remaining`` is the posterior's share of the prior variance."""

    unknown: Unknown
    status: Literal["fitted", "tied", "held"]
    prior: float
    value: float
    low: float
    high: float
    remaining: float


@dataclass(frozen=True)
class Blind:
    """What the runs do not see: ``held`` and the ``companions`` that hide it; ``weak``: seen too faintly."""

    held: Unknown
    companions: tuple[tuple[Unknown, float], ...]
    weak: bool = False


@dataclass(frozen=True)
class Combination:
    """What the runs carry of a tied number: a product of ``powers``; ``deviation`` is a share."""

    powers: tuple[tuple[Unknown, float], ...]
    value: float
    deviation: float


@dataclass(frozen=True)
class Fit:
    """The outcome of a calibration."""

    truck: Truck
    estimates: tuple[Estimate, ...]
    blind: tuple[Blind, ...]
    combinations: tuple[Combination, ...]
    correlation: Floats  # (K, K) of the posterior, in the order of the estimates
    observed: Observations
    before: Floats
    after: Floats
    spread_factor: float  # By how much residuals exceed the stated deviations; intervals are widened by it


def calibrate(measurements: Sequence[str | Path], truck: Truck, physics: Physics | None = None) -> Fit:
    """Fit a truck to datasets and CSV tables (:class:`fleetlog.calibrate.observe.Run`), ``physics`` given."""
    base = Physics(truck) if physics is None else Physics(truck, physics.values, physics.off, physics.fields)
    return fit(together([observations(located(m), base) for m in measurements]), base)


def fit(observed: Observations, physics: Physics) -> Fit:
    """Fit the truck of ``physics`` to the observations; its added terms stay as they are."""
    from scipy.linalg import qr

    problem = _Problem(observed, physics)
    # Free are numbers of which the runs say more than the prior, given those that they say most of.
    first = problem.jacobian(problem.solve(np.ones(len(UNKNOWNS), dtype=bool)))
    triangle, order = qr(first, mode="r", pivoting=True)
    diagonal = np.abs(np.diag(triangle))
    free = np.isin(np.arange(len(order)), order[: len(diagonal)][diagonal >= LEAST_INFORMATION])
    z = problem.solve(free)
    misfit, spare = problem.misfit(z), len(observed) - int(free.sum())
    # Root of chi-squared a degree of freedom, at least 1; 1 where too few figures are left to tell.
    factor = max(1.0, float(np.sqrt(misfit @ misfit / spare))) if spare >= 3 else 1.0
    jacobian = problem.jacobian(z) / factor
    doubt = observed.doubt / (observed.sigma[:, None] * factor)
    covariance = _posterior(jacobian, doubt)
    alone = np.ones(len(UNKNOWNS))
    alone[free] = np.sqrt(np.diag(_posterior(jacobian[:, free], doubt)))
    estimates = problem.estimates(z, np.diag(covariance), alone**2, free)
    blind = _blind(jacobian, free)
    named = {u.key for b in blind for u, _ in b.companions}
    tied = [e.unknown for e in estimates if e.status == "tied"]
    blind += [Blind(u, (), weak=True) for u in tied if u.key not in named]
    scale = np.sqrt(np.diag(covariance))
    return Fit(
        problem.truck(z), estimates, tuple(blind), tuple(_combinations(estimates, blind, alone, problem)),
        covariance / np.outer(scale, scale), observed, observed.predict(physics), problem.predict(z), factor,
    )  # fmt: skip


def _posterior(jacobian: Floats, doubt: Floats) -> Floats:
    """Covariance of z given the runs and the prior, and what each pattern of doubt would shift the fit by."""
    noise = np.linalg.inv(jacobian.T @ jacobian + np.eye(jacobian.shape[1]))
    shift = noise @ jacobian.T @ doubt
    return np.asarray(noise + shift @ shift.T, dtype=np.float64)


class _Problem:
    """Observations, model and prior in units of the prior."""

    def __init__(self, observed: Observations, physics: Physics) -> None:
        self.observed, self.physics = observed, physics
        self.prior = np.array([physics.truck.value(u.key) for u in UNKNOWNS])
        self.spread = np.array([u.deviation(physics.truck) for u in UNKNOWNS])
        self.bounds = np.array([(u.in_file["low"], u.in_file["high"]) for u in UNKNOWNS], float).T
        self.low, self.high = (self.bounds - self.prior) / self.spread

    def truck(self, z: Floats) -> Truck:
        truck = self.physics.truck
        for u, value in zip(UNKNOWNS, self.prior + z * self.spread, strict=True):
            truck = truck.with_value(u.key, float(value))
        return truck

    def predict(self, z: Floats) -> Floats:
        return self.observed.predict(replace(self.physics, truck=self.truck(z)))

    def misfit(self, z: Floats) -> Floats:
        return np.asarray((self.predict(z) - self.observed.measured) / self.observed.sigma)

    def solve(self, free: Mask) -> Floats:
        """The optimum with all but the free numbers at their prior."""
        from scipy.optimize import least_squares

        if not len(axes := np.eye(len(UNKNOWNS))[free]):
            return np.zeros(len(UNKNOWNS))
        low, high = self.low[free], self.high[free]

        def residual(part: Floats) -> Floats:
            return np.concatenate([self.misfit(part @ axes), part])

        def slope(part: Floats) -> Floats:
            return np.concatenate([self.jacobian(part @ axes)[:, free], np.eye(len(part))])

        # The trust region wants a start inside the bounds, also where the prior stands on one.
        start = np.clip(np.zeros(len(low)), low + 1e-2, high - 1e-2)
        found = least_squares(residual, start, jac=slope, bounds=(low, high), xtol=1e-10).x
        # A solution a hair from its bound is the bound.
        found = np.where(found - low < 1e-6, low, np.where(high - found < 1e-6, high, found))
        return np.asarray(found @ axes)

    def jacobian(self, z: Floats) -> Floats:
        """(M, K) derivative of prediction / sigma by z, central where the bounds allow."""
        columns = []
        for axis in np.eye(len(z), dtype=bool):
            up = np.where(axis, np.minimum(z + STEP, self.high), z)
            down = np.where(axis, np.maximum(z - STEP, self.low), z)
            columns.append((self.misfit(up) - self.misfit(down)) / (up - down)[axis])
        return np.stack(columns, axis=1)

    def estimates(self, z: Floats, remaining: Floats, alone: Floats, free: Mask) -> tuple[Estimate, ...]:
        """The numbers; ``remaining``, ``alone``: posterior variances with the held ones unknown and known."""
        from scipy.stats import norm

        value, tails = self.prior + z * self.spread, (1.0 - CONFIDENCE) / len(UNKNOWNS)
        reach = float(norm.ppf(1.0 - tails / 2.0)) * np.sqrt(remaining) * self.spread
        low, high = np.maximum(value - reach, self.bounds[0]), np.minimum(value + reach, self.bounds[1])
        own = (remaining <= CARRIED) & (alone >= (1.0 - BORROWED) * remaining)
        status = np.where(free, np.where(own, "fitted", "tied"), "held")
        columns = (c.tolist() for c in (status, self.prior, value, low, high, remaining))
        return tuple(map(Estimate, UNKNOWNS, *columns))


def _blind(jacobian: Floats, free: Mask) -> list[Blind]:
    """For each held number the free ones that hide its effect: the least-squares x of J_free x = -J_held."""
    basis, out = np.flatnonzero(free), []
    for k in np.flatnonzero(~free):
        weight: Floats = np.zeros(len(basis))
        if np.linalg.norm(jacobian[:, k]) >= LEAST_INFORMATION and len(basis):
            weight = -np.asarray(np.linalg.lstsq(jacobian[:, basis], jacobian[:, k], rcond=None)[0], float)
        strong = [j for j in np.argsort(-np.abs(weight)) if abs(weight[j]) >= COMPANION]
        out.append(Blind(UNKNOWNS[k], tuple((UNKNOWNS[basis[j]], float(weight[j])) for j in strong)))
    return out


def _combinations(
    estimates: tuple[Estimate, ...], blind: list[Blind], alone: Floats, problem: _Problem
) -> Iterator[Combination]:
    """For each tied number p the product p * held^-e that the runs carry, e its elasticity by the held."""
    value = {e.unknown.key: e.value for e in estimates}
    spread = dict(zip(value, problem.spread, strict=True))
    for e, deviation in zip(estimates, alone * problem.spread, strict=True):
        if e.status != "tied" or e.value <= 0.0:
            continue
        powers = []
        for held, moved in ((b.held, w) for b in blind for u, w in b.companions if u == e.unknown):
            if value[held.key] > 0.0:
                slope = moved * spread[e.unknown.key] / spread[held.key]
                powers.append((held, -slope * value[held.key] / e.value))
        if powers:
            product = e.value * float(np.prod([value[u.key] ** w for u, w in powers]))
            yield Combination(((e.unknown, 1.0), *powers), product, float(deviation) / e.value)

"""Coefficients of a joint model: numbers a little off in their tolerance, and those of hypotheses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from fleetlog.core.arrays import Floats, Ints
from fleetlog.discovery.channels.base import Channel
from fleetlog.discovery.hypotheses.hypothesis import Hypothesis
from fleetlog.discovery.hypotheses.sources import KnobSource, Layout, Source
from fleetlog.discovery.model import Knob, Model, Scope
from fleetlog.discovery.search.ridge import Normal, Prior, Sums, inverse, stiff

CERTAIN = 2.0  # A tolerance is stated at this many standard deviations


@dataclass(frozen=True)
class Atom:
    """One coefficient: weighted ``columns``, of one ``vehicle`` or all; its prior, bounds and owner."""

    columns: Ints
    weights: Floats
    precision: float
    centre: float = 0.0
    low: float = -np.inf
    high: float = np.inf
    vehicle: int | None = None
    knob: Knob | None = None
    owner: Hypothesis | None = None

    @property
    def of_truck_file(self) -> bool:
        """Whether it is a number of the truck file that may be a little off."""
        return self.owner is None and self.knob is not None and self.knob.scope.whole

    @property
    def of_error(self) -> bool:
        """Whether it is of what the log hides (sampling, loads), or of how trucks are driven."""
        return self.owner is None and self.knob is None

    @property
    def ends(self) -> bool:
        """Whether trucks may have just the lower bound of the number."""
        return self.knob is not None and self.knob.definition.ends


@dataclass(frozen=True)
class Design:
    """The coefficients of a model, in order."""

    atoms: tuple[Atom, ...]

    @property
    def prior(self) -> Prior:
        """Their priors and bounds."""
        rows = [(a.precision, a.centre, a.low, a.high) for a in self.atoms]
        return Prior(*np.array(rows, dtype=float).reshape(-1, 4).T.copy())

    def scaled(self, share: float) -> Design:
        """Return the design for a truck file that is as good as this share of its tolerances."""
        atoms = (replace(a, precision=a.precision / share**2) if a.of_truck_file else a for a in self.atoms)
        return Design(tuple(atoms))

    def occam(self, normal: Normal, share: float) -> float:
        """Return what the share that it is scaled by costs: log width of the prior by number that is told."""
        which = np.array([a.of_truck_file for a in self.atoms])
        spread = np.diag(inverse(stiff(normal.gram.sum(axis=0), self.prior)))
        return float(np.clip(1.0 - self.prior.precision * spread, 0.0, 1.0)[which].sum() * np.log(share))

    def normal(self, sums: Sums, slow: bool = False) -> Normal:
        """Return the products of the coefficients' columns by fold (of stretches of hours where ``slow``)."""
        p, grams = (sums.layout.core, sums.slow) if slow else (sums.layout.width, sums.fold)
        fleet = np.array([a.vehicle is None for a in self.atoms])
        shared = [a for a in self.atoms if a.vehicle is None]
        rows = np.repeat(np.arange(len(shared)), [len(a.columns) for a in shared])
        data, column = (np.concatenate([getattr(a, n) for a in shared]) for n in ("weights", "columns"))
        basis = sparse.csr_matrix((data, (rows, column)), shape=(len(shared), p))
        k, count = len(self.atoms), len(grams)
        n = Normal(np.zeros((count, k, k)), np.zeros((count, k)), grams[:, -1, -1].copy())
        for f, g in enumerate(grams):
            half = basis @ g[:p]
            n.gram[f][np.ix_(fleet, fleet)] = basis @ np.ascontiguousarray(half[:, :p].T)
            n.moment[f, fleet] = half[:, -1]
        own = [] if slow else [a for a in self.atoms if a.vehicle is not None]
        column, of = np.array([int(a.columns[0]) for a in own]), np.array([a.vehicle for a in own])
        for f, gram in enumerate(n.gram) if own else ():
            rows = sums.own[of, f, column]
            cross = basis @ rows[:, :-1].T
            gram[np.ix_(~fleet, fleet)], gram[np.ix_(fleet, ~fleet)] = cross.T, cross
            gram[np.ix_(~fleet, ~fleet)] = rows[:, column] * (of[:, None] == of[None, :])
            n.moment[f, ~fleet] = rows[:, -1]
        return n

    def columns(self, x: NDArray[np.float32], vehicle: Ints) -> Floats:
        """Return the coefficients' columns, (W, k), from the layout's, (W, P), and the windows' vehicles."""
        basis = np.zeros((x.shape[1], len(self.atoms)))
        for j, atom in enumerate(self.atoms):
            basis[atom.columns, j] = atom.weights
        own = np.array([-1 if a.vehicle is None else a.vehicle for a in self.atoms])
        return np.asarray((x @ basis) * ((own < 0) | (vehicle[:, None] == own)))


def make_design(channel: Channel, layout: Layout, model: Model, chosen: Sequence[Hypothesis]) -> Design:
    """Return the design of a joint model about ``model``: steps of its coefficients."""
    freed = {k for h in chosen for k in h.knobs}
    knobs, vehicles = channel.adjustable(), range(len(channel.fleet.vehicles))
    if len(vehicles) > 1:
        knobs += [replace(k, scope=Scope((v,))) for k in knobs for v in vehicles]
    atoms = [_tolerance(channel, layout, model, k) for k in knobs if k not in freed]
    for source in channel.errors:
        at = np.array(layout.at(source))
        atoms.append(Atom(at, np.ones(1), source.spread**-2.0, low=-source.most, high=source.most))
    for h in chosen:
        alone = sum(other.term == h.term for other in chosen) == 1
        atoms.extend(of_hypothesis(channel, layout, model, h, alone))
    return Design(tuple(atoms))


def _tolerance(channel: Channel, layout: Layout, model: Model, knob: Knob) -> Atom:
    p = knob.definition
    zero = channel.base.coordinate(knob.fleet)
    width = abs(p.scaled(p.value_of(zero) + p.allowance(channel.fleet.truck, not knob.scope.whole)) - zero)
    now, zero = model.coordinate(knob), zero if knob.scope.whole else 0.0
    at = np.array(layout.at(KnobSource(knob.column)))
    low, high = zero - (0.0 if p.caps else width), zero + width
    precision, one = (CERTAIN / width) ** 2, knob.scope.one
    return Atom(at, np.ones(1), precision, zero - now, low - now, high - now, one, knob)


def of_hypothesis(
    channel: Channel, layout: Layout, model: Model, h: Hypothesis, fitted: bool = False
) -> list[Atom]:
    """Return the coefficients of a hypothesis, which of one that is ``fitted`` are steps from where it is."""
    if h.knobs:
        return [_free(layout, model, h, k, s) for k, s in zip(h.knobs, h.sources, strict=True)]
    columns = np.array(layout.at(h.sources[0]), dtype=np.int64)
    if h.patterns:
        basis = channel.cells(h.physics).inverse
        return [Atom(columns, basis @ p.weights, 1e-9, owner=h) for p in h.patterns]
    precision = 1.0 / (h.variance * (h.physics.parameters[0].usual if h.physics else 1.0) ** 2)
    now = np.zeros(len(columns))
    if fitted and h.term in model.fields:
        now = channel.cells(h.physics).inverse @ model.fields[h.term]
    return [Atom(columns[[i]], np.ones(1), precision, -float(now[i]), owner=h) for i in range(len(columns))]


def _free(layout: Layout, model: Model, h: Hypothesis, knob: Knob, source: Source) -> Atom:
    """A number that may be anything plausible."""
    p = knob.definition
    low, high = sorted((p.scaled(p.low), p.scaled(p.high)))
    at, now = np.array(layout.at(source)), model.total(knob)
    return Atom(at, np.ones(1), (high - low) ** -2.0, 0.0, low - now, high - now, knob.scope.one, knob, h)

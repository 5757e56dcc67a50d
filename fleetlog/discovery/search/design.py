"""Coefficients of a joint model: every number a little off within its tolerance, and those of the
hypotheses in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from fleetlog.discovery.channels.base import Channel
from fleetlog.discovery.hypotheses.hypothesis import Hypothesis
from fleetlog.discovery.hypotheses.scope import of_one
from fleetlog.discovery.hypotheses.sources import KnobSource, Layout, Source
from fleetlog.discovery.model import Knob, Model
from fleetlog.discovery.search.ridge import Normal, Prior
from fleetlog.discovery.search.sums import Sums
from fleetlog.physics.power import all_terms

Floats = NDArray[np.float64]

CERTAIN = 2.0  # A tolerance is stated at this many standard deviations
ALIKE = 0.5  # Trucks of a fleet differ by this share of the tolerance of the truck file


@dataclass(frozen=True)
class Atom:
    """One coefficient: weighted ``columns``, of one ``vehicle`` or all; its prior and bounds; and whose
    it is."""

    columns: NDArray[np.int64]
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


@dataclass(frozen=True)
class Design:
    """The coefficients of a model, in order."""

    atoms: tuple[Atom, ...]

    @property
    def prior(self) -> Prior:
        """Their priors and bounds."""
        get = [
            np.array([getattr(a, n) for a in self.atoms], dtype=float)
            for n in ("precision", "centre", "low", "high")
        ]
        return Prior(*get)

    def scaled(self, share: float) -> Design:
        """Return the design for a truck file that is as good as this share of its tolerances."""
        return Design(tuple(
            replace(a, precision=a.precision / share**2) if a.of_truck_file else a for a in self.atoms
        ))  # fmt: skip

    def occam(self, normal: Normal, share: float) -> float:
        """Return what the share costs: the logarithm of the prior's width, for every number that the data
        determine."""
        which = np.array([a.of_truck_file for a in self.atoms])
        if not which.any():
            return 0.0
        precision = self.scaled(share).prior.precision
        spread = np.diag(np.linalg.pinv(normal.gram.sum(axis=0) + np.diag(precision + 1e-12)))
        known = np.clip(1.0 - precision * spread, 0.0, 1.0)
        return float(known[which].sum() * np.log(share))

    def normal(self, sums: Sums, slow: bool = False) -> Normal:
        """Return the products of the coefficients' columns, fold by fold (of stretches of hours where
        ``slow``)."""
        p = sums.layout.core if slow else sums.layout.width
        grams = sums.slow if slow else sums.fold
        fleet = [i for i, a in enumerate(self.atoms) if a.vehicle is None]
        apart = [i for i, a in enumerate(self.atoms) if a.vehicle is not None]
        basis = self._basis(fleet, p)
        wide = sparse.vstack([basis, sparse.csr_matrix((grams.shape[1] - p, len(fleet)))]).T.tocsr()
        basis_t = basis.T.tocsr()
        k, last = len(self.atoms), grams.shape[1] - 1
        gram, moment, square = np.zeros((len(grams), k, k)), np.zeros((len(grams), k)), np.zeros(len(grams))
        at = np.ix_(fleet, fleet)
        for f, g in enumerate(grams):
            half = wide @ g
            gram[f][at] = basis_t @ np.ascontiguousarray(half[:, :p].T)
            moment[f, fleet] = half[:, last]
            square[f] = g[last, last]
        if apart and not slow:
            self._vehicles(sums, basis, fleet, apart, gram, moment)
        return Normal(gram, moment, square)

    def columns(self, x: NDArray[np.float32], vehicle: NDArray[np.int64]) -> Floats:
        """Return the columns of the coefficients, (W, k), from those of the layout, (W, P), and the windows'
        vehicles."""
        out = np.empty((len(x), len(self.atoms)))
        for j, atom in enumerate(self.atoms):
            own = x[:, atom.columns] @ atom.weights
            out[:, j] = own if atom.vehicle is None else own * (vehicle == atom.vehicle)
        return out

    def _basis(self, chosen: list[int], p: int) -> sparse.csr_matrix:
        rows = np.concatenate([self.atoms[i].columns for i in chosen])
        cols = np.repeat(np.arange(len(chosen)), [len(self.atoms[i].columns) for i in chosen])
        data = np.concatenate([self.atoms[i].weights for i in chosen])
        return sparse.csr_matrix((data, (rows, cols)), shape=(p, len(chosen)))

    def _vehicles(
        self,
        sums: Sums,
        basis: sparse.csr_matrix,
        fleet: list[int],
        apart: list[int],
        gram: Floats,
        moment: Floats,
    ) -> None:
        """Fill in the products of the coefficients that belong to one vehicle."""
        p = sums.layout.width
        column = np.array([int(self.atoms[i].columns[0]) for i in apart])
        of = np.array([self.atoms[i].vehicle for i in apart])
        for f in range(len(gram)):
            rows = sums.own[of, f, column]
            cross = (basis.T @ rows[:, :p].T).T
            gram[f][np.ix_(apart, fleet)] = cross
            gram[f][np.ix_(fleet, apart)] = cross.T
            inner = rows[:, column] * (of[:, None] == of[None, :])
            gram[f][np.ix_(apart, apart)] = inner
            moment[f, apart] = rows[:, p]


def make_design(
    channel: Channel, layout: Layout, model: Model, chosen: Sequence[Hypothesis], by_vehicle: bool = True
) -> Design:
    """Return the design of a joint model about ``model``: steps of its coefficients."""
    freed = {k for h in chosen for k in h.knobs}
    atoms = [_tolerance(channel, layout, model, k) for k in channel.adjustable() if k not in freed]
    if by_vehicle and len(channel.vehicles) > 1:
        for knob in channel.adjustable():
            for v in range(len(channel.vehicles)):
                own = replace(knob, scope=of_one(v))
                if own not in freed:
                    atoms.append(_tolerance(channel, layout, model, own))
    for source in channel.errors():
        for column in layout.at(source):
            atoms.append(
                Atom(
                    np.array([column]),
                    np.ones(1),
                    source.spread**-2.0,
                    low=-CERTAIN * source.spread,
                    high=CERTAIN * source.spread,
                )
            )
    for h in chosen:
        alone = sum(other.term == h.term for other in chosen) == 1
        atoms.extend(of_hypothesis(channel, layout, model, h, alone))
    return Design(tuple(atoms))


def _tolerance(channel: Channel, layout: Layout, model: Model, knob: Knob) -> Atom:
    p = knob.definition
    zero = channel.base.coordinate(knob.fleet)
    width = abs(p.scaled(p.value_of(zero) + p.allowance(channel.truck)) - zero)
    if not knob.scope.whole:
        zero, width = 0.0, ALIKE * width
    now = model.coordinate(knob)
    column = layout.at(KnobSource(knob.column))[0]
    return Atom(
        np.array([column]), np.ones(1), (CERTAIN / width) ** 2, zero - now,
        zero - width - now, zero + width - now, knob.scope.one, knob,
    )  # fmt: skip


def of_hypothesis(
    channel: Channel, layout: Layout, model: Model, h: Hypothesis, fitted: bool = False
) -> list[Atom]:
    """Return the coefficients of a hypothesis, which of one that is ``fitted`` are steps from where it is."""
    if h.knobs:
        return [_free(layout, model, h, k, s) for k, s in zip(h.knobs, h.sources, strict=True)]
    columns = np.array(layout.at(h.sources[0]), dtype=np.int64)
    if h.patterns:
        cells = channel.cells(h.physics)
        assert cells is not None and h.physics is not None
        return [
            Atom(columns, w, 1e-9, owner=h)
            for w in (cells.in_basis(p.weights, h.physics.odd) for p in h.patterns)
        ]
    usual = h.physics.parameters[0].usual if h.physics else 1.0
    precision = 1.0 / (h.variance * usual**2)
    now = np.zeros(len(columns))
    if fitted and h.physics is not None and h.term in model.fields:
        cells = channel.cells(h.physics)
        assert cells is not None
        now = cells.in_basis(model.fields[h.term], h.physics.odd)
    return [
        Atom(columns[i : i + 1], np.ones(1), precision, -float(now[i]), owner=h) for i in range(len(columns))
    ]


def _free(layout: Layout, model: Model, h: Hypothesis, knob: Knob, source: Source) -> Atom:
    """A number that may be anything plausible."""
    p = all_terms()[knob.term].by_name[knob.parameter]
    low, high = sorted((p.scaled(p.low), p.scaled(p.high)))
    column, now = layout.at(source)[0], model.total(knob)
    return Atom(
        np.array([column]),
        np.ones(1),
        (high - low) ** -2.0,
        0.0,
        low - now,
        high - now,
        knob.scope.one,
        knob,
        h,
    )

"""Whom and when: every number tried for single trucks, kinds of trucks, and parts of the time.

The products of a number's column are summed by truck and by slot of time.  Those of any scope are sums of them, so that
all trucks, all sets of trucks that stand out, all pairs of a begin and an end, and a drift are compared at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fleetlog.discovery.hypotheses.hypothesis import TIME, Hypothesis
from fleetlog.discovery.hypotheses.scope import Scope
from fleetlog.discovery.model import Knob
from fleetlog.discovery.search.design import make_design
from fleetlog.discovery.search.joint import Joint
from fleetlog.discovery.search.problem import Problem
from fleetlog.discovery.search.screen import Screened

Floats = NDArray[np.float64]
Products = tuple[Floats, Floats, Floats]
"""Of N columns with the model's, (N, K), with the residual, (N,), and with themselves, (N,)."""

SLOTS = 48
"""Of the recorded time: a change is placed within a hundredth of it."""
GROUPS = 600
"""Trucks times slots at most: of large fleets the slots are wider."""
SHORTEST = 3
"""Slots that a period lasts at least: a sixteenth of the recording."""
DISTINCT = 1e-3
"""Share of a column's square that the model must leave of it: of less, nothing is learnt."""


@dataclass(frozen=True)
class Slotted:
    """Products by slow fold F, truck V and slot S: K free coefficients of the model, J numbers that may be added.

    ``gram`` (F, K, K) and ``moment`` (F, K) of the model; ``cross`` (F, V, S, J, K), ``along`` (F, V, S, J) with the
    residual and ``own`` (F, V, S, J) of the numbers; ``precision``, ``centre`` (K,) of the model's prior.
    """

    edges: Floats
    gram: Floats
    moment: Floats
    cross: Floats
    along: Floats
    own: Floats
    precision: Floats
    centre: Floats

    def eliminated(self, without: int | None = None) -> tuple[Floats, Floats]:
        """Return the (K, K) inverse of the model's products and its (K,) fit, on all folds or all but one."""
        keep = np.arange(len(self.gram)) != (-1 if without is None else without)
        gram = self.gram[keep].sum(axis=0)
        inverse = np.linalg.pinv(gram + np.diag(self.precision + 1e-9 * np.maximum(np.diag(gram), 1e-12)))
        return inverse, inverse @ (self.moment[keep].sum(axis=0) + self.precision * self.centre)


def scoped(problem: Problem, now: Joint, screened: Sequence[Screened]) -> list[Screened]:
    """Return each number at its best for a kind of trucks, for a part of the time, and for one truck's part of the time."""
    numbers = _numbers(now, screened)
    if not numbers:
        return []
    s = _slotted(problem, now, numbers)
    assert problem.noise is not None
    beside = _Beside(*s.eliminated(), 2.0 * problem.noise.design)
    out = []
    for j, h in enumerate(numbers):
        for scope, weight in _likely(s, j, beside):
            own = replace(h, knobs=tuple(replace(k, scope=scope) for k in h.knobs))
            out.append(_validated(problem, s, j, own, weight))
    return out


def _numbers(now: Joint, screened: Sequence[Screened]) -> list[Hypothesis]:
    """Every number of the fleet whose changes are not in the model yet, in its most likely shape."""
    taken = {k.fleet for h in now.chosen for k in h.knobs if k.scope.timed}
    best: dict[Knob, Hypothesis] = {}
    for h in (s.hypothesis for s in screened):
        if len(h.knobs) == 1 and h.scope.whole and h.knobs[0] not in taken:
            best.setdefault(h.knobs[0], h)
    return list(best.values())


def _slotted(problem: Problem, now: Joint, numbers: Sequence[Hypothesis]) -> Slotted:
    assert now.design is not None and now.fitted is not None and problem.noise is not None
    layout, _ = problem.layout([*now.chosen, *numbers])
    design = make_design(problem.channel, layout, now.model, now.chosen)
    at = [layout.at(h.sources[0])[0] for h in numbers]
    vehicles, folds = len(problem.channel.vehicles), problem.settings.folds
    slots = int(np.clip(GROUPS // vehicles, 12, SLOTS))
    edges = problem.channel.moments(slots)
    k, j, groups = len(design.atoms), len(numbers), folds * vehicles * slots
    gram, moment = np.zeros((folds, k, k)), np.zeros((folds, k))
    cross, along, own = np.zeros((groups, j, k)), np.zeros((groups, j)), np.zeros((groups, j))
    for i, unit in problem.training():
        use, w = unit.whole, unit.windows[unit.whole]
        modelled, x = problem.channel.columns(unit, now.model, layout.sources)
        root = np.sqrt(problem.noise.weight(i, unit)[use])[:, None]
        base, new = design.columns(x[use], w.vehicle) * root, x[use][:, at] * root
        left = (unit.recorded - modelled)[use] * root[:, 0]
        slot = np.clip(np.searchsorted(edges, w.time, side="right") - 1, 0, slots - 1)
        code = (problem.folds(i, unit)[1][use] * vehicles + w.vehicle) * slots + slot
        for c in np.unique(code):
            rows = code == c
            b, n, r = base[rows], new[rows], left[rows]
            gram[c // (vehicles * slots)] += b.T @ b
            moment[c // (vehicles * slots)] += b.T @ r
            cross[c] += n.T @ b
            along[c] += n.T @ r
            own[c] += np.einsum("ij,ij->j", n, n)
    # Coefficients on a bound stay there.
    prior, beta = now.design.prior, now.fitted.beta
    free = (beta > prior.low) & (beta < prior.high)
    held = np.where(free, 0.0, beta)
    shape = (folds, vehicles, slots, j)
    return Slotted(
        edges, gram[:, free][:, :, free], (moment - gram @ held)[:, free], cross[..., free].reshape(*shape, -1),
        (along - cross @ held).reshape(shape), own.reshape(shape), prior.precision[free], prior.centre[free],
    )  # fmt: skip


@dataclass(frozen=True)
class _Beside:
    """What columns say beside the model: ``inverse`` (K, K) of its products, ``beta`` (K,) its fit, ``unit`` of the losses."""

    inverse: Floats
    beta: Floats
    unit: float

    def left(self, p: Products) -> tuple[Floats, Floats]:
        """Return the (N,) size and moment of N columns with these products, what the model says of them taken away."""
        cross, along, own = p
        return own - np.einsum("ni,ni->n", cross @ self.inverse, cross), along - cross @ self.beta

    def gain(self, p: Products) -> Floats:
        """Return the (N,) gain of the columns, in natural logarithms."""
        size, moment = self.left(p)
        known = size > DISTINCT * p[2]
        return np.where(known, moment**2 / np.where(known, size, 1.0), 0.0) / self.unit


def _likely(s: Slotted, j: int, beside: _Beside) -> list[tuple[Scope, Floats]]:
    """The likeliest scope of each kind, with its weight by truck and slot, (V, S)."""
    cross, along, own = (a.sum(axis=0)[:, :, j] for a in (s.cross, s.along, s.own))
    vehicles, slots = along.shape
    found = []
    who = _kind((cross.sum(axis=1), along.sum(axis=1), own.sum(axis=1)), beside)
    if who:
        found.append((Scope(who), np.ones(slots)))
    found.append(_part((cross.sum(axis=0), along.sum(axis=0), own.sum(axis=0)), beside, s.edges)[1:])
    if vehicles > 1:
        parts = [_part((cross[v], along[v], own[v]), beside, s.edges) for v in range(vehicles)]
        v = int(np.argmax([gain for gain, _, _ in parts]))
        found.append((replace(parts[v][1], vehicles=(v,)), parts[v][2]))
    covered = [np.array([scope.covers(v) for v in range(vehicles)], float) for scope, _ in found]
    return [(scope, np.outer(c, weight)) for c, (scope, weight) in zip(covered, found, strict=True)]


def _kind(by_truck: Products, beside: _Beside) -> tuple[int, ...]:
    """The trucks, two or more but not all, with the largest or the smallest numbers, that stand out most; () of few trucks."""
    count = len(by_truck[1])
    if count < 3:
        return ()
    size, moment = beside.left(by_truck)
    order = np.argsort(moment / np.maximum(size, 1e-9 * by_truck[2] + 1e-300))
    sets = [np.sort(o[:n]) for o in (order, order[::-1]) for n in range(2, count)]
    cross, along, own = (np.stack([p[who].sum(axis=0) for who in sets]) for p in by_truck)
    return tuple(int(v) for v in sets[int(np.argmax(beside.gain((cross, along, own))))])


def _part(by_slot: Products, beside: _Beside, edges: Floats) -> tuple[float, Scope, Floats]:
    """The part of the time, or the drift, that explains most: its gain less what its choice costs, and its weight by slot."""
    slots = len(by_slot[1])
    first, last = _periods(slots)
    cross, along, own = (_cumulated(p)[last] - _cumulated(p)[first] for p in by_slot)
    gains = beside.gain((cross, along, own)) - TIME * ((first > 0).astype(float) + (last < slots))
    k = int(np.argmax(gains))
    cross, along, own = by_slot
    ramp = (np.arange(slots) + 0.5) / slots
    drift = (
        float(beside.gain(((ramp @ cross)[None], (ramp @ along)[None], (ramp**2 @ own)[None]))[0])
        - 2.0 * TIME
    )
    if drift > gains[k]:
        return drift, Scope((), float(edges[0]), float(edges[-1]), True), ramp
    begin = float(edges[first[k]]) if first[k] else -np.inf
    until = float(edges[last[k]]) if last[k] < slots else np.inf
    number = np.arange(slots)
    return float(gains[k]), Scope((), begin, until), ((number >= first[k]) & (number < last[k])).astype(float)


def _periods(slots: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First slot, and the one after the last, of every period but the whole."""
    first, last = np.triu_indices(slots + 1, SHORTEST)
    part = (first > 0) | (last < slots)
    return first[part], last[part]


def _cumulated(products: Floats) -> Floats:
    """(S + 1, ...) sums of the slots before each edge."""
    return np.concatenate([np.zeros((1, *products.shape[1:])), np.cumsum(products, axis=0)])


def _validated(problem: Problem, s: Slotted, j: int, h: Hypothesis, weight: Floats) -> Screened:
    """What a scoped number gains on stretches of hours that it has not seen."""
    assert problem.noise is not None
    cross = np.einsum("vs,fvsk->fk", weight, s.cross[:, :, :, j])
    along = np.einsum("vs,fvs->f", weight, s.along[..., j])
    own = np.einsum("vs,fvs->f", weight**2, s.own[..., j])
    gains = np.zeros(len(s.gram))
    for f in range(len(s.gram)):
        inverse, beta = s.eliminated(f)
        c, a, o = (p.sum(axis=0) - p[f] for p in (cross, along, own))
        by = inverse @ c
        size = o - c @ by
        step = (a - c @ beta) / size if size > DISTINCT * o else 0.0
        # Of the fold held out: its products once the fit on the others is taken away.
        size = own[f] - 2.0 * cross[f] @ by + by @ s.gram[f] @ by
        left = along[f] - cross[f] @ beta - by @ (s.moment[f] - s.gram[f] @ beta)
        gains[f] = 2.0 * step * left - step**2 * size
    gains /= 2.0 * problem.noise.design
    return Screened(h, float(gains.sum()) - problem.settings.parameter * h.numbers - h.choices, gains)

"""Whom and when: every number tried for kinds of trucks, parts of the time, and a truck's part of the time.

The products of a number's column are summed by truck and by slot of time.  Those of any scope are sums of
them, so that all sets of trucks that stand out, all begins and ends, and a drift are compared at once."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.arrays import Floats, Ints, Mask
from fleetlog.discovery.channels.base import Unit
from fleetlog.discovery.hypotheses.cells import Cells, Stretches
from fleetlog.discovery.hypotheses.hypothesis import TIME, Hypothesis, Pattern
from fleetlog.discovery.hypotheses.sources import KNOTS
from fleetlog.discovery.model import Knob, Scope
from fleetlog.discovery.recording.blocks import Windows
from fleetlog.discovery.search.beside import Added, Beside, Screened
from fleetlog.discovery.search.design import Design, make_design, of_hypothesis
from fleetlog.discovery.search.joint import Joint, said
from fleetlog.discovery.search.problem import Problem
from fleetlog.discovery.search.ridge import Prior

SLOTS = 48  # Of the recorded time: a change is found within a hundredth of it, and then placed by windows
GROUPS = 600  # Trucks times slots at most: of large fleets the slots are wider
SHORTEST = 3  # Slots that a period, and what is left of the recording, last at least: a sixteenth of it
DISTINCT = 1e-3  # Share of a column's square that the model must leave of it: of less, nothing is learnt
ANYTHING = Prior(np.zeros(1), np.zeros(1), np.array([-np.inf]), np.array([np.inf]))
OWN = 0.5
"""Share of a column's square that must lie within the classes (trips) that are known to differ each by
itself: of less, a time is told apart from a run of alike classes by the smaller part of what it says."""


@dataclass(frozen=True)
class Column:
    """One column beside a model: products by slow fold F, truck V and slot S. ``cross`` (F, V, S, K) with the
    coefficients, of which the ``model`` has those that are ``free``, and ``summed`` (V, S, k) over folds with
    these; ``along`` (F, V, S) the residual, ``own`` (F, V, S) itself; ``unit`` of the losses."""

    model: Beside
    cross: NDArray[np.float32]
    free: Mask
    summed: Floats
    along: Floats
    own: Floats
    unit: float

    def gain(self, trucks: Floats, slots: Floats) -> tuple[Floats, Floats]:
        """Return the (N,) gains, in natural logarithms, and steps of the column, weighted by trucks (V,) and
        slots of time (N, S), or by trucks (N, V) at all times (S,)."""
        inverse, beta = self.model.fit()
        one, other, axis = (trucks, slots, 0) if trucks.ndim == 1 else (slots, trucks, 1)
        parts = (one, self.summed), (one, self.along.sum(axis=0)), (one**2, self.own.sum(axis=0))
        c, a, o = (np.tensordot(weight, p, (0, axis)) for weight, p in parts)
        o, moment = other**2 @ o, other @ (a - c @ beta)
        size = o - ((other @ (c @ inverse @ c.T)) * other).sum(axis=1)
        known = size > DISTINCT * o
        step = np.where(known, moment / np.where(known, size, 1.0), 0.0)
        return step * moment / self.unit, step

    def added(self, weight: Floats) -> Added:
        """Return the column with (V, S) weights."""
        own = np.einsum("vs,fvs->f", weight**2, self.own)[:, None, None]
        cross = np.einsum("vs,fvsk->fk", weight, self.cross)[:, self.free, None]
        return Added(cross, np.einsum("vs,fvs->f", weight, self.along)[:, None], own)

    def left(self, weight: Floats) -> float:
        """Return the share of the square of the column with (V, S) weights that the model leaves."""
        new = self.added(weight)
        return float(self.model.left(new).product[0, 0] / max(float(new.own.sum()), 1e-300))

    def validated(self, weight: Floats) -> tuple[Floats, float]:
        """Return what the column with (V, S) weights gains on each unseen fold, (F,), and costs the prior."""
        ((gains, paid),) = self.model.gains(self.added(weight), [(slice(0, 1), ANYTHING)])
        return gains / self.unit, paid


class Slotted:
    """Products of J columns that are tried, see :class:`Column`, and of a model's K coefficients."""

    def __init__(self, problem: Problem, now: Joint, tried: Sequence[Hypothesis]) -> None:
        fleet, atoms, folds = problem.channel.fleet, now.design.atoms, problem.settings.folds
        vehicles, k, j = len(fleet.vehicles), len(atoms), len(tried)
        slots = _slots(vehicles)
        shape = folds, vehicles, slots
        self.edges, self.beta, self.unit = fleet.moments(slots), now.fitted.beta, 2.0 * problem.noise.design
        self.gram, self.moment = np.zeros((folds, k, k)), np.zeros((folds, k))
        # Sums of the search itself are of columns in single precision; there are many of these.
        self.cross, (self.along, self.own) = np.zeros((*shape, j, k), np.float32), np.zeros((2, *shape, j))
        for slot, w, base, new, left in _rows(problem, now, tried, self.edges):
            code = (problem.split.slow_fold(w) * vehicles + w.vehicle) * slots + slot
            for c in np.unique(code):
                at, rows = np.unravel_index(c, shape), code == c
                b, n, r = base[rows], new[rows], left[rows]
                self.gram[at[0]] += b.T @ b
                self.moment[at[0]] += b.T @ r
                self.cross[at] += n.T @ b
                self.along[at] += n.T @ r
                self.own[at] += np.einsum("ij,ij->j", n, n)
        self._summed = self.cross.sum(axis=0, dtype=float)
        self.knobs = tuple(a.knob for a in atoms)
        # The values of classes (of trips or days) of a free curve
        classes = [bool(a.owner and a.owner.curve and a.owner.curve.classes) for a in atoms]
        free = (replace(a, precision=0.0) if of else a for a, of in zip(atoms, classes, strict=True))
        self.prior, self.by_class = Design(tuple(free)).prior, any(classes)
        self._models: dict[bytes, Beside] = {}

    def column(self, j: int, loose: Knob | None = None) -> Column:
        """Return one column; the model's coefficients on a bound stay, but those of the ``loose`` number."""
        free = self.prior.within(self.beta) | self._of(loose)
        held, cross = np.flatnonzero(~free & (self.beta != 0.0)), self.cross[..., j, :]
        along = self.along[..., j] - cross[..., held] @ self.beta[held]
        parts = cross, free, self._summed[:, :, j, free], along, self.own[..., j]
        return Column(self._beside(free), *parts, self.unit)

    def loosened(self, loose: Knob) -> tuple[Floats, float]:
        """Return what letting the ``loose`` number off its bounds gains by itself on each unseen fold, (F,),
        and costs the prior: the column beside it gains that more over the model as it is."""
        free = self.prior.within(self.beta)
        let = ~free & self._of(loose)
        if not let.any():
            return np.zeros(len(self.gram)), 0.0
        moment = self.moment - self.gram @ np.where(free, 0.0, self.beta)
        new = Added(self.gram[:, free][:, :, let], moment[:, let], self.gram[:, let][:, :, let])
        own, none = self.prior.part(let), np.zeros(let.sum())
        off = Prior(own.precision, own.centre - self.beta[let], none - np.inf, none + np.inf)
        ((gains, paid),) = self._beside(free).gains(new, [(slice(0, len(none)), off)])
        return gains / self.unit, paid - off.penalty(none)

    def _of(self, number: Knob | None) -> Mask:
        return np.array([number is not None and k is not None and k.fleet == number for k in self.knobs])

    def _beside(self, free: Mask) -> Beside:
        """The model with its ``free`` coefficients, the others as they are."""
        if (key := free.tobytes()) not in self._models:
            moment = (self.moment - self.gram @ np.where(free, 0.0, self.beta))[:, free]
            self._models[key] = Beside(self.gram[:, free][:, :, free], moment, self.prior.part(free))
        return self._models[key]


def scoped(problem: Problem, now: Joint, screened: Sequence[Screened]) -> list[Screened]:
    """Return each number at its best for a kind of trucks, a part of the time, and one truck's part."""
    # Every number of the fleet whose changes are not in the model yet, in its most likely shape
    taken = {k.fleet for h in now.chosen for k in h.knobs if k.scope.timed}
    numbers: dict[Knob, Hypothesis] = {}
    for h in (s.hypothesis for s in screened):
        if len(h.knobs) == 1 and h.scope.whole and h.knobs[0] not in taken:
            numbers.setdefault(h.knobs[0], h)
    if not numbers:
        return []
    s = Slotted(problem, now, list(numbers.values()))
    # What comes and goes between two knots of the curves by which power was told is no battery's.
    knots, out = np.ptp(s.edges) / (KNOTS - 1) if problem.channel.unsteady else 0.0, list[Screened]()
    for j, h in enumerate(numbers.values()):
        alone, cost = s.loosened(h.knobs[0])
        for column, scope, weight in _likely(s, j, h.knobs[0]):
            if column.left(weight) < (OWN if s.by_class else DISTINCT) or scope.until - scope.begin < knots:
                continue
            own = h.of(scope)
            gains, paid = column.validated(weight)
            if scope.timed:
                gains, paid = gains + alone, paid + cost
            out.append(Screened(own, float(gains.sum()) - paid - problem.price(own), gains))
    return out


def narrowed(problem: Problem, now: Joint, joint: Joint) -> Hypothesis | None:
    """Return the field that a joint model adds, in its likeliest part of the time; None if there is none."""
    h = joint.chosen[-1]
    if not (h.field or h.patterns) or h.term is None or h.term in {c.term for c in now.chosen}:
        return None
    shape = Pattern(joint.model.fields[h.term].tobytes(), "as found")
    s = Slotted(problem, now, [Hypothesis(h.term, patterns=(shape,))])
    every = tuple(range(len(problem.channel.fleet.vehicles)))
    return replace(h, when=max(_parts(s.column(0), s.edges, every), key=lambda p: p[0])[1])


def ended(problem: Problem, joint: Joint, h: Hypothesis) -> Hypothesis:
    """Return a hypothesis of a part of the time with its ends where windows, not slots, say that they are."""
    scope, fleet = h.scope, problem.channel.fleet
    always, term = replace(scope, begin=-np.inf, until=np.inf), h.term or ""
    if h.knobs:
        without = joint.model.without({*h.knobs}, set())
        there = without.moved({replace(k, scope=always): joint.model.coordinate(k) for k in h.knobs})
    else:
        without, there = joint.without(h), joint.model.with_field(term, joint.model.fields[term])

    def told(unit: Unit) -> Floats:
        """Times, and what the hypothesis says better of each window."""
        use = unit.whole & (always.share(int(unit.windows.vehicle[0]), unit.windows.time) > 0.0)
        both = (replace(joint, model=m) for m in (without, there))
        off = (unit.recorded - said(problem.channel, unit, j)[0] for j in both)
        gain = next(off) ** 2 - next(off) ** 2
        return np.stack([unit.windows.time, problem.noise.weight(unit) * gain])[:, use]

    time, gain = np.concatenate([told(u) for u in problem.training()], axis=1)
    order = np.argsort(time)
    total, between = np.append(0.0, np.cumsum(gain[order])), time[order][1:] / 2.0 + time[order][:-1] / 2.0
    slot = fleet.span / _slots(len(fleet.vehicles))

    def at(end: float, worth: Floats) -> float:
        """Between which windows within a slot of an end most is gained."""
        near = np.flatnonzero(np.abs(between - end) <= slot)
        return float(between[near[worth[near + 1].argmax()]]) if near.size else end

    return h.of(replace(scope, begin=at(scope.begin, -total), until=at(scope.until, total)))


def trips_agree(problem: Problem, always: Joint, timed: Joint) -> bool:
    """Return whether what speaks for a part of the time is beyond what trips differ by: two or three of them
    that a field fits badly tell no time."""
    told: list[Floats] = []
    for unit in problem.training():
        one, other = (unit.recorded - np.sum(said(problem.channel, unit, j), axis=0) for j in (always, timed))
        _, trip = np.unique(problem.split.unit(unit.windows), return_inverse=True)
        gained = unit.whole * problem.noise.weight(unit) * (one**2 - other**2)
        told.append(np.bincount(trip, gained).astype(float))
    gain = np.concatenate(told)
    return bool(gain.sum() > problem.settings.consistency * np.sqrt((gain**2).sum()))


def stood_out(problem: Problem, now: Joint) -> list[Hypothesis]:
    """Return each field of roads in the part of the time in which one road says most for it, if that is worth
    a look: the model's own columns stay as they are here."""
    taken, channel = {h.term for h in now.chosen}, problem.channel
    fields = [h for h in problem.rest if h.field and h.term and h.term not in taken]
    tried = [replace(h, field=False, patterns=_roads(channel.cells(h.physics))) for h in fields]
    owner = np.repeat(np.arange(len(tried)), [len(h.patterns) for h in tried])
    bounds = [p.parameters[0].plausible for h in tried if (p := h.physics) for _ in h.patterns]
    (along, own), edges = np.zeros((2, SLOTS, len(owner))), channel.fleet.moments(SLOTS)
    for slot, _, base, new, left in _rows(problem, now, tried, edges) if len(owner) else ():
        off = left - base @ now.fitted.beta
        for k in np.unique(slot):
            x = new[slot == k]
            along[k] += off[slot == k] @ x
            own[k] += (x * x).sum(axis=0)
    there, first, last, cost = _spans(SLOTS)
    moment, size = there @ along, there @ own
    value = np.clip(moment / np.maximum(size, 1e-12), *np.reshape(bounds, (-1, 2)).T)
    gain = value * (2.0 * moment - value * size) / (2.0 * problem.noise.design) - cost[:, None]
    worth = problem.settings.evidence + problem.settings.parameter
    best = [gain[:, owner == i].max(axis=1, initial=0.0) for i in range(len(fields))]
    when = [_period(edges, first[g.argmax()], last[g.argmax()]) for g in best]
    return [replace(h, when=t) for h, t, g in zip(fields, when, best, strict=True) if g.max() > worth]


def _roads(cells: Cells) -> tuple[Pattern, ...]:
    """Every road of a field as a whole; none where there is no map."""
    spans = cells.roads() if isinstance(cells, Stretches) else []
    at = np.arange(len(cells))
    return tuple(Pattern(((at >= a) & (at < b)).astype(float).tobytes(), "road") for a, b in spans)


def _rows(
    problem: Problem, now: Joint, tried: Sequence[Hypothesis], edges: Floats
) -> Iterator[tuple[Ints, Windows, Floats, Floats, Floats]]:
    """Yield (w,) slots of time, windows, the weighted columns (w, K) of a model and (w, J) of hypotheses,
    and what the model leaves, (w,)."""
    layout = problem.layout([*now.chosen, *tried])
    design = make_design(problem.channel, layout, now.model, now.chosen)
    added = Design(tuple(a for h in tried for a in of_hypothesis(problem.channel, layout, now.model, h)))
    for unit in problem.training():
        use, w = unit.whole, unit.windows[unit.whole]
        modelled, x = problem.channel.columns(unit, now.model, layout.sources)
        root = np.sqrt(problem.noise.weight(unit)[use])[:, None]
        base, new = (d.columns(x[use], w.vehicle) * root for d in (design, added))
        slot = np.clip(np.searchsorted(edges, w.time, side="right") - 1, 0, len(edges) - 2)
        yield slot, w, base, new, (unit.recorded - modelled)[use] * root[:, 0]


def _slots(vehicles: int) -> int:
    return int(np.clip(GROUPS // vehicles, 12, SLOTS))


def _likely(s: Slotted, j: int, knob: Knob) -> list[tuple[Column, Scope, Floats]]:
    """The likeliest scopes of each kind: the column, the scope, and its weight by truck and slot, (V, S)."""
    column, loose = s.column(j), s.column(j, knob)
    vehicles = column.along.shape[1]
    out = [(column, scope, weight) for scope, weight in _kind(column)]
    best = _parts(loose, s.edges, tuple(range(vehicles)))
    if vehicles > 1:
        single = [part for v in range(vehicles) for part in _parts(loose, s.edges, (v,))]
        best += sorted(single, key=lambda p: -p[0])[:2]
    return out + [(loose, scope, weight) for _, scope, weight in best]


def _kind(column: Column) -> list[tuple[Scope, Floats]]:
    """The two or more trucks, at most half, with the largest or smallest numbers that stand out most."""
    _, vehicles, slots = column.along.shape
    if vehicles < 3:
        return []
    each, always = np.eye(vehicles), np.ones(slots)
    order = np.argsort(column.gain(each, always)[1])
    sets = [np.sort(o[:n]) for o in (order, order[::-1]) for n in range(2, (vehicles + 1) // 2 + 1)]
    trucks = np.stack([each[who].sum(axis=0) for who in sets])
    k = int(np.argmax(column.gain(trucks, always)[0]))
    return [(Scope(tuple(int(v) for v in sets[k])), np.outer(trucks[k], always))]


def _parts(column: Column, edges: Floats, who: tuple[int, ...]) -> list[tuple[float, Scope, Floats]]:
    """The likeliest part of the time in some trucks, and a drift: gain less its choice, scope, weight."""
    _, vehicles, slots = column.along.shape
    there, first, last, ends = _spans(slots)
    ramp = (np.arange(slots) + 0.5) / slots
    trucks = np.isin(np.arange(vehicles), who).astype(float)
    weights = np.concatenate([there, ramp[None]])
    gains = column.gain(trucks, weights)[0]
    ends = np.append(ends, 2.0 * TIME)
    k, own = int(np.argmax((gains - ends)[:-1])), who if len(who) < vehicles else ()
    drift = Scope(own, float(edges[0]), float(edges[-1]), drift=True)
    return [
        (float(gains[k] - ends[k]), _period(edges, first[k], last[k], own), np.outer(trucks, weights[k])),
        (float(gains[-1] - ends[-1]), drift, np.outer(trucks, weights[-1])),
    ]


def _spans(slots: int) -> tuple[Floats, Ints, Ints, Floats]:
    """All parts of the time: their slots (N, S), the first and the one after the last, what the ends cost."""
    first, last = np.triu_indices(slots + 1, SHORTEST)
    part = last - first <= slots - SHORTEST
    first, last, slot = first[part], last[part], np.arange(slots)
    there = (slot >= first[:, None]) & (slot < last[:, None])
    return there.astype(float), first, last, TIME * ((first > 0).astype(float) + (last < slots))


def _period(edges: Floats, first: int, last: int, who: tuple[int, ...] = ()) -> Scope:
    begin = float(edges[first]) if first else -np.inf
    return Scope(who, begin, float(edges[last]) if last < len(edges) - 1 else np.inf)

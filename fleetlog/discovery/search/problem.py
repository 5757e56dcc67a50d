"""A channel with its split and weights: what the search asks, and what it gets in return.

Weights follow how far windows scatter about a model that is right: first the nominal one, then, once a model
leaves far less, the freest about it, as what bends about the nominal one is no noise.  It grows with the
power drawn, so it is measured in classes of power; and where rows scatter more than is usual at that power,
as trucks jerk between them, by a power of that excess which is measured too."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial, reduce

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky, solve_triangular

from fleetlog.core.arrays import Floats, Ints
from fleetlog.discovery.channels.base import Channel, Columns, Unit
from fleetlog.discovery.hypotheses.hypothesis import Chosen, Hypothesis
from fleetlog.discovery.hypotheses.sources import FieldSource, KnobSource, Layout, Source, lay_out
from fleetlog.discovery.model import Model
from fleetlog.discovery.recording.blocks import Windows
from fleetlog.discovery.recording.splits import HELD_OUT, Split
from fleetlog.discovery.search.ridge import Sums
from fleetlog.discovery.settings import Settings

CLASSES = 12
ENOUGH = 50  # Windows of a class: their median tells the variance to a quarter
RIDGE = 0.02  # Ridge of the freest model, as a share of each column's own square: idle columns stay small
HUBER = 4.0  # Standard deviations beyond which a window counts less (Huber 1964, doi 10.1214/aoms/1177703732)
MEDIAN = 2.198  # The mean square of a normal variable over the median of its square
FEWEST = 5
LESS = 0.5  # Of the losses that noise leads to expect; medians of a hundred windows tell it to a seventh
EXPONENTS = np.linspace(0.0, 2.0, 9)  # Of rows' scatter in windows' variance: 0, they telescope; 2, each errs


@dataclass
class Noise:
    """Variance per second of a window by its power, robust weights of the windows seen, and the design
    effect. ``design`` is by how much more sums over a trip (or what is held out in its place) scatter than
    independent windows would."""

    power: Floats
    variance: Floats
    model_error: float
    design: float = 1.0
    usual: Floats = field(default_factory=lambda: np.array([1.0]))
    """Usual scatter of rows in each class of power."""
    exponent: float = 0.0
    robust: dict[tuple[int, float], NDArray[np.float32]] = field(default_factory=dict)
    levels: dict[tuple[int, float], NDArray[np.float32]] = field(default_factory=dict)
    """What the freest model says of the windows seen; noise grows with it."""
    apart: bool = False
    """Whether windows have their known noise each by itself, as waits are, and not alike in a trip."""
    of_logger: dict[int, "Noise"] = field(default_factory=dict)
    """That of each vehicle's kind of logger, where there are several."""

    def weight(self, unit: Unit) -> Floats:
        """Return the inverse variance of every window, (W,)."""
        return self.plain(unit) * self.robust.get(unit.key, np.float32(1.0))

    def plain(self, unit: Unit) -> Floats:
        """Return it without regard to outliers."""
        seconds = np.maximum(unit.windows.duration, 1e-6)
        level = np.abs(self.levels.get(unit.key, unit.level))
        power, own = level / seconds, self.of_logger.get(unit.key[0], self)
        excess = unit.swing / np.interp(power, own.power, own.usual)
        rate = np.interp(power, own.power, own.variance) * excess**own.exponent
        known = unit.noise / (self.design if self.apart else 1.0)
        return np.asarray(1.0 / (rate * seconds + (own.model_error * level) ** 2 + known))


Table = tuple[Unit, Floats, Columns]  # A unit, its modelled quantity (W,), and columns (W, P)


@dataclass
class Problem:
    """A channel to be explained; ``rest`` are all hypotheses but patterns of places."""

    channel: Channel
    split: Split
    settings: Settings
    rest: Chosen
    noise: Noise = field(init=False)  # What :meth:`learn` measured

    def layout(self, hypotheses: Sequence[Hypothesis]) -> Layout:
        """Return the columns of the base and of hypotheses."""
        base: list[Source] = [*(KnobSource(k) for k in self.channel.adjustable()), *self.channel.errors]
        sources = list(dict.fromkeys([*base, *(s for h in hypotheses for s in h.sources)]))
        sources.sort(key=lambda s: isinstance(s, FieldSource) - isinstance(s, KnobSource))
        return lay_out(sources, [self.channel.width(s) for s in sources])

    def training(self, units: Iterable[Unit] | None = None) -> Iterator[Unit]:
        """Yield units, by default all, with what is held out marked as not whole."""
        for unit in self.channel.units() if units is None else units:
            yield replace(unit, whole=unit.whole & (unit.fold != HELD_OUT))

    def count(self, units: Iterable[Unit]) -> int:
        """Return the number of windows of units that may be looked at."""
        return sum(int(unit.whole.sum()) for unit in self.training(units))

    def held_out(self, units: Iterable[Unit] | None = None) -> Iterator[Unit]:
        """Yield what is held out of units, whatever else hangs together with it marked as not whole."""
        for unit in self.channel.units() if units is None else units:
            out = unit.fold == HELD_OUT
            if (unit.whole & out).any():
                yield replace(unit, whole=unit.whole & out).part(out)

    def sampled(self, share: float) -> "Problem":
        """Return the problem with a share of the trips in training, or all."""
        return Problem(self.channel.sampled(share), self.split, self.settings, self.rest)

    def price(self, h: Hypothesis) -> float:
        """Return what a hypothesis costs [nat]: its numbers, and being one of many."""
        return self.settings.parameter * h.numbers + h.choices

    def learn(self, model: Model, hypotheses: Sequence[Hypothesis]) -> None:
        """Measure the noise by what the hypotheses leave, where it is not known."""
        if not hasattr(self, "noise"):
            self.noise = self._measured(model, hypotheses)

    def learn_anew(self, model: Model, hypotheses: Sequence[Hypothesis], lost: float) -> bool:
        """Measure the noise about a model that has ``lost`` [nat] far less on unseen trips than noise allows,
        and return whether it has. What the outline of a free curve misses is no noise, nor evidence."""
        count = sum(int(unit.whole.sum()) for unit in self.training())
        named = self.channel.bends and all(h.term for h in hypotheses)
        if far := named and 2.0 * self.noise.design * lost < LESS * count:
            self.noise = self._measured(model, [*self.rest, *hypotheses])
        return far

    def _measured(self, model: Model, hypotheses: Sequence[Hypothesis]) -> Noise:
        layout = self.layout(hypotheses)
        stands = np.zeros(layout.width)
        for s in layout.sources:  # Fields have seen the windows: they are fitted again, from nothing
            if isinstance(s, FieldSource) and s.term in model.fields and s.scope == model.when[s.term]:
                stands[list(layout.at(s))] = self.channel.cells(s.physics).inverse @ model.fields[s.term]
        tables = ((unit, modelled - x @ stands, x) for unit, modelled, x in self._tables(model, layout))
        own, kinds = self.channel.own_error, self.channel.fleet.loggers
        of_kind = [(kind, float(own[kind[0]])) for kind in kinds] if len(kinds) > 1 else []
        noise = learn(tables, self.settings, self.channel.model_error, self.split.unit, of_kind)
        return replace(noise, apart=not self.channel.bends)

    def sums(self, model: Model, hypotheses: Sequence[Hypothesis]) -> Sums:
        """Return the products of the columns of base and hypotheses about a model, over training windows."""
        self.learn(model, hypotheses)
        return reduce(Sums.__add__, self.channel.each(partial(self._summed, model, self.layout(hypotheses))))

    def _summed(self, model: Model, layout: Layout, units: Iterable[Unit]) -> Sums:
        sums = Sums.empty(layout, self.settings.folds, len(self.channel.fleet.vehicles))
        for unit, modelled, x in self._tables(model, layout, units):
            use, w = unit.whole, unit.windows[unit.whole]
            if len(w):
                sums.add(
                    x[use], (unit.recorded - modelled)[use], unit.recorded[use], self.noise.weight(unit)[use],
                    unit.fold[use], self.split.slow_fold(w), w.vehicle,
                )  # fmt: skip
        sums.flush()
        return sums

    def _tables(self, model: Model, layout: Layout, units: Iterable[Unit] | None = None) -> Iterator[Table]:
        for unit in self.training(units):
            yield unit, *self.channel.columns(unit, model, layout.sources)


def learn(
    tables: Iterable[Table], settings: Settings, model_error: float, together: Callable[[Windows], Ints],
    loggers: Sequence[tuple[Sequence[int], float]] = (),
) -> Noise:  # fmt: skip
    """Measure the noise; windows held out ``together``, (W,), are the independent samples. ``loggers``, where
    there are several kinds: the vehicles of each, and the model's error in them."""
    kept: list[Table] = []
    for table in tables:
        kept.append(table)
        if sum(len(unit.windows) for unit, _, _ in kept) >= settings.sample:
            break
    noise = Noise(np.array([0.0]), np.array([1.0]), 0.0)
    for _ in range(3):
        residual, levels = _left(kept, noise)
        noise = _classes(kept, residual, levels, model_error)
        for vehicles, own in loggers:
            mine = [one for one in zip(kept, residual, levels, strict=True) if one[0][0].key[0] in vehicles]
            if sum(int(unit.whole.sum()) for (unit, _, _), _, _ in mine) >= ENOUGH:
                seen, rest, said = map(list, zip(*mine, strict=True))
                noise.of_logger |= dict.fromkeys(vehicles, _classes(seen, rest, said, own))
        for (unit, _, _), r in zip(kept, residual, strict=True):
            z = np.abs(r) * np.sqrt(noise.plain(unit))
            noise.robust[unit.key] = np.minimum(1.0, HUBER / np.maximum(z, 1e-9)).astype(np.float32)
        noise.design = _design(kept, residual, noise, together)
    return noise


def _left(kept: list[Table], noise: Noise) -> tuple[list[Floats], list[Floats]]:
    """What a ridge fit of every column leaves of a window as if it had not seen it, and what it says."""
    width = kept[0][2].shape[1]
    gram, moment = np.zeros((width, width)), np.zeros(width)
    for unit, modelled, x in kept:
        root = np.sqrt(noise.weight(unit) * unit.whole)
        z = x * root[:, None].astype(np.float32)
        gram += z.T @ z
        moment += z.T @ ((unit.recorded - modelled) * root).astype(np.float32)
    gram += np.diag(RIDGE * np.diag(gram) + 1e-9 * max(float(np.diag(gram).max(initial=0.0)), 1e-9))
    root = cholesky(gram, lower=True)
    beta = cho_solve((root, True), moment).astype(np.float32)
    small = root.astype(np.float32)
    left, said = [], []
    for unit, modelled, x in kept:
        weight = noise.weight(unit) * unit.whole
        told = solve_triangular(small, x.T, lower=True, check_finite=False)
        lever = np.einsum("ij,ij->j", told, told) * weight
        said.append(np.abs(unit.level + x @ beta))
        left.append((unit.recorded - modelled - x @ beta) / np.maximum(1.0 - lever, 1e-3))
    return left, said


def _classes(kept: list[Table], residual: list[Floats], levels: list[Floats], model_error: float) -> Noise:
    units = [unit for unit, _, _ in kept]
    use = np.concatenate([u.whole for u in units])
    seconds = np.maximum(np.concatenate([u.windows.duration for u in units]), 1e-6)[use]
    power = np.concatenate(levels)[use] / seconds
    rate = np.concatenate(residual)[use] ** 2 / seconds
    count = int(np.clip(len(power) // ENOUGH, 1, CLASSES))
    edges = np.quantile(power, np.linspace(0.0, 1.0, count + 1))
    which = np.clip(np.searchsorted(edges, power) - 1, 0, count - 1)
    known = [k for k in range(count) if (which == k).sum() >= FEWEST]
    swing = np.concatenate([u.swing for u in units])[use]
    usual = np.array([np.median(swing[which == k]) for k in known])
    mean = np.array([power[which == k].mean() for k in known])
    excess = swing / np.interp(power, mean, usual)
    seen = {u.key: level.astype(np.float32) for u, level in zip(units, levels, strict=True)}
    tried = []
    for exponent in EXPONENTS:
        part = rate / excess**exponent
        variance = np.array([np.median(part[which == k]) * MEDIAN for k in known])
        variance = np.maximum(variance, 0.1 * np.median(variance) + 1e-12)
        scale = np.interp(power, mean, variance) * excess**exponent
        # Twice the Student likelihood of four degrees of freedom, lost: a few gross errors do not decide.
        lost = float(np.sum(np.log(scale) + 5.0 * np.log1p(rate / scale / 4.0)))
        tried.append((lost, Noise(mean, variance, model_error, usual=usual, exponent=exponent, levels=seen)))
    return min(tried, key=lambda t: t[0])[1]


def _design(kept: list[Table], off: list[Floats], noise: Noise, together: Callable[[Windows], Ints]) -> float:
    """Mean square of sums over what is held out together, of a constant and the energy, over their parts'."""
    found = []
    for constant in (True, False):
        top = bottom = 0.0
        for (unit, _, _), r in zip(kept, off, strict=True):
            weight = noise.weight(unit) * unit.whole
            along = (unit.windows.duration if constant else unit.recorded) * weight * r
            _, which = np.unique(together(unit.windows), return_inverse=True)
            top += float((np.bincount(which, along) ** 2).sum())
            bottom += float((along**2).sum())
        found.append(top / max(bottom, 1e-300))
    return max(1.0, float(np.mean(found)))

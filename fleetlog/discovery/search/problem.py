"""A channel with its split, weights and tolerances: what the search asks, and what it gets in return."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

from fleetlog.core.arrays import Ints
from fleetlog.discovery.channels.base import Channel, Unit
from fleetlog.discovery.hypotheses.hypothesis import Hypothesis
from fleetlog.discovery.hypotheses.sources import FieldSource, KnobSource, Layout, Source, lay_out
from fleetlog.discovery.model import Model
from fleetlog.discovery.recording.splits import HELD_OUT, Split
from fleetlog.discovery.search.noise import Noise, Table, learn
from fleetlog.discovery.search.ridge import Sums
from fleetlog.discovery.settings import Settings


@dataclass
class Problem:
    """A channel to be explained; ``rest`` are all hypotheses but patterns of places."""

    channel: Channel
    split: Split
    settings: Settings
    rest: tuple[Hypothesis, ...]
    noise: Noise = field(init=False)  # What :meth:`learn` measured
    _folds: dict[tuple[int, float], Ints] = field(default_factory=dict, init=False)

    def layout(self, hypotheses: Sequence[Hypothesis]) -> Layout:
        """Return the columns of the base and of hypotheses."""
        base: list[Source] = [*(KnobSource(k) for k in self.channel.adjustable()), *self.channel.errors]
        sources = list(dict.fromkeys([*base, *(s for h in hypotheses for s in h.sources)]))
        sources.sort(key=lambda s: isinstance(s, FieldSource) - isinstance(s, KnobSource))
        return lay_out(sources, [self.channel.width(s) for s in sources])

    def folds(self, unit: Unit) -> Ints:
        """Return the fold of every window of a unit, (W,), which is dealt once for all passes."""
        if unit.key not in self._folds:
            self._folds[unit.key] = self.split.fold(unit.windows)
        return self._folds[unit.key]

    def training(self) -> Iterator[Unit]:
        """Yield the units with what is held out marked as not whole."""
        for unit in self.channel.units():
            yield replace(unit, whole=unit.whole & (self.folds(unit) != HELD_OUT))

    def held_out(self) -> Iterator[Unit]:
        """Yield the units with all but what is held out marked as not whole."""
        for unit in self.channel.units():
            use = unit.whole & (self.folds(unit) == HELD_OUT)
            if use.any():
                yield replace(unit, whole=use)

    def sampled(self, share: float) -> "Problem":
        """Return the problem with a share of the trips; itself where the share is all."""
        if share >= 1.0:
            return self
        return Problem(self.channel.sampled(self.split, share), self.split, self.settings, self.rest)

    def learn(self, model: Model, hypotheses: Sequence[Hypothesis]) -> None:
        """Measure the noise by what the hypotheses leave, where it is not known."""
        if not hasattr(self, "noise"):
            tables = self._tables(model, self.layout(hypotheses))
            self.noise = learn(tables, self.settings, self.channel.model_error, self.split.unit)

    def sums(self, model: Model, hypotheses: Sequence[Hypothesis]) -> Sums:
        """Return the products of the columns of base and hypotheses about a model, over training windows."""
        self.learn(model, hypotheses)
        layout = self.layout(hypotheses)
        sums = Sums.empty(layout, self.settings.folds, len(self.channel.fleet.vehicles))
        for unit, modelled, x in self._tables(model, layout):
            use, w = unit.whole, unit.windows[unit.whole]
            if len(w):
                sums.add(
                    x[use], (unit.recorded - modelled)[use], unit.recorded[use], self.noise.weight(unit)[use],
                    self.folds(unit)[use], self.split.slow_fold(w), w.vehicle,
                )  # fmt: skip
        sums.flush()
        return sums

    def _tables(self, model: Model, layout: Layout) -> Iterator[Table]:
        for unit in self.training():
            yield unit, *self.channel.columns(unit, model, layout.sources)

"""A channel with its split, weights and tolerances: what the search asks, and what it gets in return."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fleetlog.discovery.channels.base import Channel, Columns, Unit
from fleetlog.discovery.hypotheses.hypothesis import Hypothesis
from fleetlog.discovery.hypotheses.sources import FieldSource, KnobSource, Layout, Source, lay_out
from fleetlog.discovery.model import Model
from fleetlog.discovery.recording.splits import HELD_OUT, Split
from fleetlog.discovery.search.noise import Noise, learn
from fleetlog.discovery.search.sums import Sums
from fleetlog.discovery.settings import Settings

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass
class Problem:
    """A channel to be explained; ``rest`` are all hypotheses but patterns of places."""

    channel: Channel
    split: Split
    settings: Settings
    rest: tuple[Hypothesis, ...]
    noise: Noise | None = None
    _folds: dict[int, tuple[Ints, Ints]] = field(default_factory=dict)

    def folds(self, number: int, unit: Unit) -> tuple[Ints, Ints]:
        """Return the fold of every window of a unit, by trips and by stretches of hours, (W,) each."""
        if number not in self._folds:
            self._folds[number] = self.split.fold(unit.windows), self.split.slow_fold(unit.windows)
        return self._folds[number]

    def base_sources(self) -> list[Source]:
        """Return the sources of what may be a little off: tolerances and what sampling hides."""
        return [*(KnobSource(k) for k in self.channel.adjustable()), *self.channel.errors()]

    def layout(self, hypotheses: Sequence[Hypothesis]) -> Layout:
        """Return the columns of the base and of hypotheses."""
        sources = list(dict.fromkeys([*self.base_sources(), *(s for h in hypotheses for s in h.sources)]))
        sources.sort(key=lambda s: isinstance(s, FieldSource) - isinstance(s, KnobSource))
        return lay_out(sources, [self.channel.width(s) for s in sources])

    def training(self) -> Iterator[tuple[int, Unit]]:
        """Yield the units with what is held out marked as not whole."""
        for i, unit in enumerate(self.channel.units()):
            use = unit.whole & (self.folds(i, unit)[0] != HELD_OUT)
            yield i, replace(unit, whole=use)

    def held_out(self) -> Iterator[Unit]:
        """Yield the units with all but what is held out marked as not whole."""
        for i, unit in enumerate(self.channel.units()):
            use = unit.whole & (self.folds(i, unit)[0] == HELD_OUT)
            if use.any():
                yield replace(unit, whole=use)

    def sampled(self, share: float) -> "Problem":
        """Return the problem with a share of the trips; itself where the share is all."""
        if share >= 1.0:
            return self
        return Problem(self.channel.sampled(self.split, share), self.split, self.settings, self.rest)

    def learn(self, model: Model, hypotheses: Sequence[Hypothesis]) -> None:
        """Measure the noise by what the hypotheses leave, where it is not known."""
        if self.noise is None:
            tables = self._tables(model, self.layout(hypotheses))
            self.noise = learn(tables, self.settings, self.channel.model_error, self.split.unit)

    def sums(self, model: Model, hypotheses: Sequence[Hypothesis]) -> Sums:
        """Return the products of the columns of the base and of hypotheses about a model, over all
        training windows."""
        self.learn(model, hypotheses)
        layout = self.layout(hypotheses)
        assert self.noise is not None
        sums = Sums.empty(layout, self.settings.folds, len(self.channel.vehicles))
        for i, unit, modelled, x in self._tables(model, layout):
            w, use = unit.windows, unit.whole
            fold, slow = self.folds(i, unit)
            if use.any():
                sums.add(
                    x[use], (unit.recorded - modelled)[use], unit.recorded[use], self.noise.weight(i,
                    unit)[use],
                    fold[use], slow[use], w.vehicle[use],
                )  # fmt: skip
        sums.flush()
        return sums

    def _tables(self, model: Model, layout: Layout) -> Iterator[tuple[int, Unit, Floats, Columns]]:
        for i, unit in self.training():
            modelled, x = self.channel.columns(unit, model, layout.sources)
            yield i, unit, modelled, x

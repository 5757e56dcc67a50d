"""Columns of the speed channel: how the time on a path changes with each number, field and free curve."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fleetlog.core.arrays import Floats, Ints, Mask
from fleetlog.discovery.channels.base import Channel, Columns, side_by_side
from fleetlog.discovery.channels.paths import Path
from fleetlog.discovery.hypotheses.cells import Stretches
from fleetlog.discovery.hypotheses.sources import (
    UNIT,
    ErrorSource,
    FieldSource,
    FreeCurve,
    KnobSource,
    Source,
)
from fleetlog.discovery.model import Model
from fleetlog.physics.motion.legs import quickest
from fleetlog.physics.power import Physics, all_terms
from fleetlog.physics.term import Term

STEP = 0.02  # Finite differences, as a share of a parameter's range


def drive_times(path: Path, physics: Physics) -> tuple[Floats, Mask]:
    """Return the time of the step to each node, (G,) [s], and whether a cap holds the speed down there."""
    if physics.own:
        parts = [(w, *drive_times(path, p)) for w, p in physics.phases(path.motion.time)]
        held = np.any([capped & (w > 0.5) for w, _, capped in parts], axis=0)
        return np.asarray(sum(w * time for w, time, _ in parts)), held
    ends = ~path.inside | path.last
    speed, time, cap = quickest(path.s, path.motion, physics, ends, np.zeros(len(ends)))
    return np.where(path.inside, np.diff(time, prepend=0.0), 0.0), (speed > 0.97 * cap) & path.inside


def summed(path: Path, values: Floats) -> Floats:
    """Return the sums of values at nodes over windows, (W,)."""
    return np.asarray(np.bincount(path.of, values, int(path.of[-1]) + 1), dtype=np.float64)


@dataclass
class About:
    """Columns of a path about a model."""

    channel: Channel
    path: Path
    model: Model
    physics: Physics
    vehicle: int
    seconds: Floats
    capped: Mask

    def columns(self, sources: Sequence[Source]) -> Columns:
        """Return the columns of sources, (W, P)."""
        return side_by_side(sources, self._knob, self._field, self._curve, self._error)

    def _knob(self, source: KnobSource) -> Floats:
        knob = source.knob
        term, p = all_terms()[knob.term], knob.definition
        now = self.model.in_force(knob, self.vehicle)
        low, high = sorted((p.scaled(p.low), p.scaled(p.high)))
        step = STEP * min(high - low, 4.0 * abs(now))
        ends = [now + step, now - step]
        if p.reach and now == p.scaled(p.neutral):
            ends = [p.scaled(p.neutral - p.reach), now]
        times = [self._set(term, {**dict(source.setting), p.name: p.value_of(e)}) for e in ends]
        change = times[0] - times[1]
        if not knob.scope.whole:
            change = change * knob.scope.share(self.vehicle, self.path.motion.time)
        return np.asarray(summed(self.path, change)[:, None] / (ends[0] - ends[1]))

    def _set(self, term: Term, setting: dict[str, float]) -> Floats:
        phases = self.physics.phases(self.path.motion.time)
        return np.asarray(
            sum(w * drive_times(self.path, p.changed({term.name: setting}))[0] for w, p in phases)
        )

    def _field(self, source: FieldSource) -> Floats:
        term, there = source.physics, source.scope.share(self.vehicle, self.path.motion.time)
        cells = self.channel.cells(term)
        assert isinstance(cells, Stretches)
        if term is None:
            return self._by_cell(cells, UNIT["time"] * self.seconds) @ cells.root
        if term.acts == "wait":
            return self._by_cell(cells, self.path.share * there) @ cells.root
        first = term.parameters[0]
        now = np.asarray(self.physics.values.get(term.name, {}).get(first.name, first.neutral), dtype=float)
        # Where a cap binds, time goes with the inverse of the share of it that is driven.
        slope = np.where(self.capped, self.seconds * now, 0.0)
        return np.asarray(self._by_cell(cells, slope * there) @ cells.root)

    def _by_cell(self, cells: Stretches, values: Floats) -> Floats:
        return self._sorted(cells.at(self.path.motion)[0].astype(np.int64), len(cells), values)

    def _sorted(self, column: Ints, count: int, values: Floats) -> Floats:
        windows = int(self.path.of[-1]) + 1
        total = np.bincount(self.path.of * count + column, values, windows * count)
        return np.asarray(total.reshape(windows, count), dtype=np.float64)

    def _curve(self, curve: FreeCurve) -> Floats:
        parts = [
            self._sorted(column, curve.width, UNIT["time"] * self.seconds * share)
            for column, share in curve.hats(self.channel.state(self.path))
        ]
        return np.asarray(np.sum(parts, axis=0))

    def _error(self, source: ErrorSource) -> Floats:
        if source.name == "kinks":
            return self._along_kinks()[:, None]
        step = np.diff(self.path.s, prepend=self.path.s[:1])
        pace = np.where(self.path.inside, self.seconds / np.maximum(step, 1e-9), 0.0)
        dip = (
            self.path.inside
            & (pace >= np.roll(pace, 1))
            & (pace > np.roll(pace, -1))
            & ~np.roll(~self.path.inside, 1)
        )
        which = {
            "setting off": ~self.path.inside,
            "stopping": self.path.last,
            "slowing down": dip & ~self.path.last,
        }[source.name]
        return summed(self.path, which.astype(float))[:, None]

    def _along_kinks(self) -> Floats:
        """(W,) seconds that following every kink of the map's line adds."""
        if not self.path.kink.any():
            return np.zeros(len(self.path.behind))
        bend = np.maximum(np.abs(self.path.motion.curvature), self.path.kink)
        path = replace(self.path, motion=self.path.motion.replaced(curvature=bend))
        return summed(self.path, drive_times(path, self.physics)[0] - self.seconds)

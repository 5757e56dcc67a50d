"""Columns of the speed channel: how the time on a path changes with each number, field and free curve."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fleetlog.core.arrays import Floats, Mask
from fleetlog.discovery.channels.base import About
from fleetlog.discovery.channels.paths import Path
from fleetlog.discovery.hypotheses.sources import UNIT, ErrorSource, FieldSource, FreeCurve, KnobSource
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


@dataclass
class TravelAbout(About):
    """What a model says of the time that the windows of a path take, (W,) [s], and columns about it."""

    own: Path
    physics: Physics
    waits: Floats  # (G,) seconds of standing at every node that belong to the place

    @cached_property
    def modelled(self) -> Floats:
        """The modelled time, (W,) [s]."""
        return self.own.summed(self.seconds + self.waits)

    @property
    def seconds(self) -> Floats:
        """The time of the step to each node, (G,) [s], waits left out."""
        return self._times[0]

    @cached_property
    def _times(self) -> tuple[Floats, Mask]:
        return drive_times(self.own, self.physics)

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
        change = self._shared(knob.scope, times[0] - times[1])
        return np.asarray(self.own.summed(change)[:, None] / (ends[0] - ends[1]))

    def _set(self, term: Term, setting: dict[str, float]) -> Floats:
        phases = self.physics.phases(self.own.motion.time)
        return np.asarray(
            sum(w * drive_times(self.own, p.changed({term.name: setting}))[0] for w, p in phases)
        )

    def _field(self, source: FieldSource) -> Floats:
        term, cells = source.physics, self.channel.cells(source.physics)
        if term is None:
            slope = UNIT["time"] * self.seconds
        elif term.acts == "wait":
            slope = self._shared(source.scope, self.own.share)
        else:
            first = term.parameters[0]
            now = np.asarray(self.physics.values.get(term.name, {}).get(first.name, first.neutral), float)
            # Where a cap binds, time goes with the inverse of the share of it that is driven.
            slope = self._shared(source.scope, np.where(self._times[1], self.seconds * now, 0.0))
        return np.asarray(self.own.by_column(cells.at(self.own.motion)[0], slope, len(cells)) @ cells.root)

    def _curve(self, curve: FreeCurve) -> Floats:
        time, total = UNIT["time"] * self.seconds, np.zeros((self.own.count, curve.width))
        for column, share in curve.hats(self.state):
            total += self.own.by_column(column, time * share, curve.width)
        return total

    def _error(self, source: ErrorSource) -> Floats:
        if source.name == "kinks":
            return self._along_kinks()[:, None]
        step = np.diff(self.own.s, prepend=self.own.s[:1])
        pace = np.where(self.own.inside, self.seconds / np.maximum(step, 1e-9), 0.0)
        dip = (
            self.own.inside
            & (pace >= np.roll(pace, 1))
            & (pace > np.roll(pace, -1))
            & ~np.roll(~self.own.inside, 1)
        )
        which = {
            "setting off": ~self.own.inside,
            "stopping": self.own.last,
            "slowing down": dip & ~self.own.last,
        }[source.name]
        return self.own.summed(which.astype(float))[:, None]

    def _along_kinks(self) -> Floats:
        """(W,) seconds that following every kink of the map's line adds."""
        if not self.own.kink.any():
            return np.zeros(self.own.count)
        bend = np.maximum(np.abs(self.own.motion.curvature), self.own.kink)
        path = replace(self.own, motion=self.own.motion.replaced(curvature=bend))
        return self.own.summed(drive_times(path, self.physics)[0] - self.seconds)

"""Where trucks wait, by stretch of lane: where they stand for no purpose, and how that scatters."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fleetlog.core.arrays import Floats, Ints, Mask
from fleetlog.discovery.channels.paths import Laid, Path
from fleetlog.discovery.hypotheses.cells import Stretches

FEW = 3  # Stops from which on trucks wait at a place
SCATTER = 0.5  # Of waits, as a share of their mean, by what counts as one passage; the others tell the rest


@dataclass(frozen=True)
class Waits:
    """What trucks tell of the ``lanes``, (C,) each: where they ``stop``; and of what counts there passages,
    waits, their seconds, and squares of how far these scatter, ``by_place`` (4, C).

    Whoever waits before a border of two stretches stops now on this and now on that side, and mostly on one:
    to that, their ``place``, the waits of both count."""

    lanes: Stretches
    stops: Floats
    by_place: Floats

    @cached_property
    def place(self) -> Ints:
        """(C,) the stretch to which the waits on each count."""
        own, edge = np.arange(len(self.stops)), self.lanes.road_edge
        beside = np.clip(own + np.array([[0], [-1], [1]]), 0, len(own) - 1)
        most = np.argmax(np.where(edge[beside] == edge, self.stops[beside], -1.0), axis=0)
        return np.where(self.stops > 0.0, beside[most, own], own)

    def _gathered(self, values: Floats) -> Floats:
        return np.bincount(self.place, values, len(self.stops)).astype(np.float64)

    @cached_property
    def size(self) -> Floats:
        """(C,) metres of all stretches that count to each."""
        return self._gathered(self.lanes.end - self.lanes.start)

    @cached_property
    def here(self) -> Mask:
        """(C,) whether trucks wait there: what holds up one direction of a road often holds up the other."""
        stood, other = self._gathered(self.by_place[1]), self.lanes.opposite
        return np.asarray(stood + np.where(other >= 0, stood[other], 0.0) >= FEW)

    @cached_property
    def scatter(self) -> Floats:
        """(C,) variance of what a passage waits [s2]."""
        passages, stood, wait, off = map(self._gathered, self.by_place)
        return (off + (SCATTER * wait / np.maximum(stood, 1.0)) ** 2) / np.maximum(passages, 1.0)

    def usual(self, path: Path) -> tuple[Floats, Floats]:
        """Return stops, and seconds of standing, at every node on average, (G,), whoever is in the way."""
        place, (passages, stood, wait) = self.at(path), map(self._gathered, self.by_place[:3])
        each = path.share / np.maximum(passages, 1.0)[place]
        return stood[place] * each, wait[place] * each

    def at(self, path: Path) -> Ints:
        """Return the place of every node, (G,)."""
        return self.place[self.lanes.at(path.motion)[0]]


def stands(laid: Sequence[Laid], seen: Sequence[Mask], lanes: Stretches) -> Floats:
    """Return the (5, C) stops and what counts at places, see :class:`Waits`, of the windows ``seen``, (W,)
    each. A truck with another in its way waits as well: of such passages only the standing counts."""
    n, stops, found = len(lanes), np.zeros(len(lanes)), [np.zeros((3, 0))]
    cells = [lanes.at(path.motion)[0] for path, *_ in laid]
    for (path, *_), use, cell in zip(laid, seen, cells, strict=True):
        stops += np.bincount(cell, use[path.of] & (path.standing > 0.0), n)
    waits = Waits(lanes, stops, np.zeros((4, n)))
    for (path, *_), use, cell in zip(laid, seen, cells, strict=True):
        place = waits.place[cell]
        node = (use & path.alone(place))[path.of]
        of, passed, _ = path.passages(place, waits.size)
        first, wait = np.flatnonzero(np.diff(of, prepend=-1)), np.bincount(of, node * path.standing)
        counts = passed & (node[first] | (wait > 0.0))
        found.append(np.stack([place[first], path.motion.time[first], wait])[:, counts])
    at, time, wait = np.concatenate(found, axis=1)
    order = np.lexsort((time, at))
    at, wait = at[order].astype(np.int64), wait[order]
    # Passages are compared with the one before: where trucks wait since noon, that is no scatter.
    next_one = np.diff(at) == 0
    off = np.bincount(at[1:][next_one], 0.5 * np.diff(wait)[next_one] ** 2, n)
    return np.stack([stops, *(np.bincount(at, v, n) for v in (wait >= 0.0, wait > 0.0, wait)), off])

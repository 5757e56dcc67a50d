"""Where trucks wait, by stretch of lane: what stands there for no purpose, and how it scatters."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fleetlog.core.arrays import Floats, Index, Ints, Mask
from fleetlog.discovery.channels.paths import Laid, Path
from fleetlog.discovery.hypotheses.cells import Stretches

FEW = 3  # Stops from which on trucks wait at a place
SCATTER = 0.5  # Of waits, as a share of their mean, by what counts as one passage; the others tell the rest


@dataclass(frozen=True)
class Places:
    """Where trucks stood, by stop on each stretch, ``stops`` (C,), of the ``lanes``.

    Whoever waits before a border of two stretches stops now on this and now on that side, and mostly on one:
    to that, their ``place``, the waits of both count."""

    lanes: Stretches
    stops: Floats

    @cached_property
    def place(self) -> Ints:
        """(C,) the stretch to which the waits on each count."""
        own, edge = np.arange(len(self.stops)), self.lanes.road_edge
        beside = np.clip(own + np.array([[0], [-1], [1]]), 0, len(own) - 1)
        most = np.argmax(np.where(edge[beside] == edge, self.stops[beside], -1.0), axis=0)
        return np.where(self.stops > 0.0, beside[most, own], own)

    @cached_property
    def size(self) -> Floats:
        """(C,) metres of all stretches that count to each."""
        return self.gathered(self.lanes.end - self.lanes.start)

    def gathered(self, values: Floats) -> Floats:
        """Return the sums of values, (C,), of all stretches that count to each, (C,)."""
        return np.bincount(self.place, values, len(self.stops)).astype(np.float64)

    def at(self, path: Path) -> Ints:
        """Return the place of every node, (G,)."""
        return self.place[self.lanes.at(path.motion)[0]]

    def stood(self, laid: Sequence[Laid], seen: Sequence[Mask]) -> Floats:
        """Return (4, C) by place: passages, waits, their seconds, and squares of how far these scatter; of
        the windows ``seen``, (W,) each. A truck with another in its way waits as well: of such passages only
        the standing counts."""
        n, found = len(self.stops), [np.zeros((3, 0))]
        for (path, *_), counts in zip(laid, seen, strict=True):
            place = self.at(path)
            node = (counts & (~path.behind | path.alone(place)))[path.of]
            of, passed, _ = path.passages(place, self.size)
            first, wait = np.flatnonzero(np.diff(of, prepend=-1)), np.bincount(of, node * path.standing)
            use = passed & (node[first] | (wait > 0.0))
            found.append(np.stack([place[first], path.motion.time[first], wait])[:, use])
        at, time, wait = np.concatenate(found, axis=1)
        order = np.lexsort((time, at))
        at, wait = at[order].astype(np.int64), wait[order]
        # Passages are compared with the one before: where trucks wait since noon, that is no scatter.
        next_one = np.diff(at) == 0
        off = np.bincount(at[1:][next_one], 0.5 * np.diff(wait)[next_one] ** 2, n)
        passages, waits = (np.bincount(at[k], minlength=n) for k in (wait >= 0.0, wait > 0.0))
        return np.stack([passages, waits, np.bincount(at, wait, n), off])


def stands(laid: Sequence[Laid], seen: Sequence[Mask], lanes: Stretches) -> Floats:
    """Return (5, C) by stretch: stops, and how trucks :meth:`Places.stood` where these count to it."""
    stops = np.zeros(len(lanes))
    for (path, *_), use in zip(laid, seen, strict=True):
        stops += np.bincount(lanes.at(path.motion)[0], use[path.of] & (path.standing > 0.0), len(lanes))
    return np.vstack([stops, Places(lanes, stops).stood(laid, seen)])


@dataclass(frozen=True)
class Waits:
    """``places`` where trucks wait, ``here`` (C,) whether they do, ``scatter`` (C,) of a passage's [s2]."""

    places: Places
    here: Mask
    scatter: Floats

    def noise(self, path: Path, place: Index | Ints) -> Floats:
        """Return the variance of what its windows wait, (W,) [s2]; ``place`` (G,) of its nodes."""
        out = np.zeros(path.count)
        np.maximum.at(out, path.of, np.where(self.here[place], self.scatter[place], 0.0))
        return out


def waits(told: Sequence[Floats], lanes: Stretches) -> Waits:
    """Return where trucks wait, by what all dates tell."""
    stops, *by_stretch = np.sum(told, axis=0)
    places = Places(lanes, stops)
    passages, stood, wait, off = map(places.gathered, by_stretch)
    # What holds up one direction of a road often holds up the other.
    here = stood + np.where(lanes.opposite >= 0, stood[lanes.opposite], 0.0) >= FEW
    passed, stopped = (np.maximum(count, 1.0) for count in (passages, stood))
    return Waits(places, here, (off + (SCATTER * wait / stopped) ** 2) / passed)

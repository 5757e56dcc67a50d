"""The table of the pieces of road that were ever reserved."""

import numpy as np

from fleetlog.core.trajectory import Labels
from fleetlog.simulate.arrays import Ints
from fleetlog.simulate.world import World
from fleetlog.store.events import WAYS, Columns, Lines

KINDS = tuple(WAYS)
"""In the order of the numbers of ways; see :mod:`fleetlog.simulate.junctions`."""


class WayTable:
    """Which ways, resources of :mod:`fleetlog.simulate.junctions`, were ``used``, and where they lie."""

    def __init__(self, world: World) -> None:
        self.world, self.pieces, self.lanes = world, len(world.roads.length), len(world.roads.clear)
        self.used = np.zeros(len(world.roads.conflict_first) - 1, dtype=bool)

    def table(self) -> Columns:
        """One row a way."""
        way = np.flatnonzero(self.used)
        track, doors = self.world.track, self.world.doors
        kind, piece = self._kinds(way)
        turn, bay = kind == KINDS.index("turn"), kind == KINDS.index("bay")
        joint = np.where(turn, piece, 0)
        door = np.where(bay, piece - self.pieces, 0)
        lane, of_bay = (np.array([getattr(d, name) for d in doors])[door] for name in ("lane", "bay"))
        edge = np.where(bay, lane, np.where(turn, track.source[joint], piece))
        edges, places = track.network.edge_ids, tuple(b.place.id for b in self.world.bays)
        return {
            "way": way,
            "kind": Labels(kind.astype(np.int32), KINDS),
            "edge_id": Labels(edge.astype(np.int32), edges),
            "to_edge": Labels(np.where(turn, track.target[joint], -1).astype(np.int32), edges),
            "place": Labels(np.where(bay, of_bay, -1).astype(np.int32), places),
            **self._lines(kind, piece),
        }

    def _kinds(self, way: Ints) -> tuple[Ints, Ints]:
        """(N,) place in ``KINDS`` of ways, and the piece of the ground that each lies on."""
        bounds = [self.lanes, self.pieces, self.pieces + self.lanes, self.pieces + 2 * self.lanes]
        kind = np.searchsorted(bounds, way, side="right")
        shift = np.array([0, 0, self.pieces, self.pieces + self.lanes, 2 * self.lanes])
        return kind, way - shift[kind]

    def _lines(self, kind: Ints, piece: Ints) -> dict[str, Lines]:
        """Middle lines, to the millimetre; of the ends of a lane as far as the next sample."""
        g, r = self.world.ground, self.world.roads
        first, last, step = g.first[piece], g.first[piece + 1] - 1, g.spacing[piece]
        leaves, enters = kind == KINDS.index("exit"), kind == KINDS.index("entry")
        lane = np.where(leaves | enters, piece, 0)
        stop, clear = np.floor(r.stop[lane] / step).astype(int), np.ceil(r.clear[lane] / step).astype(int)
        last = np.where(enters, np.minimum(first + np.maximum(clear, 1), last), last)
        first = np.where(leaves, np.minimum(first + stop, last - 1), first)
        samples = [np.arange(a, b + 1) for a, b in zip(first, last, strict=True)]
        every = np.concatenate(samples) if samples else np.zeros(0, np.int64)
        return {axis: Lines(np.round(getattr(g, axis)[every], 3), last - first + 1) for axis in "xyz"}

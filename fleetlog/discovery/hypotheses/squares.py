"""Squares of the floor, the cells of a field where there is no map.

A field that is odd in direction is a vector there, so that it has two values a square: slope = east cos +
north sin.
"""

from dataclasses import dataclass

import numpy as np

from fleetlog.core.arrays import Floats, Index, Ints
from fleetlog.core.motion import Motion
from fleetlog.discovery.hypotheses.stretches import Cells, Part

SMALLEST = 8.0  # Side of a square [m]
MOST = 350  # More squares than this are made larger instead
REACH = 3.0  # Distance over which neighbours resemble each other, in sides of a square
COARSE = 0.95
"""Share of the prior's variance that is kept: half the columns at no loss, measured on roads with hills."""


@dataclass(frozen=True)
class Squares(Cells):
    """C squares of ``side`` [m] that were driven over; ``key`` (C,) sorted codes of column and row."""

    side: float
    key: Ints

    @property
    def size(self) -> int:
        """Number of values of a field: two a square where it is odd in direction."""
        return len(self) * (2 if self.odd else 1)

    def at(self, motion: Motion) -> tuple[Index, Floats]:
        """(N,) square of each sample, -1 for none; none is driven against."""
        k = _key(motion.x, motion.y, self.side)
        j = np.clip(np.searchsorted(self.key, k), 0, len(self.key) - 1)
        return np.where(self.key[j] == k, j, -1).astype(np.int32), np.ones(len(k))

    def parts(self, motion: Motion) -> list[Part]:
        """Which values of a field act on each sample, and with what weight."""
        if not self.odd:
            return super().parts(motion)
        cell, _ = self.at(motion)
        east = np.where(cell >= 0, 2 * cell, -1).astype(np.int32)
        north = np.where(cell >= 0, 2 * cell + 1, -1).astype(np.int32)
        return [(east, np.cos(motion.heading)), (north, np.sin(motion.heading))]

    def directions(self) -> tuple[Floats, Floats]:
        """Return the values of an odd field of slope 1 to the east, and to the north."""
        return np.tile([1.0, 0.0], len(self)), np.tile([0.0, 1.0], len(self))

    def _root(self) -> Floats:
        """Neighbours resembling each other, but for the finest modes."""
        apart = np.hypot(*(self.middle[:, None, :] - self.middle[None, :, :]).transpose(2, 0, 1))
        size, mode = np.linalg.eigh(np.exp(-apart / (REACH * self.side)))
        size, mode = size[::-1], mode[:, ::-1]
        count = int(np.searchsorted(np.cumsum(size), COARSE * size.sum())) + 1
        one = mode[:, :count] * np.sqrt(np.maximum(size[:count], 0.0))
        return np.asarray(np.kron(one, np.eye(2)) if self.odd else one)


def _key(x: Floats, y: Floats, side: float) -> Ints:
    column = np.floor(np.nan_to_num(x) / side).astype(np.int64)
    row = np.floor(np.nan_to_num(y) / side).astype(np.int64)
    return np.asarray((column + (1 << 20)) * (1 << 22) + row + (1 << 20))


def make_squares(x: Floats, y: Floats) -> Squares | None:
    """Squares under a track, as small as their number allows; None where there are no positions."""
    known = np.isfinite(x) & np.isfinite(y)
    if known.sum() < 50:
        return None
    x, y = x[known], y[known]
    side = SMALLEST
    while len(np.unique(_key(x, y, side))) > MOST:
        side *= 1.4
    keys, first = np.unique(_key(x, y, side), return_index=True)
    if len(keys) < 4:
        return None
    middle = (np.floor(np.stack([x[first], y[first]], axis=1) / side) + 0.5) * side
    return Squares(middle, side, keys)

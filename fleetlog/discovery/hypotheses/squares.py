"""Squares of the floor, the cells of a field where there is no map.

A field that is odd in direction is a vector there, so that it has two values a square: slope = east cos +
north sin.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.motion import Motion
from fleetlog.discovery.hypotheses.stretches import Index, Part

Floats = NDArray[np.float64]

SMALLEST = 8.0  # Side of a square [m]
MOST = 350  # More squares than this are made larger instead
REACH = 3.0  # Distance over which neighbours resemble each other, in sides of a square
COARSE = 0.95
"""Share of the prior's variance that is kept: half the columns at no loss, measured on roads with hills."""


@dataclass(frozen=True)
class Squares:
    """C squares of ``side`` [m] that were driven over; ``key`` (C,) sorted codes of column and row;
    ``middle`` (C, 2) [m]."""

    side: float
    key: NDArray[np.int64]
    middle: Floats
    _roots: dict[bool, Floats] = field(default_factory=dict, compare=False)

    def __len__(self) -> int:
        return len(self.key)

    def size(self, odd: bool) -> int:
        """Number of values of a field: two a square where it is odd in direction."""
        return len(self) * (2 if odd else 1)

    def number(self, x: Floats, y: Floats) -> Index:
        """(N,) square of every place, -1 for none."""
        k = _key(x, y, self.side)
        j = np.clip(np.searchsorted(self.key, k), 0, len(self.key) - 1)
        return np.where(self.key[j] == k, j, -1).astype(np.int32)

    def parts(self, motion: Motion, odd: bool) -> list[Part]:
        """Which values of a field act on each sample, and with what weight."""
        cell = self.number(motion.x, motion.y)
        if not odd:
            return [(cell, np.ones(len(cell)))]
        east = np.where(cell >= 0, 2 * cell, -1).astype(np.int32)
        north = np.where(cell >= 0, 2 * cell + 1, -1).astype(np.int32)
        return [(east, np.cos(motion.heading)), (north, np.sin(motion.heading))]

    def directions(self) -> tuple[Floats, Floats]:
        """Return the values of an odd field of slope 1 to the east, and to the north."""
        return np.tile([1.0, 0.0], len(self)), np.tile([0.0, 1.0], len(self))

    def in_basis(self, pattern: Floats, odd: bool) -> Floats:
        """Return the coefficients in the basis of the root of a field, as near as its modes allow."""
        return np.asarray(np.linalg.lstsq(self.root(odd), pattern)[0])

    def root(self, odd: bool) -> Floats:
        """Return L (values, modes) with L L' the prior covariance, neighbours resembling each other, but
        for its finest modes."""
        if odd not in self._roots:
            self._roots[odd] = self._root(odd)
        return self._roots[odd]

    def _root(self, odd: bool) -> Floats:
        apart = np.hypot(*(self.middle[:, None, :] - self.middle[None, :, :]).transpose(2, 0, 1))
        size, mode = np.linalg.eigh(np.exp(-apart / (REACH * self.side)))
        size, mode = size[::-1], mode[:, ::-1]
        count = int(np.searchsorted(np.cumsum(size), COARSE * size.sum())) + 1
        one = mode[:, :count] * np.sqrt(np.maximum(size[:count], 0.0))
        return np.asarray(np.kron(one, np.eye(2)) if odd else one)


def _key(x: Floats, y: Floats, side: float) -> NDArray[np.int64]:
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
    middle = np.stack(
        [(np.floor(x[first] / side) + 0.5) * side, (np.floor(y[first] / side) + 0.5) * side], axis=1
    )
    return Squares(side, keys, middle)

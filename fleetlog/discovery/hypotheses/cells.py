"""The cells of a field: short stretches of road, and squares of the floor where there is no map.

Both directions of a road share their stretches, so a field over them has an odd part (slope: opposite in the
two directions) and an even part (floor: the same).  On squares an odd field is a vector, so that it has two
values a square: slope = east cos + north sin."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np

from fleetlog.core.arrays import Floats, Index, Indices, Ints, Mask
from fleetlog.core.motion import Motion
from fleetlog.core.network import Network

Part = tuple[Index, Floats]  # (N,) number of a field's value, -1 for none, and (N,) its weight

LENGTH = 4.0  # Of a stretch, before edges are divided evenly [m]
REACH, NEAR = 40.0, 8.0  # Distances over which stretches of one road resemble each other, in the prior [m]
MOST = 600  # More are made longer instead: products of modes, some half as many, are kept by fold
SMALLEST = 8.0  # Side of a square, and length of stretches that say nothing of each other [m]
MOST_SQUARES = 350  # More squares than this are made larger instead
ALIKE = 3.0  # Distance over which neighbours resemble each other, in sides of a square
LARGE = 0.35  # Of the largest value: as large is where an effect is, less is the fringe of the prior
COARSE = 0.95  # Of the prior's variance that is kept: half the columns at no loss, measured on hilly roads


@dataclass(frozen=True)
class Cells(ABC):
    """C pieces of the floor that a field has values on, with the ``middle`` (C, 2) of each [m]."""

    middle: Floats
    odd: bool = field(default=False, kw_only=True)  # Whether the field is odd in the direction of travel
    _roots: dict[bool, tuple[Floats, Floats]] = field(default_factory=dict, kw_only=True, compare=False)
    _token: object = field(default_factory=object, kw_only=True, compare=False)  # Of what is looked up

    def __len__(self) -> int:
        return len(self.middle)

    @property
    def size(self) -> int:
        """Number of values of a field."""
        return len(self)

    def at(self, motion: Motion) -> Part:
        """(N,) cell of each sample, -1 for none, and (N,) +1 or -1: driven as counted or against."""
        if self._token not in motion.looked_up:  # Many fields are looked up along the same
            motion.looked_up[self._token] = self._at(motion)
        return motion.looked_up[self._token]

    @abstractmethod
    def _at(self, motion: Motion) -> Part: ...

    def parts(self, motion: Motion) -> list[Part]:
        """Which values act on each sample, and with what weight."""
        cell, sign = self.at(motion)
        return [(cell, sign if self.odd else np.ones(len(cell)))]

    def along(self, motion: Motion, values: Floats) -> Floats:
        """(N,) a field looked up along a motion; 0 where it has no value."""
        total = np.zeros(len(motion))
        for number, weight in self.parts(motion):
            total += np.where(number >= 0, values[np.maximum(number, 0)] * weight, 0.0)
        return total

    def extent(self, which: Mask) -> list[float]:
        """Return the least and the largest x and y of some cells, (C,), as the contract writes them."""
        corners = self._corners(which)
        return [*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist()]

    @abstractmethod
    def _corners(self, which: Mask) -> Floats: ...

    @property
    def root(self) -> Floats:
        """L (values, modes) with L L' the prior covariance of the values."""
        return self._both[0]

    @property
    def inverse(self) -> Floats:
        """(modes, values) takes a field to its coefficients in the basis of the root, as near as may be."""
        return self._both[1]

    @property
    def _both(self) -> tuple[Floats, Floats]:
        if self.odd not in self._roots:
            root = self._root()
            self._roots[self.odd] = root, np.asarray(np.linalg.pinv(root), dtype=np.float64)
        return self._roots[self.odd]

    @abstractmethod
    def _root(self) -> Floats: ...

    @abstractmethod
    def directions(self) -> tuple[Floats, Floats]:
        """Return the values of an odd field of slope 1 to the east, and to the north."""


@dataclass(frozen=True)
class Stretches(Cells):
    """C stretches: ``road_edge`` (C,) the edge in whose direction they are counted, ``start``/``end`` offsets
    along it [m]. ``first`` and ``count`` (E,) locate an edge's stretches; its ``sign`` (E,) is -1 against."""

    network: Network
    road_edge: Index
    start: Floats
    end: Floats
    first: Index
    count: Index
    sign: Floats
    alike: bool = True  # Whether neighbours resemble each other

    def _at(self, motion: Motion) -> Part:
        on = motion.edge >= 0
        edge = np.maximum(motion.edge, 0)
        share = np.clip(motion.edge_offset / np.maximum(self.network.length[edge], 1e-6), 0.0, 1.0 - 1e-9)
        share = np.where(self.sign[edge] < 0, 1.0 - 1e-9 - share, share)
        cell = self.first[edge] + np.floor(share * self.count[edge]).astype(np.int32)
        return np.where(on, cell, -1).astype(np.int32), self.sign[edge]

    def road(self, edge: Ints | Index) -> Index:
        """(N,) the edge in whose direction the road of each is counted; -1 off the map."""
        return np.where(edge >= 0, self.road_edge[self.first[np.maximum(edge, 0)]], -1).astype(np.int32)

    @property
    def opposite(self) -> Ints:
        """(C,) the stretch of the other direction beside each, where both have their own; -1 for none."""
        edge, other = self.road_edge, self.network.reverse[self.road_edge]
        facing = self.first[other] + self.count[other] - 1 - (np.arange(len(self)) - self.first[edge])
        return np.where(other >= 0, facing, -1)

    def roads(self) -> list[tuple[int, int]]:
        """Return the first stretch of every road, and the one after its last."""
        begin = np.flatnonzero(np.diff(self.road_edge, prepend=-1) != 0)
        return list(zip(begin.tolist(), [*begin[1:].tolist(), len(self)], strict=True))

    def label(self, first: int, last: int) -> str:
        """Return where a run of stretches is, as ``e012 8-24 m``."""
        name = self.network.edge_ids[self.road_edge[first]]
        return f"{name} {self.start[first]:.0f}-{self.end[last - 1]:.0f} m"

    def runs(self, mask: Mask, sign: Floats, *, bridged: bool = False) -> list[Indices]:
        """Return runs of kept stretches of a road and a sign; ``bridged`` over a single quiet one between."""
        keep, road = mask.copy(), self.road_edge
        if bridged:
            keep[1:-1] |= keep[:-2] & keep[2:] & (road[:-2] == road[2:]) & (sign[:-2] == sign[2:])
        on = np.flatnonzero(keep)
        cut = (np.diff(on) > 1) | (np.diff(sign[on]) != 0) | (np.diff(road[on]) != 0)
        return np.split(on, np.flatnonzero(cut) + 1) if len(on) else []

    def inner(self, mask: Mask, sign: Floats, near: float) -> Mask:
        """(C,) the kept stretches but those beside a junction alone: of runs shorter than ``near`` [m] at an
        end of a road, and not all of it."""
        out, border = mask.copy(), np.diff(self.road_edge, prepend=-1, append=-1) != 0
        for run in self.runs(mask, sign):
            short = self.end[run[-1]] - self.start[run[0]] < near
            out[run] = not (short and border[run[0]] != border[run[-1] + 1])
        return out

    def _corners(self, which: Mask) -> Floats:
        edge, ends = self.road_edge[which], (self.start[which], self.end[which])
        ways = [self.network.position(edge, offset)[:, :2] for offset in ends]
        return np.concatenate([self.middle[which], *ways])

    def directions(self) -> tuple[Floats, Floats]:
        """Return the values of an odd field of slope 1 to the east, and to the north."""
        heading = self.network.heading(self.road_edge, (self.start + self.end) / 2.0)
        return np.cos(heading), np.sin(heading)

    def _root(self) -> Floats:
        """A part shared along the road, and one shared with what is near."""
        if not self.alike:
            return np.eye(len(self))
        same = self.road_edge[:, None] == self.road_edge[None, :]
        middle = (self.start + self.end) / 2.0
        apart = np.where(same, np.abs(middle[:, None] - middle[None, :]), np.inf)
        return _modes(0.1 * np.exp(-apart / NEAR) + 0.9 * np.exp(-apart / REACH))


def make_stretches(network: Network, *, apart: bool = False) -> Stretches:
    """Stretches of all roads of a network; ``apart``: each direction of a road has its own."""
    forward = (network.reverse < 0) | (np.arange(len(network)) < network.reverse) | apart
    length, most = (SMALLEST, MOST // 2) if apart else (LENGTH, MOST)
    while np.ceil(network.length[forward] / length).sum() > most:
        length *= 1.3
    count = np.maximum(1, np.rint(network.length / length)).astype(np.int32)
    own = np.flatnonzero(forward)
    first = np.zeros(len(network), np.int32)
    first[own] = np.concatenate([[0], np.cumsum(count[own])[:-1]])
    against = np.flatnonzero(~forward)
    first[against] = first[network.reverse[against]]
    count[against] = count[network.reverse[against]]
    road_edge = np.repeat(own, count[own]).astype(np.int32)
    number = np.concatenate([np.arange(c) for c in count[own]]).astype(np.float64)
    size = np.repeat(network.length[own] / count[own], count[own])
    sign = np.where(forward, 1.0, -1.0)
    start, end = number * size, (number + 1.0) * size
    middle = network.position(road_edge, (start + end) / 2.0)[:, :2]
    return Stretches(middle, network, road_edge, start, end, first, count, sign, not apart)


@dataclass(frozen=True)
class Squares(Cells):
    """C squares of ``side`` [m] that were driven over; ``key`` (C,) sorted codes of column and row."""

    side: float
    key: Ints

    @property
    def size(self) -> int:
        """Number of values of a field: two a square where it is odd in direction."""
        return len(self) * (2 if self.odd else 1)

    def _at(self, motion: Motion) -> Part:
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

    def _corners(self, which: Mask) -> Floats:
        return np.concatenate([self.middle[which] + s * self.side / 2.0 for s in (-1.0, 1.0)])

    def directions(self) -> tuple[Floats, Floats]:
        """Return the values of an odd field of slope 1 to the east, and to the north."""
        return np.tile([1.0, 0.0], len(self)), np.tile([0.0, 1.0], len(self))

    def _root(self) -> Floats:
        """Neighbours resembling each other."""
        apart = np.hypot(*(self.middle[:, None, :] - self.middle[None, :, :]).transpose(2, 0, 1))
        one = _modes(np.exp(-apart / (ALIKE * self.side)))
        return np.asarray(np.kron(one, np.eye(2)) if self.odd else one)


def _modes(covariance: Floats) -> Floats:
    """Return the root of the (n, n) prior covariance of values, (n, modes), but for its finest modes."""
    size, mode = np.linalg.eigh(covariance)
    down = size[::-1]
    least = down[np.searchsorted(np.cumsum(down), COARSE * down.sum())]
    kept = size >= least * (1.0 - 1e-9)  # Of roads that are alike, all or none
    return np.asarray(mode[:, kept] * np.sqrt(size[kept]))


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
    while len(np.unique(_key(x, y, side))) > MOST_SQUARES:
        side *= 1.4
    keys, first = np.unique(_key(x, y, side), return_index=True)
    if len(keys) < 4:
        return None
    return Squares((np.floor(np.stack([x[first], y[first]], axis=1) / side) + 0.5) * side, side, keys)

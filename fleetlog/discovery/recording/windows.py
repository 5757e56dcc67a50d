"""The weak form: power and every candidate become energy over windows of about ten seconds that never
straddle a trip.

Noise averages out, accelerations telescope, and windows are nearly independent.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from fleetlog.core.arrays import Floats, Index, Ints
from fleetlog.discovery.recording.blocks import Block, picked


@dataclass(frozen=True)
class Cut:
    """The windows of a block, 0..count-1 in order: ``of_row`` (rows,) and ``of_sample`` (n,) number them."""

    of_row: Index
    of_sample: Index
    count: int

    @cached_property
    def begin(self) -> Ints:
        """(count,) first sample of every window."""
        return np.searchsorted(self.of_sample, np.arange(self.count))

    def energy(self, block: Block, power: Floats) -> Floats:
        """Return the energy of a power along the samples [W], (count,) [kJ]."""
        return np.asarray(np.add.reduceat(power * block.motion.dt, self.begin) * 1e-3, dtype=np.float64)

    def energies(self, block: Block, cell: Index, cells: int, power: Floats) -> Floats:
        """Return the energy by the cell of each sample, (count, cells) [kJ]; negative ones count nowhere."""
        on = cell >= 0
        flat = self.of_sample[on] * cells + cell[on]
        weight = (power * block.motion.dt)[on]
        total = np.bincount(flat, weight, self.count * cells).reshape(self.count, cells)
        return np.asarray(total * 1e-3, dtype=np.float64)


@dataclass(frozen=True)
class Windows:
    """W windows; all arrays are (W,).

    ``trip``, ``vehicle``, ``day``, ``edge`` are codes (edge -1 off the map), ``duration`` [s], ``distance``
    [m], ``x``, ``y`` [m] and ``time`` [s] of the middle.
    """

    trip: Ints
    vehicle: Ints
    day: Ints
    edge: Ints
    duration: Floats
    distance: Floats
    x: Floats
    y: Floats
    time: Floats

    def __len__(self) -> int:
        return len(self.trip)

    def __getitem__(self, index: Any) -> Windows:
        """Return the windows of a mask or index array."""
        return Windows(**picked(self, index))


def cut(block: Block, width: float) -> Cut:
    """Return windows of about ``width`` seconds within the trips of a block and between its silences."""
    starts = np.flatnonzero(np.concatenate([[True], (np.diff(block.trip) != 0) | block.silent[1:]]))
    length = np.diff(np.append(starts, len(block)))
    before = np.cumsum(block.seconds) - block.seconds
    since = before - np.repeat(before[starts], length)
    total = np.add.reduceat(block.seconds, starts)
    parts = np.maximum(1, np.rint(total / width)).astype(np.int64)
    share = since / np.maximum(np.repeat(total, length), 1e-9)
    local = np.minimum((share * np.repeat(parts, length)).astype(np.int64), np.repeat(parts, length) - 1)
    base = np.concatenate([[0], np.cumsum(parts)[:-1]])
    # A trip of fewer rows than parts leaves numbers unused; make them dense.
    numbers = np.repeat(base, length) + local
    numbers[1:] = np.where(block.seconds[1:] > 0.0, numbers[1:], numbers[:-1])
    of_row = (np.cumsum(np.diff(numbers, prepend=numbers[:1]) != 0)).astype(np.int32)
    return Cut(of_row, of_row[block.row], int(of_row[-1]) + 1)


def describe(block: Block, c: Cut) -> Windows:
    """Return where and when the windows of a block are."""
    first = np.flatnonzero(np.concatenate([[True], np.diff(c.of_row) != 0]))
    middle = (first + np.append(first[1:], len(block)) - 1) // 2
    m = block.motion
    sample = (c.begin + np.append(c.begin[1:], len(m)) - 1) // 2
    return Windows(
        trip=block.trip[middle], vehicle=np.full(c.count, block.vehicle), day=np.full(c.count, block.day),
        edge=m.edge[sample].astype(np.int64), duration=np.add.reduceat(m.dt, c.begin),
        distance=np.add.reduceat(m.speed * m.dt, c.begin), x=m.x[sample], y=m.y[sample],
        time=block.time[middle],
    )  # fmt: skip

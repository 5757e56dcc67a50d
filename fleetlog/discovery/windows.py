"""The weak form: power and every candidate become energy over windows of about ten seconds that never straddle a trip.

Noise averages out, accelerations telescope, and windows are nearly independent.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.discovery.replay import Block

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

WIDTH = 10.0
"""Of a window [s]."""
MOST = 32_000
"""More windows than this are made longer instead: memory stays bounded for any length of recording."""


@dataclass(frozen=True)
class Cut:
    """The windows of one block: ``of_row`` (rows,) and ``of_sample`` (rows * steps,) number its windows 0..count-1."""

    of_row: Ints
    of_sample: Ints
    count: int

    @cached_property
    def begin(self) -> Ints:
        """(count,) first sub-sample of every window; windows follow one another."""
        return np.searchsorted(self.of_sample, np.arange(self.count))

    def energy(self, block: Block, power: Floats) -> Floats:
        """(count,) kJ of a power along the sub-samples [W]."""
        return np.asarray(np.add.reduceat(power * block.motion.dt, self.begin) * 1e-3, dtype=np.float64)

    def energies(self, block: Block, cell: NDArray[np.int32], cells: int, power: Floats) -> Floats:
        """(count, cells) kJ of a power, apart by the cell of each sub-sample; cells below zero count nowhere."""
        on = cell >= 0
        flat = self.of_sample[on] * cells + cell[on]
        weight = (power * block.motion.dt)[on]
        total = np.bincount(flat, weight, self.count * cells).reshape(self.count, cells)
        return np.asarray(total * 1e-3, dtype=np.float64)


@dataclass(frozen=True)
class Windows:
    """W windows; all arrays are (W,).

    ``trip``, ``vehicle``, ``day``, ``edge`` are codes (edge -1 off the map), ``duration`` [s], ``moving`` whether the
    truck drove, ``x``, ``y`` [m], ``time`` [s] the middle.
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
    pieces: bool = False
    """Whether ``trip`` numbers pieces of trips, since no trip resembles another."""

    def __len__(self) -> int:
        return len(self.trip)

    @property
    def moving(self) -> NDArray[np.bool_]:
        """(W,) whether the truck drove at least a metre."""
        return np.asarray(self.distance > 1.0)


def cut(block: Block, width: float) -> Cut:
    """Windows of about ``width`` seconds within the trips of a block."""
    rows = len(block)
    starts = np.flatnonzero(np.concatenate([[True], np.diff(block.trip) != 0]))
    length = np.diff(np.append(starts, rows))
    step = max(float(np.median(np.diff(block.time))), 1e-3)
    parts = np.maximum(1, np.rint(length * step / width)).astype(np.int64)
    inside = np.arange(rows) - np.repeat(starts, length)
    local = inside * np.repeat(parts, length) // np.repeat(length, length)
    base = np.concatenate([[0], np.cumsum(parts)[:-1]])
    of_row = np.repeat(base, length) + local
    # A trip of fewer rows than parts leaves numbers unused; make them dense.
    _, of_row = np.unique(of_row, return_inverse=True)
    return Cut(of_row, np.repeat(of_row, block.steps), int(of_row.max()) + 1)


def describe(block: Block, c: Cut) -> Windows:
    """Where and when the windows of a block are."""
    first = np.flatnonzero(np.concatenate([[True], np.diff(c.of_row) != 0]))
    middle = (first + np.append(first[1:], len(block)) - 1) // 2
    m = block.motion
    sample = middle * block.steps + block.steps // 2

    def total(values: Floats) -> Floats:
        return np.asarray(np.bincount(c.of_sample, values, c.count), dtype=np.float64)

    return Windows(
        trip=block.trip[middle], vehicle=np.full(c.count, block.vehicle), day=np.full(c.count, block.day),
        edge=m.edge[sample].astype(np.int64), duration=total(m.dt), distance=total(m.speed * m.dt),
        x=m.x[sample], y=m.y[sample], time=block.time[middle],
    )  # fmt: skip


def join(pieces: list[Windows]) -> Windows:
    """Windows of several blocks, one after the other."""
    names = [f.name for f in fields(Windows) if f.name != "pieces"]
    joined: dict[str, Any] = {n: np.concatenate([getattr(p, n) for p in pieces]) for n in names}
    return Windows(**joined)

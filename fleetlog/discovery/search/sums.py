"""Sums of squares and products of the columns over windows, fold by fold: all that the search needs, and
they add up.

Those of two days are the sum of those of each, so that a year is a sum of days.  Memory grows with the
columns, not the rows.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.arrays import Floats, Ints
from fleetlog.discovery.hypotheses.sources import Layout

Rows = NDArray[np.float32]

ENOUGH = 4096  # Windows that are multiplied at once


@dataclass
class Sums:
    """Products of P columns and the residual (the last column), weighted.

    ``fold`` (F, P+1, P+1) by fold of trips; ``slow`` (F, p+1, p+1) by fold of stretches of hours, of the
    columns without cells and the residual; ``own`` (V, F, n, P+1) those of numbers, by vehicle.
    """

    layout: Layout
    fold: Floats
    slow: Floats
    own: Floats
    energy: float = 0.0  # Weighted square of the recorded quantity, over all windows
    _waiting: list[tuple[NDArray[Any], ...]] = field(default_factory=list)

    @classmethod
    def empty(cls, layout: Layout, folds: int, vehicles: int) -> Sums:
        """Return sums of nothing."""
        p, q = layout.width + 1, layout.core + 1
        own = np.zeros((vehicles if vehicles > 1 else 0, folds, layout.numbers, p))
        return cls(layout, np.zeros((folds, p, p)), np.zeros((folds, q, q)), own)

    def add(self, x: Rows, residual: Floats, recorded: Floats, weight: Floats, *codes: Ints) -> None:
        """Add windows: (W, P) columns, residual, recorded quantity, inverse variance; folds and vehicle."""
        root = np.sqrt(weight).astype(np.float32)[:, None]
        z = np.concatenate([x, residual.astype(np.float32)[:, None]], axis=1) * root
        self._waiting.append((z, *codes))
        self.energy += float(weight @ recorded**2)
        if sum(len(w[0]) for w in self._waiting) >= ENOUGH:
            self.flush()

    def flush(self) -> None:
        """Multiply what is waiting."""
        if not self._waiting:
            return
        z, fold, slow, vehicle = (np.concatenate(column) for column in zip(*self._waiting, strict=True))
        self._waiting.clear()
        for k in np.unique(fold):
            part = z[fold == k]
            self.fold[k] += part.T @ part
            for v in np.unique(vehicle[fold == k]) if len(self.own) else ():
                mine = part[vehicle[fold == k] == v]
                self.own[v, k] += mine[:, : self.layout.numbers].T @ mine
        few = np.concatenate([z[:, : self.layout.core], z[:, -1:]], axis=1)
        for k in np.unique(slow):
            part = few[slow == k]
            self.slow[k] += part.T @ part

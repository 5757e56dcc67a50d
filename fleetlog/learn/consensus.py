"""Cells gathered on the lines that trucks agree on."""

from dataclasses import replace

import numpy as np

from fleetlog.learn.cells import Cells, Floats
from fleetlog.learn.kernels.consensus import shift

ALIKE = np.cos(np.radians(35.0))
"""Headings closer than this go one way."""
ALONG = 1.0
"""Standard deviation along the way of what is averaged [m]."""
ROUNDS = 12
SCATTER = 0.1
"""Directions with a smaller share of what is driven about there pull by that share, the others alike."""


def gathered(cells: Cells, noise: float, lane: float) -> Cells:
    """``cells`` on the lines that they follow by direction; lines closer than ``lane`` [m] are one.

    ``noise`` [m] is that of the positions.  The weight is then in passes: as much per metre of a line as
    the log has trips over it.
    """
    one_way, _ = _shifted(cells, max(0.5, 0.8 * noise), either=False)
    own = _shifted(one_way, 0.5, either=False, rounds=1)[1]
    around = _shifted(one_way, lane, either=True, rounds=1)[1]
    even = replace(one_way, weight=one_way.weight / np.maximum(own, SCATTER * around))
    both, _ = _shifted(even, lane, either=True)
    return replace(both, weight=one_way.weight)


def _shifted(cells: Cells, across: float, *, either: bool, rounds: int = ROUNDS) -> tuple[Cells, Floats]:
    """Cells moved across their heading to the local mean, in their order; and the weight about each."""
    side = max(3.0 * ALONG, across if either else 3.0 * across) + 1.0
    x0, y0 = cells.x.min(), cells.y.min()
    i, j = ((v - low) // side for v, low in ((cells.x, x0), (cells.y, y0)))
    columns, rows = int(i.max()) + 1, int(j.max()) + 1
    block = i.astype(np.int64) * rows + j.astype(np.int64)
    order = np.argsort(block, kind="stable")
    x, y, heading, weight = (v[order] for v in (cells.x, cells.y, cells.heading, cells.weight))
    first = np.searchsorted(block[order], np.arange(columns * rows + 1))
    left, near = np.empty(len(x)), np.empty(len(x))
    left[order], near[order] = shift(
        x, y, np.cos(heading), np.sin(heading), weight, first, columns, rows, float(x0), float(y0), side,
        ALONG, across, ALIKE, either, rounds,
    )  # fmt: skip
    moved = replace(cells, x=cells.x - np.sin(cells.heading) * left, y=cells.y + np.cos(cells.heading) * left)
    return moved, near

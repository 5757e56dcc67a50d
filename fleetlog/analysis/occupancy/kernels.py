"""The Numba kernel of the heat map."""

import numpy as np

from fleetlog.compiling import kernel
from fleetlog.core.arrays import Floats, Ints, Mask


@kernel()
def accumulate(
    x: Floats, y: Floats, time: Ints, speed: Floats, power: Floats, standing: float, use: Mask,
    x0: float, y0: float, cell: float, max_gap: float, out: Floats,
) -> None:  # fmt: skip
    """Add everything that a heat map shows to ``out`` (6, rows, columns).

    Layers: time [s], distance [m], energy [J], standing time [s], passages (times a truck came into the
    cell), and the part of the time in which the power was known [s].  Each interval between two rows is
    spread along the straight line between them in pieces no longer than half a cell, so that sparse sampling
    leaves no holes; energy takes the mean of both powers where both are known.
    """
    _, rows, columns = out.shape
    flat = out.reshape(6, rows * columns)
    last = -1
    for i in range(len(x) - 1):
        dt = (time[i + 1] - time[i]) * 1e-6
        dx, dy = x[i + 1] - x[i], y[i + 1] - y[i]
        length = np.hypot(dx, dy)
        if not (0.0 < dt <= max_gap and use[i] and length < 1e7):
            last = -1
            continue
        pieces = int(length / (0.5 * cell)) + 1
        part = dt / pieces
        v, w = 0.5 * (speed[i] + speed[i + 1]), 0.5 * (power[i] + power[i + 1])
        for k in range(pieces):
            f = (k + 0.5) / pieces
            c, r = (x[i] + f * dx - x0) / cell, (y[i] + f * dy - y0) / cell
            here = int(r) * columns + int(c) if 0.0 <= c < columns and 0.0 <= r < rows else -1
            came, last = here != last, here
            if here < 0:
                continue
            flat[0, here] += part
            if v == v:
                flat[1, here] += v * part
                if v < standing:
                    flat[3, here] += part
            if w == w:
                flat[2, here] += w * part
                flat[5, here] += part
            if came:
                flat[4, here] += 1.0

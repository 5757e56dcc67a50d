"""Numba kernels of the heat map."""

import numpy as np

from fleetlog.compiling import kernel
from fleetlog.core.arrays import Floats, Index, Ints, Mask


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
        v, w = 0.5 * (speed[i] + speed[i + 1]), 0.5 * (power[i] + power[i + 1])
        for k in range(pieces):
            f = (k + 0.5) / pieces
            c, r = (x[i] + f * dx - x0) / cell, (y[i] + f * dy - y0) / cell
            here = int(r) * columns + int(c) if 0.0 <= c < columns and 0.0 <= r < rows else -1
            _add(flat, here, last, dt / pieces, v, w, standing)
            last = here


@kernel()
def along_edges(
    edge: Index, offset: Floats, time: Ints, speed: Floats, power: Floats, standing: float,
    use: Mask, first_bin: Ints, size: float, max_gap: float, out: Floats,
) -> None:  # fmt: skip
    """Add the same layers of every stretch to ``out`` (6, bins); a row stands for the time after it."""
    last = -1
    for i in range(len(edge) - 1):
        dt = (time[i + 1] - time[i]) * 1e-6
        e = edge[i]
        here = -1
        if e >= 0 and 0.0 < dt <= max_gap and use[i]:
            stretches = first_bin[e + 1] - first_bin[e]
            here = first_bin[e] + min(int(offset[i] / size), stretches - 1)
        _add(out, here, last, dt, speed[i], power[i], standing)
        last = here


@kernel()
def _add(out: Floats, here: int, last: int, dt: float, v: float, w: float, standing: float) -> None:
    """Add a time to the cell ``here`` (-1 for none), with speed and power where these are not NaN."""
    if here < 0:
        return
    out[0, here] += dt
    if v == v:
        out[1, here] += v * dt
        if v < standing:
            out[3, here] += dt
    if w == w:
        out[2, here] += w * dt
        out[5, here] += dt
    if here != last:
        out[4, here] += 1.0

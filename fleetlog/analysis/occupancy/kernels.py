"""Numba kernels of the heat map."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@njit(cache=True)
def occupy(
    x: Floats,
    y: Floats,
    time: NDArray[np.int64],
    x0: float,
    y0: float,
    cell: float,
    max_gap: float,
    out: Floats,
) -> None:
    """Seconds spent in each cell, added to ``out`` (rows, columns); the plain case with one pass and no
    subdivision.

    A row stands for half the time to the row before and half to the row after; a gap longer than ``max_gap``
    [s] counts on neither side.  NaN positions and rows outside are passed over.
    """
    rows, columns = out.shape
    n = len(x)
    inverse = 1.0 / cell
    top = max_gap * 1e6
    before = 0.0
    for i in range(n):
        after = 0.0
        if i + 1 < n:
            dt = float(time[i + 1] - time[i])
            if 0.0 < dt <= top:
                after = dt
        c, r = (x[i] - x0) * inverse, (y[i] - y0) * inverse
        if 0.0 <= c < columns and 0.0 <= r < rows:
            out[int(r), int(c)] += 0.5e-6 * (before + after)
        before = after


@njit(cache=True)
def accumulate(
    x: Floats,
    y: Floats,
    time: NDArray[np.int64],
    speed: Floats,
    power: Floats,
    standing: float,
    use: NDArray[np.bool_],
    x0: float,
    y0: float,
    cell: float,
    max_gap: float,
    out: Floats,
) -> None:
    """Everything that a heat map shows, added to ``out`` (6, rows, columns).

    Layers: time [s], distance [m], energy [J], standing time [s], passages (times a truck came into the
    cell), and the part of the time in which the power was known [s].  Each interval between two rows is
    spread along the straight line between them in pieces no longer than half a cell, so that sparse sampling
    leaves no holes; energy takes the mean of both powers where both are known.
    """
    _, rows, columns = out.shape
    last = -1
    for i in range(len(x) - 1):
        dt = (time[i + 1] - time[i]) * 1e-6
        if not (0.0 < dt <= max_gap) or not use[i]:
            last = -1
            continue
        dx, dy = x[i + 1] - x[i], y[i + 1] - y[i]
        length = np.hypot(dx, dy)
        if not length < 1e7:
            last = -1
            continue
        pieces = int(length / (0.5 * cell)) + 1
        v = 0.5 * (speed[i] + speed[i + 1])
        w = 0.5 * (power[i] + power[i + 1])
        share = dt / pieces
        for k in range(pieces):
            f = (k + 0.5) / pieces
            c, r = (x[i] + f * dx - x0) / cell, (y[i] + f * dy - y0) / cell
            if not (0.0 <= c < columns and 0.0 <= r < rows):
                last = -1
                continue
            ci, ri = int(c), int(r)
            out[0, ri, ci] += share
            if v == v:
                out[1, ri, ci] += v * share
                if v < standing:
                    out[3, ri, ci] += share
            if w == w:
                out[2, ri, ci] += w * share
                out[5, ri, ci] += share
            here = ri * columns + ci
            if here != last:
                out[4, ri, ci] += 1.0
                last = here


@njit(cache=True)
def along_edges(
    edge: NDArray[np.int32],
    offset: Floats,
    time: NDArray[np.int64],
    speed: Floats,
    power: Floats,
    standing: float,
    use: NDArray[np.bool_],
    first_bin: NDArray[np.int64],
    size: float,
    max_gap: float,
    out: Floats,
) -> None:
    """The same layers per stretch of directed edge, added to ``out`` (6, bins);
    a row stands for the time after it.
    """
    last = -1
    for i in range(len(edge) - 1):
        dt = (time[i + 1] - time[i]) * 1e-6
        e = edge[i]
        if e < 0 or not (0.0 < dt <= max_gap) or not use[i]:
            last = -1
            continue
        stretches = first_bin[e + 1] - first_bin[e]
        b = first_bin[e] + min(int(offset[i] / size), stretches - 1)
        v, w = speed[i], power[i]
        out[0, b] += dt
        if v == v:
            out[1, b] += v * dt
            if v < standing:
                out[3, b] += dt
        if w == w:
            out[2, b] += w * dt
            out[5, b] += dt
        if b != last:
            out[4, b] += 1.0
            last = b

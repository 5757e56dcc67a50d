"""Compiled loops over rows: places on edges, banded channels; imported only where they run."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Index = NDArray[np.int32]


@njit(cache=True)
def on_edges(
    edge: Index, offset: Floats, x: Floats, y: Floats, points: Floats, first: Index, distance: Floats,
    along: Floats, heading: Floats, slope: Floats,
) -> None:  # fmt: skip
    """How far each position lies ahead of its place on the edge [m], and the edge's shape there.

    Heading and slope [rad].  Rows off the map (edge -1) are left as they are.
    """
    last, k = -1, 0
    for i in range(len(edge)):
        e = edge[i]
        if e < 0:
            continue
        top = first[e + 1] - 2
        if e != last or offset[i] < distance[k]:
            last, k = e, first[e]
        while k < top and distance[k + 1] <= offset[i]:
            k += 1
        dx, dy = points[k + 1, 0] - points[k, 0], points[k + 1, 1] - points[k, 1]
        flat = math.hypot(dx, dy)
        run = distance[k + 1] - distance[k]
        share = min(max((offset[i] - distance[k]) / run, 0.0), 1.0) if run > 0.0 else 0.0
        heading[i] = math.atan2(dy, dx)
        slope[i] = math.atan2(points[k + 1, 2] - points[k, 2], max(flat, 1e-9))
        if flat > 0.0:
            along[i] = (
                (x[i] - points[k, 0] - share * dx) * dx + (y[i] - points[k, 1] - share * dy) * dy
            ) / flat


@njit(cache=True)
def dead_band(value: Floats, band: float) -> Floats:
    """``value`` without its jitter.

    It is followed only where it leaves a band of half-width ``band`` (NaN stays).
    """
    out = value.copy()
    held = math.nan
    for i in range(len(value)):
        if math.isnan(value[i]):
            continue
        if math.isnan(held):
            held = value[i]
        elif value[i] > held + band:
            held = value[i] - band
        elif value[i] < held - band:
            held = value[i] + band
        out[i] = held
    return out

"""Samples along plane curves."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from fleetlog.simulate.arrays import Floats


@njit(cache=True)
def between(x: float, known: Floats, values: Floats) -> float:
    """A value at ``x`` by straight lines between ``known`` places in order, the outermost beyond them."""
    if x <= known[0]:
        return values[0]
    if x >= known[-1]:
        return values[-1]
    k = np.searchsorted(known, x, side="right") - 1
    return (values[k + 1] - values[k]) / (known[k + 1] - known[k]) * (x - known[k]) + values[k]


@njit(cache=True)
def even_samples(points: Floats, spacing: float) -> Any:
    """(n, 4) x, y, heading, curvature of a polyline without repeated points,
    evenly at most ``spacing`` apart; and its length.
    """
    legs = len(points) - 1
    along, chord, middle = np.zeros(legs + 1), np.empty(legs), np.empty(legs)
    for i in range(legs):
        dx, dy = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
        along[i + 1] = along[i] + np.sqrt(dx * dx + dy * dy)
        chord[i] = np.arctan2(dy, dx)
        if i:
            chord[i] -= 2.0 * np.pi * np.round((chord[i] - chord[i - 1]) / (2.0 * np.pi))
        # A chord's direction is that of the curve at its middle.
        middle[i] = 0.5 * (along[i] + along[i + 1])
    length = max(along[legs], 1e-3)
    n = max(2, int(np.ceil(length / spacing)) + 1)
    step = length / (n - 1)
    out = np.empty((n, 4))
    for k in range(n):
        s = k * step
        out[k, 0] = between(s, along, points[:, 0])
        out[k, 1] = between(s, along, points[:, 1])
        out[k, 2] = between(s, middle, chord)
    for k in range(n):
        before, after = max(k - 1, 0), min(k + 1, n - 1)
        out[k, 3] = (out[after, 2] - out[before, 2]) / ((after - before) * step)
    return out, length


@njit(cache=True)
def abreast(
    at: float, offset: Floats, first: int, last: int, spacing: float, length: float, other: int, end: int,
    pitch: float
) -> float:  # fmt: skip
    """Where on the opposite lane a truck is beside ``at`` [m] of a lane of a road of ``length`` [m].

    ``offset`` along the road of the samples ``first`` to ``last`` - 1 of the lane, every ``spacing``, and of
    ``other`` to ``end`` - 1 of the opposite one, every ``pitch``.
    """
    k = min(int(max(at, 0.0) / spacing), last - first - 1)
    on_road = offset[first + k]
    if k + 1 < last - first:
        on_road += (max(at, 0.0) / spacing - k) * (offset[first + k + 1] - on_road)
    back = length - on_road
    there = offset[other:end]
    if back <= there[0]:
        return 0.0
    if back >= there[-1]:
        return (len(there) - 1) * pitch
    k = np.searchsorted(there, back, side="right") - 1
    return (k + (back - there[k]) / (there[k + 1] - there[k])) * pitch

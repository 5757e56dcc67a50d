"""Distances from segments."""

import numpy as np

from fleetlog.core.arrays import Floats


def distance_to_segment(points: Floats, a: Floats, b: Floats) -> Floats:
    """(N,) distance of points from the segments a to b; each (N, d), or (d,) where it is one for all."""
    d = b - a
    share = ((points - a) * d).sum(axis=-1) / np.maximum((d * d).sum(axis=-1), 1e-18)
    return np.asarray(np.linalg.norm(a + np.clip(share, 0.0, 1.0)[..., None] * d - points, axis=-1))


def reduced(line: Floats, tolerance: float) -> Floats:
    """A polyline (n, d) with few of its points, true to ``tolerance`` [m] (Douglas and Peucker 1973)."""
    keep = np.zeros(len(line), dtype=bool)
    keep[[0, -1]] = True
    todo = [(0, len(line) - 1)]
    while todo:
        a, b = todo.pop()
        if b - a < 2:
            continue
        gap = distance_to_segment(line[a + 1 : b], line[a], line[b])
        worst = a + 1 + int(gap.argmax())
        if gap.max() > tolerance:
            keep[worst] = True
            todo += [(a, worst), (worst, b)]
    return line[keep]

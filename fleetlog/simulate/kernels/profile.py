"""Speeds ahead and places along the pieces of a track."""

import numpy as np
from numba import njit

from fleetlog.simulate.arrays import Flags, Floats, Index, Ints


@njit(cache=True)
def brake_ahead(cap: Floats, first: Ints, spacing: Floats, down: float) -> Floats:
    """(S,) caps lowered so that on every piece each can be reached from the one before by braking."""
    out = cap.copy()
    for p in range(len(first) - 1):
        for i in range(first[p + 1] - 2, first[p] - 1, -1):
            reach = np.sqrt(out[i + 1] * out[i + 1] + 2.0 * down * spacing[p])
            out[i] = min(out[i], reach)
    return out


@njit(cache=True, nogil=True)
def expand(
    piece: Index, s: Floats, back: Flags, first: Ints, spacing: Floats,
    x: Floats, y: Floats, z: Floats, heading: Floats, curvature: Floats, slope: Floats,
    edge: Index, offset: Floats, lateral: Floats,
) -> tuple[Floats, Index]:  # fmt: skip
    """(8, N) x, y, z, heading, curvature, slope, offset, lateral, (N,) edge at places; ``back``: backing."""
    n = len(piece)
    out = np.empty((8, n))
    where = np.empty(n, np.int32)
    for k in range(n):
        if k and piece[k] == piece[k - 1] and s[k] == s[k - 1] and back[k] == back[k - 1]:
            # Half of a fleet stands.
            where[k] = where[k - 1]
            for c in range(8):
                out[c, k] = out[c, k - 1]
            continue
        p = piece[k]
        at = max(s[k], 0.0) / spacing[p]
        i = first[p] + min(int(at), first[p + 1] - first[p] - 2)
        t = min(at - (i - first[p]), 1.0)
        out[0, k] = x[i] + t * (x[i + 1] - x[i])
        out[1, k] = y[i] + t * (y[i + 1] - y[i])
        out[2, k] = z[i] + t * (z[i + 1] - z[i])
        turn = heading[i + 1] - heading[i]
        turn -= 2.0 * np.pi * np.round(turn / (2.0 * np.pi))
        h = heading[i] + t * turn
        sign = -1.0 if back[k] else 1.0
        if back[k]:
            h += np.pi
        out[3, k] = h - 2.0 * np.pi * np.round(h / (2.0 * np.pi))
        out[4, k] = sign * (curvature[i] + t * (curvature[i + 1] - curvature[i]))
        out[5, k] = sign * (slope[i] + t * (slope[i + 1] - slope[i]))
        if edge[i] == edge[i + 1]:
            where[k] = edge[i]
            out[6, k] = offset[i] + t * (offset[i + 1] - offset[i])
            out[7, k] = lateral[i] + t * (lateral[i + 1] - lateral[i])
        else:
            j = i if t < 0.5 else i + 1
            where[k], out[6, k], out[7, k] = edge[j], offset[j], lateral[j]
    return out, where

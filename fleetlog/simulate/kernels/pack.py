"""From batches of steps to rows in whole numbers."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Index = NDArray[np.int32]


@njit(cache=True, nogil=True)
def pack_picked(
    values: Floats, first: int, every: int, scale: float, null: int, out: Index, row: Index, at: Index
) -> None:
    """Every ``every``-th of (V, K) values from ``first`` on, times ``scale`` and rounded, to ``out[row[v], at[v]:]``.

    NaN is ``null``.
    """
    for v in range(len(values)):
        to = at[v]
        for k in range(first, values.shape[1], every):
            x = values[v, k]
            out[row[v], to] = null if np.isnan(x) else np.int32(np.rint(x * scale))
            to += 1


@njit(cache=True, nogil=True)
def pack_mean(values: Floats, every: int, scale: float, null: int, out: Index, row: Index, at: Index) -> None:
    """The mean of each ``every`` of (V, K) values, otherwise the same."""
    for v in range(len(values)):
        to = at[v]
        for k in range(0, values.shape[1], every):
            x = values[v, k : k + every].mean()
            out[row[v], to] = null if np.isnan(x) else np.int32(np.rint(x * scale))
            to += 1


@njit(cache=True, nogil=True)
def pack_codes(values: Index, first: int, every: int, out: Index, row: Index, at: Index) -> None:
    """Every ``every``-th of (V, K) whole numbers from ``first`` on, as they are."""
    for v in range(len(values)):
        to = at[v]
        for k in range(first, values.shape[1], every):
            out[row[v], to] = values[v, k]
            to += 1

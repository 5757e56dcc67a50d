"""From batches of steps to rows in whole numbers."""

from typing import Any

import numpy as np
from numba import njit

from fleetlog.simulate.arrays import Flags, Floats, Index


@njit(cache=True, nogil=True)
def pack(
    values: tuple[Floats, ...], mean: Flags, scale: Floats, every: int, null: int, out: Index,
    row: Index, at: Index
) -> None:  # fmt: skip
    """Each column's (V, K) values, times its ``scale`` and rounded, to ``out[row[v], at[v], column]``; NaN is
    ``null``.

    One value of ``every`` is taken, the middle one or, where ``mean``, the mean of all.
    """
    for v in range(len(row)):
        for c in range(len(values)):
            to, x = out[row[v], at[v], c], values[c][v]
            for j in range(len(to)):
                k = j * every
                y = (x[k : k + every].mean() if mean[c] and every > 1 else x[k + every // 2]) * scale[c]
                to[j] = null if np.isnan(y) else np.int32(np.rint(y))


@njit(cache=True, nogil=True)
def pack_codes(values: tuple[Index, ...], column: int, every: int, out: Index, row: Index, at: Index) -> Any:
    """Whole numbers as they are, the middle one of ``every``, to columns ``column`` and following."""
    for v in range(len(row)):
        for c in range(len(values)):
            to, x = out[row[v], at[v], column + c], values[c][v]
            for j in range(len(to)):
                to[j] = x[j * every + every // 2]


@njit(cache=True, nogil=True)
def unpack(kept: Index, scale: Floats, null: int, out: Floats) -> None:
    """(trucks, batches, columns, rows) whole numbers to (columns, all rows) numbers."""
    at = 0
    for v in range(kept.shape[0]):
        for b in range(kept.shape[1]):
            for c in range(len(scale)):
                for j in range(kept.shape[3]):
                    k = kept[v, b, c, j]
                    out[c, at + j] = np.nan if k == null else k / scale[c]
            at += kept.shape[3]

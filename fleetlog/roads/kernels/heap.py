"""A binary heap in two arrays, distances and edges, for Dijkstra in numba."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.roads.kernels.compiling import inner

Floats = NDArray[np.float64]
Index = NDArray[np.int32]


@inner
def push(heap_d: Floats, heap_e: Index, size: int, d: float, e: int) -> Any:
    """Add edge ``e`` at distance ``d`` to a heap of ``size`` entries; returns its new size."""
    i = size
    while i > 0:
        up = (i - 1) >> 1
        if heap_d[up] <= d:
            break
        heap_d[i], heap_e[i] = heap_d[up], heap_e[up]
        i = up
    heap_d[i], heap_e[i] = d, e
    return size + 1


@inner
def pop(heap_d: Floats, heap_e: Index, size: int) -> Any:
    """Drop the top, which the caller has read; returns the new size."""
    size -= 1
    d, e = heap_d[size], heap_e[size]
    i = 0
    while True:
        child = 2 * i + 1
        if child >= size:
            break
        if child + 1 < size and heap_d[child + 1] < heap_d[child]:
            child += 1
        if heap_d[child] >= d:
            break
        heap_d[i], heap_e[i] = heap_d[child], heap_e[child]
        i = child
    heap_d[i], heap_e[i] = d, e
    return size

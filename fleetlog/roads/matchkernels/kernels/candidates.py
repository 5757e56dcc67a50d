"""Segments in a grid, and the edges near a position."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fleetlog.roads.matchkernels.kernels.growing import longer, wider

Floats = NDArray[np.float64]
Wide = NDArray[np.int64]
Index = NDArray[np.int32]


@njit(cache=True, error_model="numpy", fastmath=True)
def _visit_cells(
    px: Floats,
    py: Floats,
    k: int,
    x0: float,
    y0: float,
    cell: float,
    nx: int,
    ny: int,
    counts: Wide,
    fill: bool,
    items: Wide,
) -> None:
    """Count (``fill`` false) or enter segment k (vertices k, k + 1) in every cell that its band crosses."""
    ax, ay, bx, by = px[k], py[k], px[k + 1], py[k + 1]
    i0 = max(int((min(ax, bx) - x0) / cell), 0)
    i1 = min(int((max(ax, bx) - x0) / cell), nx - 1)
    j0 = max(int((min(ay, by) - y0) / cell), 0)
    j1 = min(int((max(ay, by) - y0) / cell), ny - 1)
    dx, dy = bx - ax, by - ay
    length = np.hypot(dx, dy)
    for i in range(i0, i1 + 1):
        for j in range(j0, j1 + 1):
            if length > 0.0 and (i1 > i0 and j1 > j0):
                cx, cy = x0 + (i + 0.5) * cell - ax, y0 + (j + 0.5) * cell - ay
                if abs(cx * dy - cy * dx) / length > 0.75 * cell:  # the cell's half diagonal is 0.707
                    continue
            c = i * ny + j
            if fill:
                items[counts[c]] = k
            counts[c] += 1


@njit(cache=True, error_model="numpy", fastmath=True)
def build_grid(
    px: Floats, py: Floats, first: Wide, twin: Index, x0: float, y0: float, cell: float, nx: int, ny: int
) -> Any:
    """CSR of the segments in every cell: starts (nx * ny + 1,), segments (first vertex index).

    Of two edges that are each other's ``twin`` (the same line in both directions, -1 none) only the first is
    entered.
    """
    counts = np.zeros(nx * ny, np.int64)
    empty = np.empty(0, np.int64)
    for e in range(len(first) - 1):
        if 0 <= twin[e] < e:
            continue
        for k in range(first[e], first[e + 1] - 1):
            _visit_cells(px, py, k, x0, y0, cell, nx, ny, counts, False, empty)
    starts = np.zeros(nx * ny + 1, np.int64)
    for c in range(nx * ny):
        starts[c + 1] = starts[c] + counts[c]
    items = np.empty(starts[-1], np.int64)
    at = starts[:-1].copy()
    for e in range(len(first) - 1):
        if 0 <= twin[e] < e:
            continue
        for k in range(first[e], first[e + 1] - 1):
            _visit_cells(px, py, k, x0, y0, cell, nx, ny, at, True, items)
    return starts, items


@njit(cache=True, error_model="numpy", fastmath=True)
def project(px: Floats, py: Floats, k: int, x: float, y: float) -> Any:
    """Foot of (x, y) on segment k: squared distance, and the share of the segment passed."""
    ax, ay = px[k], py[k]
    dx, dy = px[k + 1] - ax, py[k + 1] - ay
    along, square = (x - ax) * dx + (y - ay) * dy, dx * dx + dy * dy
    share = 0.0 if along <= 0.0 else (1.0 if along >= square else along / square)
    ex, ey = x - ax - share * dx, y - ay - share * dy
    return ex * ex + ey * ey, share


@njit(cache=True, error_model="numpy", fastmath=True)
def find_candidates(
    x: Floats,
    y: Floats,
    px: Floats,
    py: Floats,
    dist: Floats,
    length: Floats,
    owner: Index,
    twin: Index,
    grid: tuple[float, float, float, int, int],
    starts: Wide,
    items: Wide,
    radius: float,
    margin: float,
    limit: int,
) -> Any:
    """Edges within ``radius`` of every position and not more than ``margin`` farther than the nearest; at
    most ``limit``.

    ``grid`` is (x0, y0, cell, nx, ny).  Returns CSR starts (N + 1,), and of every candidate: edge; offset,
    lateral distance (left positive; beyond an end the whole distance), tangent x, tangent y.  One candidate
    an edge: its nearest point.
    """
    x0, y0, cell, nx, ny = grid
    n = len(x)
    ptr = np.zeros(n + 1, np.int64)
    capacity = 8 * n + limit
    edge = np.empty(capacity, np.int32)
    value = np.empty((4, capacity))
    near_k = np.empty(limit // 2, np.int64)
    near = np.empty((2, limit // 2))
    total = 0
    for p in range(n):
        m = 0
        best = radius * radius
        cut = best
        i0 = max(int(np.floor((x[p] - radius - x0) / cell)), 0)
        i1 = min(int(np.floor((x[p] + radius - x0) / cell)), nx - 1)
        j0 = max(int(np.floor((y[p] - radius - y0) / cell)), 0)
        j1 = min(int(np.floor((y[p] + radius - y0) / cell)), ny - 1)
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                for q in range(starts[i * ny + j], starts[i * ny + j + 1]):
                    k = items[q]
                    d2, share = project(px, py, k, x[p], y[p])
                    if d2 > cut:
                        continue
                    if d2 < best:
                        best = d2
                        cut = min((math.sqrt(best) + margin) ** 2, radius * radius)
                    m = _keep(near_k, near, m, k, d2, share, owner)
        if total + limit > capacity:
            capacity *= 2
            edge, value = longer(edge, capacity), wider(value, capacity)
        for c in range(m):
            if near[0, c] > cut:
                continue
            k, e = near_k[c], owner[near_k[c]]
            dx, dy = px[k + 1] - px[k], py[k + 1] - py[k]
            scale = 1.0 / max(math.sqrt(dx * dx + dy * dy), 1e-12)
            left = dx * (y[p] - py[k]) - dy * (x[p] - px[k]) >= 0.0
            offset = dist[k] + near[1, c] * (dist[k + 1] - dist[k])
            aside = math.sqrt(near[0, c]) if left else -math.sqrt(near[0, c])
            edge[total], value[0, total], value[1, total] = e, offset, aside
            value[2, total], value[3, total] = dx * scale, dy * scale
            total += 1
            if twin[e] >= 0:
                edge[total], value[0, total], value[1, total] = twin[e], length[e] - offset, -aside
                value[2, total], value[3, total] = -dx * scale, -dy * scale
                total += 1
        ptr[p + 1] = total
    return ptr, edge[:total].copy(), value[:, :total].copy()


@njit(cache=True, error_model="numpy", fastmath=True)
def _keep(near_k: Wide, near: Floats, m: int, k: int, d2: float, share: float, owner: Index) -> Any:
    """Enter a foot in the list of one position;
    of an edge the nearest foot stays, of too many edges the farthest goes.
    """
    at = -1
    for c in range(m):
        if owner[near_k[c]] == owner[k]:
            at = c
            if d2 >= near[0, c]:
                return m
            break
    if at < 0:
        if m < len(near_k):
            at = m
            m += 1
        else:
            at = int(np.argmax(near[0]))
            if near[0, at] <= d2:
                return m
    near_k[at], near[0, at], near[1, at] = k, d2, share
    return m

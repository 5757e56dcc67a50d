"""The edges near a position."""

import math
from typing import Any

import numpy as np

from fleetlog.roads.kernels.compiling import fast_inner, fast_outer
from fleetlog.roads.kernels.records import Candidates, Floats, Grid, Index, Roads, Wide


@fast_inner
def project(px: Floats, py: Floats, k: int, x: float, y: float) -> Any:
    """Foot of (x, y) on segment k: squared distance, and the share of the segment passed."""
    ax, ay = px[k], py[k]
    dx, dy = px[k + 1] - ax, py[k + 1] - ay
    along, square = (x - ax) * dx + (y - ay) * dy, dx * dx + dy * dy
    share = 0.0 if along <= 0.0 else (1.0 if along >= square else along / square)
    ex, ey = x - ax - share * dx, y - ay - share * dy
    return ex * ex + ey * ey, share


@fast_outer
def find_candidates(
    x: Floats, y: Floats, roads: Roads, grid: Grid, radius: float, margin: float, begin: int,
    out: Candidates, near_k: Wide, near: Floats,
) -> Any:  # fmt: skip
    """Edges within ``radius`` and not more than ``margin`` farther than the nearest, into ``out``.

    One candidate an edge: its nearest point; beyond an end the lateral distance is the whole one.  Begins at
    position ``begin`` and returns where it ended: at the first for which ``out`` has no room, or after the
    last.  ``near_k`` (K,) and ``near`` (2, K) are for the K nearest lines of one position.
    """
    px, py, dist = roads.px, roads.py, roads.dist
    ptr, edge, value = out
    total = ptr[begin]
    for p in range(begin, len(x)):
        if total + 2 * len(near_k) > len(edge):
            return p
        m = 0
        best = cut = radius * radius
        i0 = max(int(np.floor((x[p] - radius - grid.x0) / grid.cell)), 0)
        i1 = min(int(np.floor((x[p] + radius - grid.x0) / grid.cell)), grid.nx - 1)
        j0 = max(int(np.floor((y[p] - radius - grid.y0) / grid.cell)), 0)
        j1 = min(int(np.floor((y[p] + radius - grid.y0) / grid.cell)), grid.ny - 1)
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                for q in range(grid.starts[i * grid.ny + j], grid.starts[i * grid.ny + j + 1]):
                    k = grid.items[q]
                    d2, share = project(px, py, k, x[p], y[p])
                    if d2 > cut:
                        continue
                    if d2 < best:
                        best = d2
                        cut = min((math.sqrt(best) + margin) ** 2, radius * radius)
                    m = _keep(near_k, near, m, k, d2, share, roads.owner)
        for c in range(m):
            if near[0, c] > cut:
                continue
            k, e = near_k[c], roads.owner[near_k[c]]
            dx, dy = px[k + 1] - px[k], py[k + 1] - py[k]
            scale = 1.0 / max(math.sqrt(dx * dx + dy * dy), 1e-12)
            left = dx * (y[p] - py[k]) - dy * (x[p] - px[k]) >= 0.0
            offset = dist[k] + near[1, c] * (dist[k + 1] - dist[k])
            aside = math.sqrt(near[0, c]) if left else -math.sqrt(near[0, c])
            edge[total], value[0, total], value[1, total] = e, offset, aside
            value[2, total], value[3, total] = dx * scale, dy * scale
            total += 1
            if roads.twin[e] >= 0:
                edge[total], value[0, total] = roads.twin[e], roads.length[e] - offset
                value[1, total] = -aside
                value[2, total], value[3, total] = -dx * scale, -dy * scale
                total += 1
        ptr[p + 1] = total
    return len(x)


@fast_inner
def _keep(near_k: Wide, near: Floats, m: int, k: int, d2: float, share: float, owner: Index) -> Any:
    """Enter a foot of one position: of an edge the nearest stays, of too many edges the farthest goes."""
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
            at = 0
            for c in range(1, m):
                if near[0, c] > near[0, at]:
                    at = c
            if near[0, at] <= d2:
                return m
    near_k[at], near[0, at], near[1, at] = k, d2, share
    return m

"""Rectangles that meet, points laid on lines."""

from typing import Any

import numpy as np
from numba import njit

from fleetlog.simulate.arrays import Flags, Floats, Index


@njit(cache=True)
def project_points(points: Floats, first: Index, distance: Floats, edge: Index, x: Floats, y: Floats) -> Any:
    """(N,) offset along the polyline of each point's edge, and distance left of it."""
    n = len(x)
    offset, lateral = np.zeros(n), np.zeros(n)
    for i in range(n):
        best = np.inf
        for k in range(first[edge[i]], first[edge[i] + 1] - 1):
            ax, ay = points[k, 0], points[k, 1]
            dx, dy = points[k + 1, 0] - ax, points[k + 1, 1] - ay
            size = dx * dx + dy * dy
            if size <= 0.0:
                continue
            t = min(max(((x[i] - ax) * dx + (y[i] - ay) * dy) / size, 0.0), 1.0)
            ex, ey = x[i] - ax - t * dx, y[i] - ay - t * dy
            d = ex * ex + ey * ey
            if d < best:
                best = d
                offset[i] = distance[k] + t * (distance[k + 1] - distance[k])
                side = dx * ey - dy * ex
                lateral[i] = np.sqrt(d) if side >= 0.0 else -np.sqrt(d)
    return offset, lateral


@njit(cache=True)
def boxes_meet(
    xa: float, ya: float, ha: float, xb: float, yb: float, hb: float, half_l: float, half_w: float
) -> bool:
    """Whether two rectangles of one size meet: no separating axis (Gottschalk, Lin and Manocha 1996)."""
    dx, dy = xb - xa, yb - ya
    if dx * dx + dy * dy > 4.0 * (half_l * half_l + half_w * half_w):
        return False
    return turned_boxes_meet(dx, dy, np.cos(ha), np.sin(ha), np.cos(hb), np.sin(hb), half_l, half_w)


@njit(cache=True)
def turned_boxes_meet(
    dx: float, dy: float, ca: float, sa: float, cb: float, sb: float, half_l: float, half_w: float
) -> bool:
    """The same of boxes ``dx`` and ``dy`` apart, by the cosines and sines of their headings."""
    c, s = abs(ca * cb + sa * sb), abs(ca * sb - sa * cb)
    along, across = half_l + half_l * c + half_w * s, half_w + half_l * s + half_w * c
    if abs(dx * ca + dy * sa) > along or abs(-dx * sa + dy * ca) > across:
        return False
    return not (abs(dx * cb + dy * sb) > along or abs(-dx * sb + dy * cb) > across)


@njit(cache=True)
def grid_of(x: Floats, y: Floats, cell: float) -> Any:
    """Points in square cells: order, start of each cell in it, west and south edge, columns, rows."""
    x0, y0 = x.min(), y.min()
    columns, rows = int((x.max() - x0) / cell) + 1, int((y.max() - y0) / cell) + 1
    count = np.zeros(columns * rows + 1, np.int64)
    where = np.empty(len(x), np.int64)
    for i in range(len(x)):
        where[i] = int((y[i] - y0) / cell) * columns + int((x[i] - x0) / cell)
        count[where[i] + 1] += 1
    start = np.cumsum(count)
    fill = start.copy()
    order = np.empty(len(x), np.int64)
    for i in range(len(x)):
        order[fill[where[i]]] = i
        fill[where[i]] += 1
    return order, start, x0, y0, columns, rows


@njit(cache=True)
def twice(pairs: Index) -> Index:
    """The same pairs, with room for as many more."""
    out = np.empty((2 * len(pairs), 2), np.int32)
    for k in range(len(pairs)):
        out[k, 0], out[k, 1] = pairs[k, 0], pairs[k, 1]
    return out


@njit(cache=True)
def meetings(
    x: Floats, y: Floats, z: Floats, heading: Floats, owner: Index, ask: Flags, half_l: float,
    half_w: float, skip: Index,
) -> Any:  # fmt: skip
    """Pairs (a, b), a < b, of samples of different owners whose boxes meet; at least one of them in ``ask``.

    Those in ``ask`` pass over the owner ``skip`` (N,), -1 where they pass over none.
    """
    cell = 2.0 * np.sqrt(half_l * half_l + half_w * half_w)
    order, start, x0, y0, columns, rows = grid_of(x, y, cell)
    cos, sin = np.cos(heading), np.sin(heading)
    out, n = np.empty((1024, 2), np.int32), 0
    for a in range(len(x)):
        if not ask[a]:
            continue
        column, row = int((x[a] - x0) / cell), int((y[a] - y0) / cell)
        left, right = max(column - 1, 0), min(column + 1, columns - 1)
        for r in range(max(row - 1, 0), min(row + 2, rows)):
            # Cells of a row lie one after the other.
            for k in range(start[r * columns + left], start[r * columns + right + 1]):
                b = order[k]
                if (ask[b] and b <= a) or owner[a] == owner[b] or owner[b] == skip[a]:
                    continue
                dx, dy = x[b] - x[a], y[b] - y[a]
                if dx * dx + dy * dy > cell * cell or abs(z[a] - z[b]) > 2.5:
                    continue
                if not turned_boxes_meet(dx, dy, cos[a], sin[a], cos[b], sin[b], half_l, half_w):
                    continue
                if n == len(out):
                    out = twice(out)
                out[n, 0], out[n, 1] = min(a, b), max(a, b)
                n += 1
    return out[:n]

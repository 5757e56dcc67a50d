"""Rectangles that meet, free ground beside the roads, points laid on lines, places along a track."""

from typing import Any, NamedTuple

import numpy as np

from fleetlog.compiling import free, inner, outer
from fleetlog.core.arrays import Floats, Index, Ints, Mask

PASSED, SAFE, PARKED = range(3)  # Ground that trucks drive over, wait on, stand on in a bay


@outer
def project_points(
    points: Floats, first: Index, distance: Floats, edge: Index, x: Floats, y: Floats, offset: Floats,
    lateral: Floats,
) -> None:  # fmt: skip
    """(N,) offset along the polyline of each point's edge, and distance left of it."""
    for i in range(len(x)):
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


@inner
def boxes_meet(
    dx: float, dy: float, ca: float, sa: float, cb: float, sb: float, half_l: float, half_w: float
) -> bool:
    """Whether two rectangles of one size meet: no separating axis (Gottschalk, Lin and Manocha 1996). They
    are ``dx`` and ``dy`` apart; cosines and sines of their headings."""
    if dx * dx + dy * dy > 4.0 * (half_l * half_l + half_w * half_w):
        return False
    c, s = abs(ca * cb + sa * sb), abs(ca * sb - sa * cb)
    along, across = half_l + half_l * c + half_w * s, half_w + half_l * s + half_w * c
    if abs(dx * ca + dy * sa) > along or abs(-dx * sa + dy * ca) > across:
        return False
    return not (abs(dx * cb + dy * sb) > along or abs(-dx * sb + dy * cb) > across)


class Cells(NamedTuple):
    """Boxes of one size in square cells: ``head`` (cells,) a cell's last box, ``after`` (N,) that before it.

    ``shape`` x0, y0, cell [m], columns, rows;  ``box`` (N, 3) x, y, heading;  ``group``, ``kind`` (N,) what
    a box belongs to;  ``size`` (1,) boxes in use.  Boxes outside the cells lie in the nearest one."""

    shape: Floats
    head: Ints
    after: Ints
    box: Floats
    group: Index
    kind: Index
    size: Ints


def new_cells(x: Floats, y: Floats, cell: float, room: int) -> Cells:
    """Empty cells over the extent of points (x, y), for up to ``room`` boxes."""
    columns, rows = int(np.ptp(x) / cell) + 1, int(np.ptp(y) / cell) + 1
    shape = np.array([x.min(), y.min(), cell, columns, rows], dtype=np.float64)
    head, after = np.full(columns * rows, -1, np.int64), np.full(room, -1, np.int64)
    group, kind = np.zeros(room, np.int32), np.zeros(room, np.int32)
    return Cells(shape, head, after, np.zeros((room, 3)), group, kind, np.zeros(1, np.int64))


def grown(c: Cells, more: int) -> Cells:
    """The same cells with room for ``more`` boxes."""
    if c.size[0] + more <= len(c.after):
        return c
    longer = 2 * len(c.after) + more
    parts = (np.resize(values, (longer, *values.shape[1:])) for values in (c.after, c.box, c.group, c.kind))
    return c._replace(**dict(zip(("after", "box", "group", "kind"), parts, strict=True)))


@inner
def _at(value: float, low: float, cell: float, count: int) -> int:
    return min(max(int(np.floor((value - low) / cell)), 0), count - 1)


@outer
def put(c: Cells, boxes: Floats, group: Index, kind: Index) -> None:
    """Add (n, 3+) boxes of (n,) groups and kinds; there must be room."""
    columns, rows = int(c.shape[3]), int(c.shape[4])
    for i in range(len(boxes)):
        k = c.size[0]
        c.size[0] += 1
        column = _at(boxes[i, 0], c.shape[0], c.shape[2], columns)
        where = _at(boxes[i, 1], c.shape[1], c.shape[2], rows) * columns + column
        c.box[k, 0], c.box[k, 1], c.box[k, 2] = boxes[i, 0], boxes[i, 1], boxes[i, 2]
        c.group[k], c.kind[k], c.after[k], c.head[where] = group[i], kind[i], c.head[where], k


@inner
def cells_near(c: Cells, x: float, y: float) -> Any:
    """Rows and columns of the cells round a point, from the first to the one behind the last."""
    columns, rows = int(c.shape[3]), int(c.shape[4])
    column, row = _at(x, c.shape[0], c.shape[2], columns), _at(y, c.shape[1], c.shape[2], rows)
    return max(row - 1, 0), min(row + 2, rows), max(column - 1, 0), min(column + 2, columns)


def meetings(
    x: Floats, y: Floats, z: Floats, heading: Floats, owner: Index, ask: Mask, half_l: float, half_w: float
) -> Any:
    """Pairs (a, b), a < b, of samples of different owners whose boxes meet, at least one in ``ask``."""
    c = new_cells(x, y, 2.0 * np.sqrt(half_l * half_l + half_w * half_w), len(x))
    put(c, np.column_stack((x, y, heading)), owner, owner)
    n, out, turn = -1, np.empty((256, 2), np.int32), np.empty((2, len(x)))
    while n < 0:
        out = np.empty((4 * len(out), 2), np.int32)
        n = _meetings(c, z, ask, bool(ask.all()), half_l, half_w, turn, out)
    return out[:n]


@outer
def _meetings(
    c: Cells, z: Floats, ask: Mask, everyone: bool, half_l: float, half_w: float, turn: Floats, out: Index
) -> int:
    """How many pairs are in ``out``, -1 where there is no room for them."""
    n = 0
    for a in range(len(z)):
        turn[0, a], turn[1, a] = np.cos(c.box[a, 2]), np.sin(c.box[a, 2])
    for a in range(len(z)):
        if not ask[a]:
            continue
        x, y, cos, sin = c.box[a, 0], c.box[a, 1], turn[0, a], turn[1, a]
        low, high, left, right = cells_near(c, x, y)
        for r in range(low, high):
            for q in range(left, right):
                b = c.head[r * int(c.shape[3]) + q]
                while b > (a if everyone else -1):  # the last of a cell comes first
                    dx, dy, dz = c.box[b, 0] - x, c.box[b, 1] - y, abs(z[b] - z[a])
                    counts = (not ask[b] or b > a) and c.group[a] != c.group[b] and dz <= 2.5
                    if counts and boxes_meet(dx, dy, cos, sin, turn[0, b], turn[1, b], half_l, half_w):
                        if n == len(out):
                            return -1
                        out[n, 0], out[n, 1] = min(a, b), max(a, b)
                        n += 1
                    b = c.after[b]
    return n


@outer
def spur_is_free(c: Cells, path: Floats, half_l: float, half_w: float, lane: int, reverse: int) -> bool:
    """Whether a spur (n, 4) touches no parked truck and no safe part of other lanes than ``lane`` and
    ``reverse``, its end nothing; cells are wider than two boxes."""
    for i in range(len(path) - 1, -1, -1):  # most ground that is taken is taken at the bay
        x, y, cos, sin = path[i, 0], path[i, 1], np.cos(path[i, 2]), np.sin(path[i, 2])
        low, high, left, right = cells_near(c, x, y)
        for r in range(low, high):
            for q in range(left, right):
                k = c.head[r * int(c.shape[3]) + q]
                while k >= 0:
                    other = c.kind[k] == SAFE and c.group[k] != lane and c.group[k] != reverse
                    if other or c.kind[k] == PARKED or i == len(path) - 1:
                        dx, dy, turn = c.box[k, 0] - x, c.box[k, 1] - y, c.box[k, 2]
                        if boxes_meet(dx, dy, cos, sin, np.cos(turn), np.sin(turn), half_l, half_w):
                            return False
                    k = c.after[k]
    return True


@outer
def brake_ahead(cap: Floats, first: Ints, spacing: Floats, down: float) -> None:
    """Lower (S,) caps so that on every piece each can be reached from the one before by braking."""
    for p in range(len(first) - 1):
        for i in range(first[p + 1] - 2, first[p] - 1, -1):
            cap[i] = min(cap[i], np.sqrt(cap[i + 1] * cap[i + 1] + 2.0 * down * spacing[p]))


@free
def expand(
    piece: Index, s: Floats, back: Mask, first: Ints, spacing: Floats, samples: Floats, edge: Index,
    out: Floats, where: Index,
) -> None:  # fmt: skip
    """``out`` (8, N): columns of ``samples`` (S, 8), see ``Track.samples``, and ``where`` (N,): the edge, at
    places of pieces; ``back`` (N,): who backs there."""
    for k in range(len(piece)):
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
        for c in range(8):
            out[c, k] = samples[i, c] + t * (samples[i + 1, c] - samples[i, c])
        turn = samples[i + 1, 3] - samples[i, 3]
        turn -= 2.0 * np.pi * np.rint(turn / (2.0 * np.pi))
        h = samples[i, 3] + t * turn
        if back[k]:
            h += np.pi
            out[4, k], out[5, k] = -out[4, k], -out[5, k]
        out[3, k] = h - 2.0 * np.pi * np.rint(h / (2.0 * np.pi))
        where[k] = edge[i]
        if edge[i] != edge[i + 1]:
            j = i if t < 0.5 else i + 1
            where[k], out[6, k], out[7, k] = edge[j], samples[j, 6], samples[j, 7]

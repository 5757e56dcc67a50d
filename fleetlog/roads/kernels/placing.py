"""Points on a route: a fixed-interval smoother on the path coordinate."""

import math

from fleetlog.compiling import inner, outer
from fleetlog.core.arrays import Floats, Index
from fleetlog.roads.kernels.records import Lines, Routes, Rows, Wide


@inner
def smooth_coordinate(rows: Rows, a: int, b: int, accel: float) -> None:
    """Rauch-Tung-Striebel smoother of (coordinate, speed) of rows a to b under white acceleration ``accel``
    [m2/s3]: from ``seen`` and ``speed`` to ``where`` and ``sd``."""
    t, seen, speed, where, sd, kept = rows.t, rows.seen, rows.speed, rows.where, rows.sd, rows.kept
    x, v, pxx, pxv, pvv = seen[a], 0.0, rows.position_var[a], 0.0, 25.0
    for i in range(a, b):
        if i > a:
            h = t[i] - t[i - 1]
            x += h * v
            pxx += h * (2.0 * pxv + h * pvv) + accel * h * h * h / 3.0
            pxv += h * pvv + accel * h * h / 2.0
            pvv += accel * h
            s, r = pxx + rows.position_var[i], seen[i] - x
            kx, kv = pxx / s, pxv / s
            x += kx * r
            v += kv * r
            pvv -= kv * pxv
            pxv -= kx * pxv
            pxx -= kx * pxx
        r = speed[i] - v
        if r == r:
            s = pvv + rows.speed_var[i]
            kx, kv = pxv / s, pvv / s
            x += kx * r
            v += kv * r
            pxx -= kx * pxv
            pxv -= kv * pxv
            pvv -= kv * pvv
        kept[0, i], kept[1, i], kept[2, i], kept[3, i], kept[4, i] = x, v, pxx, pxv, pvv
    where[b - 1], sd[b - 1] = x, math.sqrt(max(pxx, 0.0))
    sxx, sxv, svv = pxx, pxv, pvv
    for i in range(b - 2, a - 1, -1):
        h = t[i + 1] - t[i]
        mx, mv, fxx, fxv, fvv = kept[0, i], kept[1, i], kept[2, i], kept[3, i], kept[4, i]
        qxx = fxx + h * (2.0 * fxv + h * fvv) + accel * h * h * h / 3.0
        qxv = fxv + h * fvv + accel * h * h / 2.0
        qvv = fvv + accel * h
        det = qxx * qvv - qxv * qxv
        # gain = P F' Q^-1 with F = [[1, h], [0, 1]]
        p, q = fxx + h * fxv, fxv + h * fvv
        g00, g01 = (p * qvv - fxv * qxv) / det, (fxv * qxx - p * qxv) / det
        g10, g11 = (q * qvv - fvv * qxv) / det, (fvv * qxx - q * qxv) / det
        ex, ev = x - (mx + h * mv), v - mv
        x, v = mx + g00 * ex + g01 * ev, mv + g10 * ex + g11 * ev
        dxx, dxv, dvv = sxx - qxx, sxv - qxv, svv - qvv
        ax, av = g00 * dxx + g01 * dxv, g00 * dxv + g01 * dvv
        bx, bv = g10 * dxx + g11 * dxv, g10 * dxv + g11 * dvv
        sxx, sxv, svv = fxx + g00 * ax + g01 * av, fxv + g10 * ax + g11 * av, fvv + g10 * bx + g11 * bv
        where[i], sd[i] = x, math.sqrt(max(sxx, 0.0))


@outer
def place_points(
    rows: Rows, begins: Wide, ends: Wide, routes: Routes, lines: Lines, acceleration: float, lasting: float,
    out: tuple[Index, Floats, Floats, Floats],
) -> None:  # fmt: skip
    """Edge, offset [m], lateral distance [m] and confidence, ``out`` (N,), of every row that a stretch covers
    (from ``begins`` to ``ends``, (S,)).

    Two passes: the coordinate interpolated between groups, then the smoothed one, is where a row is
    projected onto the tangent of the route.  In a third the rows are placed.  ``acceleration`` is its density
    along the route [m2/s3], ``lasting`` the variance of errors that last from group to group [m2]."""
    place, along, where = routes.place, lines.along, rows.where
    edge, offsets, lateral, confidence = out
    for s in range(len(begins)):
        a, b, lo, last = begins[s], ends[s], routes.firsts[s], routes.firsts[s + 1] - 1
        end = place[last] + routes.end[last] - routes.begin[last]
        for turn in range(3):
            piece, k, before = lo, 0, -1
            for i in range(a, b):
                if turn < 2 and rows.still[i]:
                    rows.seen[i] = rows.centre[i]
                    continue
                c = min(max(where[i], 0.0), end)
                while piece > lo and c < place[piece]:
                    piece -= 1
                while piece < last and c >= place[piece + 1]:
                    piece += 1
                e = routes.edge[piece]
                offset = min(routes.begin[piece] + c - place[piece], routes.end[piece])
                if e != before or along[k] > offset:
                    k, before = lines.first[e], e
                while k < lines.first[e + 1] - 2 and along[k + 1] < offset:
                    k += 1
                dx, dy, ux, uy = rows.x[i] - lines.x[k], rows.y[i] - lines.y[k], lines.ux[k], lines.uy[k]
                if turn < 2:
                    rows.seen[i] = c + (dx * ux + dy * uy) * lines.stretch[k] - (offset - along[k])
                    continue
                edge[i], offsets[i], lateral[i] = e, offset, dy * ux - dx * uy
                width = math.sqrt(2.0 * (rows.sd[i] * rows.sd[i] + lasting) + 1e-6)
                low = -1.0 if piece == lo else math.erf((place[piece] - c) / width)
                high = 1.0 if piece == last else math.erf((place[piece + 1] - c) / width)
                confidence[i] = rows.near[i] * 0.5 * (high - low)
            if turn < 2:
                smooth_coordinate(rows, a, b, acceleration)
            if turn == 1:
                make_monotone(rows, a, b)


@inner
def make_monotone(rows: Rows, a: int, b: int) -> None:
    """Coordinates of rows a to b that never decrease, the nearest in least squares: pool adjacent violators.

    A truck does not slide back on its route: a turn would be a piece of its own.  Rows in motion stay
    nanometres apart: equal offsets mean a standstill."""
    where, kept = rows.where, rows.kept
    m = a
    for i in range(a, b):
        kept[0, m], kept[1, m] = rows.centre[i] if rows.still[i] else where[i], 1.0
        while m > a and kept[0, m - 1] > kept[0, m]:
            size = kept[1, m - 1] + kept[1, m]
            kept[0, m - 1] += (kept[0, m] - kept[0, m - 1]) * kept[1, m] / size
            kept[1, m - 1] = size
            m -= 1
        m += 1
    pool, left = a, kept[1, a]
    for i in range(a, b):
        if left == 0.0:
            pool += 1
            left = kept[1, pool]
        left -= 1.0
        where[i] = kept[0, pool] if rows.still[i] else kept[0, pool] + 1e-9 * (i - a)

"""Points on a route: a fixed-interval smoother on the path coordinate."""

import math
from typing import Any

from fleetlog.compiling import inner, outer
from fleetlog.core.arrays import Floats
from fleetlog.roads.kernels.records import Groups, Noise, Placed, Roads, Routes, Track, Wide


@inner
def smooth_coordinate(
    t: Floats, seen: Floats, seen_var: Floats, speed: Floats, speed_var: Floats, accel: float, out: Floats,
    sd: Floats, kept: Floats,
) -> None:  # fmt: skip
    """Rauch-Tung-Striebel smoother of (coordinate, speed) under white acceleration ``accel`` [m2/s3].
    ``seen`` (n,) coordinates with variances ``seen_var`` (n,); ``speed`` (n,) is NaN where the log has none.
    Writes the smoothed coordinate and its standard deviation; ``kept`` (5, n) are the states on the way."""
    n = len(t)
    m, p = kept[:2], kept[2:]
    x, v, pxx, pxv, pvv = seen[0], 0.0, seen_var[0], 0.0, 25.0
    for i in range(n):
        if i > 0:
            h = t[i] - t[i - 1]
            x += h * v
            pxx += h * (2.0 * pxv + h * pvv) + accel * h * h * h / 3.0
            pxv += h * pvv + accel * h * h / 2.0
            pvv += accel * h
            s = pxx + seen_var[i]
            kx, kv, r = pxx / s, pxv / s, seen[i] - x
            x += kx * r
            v += kv * r
            pvv -= kv * pxv
            pxv -= kx * pxv
            pxx -= kx * pxx
        if speed[i] == speed[i]:
            s = pvv + speed_var[i]
            kx, kv, r = pxv / s, pvv / s, speed[i] - v
            x += kx * r
            v += kv * r
            pxx -= kx * pxv
            pxv -= kv * pxv
            pvv -= kv * pvv
        m[0, i], m[1, i] = x, v
        p[0, i], p[1, i], p[2, i] = pxx, pxv, pvv
    out[n - 1], sd[n - 1] = x, math.sqrt(max(pxx, 0.0))
    sxx, sxv, svv = pxx, pxv, pvv
    for i in range(n - 2, -1, -1):
        h = t[i + 1] - t[i]
        fxx, fxv, fvv = p[0, i], p[1, i], p[2, i]
        qxx = fxx + h * (2.0 * fxv + h * fvv) + accel * h * h * h / 3.0
        qxv = fxv + h * fvv + accel * h * h / 2.0
        qvv = fvv + accel * h
        det = qxx * qvv - qxv * qxv
        # gain = P F' Q^-1 with F = [[1, h], [0, 1]]
        a, b = fxx + h * fxv, fxv
        c, d = fxv + h * fvv, fvv
        g00, g01 = (a * qvv - b * qxv) / det, (b * qxx - a * qxv) / det
        g10, g11 = (c * qvv - d * qxv) / det, (d * qxx - c * qxv) / det
        ex, ev = x - (m[0, i] + h * m[1, i]), v - m[1, i]
        x, v = m[0, i] + g00 * ex + g01 * ev, m[1, i] + g10 * ex + g11 * ev
        dxx, dxv, dvv = sxx - qxx, sxv - qxv, svv - qvv
        sxx = fxx + g00 * (g00 * dxx + g01 * dxv) + g01 * (g00 * dxv + g01 * dvv)
        n_xv = fxv + g00 * (g10 * dxx + g11 * dxv) + g01 * (g10 * dxv + g11 * dvv)
        svv = fvv + g10 * (g10 * dxx + g11 * dxv) + g11 * (g10 * dxv + g11 * dvv)
        sxv = n_xv
        out[i], sd[i] = x, math.sqrt(max(sxx, 0.0))


@inner
def _locate(where: float, piece: int, lo: int, hi: int, routes: Routes, roads: Roads, cursor: Wide) -> Any:
    """Piece, offset, position, tangent and metres along per metre of plan at a path coordinate. ``piece`` is
    a guess nearby; ``cursor`` (2,) is the edge and vertex of the last place."""
    p_value, dist, px, py = routes.value, roads.dist, roads.px, roads.py
    while piece > lo and where < p_value[2, piece]:
        piece -= 1
    while piece < hi - 1 and where >= p_value[2, piece] + p_value[1, piece] - p_value[0, piece]:
        piece += 1
    e = routes.edge[piece]
    offset = p_value[0, piece] + where - p_value[2, piece]
    inside = min(max(offset, p_value[0, piece]), p_value[1, piece])
    k, top = roads.first[e], roads.first[e + 1] - 2
    if cursor[0] == e and cursor[1] <= top and dist[cursor[1]] <= inside:
        k = cursor[1]
    while k < top and dist[k + 1] < inside:
        k += 1
    cursor[0], cursor[1] = e, k
    run = max(dist[k + 1] - dist[k], 1e-12)
    share = (inside - dist[k]) / run
    dx, dy = px[k + 1] - px[k], py[k + 1] - py[k]
    norm = max(math.hypot(dx, dy), 1e-12)
    # offsets may count the climb too (3-D length): one metre of offset is norm / run metres on the plan
    return piece, inside, px[k] + share * dx, py[k] + share * dy, dx / norm, dy / norm, run / norm


@outer
def place_points(
    track: Track, groups: Groups, group: Wide, routes: Routes, roads: Roads, near: Floats, noise: Noise,
    out: Placed, room: Floats, cursor: Wide,
) -> None:  # fmt: skip
    """Place every row that a stretch covers, into ``out``; ``group`` (N,) is that of each row.

    Two passes: the coordinate interpolated between groups, then the smoothed one, is where a row is
    projected onto the tangent of the route.  ``near`` (G,) is the posterior of the route about a group;
    ``room`` (13, n) is for the rows of one stretch, ``cursor`` (2,) for the search along it."""
    t, x, y, speed = track.t, track.x, track.y, track.speed
    first_row, still = groups.first, groups.still
    spans, firsts, place_of, p_value = routes.spans, routes.firsts, routes.place, routes.value
    for s in range(spans.shape[1]):
        g0, g1 = spans[0, s], spans[1, s]
        a, b = first_row[g0], first_row[g1 + 1]
        lo, hi = firsts[s], firsts[s + 1]
        end = p_value[2, hi - 1] + p_value[1, hi - 1] - p_value[0, hi - 1]
        n = b - a
        work = room[:, :n]
        where, sd, seen, var, v, v_var = work[0], work[1], work[2], work[3], work[4], work[5]
        _interpolate(t, a, g0, g1, group, groups, place_of, where)
        for _ in range(2):
            piece, cursor[0] = lo, -1
            for i in range(n):
                g = group[a + i]
                if still[g]:
                    var[i] = noise.position / max(first_row[g + 1] - first_row[g], 1)
                    seen[i], v[i], v_var[i] = place_of[g], 0.0, 1e-6
                    continue
                c = min(max(where[i], 0.0), end)
                piece, _o, qx, qy, ux, uy, stretch = _locate(c, piece, lo, hi, routes, roads, cursor)
                along = ((x[a + i] - qx) * ux + (y[a + i] - qy) * uy) * stretch
                seen[i], var[i], v[i], v_var[i] = c + along, noise.position, speed[a + i], noise.speed
            smooth_coordinate(t[a:b], seen, var, v, v_var, noise.acceleration, where, sd, work[6:11])
        for i in range(n):
            if still[group[a + i]]:
                where[i] = place_of[group[a + i]]
        # a truck does not slide back on its route: a turn would be a piece of its own
        make_monotone(where, work[11], work[12])
        piece, cursor[0] = lo, -1
        for i in range(n):
            g = group[a + i]
            if not still[g]:  # rows in motion stay nanometres apart: equal offsets mean a standstill
                where[i] += 1e-9 * i
            c = min(max(where[i], 0.0), end)
            piece, o, qx, qy, ux, uy, _s = _locate(c, piece, lo, hi, routes, roads, cursor)
            out.edge[a + i], out.offset[a + i] = routes.edge[piece], o
            out.lateral[a + i] = -(x[a + i] - qx) * uy + (y[a + i] - qy) * ux
            width = math.sqrt(2.0 * (sd[i] * sd[i] + noise.lasting) + 1e-6)
            low = -1e9 if piece == lo else (p_value[2, piece] - c) / width
            high = 1e9 if piece == hi - 1 else (p_value[2, piece + 1] - c) / width
            out.confidence[a + i] = near[g] * 0.5 * (math.erf(high) - math.erf(low))


@inner
def make_monotone(values: Floats, mean: Floats, size: Floats) -> None:
    """The nearest series (least squares) that never decreases, in place: pool adjacent violators. ``mean``
    and ``size`` (n,) are for the pools."""
    n = len(values)
    m = 0
    for i in range(n):
        mean[m], size[m] = values[i], 1
        while m > 0 and mean[m - 1] > mean[m]:
            total = size[m - 1] + size[m]
            mean[m - 1] += (mean[m] - mean[m - 1]) * size[m] / total
            size[m - 1] = total
            m -= 1
        m += 1
    i = 0
    for k in range(m):
        pool = int(size[k])
        for j in range(i, i + pool):
            values[j] = mean[k]
        i += pool


@inner
def _interpolate(
    t: Floats, a: int, g0: int, g1: int, group: Wide, groups: Groups, place_of: Floats, where: Floats,
) -> None:  # fmt: skip
    """Path coordinate of rows between the groups' centres, carried on with the nearest slope at both ends."""
    g, group_time, still = g0, groups.t, groups.still
    for i in range(a, a + len(where)):
        while g < g1 - 1 and t[i] > group_time[g + 1]:
            g += 1
        if g1 == g0 or still[group[i]]:
            where[i - a] = place_of[group[i]]
            continue
        slope = (place_of[g + 1] - place_of[g]) / max(group_time[g + 1] - group_time[g], 1e-9)
        where[i - a] = place_of[g] + slope * (t[i] - group_time[g])

"""From chosen candidates to routes: connected stretches of directed edges with one path coordinate.

Rows are placed on them by a fixed-interval smoother; routes of the quickest way are found too."""

import math
from typing import Any

import numpy as np

from fleetlog.compiling import inner, outer
from fleetlog.core.arrays import Floats, Index, Mask
from fleetlog.roads.kernels.distances import _pop, _push, path_between
from fleetlog.roads.kernels.records import Candidates, Choice, Lines, Roads, Routes, Rows, Store, Wide

LONGEST = 4096  # edges of a path between two groups at most
BY_EDGE, BY_PATH, BY_TURN = 0, 1, 2
AHEAD = 0.5  # an end this much farther along the edge can be reached without a way round [m]
Graph = tuple[Index, Index, Floats, Floats, Mask, Floats, float]
Scratch = tuple[Floats, Floats, Index, Index, Mask, Index]


def build_routes(
    store: Store, roads: Roads, near: Candidates, choice: Choice, moved: Floats, back: float
) -> Routes:
    """Pieces of all stretches, end to end."""
    groups = len(choice.chosen)
    capacity, n, stretches = groups + LONGEST, -1, 0
    path, firsts = np.empty(LONGEST, np.int32), np.empty(groups + 1, np.int64)
    spans, (of, piece) = np.empty((2, groups), np.int64), np.full((2, groups), -1)
    given = store, roads, near.edge, near.offset, choice.chosen, choice.linked, moved, back, path
    while n < 0:
        capacity *= 2
        columns = np.empty(capacity, np.int32), *np.empty((3, capacity))
        room = Routes._make([*columns, firsts, spans, of, piece, np.zeros(groups)])
        n, stretches = _build(*given, room)
    firsts, spans = firsts[: stretches + 1], spans[:, :stretches].copy()
    return Routes._make([*(c[:n].copy() for c in columns), firsts, spans, of, piece, room.centre])


@outer
def _build(
    store: Store, roads: Roads, edge: Index, offset: Floats, chosen: Wide, linked: Mask, moved: Floats,
    back: float, path: Index, out: Routes,
) -> Any:  # fmt: skip
    """Fill ``out``; how many pieces and stretches there are, -1 pieces where there is no room for them."""
    length = roads.length
    n = stretches = 0
    at = 0.0
    for g in range(len(chosen)):
        if chosen[g] < 0:
            continue
        if n + len(path) + 8 > len(out.edge):
            return -1, 0
        e, s = edge[chosen[g]], offset[chosen[g]]
        m = -1
        if linked[g] and g > 0 and chosen[g - 1] >= 0:
            last = out.edge[n - 1]
            m = _kind(store, roads, last, at, e, s, moved[g - 1], back)
            if m == BY_TURN:
                at = max(max(at, length[e] - s), out.begin[n - 1])
                out.end[n - 1] = at
                n = _append(out, n, e, length[e] - at, length[e])
            elif m == BY_PATH:
                m = path_between(store, last, e, path)
                for i in range(m + 1):
                    f = path[i] if i < m else e
                    n = _append(out, n, f, 0.0, length[f])
        if m < 0:
            out.firsts[stretches], out.spans[0, stretches] = n, g
            stretches += 1
            out.edge[n], out.begin[n], out.end[n], out.place[n] = e, 0.0, length[e], 0.0
            n += 1
        out.of[g], out.piece[g], out.spans[1, stretches - 1] = stretches - 1, n - 1, g
        out.centre[g] = out.place[n - 1] + s - out.begin[n - 1]
        at = s
    out.firsts[stretches] = n
    return n, stretches


@inner
def _append(out: Routes, n: int, e: int, begin: float, end: float) -> Any:
    out.edge[n], out.begin[n], out.end[n] = e, begin, end
    out.place[n] = out.place[n - 1] + out.end[n - 1] - out.begin[n - 1]
    return n + 1


@inner
def _kind(store: Store, roads: Roads, a: int, s: float, b: int, t: float, moved: float, back: float) -> Any:
    """How one step goes, as the model priced it: along its edge, by a path, by a turn in mid edge."""
    length = roads.length
    by_path = np.inf
    for q in range(store.begin[a], store.begin[a] + store.reached[a]):
        if store.target[q] == b:
            by_path = abs(store.away[q] + length[a] - s + t - moved)
            break
    if a == b and t - s >= -back and abs(t - s - moved) <= by_path:
        return BY_EDGE
    if roads.reverse[a] == b and (by_path == np.inf or abs(abs(length[a] - s - t) - moved) + 1.0 < by_path):
        return BY_TURN
    return BY_PATH


def route_posterior(choice: Choice, near: Candidates, routes: Routes) -> Floats:
    """(G,) posterior of the candidates on the previous, same and following piece of the route."""
    size, piece = np.diff(near.ptr), routes.piece
    on, edge = np.zeros(len(near.edge), np.bool_), np.append(routes.edge, -1)
    for beside in (-1, 0, 1):
        other = np.clip(piece + beside, 0, len(routes.edge))
        apart = (routes.firsts[routes.of] > other) | (routes.firsts[routes.of + 1] <= other)
        on |= near.edge == np.repeat(np.where(apart, -1, edge[other]), size)
    group = np.repeat(np.arange(len(size)), size)[on]
    return np.minimum(np.bincount(group, choice.posterior[np.flatnonzero(on) + group], len(size)), 1.0)


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


@outer
def _astar(graph: Graph, scratch: Scratch, source: int, target: int, most: float) -> Any:
    """How many edges the cheapest chain from ``source`` to ``target`` has, backwards in the last of
    ``scratch``; 0 if none has a cost below ``most`` up to the target.  Among equal costs the predecessor with
    the lower number wins."""
    next_first, next_edges, cost, turn_cost, closed, starts, least = graph
    best, heap_d, came, heap_e, done, chain = scratch
    for j in range(len(best)):
        best[j], came[j], done[j] = np.inf, -1, False
    best[source], heap_d[0], heap_e[0], size = 0.0, 0.0, source, 1
    while size > 0 and heap_d[0] < most and not done[target]:
        i = heap_e[0]
        size = _pop(heap_d, heap_e, size)
        if done[i]:
            continue
        done[i] = True
        onward = best[i] + cost[i]
        for k in range(next_first[i], next_first[i + 1]):
            j, there = next_edges[k], onward + turn_cost[k]
            if not (closed[j] or done[j]) and (there < best[j] or (there == best[j] and i < came[j])):
                best[j], came[j] = there, i
                x, y = starts[j, 0] - starts[target, 0], starts[j, 1] - starts[target, 1]
                z = starts[j, 2] - starts[target, 2]
                size = _push(heap_d, heap_e, size, there + least * np.sqrt(x * x + y * y + z * z), j)
    n, at = 0, target if done[target] else -1
    while at >= 0:
        chain[n], at, n = at, came[at], n + 1
    return n


def quickest(
    graph: Graph, starts: Index, at: Floats, before: Floats, ends: Index, ends_at: Floats, after: Floats,
    most: float,
) -> tuple[int, int, Index, float]:  # fmt: skip
    """The cheapest way from an offset ``at`` [m] of one of ``starts`` to offset ``ends_at`` of one of
    ``ends``: numbers of both, edges, cost; -1 if none costs less than ``most``.  ``before`` and ``after`` are
    what start and end add to the cost of all edges, both ends whole.

    The ``graph`` has ``next_first`` and ``next_edges``, the cost of driving all of an edge, that of the turn
    next_edges[k], closed edges, starts (E, 3), and cost per metre: times the straight line never more than
    the cost from start to start (consistent: the first arrival is the best)."""
    next_first, next_edges, cost = graph[:3]
    start, end, way, size, room = -1, -1, np.empty(0, np.int32), len(cost), len(next_edges) + 1
    columns = np.empty(size), np.empty(room), np.empty(size, np.int32), np.empty(room, np.int32)
    scratch = *columns, np.empty(size, np.bool_), (chain := np.empty(size, np.int32))
    for i, a in enumerate(starts.tolist()):
        for j, z in enumerate(ends.tolist()):
            # Round the block where the end lies behind.
            behind = a == z and ends_at[j] <= at[i] + AHEAD
            over = before[i] + after[j] + cost[z] + (cost[a] if behind else 0.0)
            for first in next_edges[next_first[a] : next_first[a + 1]].tolist() if behind else [a]:
                if count := _astar(graph, scratch, first, z, most - over):
                    start, end, most = i, j, float(scratch[0][z] + over)
                    way = np.append(starts[i : i + behind], chain[:count][::-1])
    return start, end, way, most

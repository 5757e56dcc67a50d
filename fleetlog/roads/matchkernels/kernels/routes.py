"""From chosen candidates to routes: connected stretches of directed edges with one path coordinate."""

from __future__ import annotations

import numpy as np
from numba import njit

from fleetlog.roads.matchkernels.kernels.distances import ensure, path_between


@njit(cache=True)
def build_routes(store, chosen, linked, edge, value, moved, reverse, next_first, next_edges, length, back):
    """Pieces of all stretches, end to end.

    Returns (P,) edge, from, to (offsets on it) and coordinate of its begin; (S + 1,) first piece and first and last group
    of every stretch; (G,) stretch, piece and path coordinate of every group (-1 off the roads).
    """
    groups = len(chosen)
    capacity = 2 * groups + 64
    p_edge = np.empty(capacity, np.int32)
    p_value = np.empty((3, capacity))
    firsts = np.empty(groups + 1, np.int64)
    spans = np.empty((2, groups + 1), np.int64)
    of = np.full(groups, -1, np.int64)
    piece = np.full(groups, -1, np.int64)
    place = np.zeros(groups)
    path = np.empty(4096, np.int32)
    n = stretches = 0
    for g in range(groups):
        if chosen[g] < 0:
            continue
        e, s = edge[chosen[g]], value[0, chosen[g]]
        if n + len(path) + 8 > capacity:
            capacity = 2 * capacity + len(path)
            p_edge = np.concatenate((p_edge, np.empty(capacity - len(p_edge), np.int32)))
            grown = np.empty((3, capacity))
            grown[:, :n] = p_value[:, :n]
            p_value = grown
        fresh = not linked[g] or g == 0 or chosen[g - 1] < 0
        if not fresh:
            last, at = p_edge[n - 1], value[0, chosen[g - 1]]
            need = 20.0 + 4.0 * moved[g - 1]
            kind = _kind(store, last, at, e, s, moved[g - 1], reverse, length, back)
            if kind == 2:  # a turn in mid edge
                turned = max(at, length[e] - s, p_value[0, n - 1])
                p_value[1, n - 1] = turned
                n = _append(p_edge, p_value, n, e, length[e] - turned, length[e])
            elif kind == 1:
                store = ensure(store, last, need, next_first, next_edges, length)
                m = path_between(store, last, e, path)
                if m < 0:
                    fresh = True
                else:
                    for i in range(m):
                        n = _append(p_edge, p_value, n, path[i], 0.0, length[path[i]])
                    n = _append(p_edge, p_value, n, e, 0.0, length[e])
        if fresh:
            firsts[stretches] = n
            spans[0, stretches] = g
            stretches += 1
            p_edge[n], p_value[0, n], p_value[1, n], p_value[2, n] = e, 0.0, length[e], 0.0
            n += 1
        of[g] = stretches - 1
        spans[1, stretches - 1] = g
        piece[g] = n - 1
        place[g] = p_value[2, n - 1] + s - p_value[0, n - 1]
    firsts[stretches] = n
    return (
        store, p_edge[:n].copy(), p_value[:, :n].copy(), firsts[: stretches + 1].copy(),
        spans[:, :stretches].copy(), of, piece, place,
    )  # fmt: skip


@njit(cache=True)
def _append(p_edge, p_value, n, e, begin, end):
    p_edge[n], p_value[0, n], p_value[1, n] = e, begin, end
    p_value[2, n] = p_value[2, n - 1] + p_value[1, n - 1] - p_value[0, n - 1]
    return n + 1


@njit(cache=True)
def _kind(store, a, s, b, t, moved, reverse, length, back):
    """How one step goes, as the model priced it: 0 along the same edge, 1 by a path, 2 by a turn in mid edge."""
    by_path = np.inf
    for q in range(store[1][a], store[1][a] + store[2][a]):
        if store[3][q] == b:
            by_path = abs(store[5][q] + length[a] - s + t - moved)
            break
    if a == b and t - s >= -back and abs(t - s - moved) <= by_path:
        return 0
    if reverse[a] == b and (by_path == np.inf or abs(abs(length[a] - s - t) - moved) + 1.0 < by_path):
        return 2
    return 1

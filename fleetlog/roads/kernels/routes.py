"""From chosen candidates to routes: connected stretches of directed edges with one path coordinate."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from fleetlog.roads.kernels.distances import path_between
from fleetlog.roads.kernels.growing import longer, wider
from fleetlog.roads.kernels.records import Candidates, Choice, Floats, Index, Roads, Routes, Store


@njit(cache=True)
def build_routes(
    store: Store, roads: Roads, near: Candidates, choice: Choice, moved: Floats, back: float
) -> Routes:
    """Pieces of all stretches, end to end."""
    chosen, linked, edge, value, length = choice.chosen, choice.linked, near.edge, near.value, roads.length
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
            p_edge, p_value = longer(p_edge, capacity), wider(p_value, capacity)
        fresh = not linked[g] or g == 0 or chosen[g - 1] < 0
        if not fresh:
            last, at = p_edge[n - 1], value[0, chosen[g - 1]]
            kind = _kind(store, roads, last, at, e, s, moved[g - 1], back)
            if kind == 2:  # a turn in mid edge
                turned = max(at, length[e] - s, p_value[0, n - 1])
                p_value[1, n - 1] = turned
                n = _append(p_edge, p_value, n, e, length[e] - turned, length[e])
            elif kind == 1:
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
    edges, values = p_edge[:n].copy(), p_value[:, :n].copy()
    return Routes(
        edges, values, firsts[: stretches + 1].copy(), spans[:, :stretches].copy(), of, piece, place
    )


@njit(cache=True)
def _append(p_edge: Index, p_value: Floats, n: int, e: int, begin: float, end: float) -> Any:
    p_edge[n], p_value[0, n], p_value[1, n] = e, begin, end
    p_value[2, n] = p_value[2, n - 1] + p_value[1, n - 1] - p_value[0, n - 1]
    return n + 1


@njit(cache=True)
def _kind(store: Store, roads: Roads, a: int, s: float, b: int, t: float, moved: float, back: float) -> Any:
    """How one step goes, as the model priced it: 0 along its edge, 1 by a path, 2 by a turn in mid edge."""
    length = roads.length
    by_path = np.inf
    for q in range(store.begin[a], store.begin[a] + store.reached[a]):
        if store.target[q] == b:
            by_path = abs(store.away[q] + length[a] - s + t - moved)
            break
    if a == b and t - s >= -back and abs(t - s - moved) <= by_path:
        return 0
    if roads.reverse[a] == b and (by_path == np.inf or abs(abs(length[a] - s - t) - moved) + 1.0 < by_path):
        return 2
    return 1

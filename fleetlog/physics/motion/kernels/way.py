"""Loops along matched edges, and over rows: standstills, dead bands; imported only where they run."""

import math

import numpy as np

from fleetlog.compiling import inner, outer
from fleetlog.core.arrays import Floats, Index, Mask
from fleetlog.physics.motion.kernels.filter import BREAK, JUMP, ON
from fleetlog.physics.motion.rows import Codes

MOST_EXTRA = 8.0  # By which a way may exceed twice the distance of the positions [m]: noise, and corners
NEAR_REACH = 3  # Edges between two rows at most; farther apart the coordinate starts anew


@inner
def way_between(a: int, b: int, next_first: Index, next_edges: Index, length: Floats, between: Index) -> int:
    """How many edges lie on the shortest way from the end of edge a to the start of b, fewer than
    ``NEAR_REACH``, -1 where there is no such way; they are written into ``between``."""
    best, count = np.inf, -1
    for i in range(next_first[a], next_first[a + 1]):
        e = next_edges[i]
        if e == b:
            best, count = 0.0, 0
        for j in range(next_first[e], next_first[e + 1]):
            f = next_edges[j]
            if f == b and length[e] < best:
                best, count = length[e], 1
                between[0] = e
            for k in range(next_first[f], next_first[f + 1]):
                g = next_edges[k]
                if g == b and length[e] + length[f] < best:
                    best, count = length[e] + length[f], 2
                    between[0], between[1] = e, f
    return count


@outer
def path_coordinate(
    edge: Index, offset: Floats, x: Floats, y: Floats, step: Floats, next_first: Index, next_edges: Index,
    length: Floats, reverse: Index, back: float, link: Codes, place: Floats, between: Index, v_edge: Index,
    v_origin: Floats, v_length: Floats, v_joined: Mask,
) -> int:  # fmt: skip
    """Map coordinate of every row into ``place``; how many visits of edges there are.

    Of each visit the edge, the coordinate of its start, its length, and whether it joins the last.  Off the
    map (edge -1) the coordinate grows by ``step``.  Where no short way joins two rows (a way much longer
    than the positions are apart is not the one that was driven), ``link`` is marked ``JUMP`` and the
    coordinate goes on behind all before.  ``between`` (NEAR_REACH,) is for the search."""
    v_edge[0], v_origin[0] = edge[0], 0.0
    v_length[0] = length[edge[0]] if edge[0] >= 0 else 0.0
    place[0] = offset[0] if edge[0] >= 0 else 0.0
    k = 0
    for i in range(1, len(edge)):
        a, b = edge[i - 1], edge[i]
        if a < 0 and b < 0:
            place[i] = place[i - 1] + step[i]
            v_length[k] = place[i] - v_origin[k]
            continue
        most_way = 2.0 * math.hypot(x[i] - x[i - 1], y[i] - y[i - 1]) + MOST_EXTRA
        if a == b and -back <= offset[i] - offset[i - 1] <= most_way:
            place[i] = v_origin[k] + offset[i]
            continue
        m = -1
        if a >= 0 and b >= 0 and a != b and reverse[a] != b:
            m = way_between(a, b, next_first, next_edges, length, between)
            way = length[a] - offset[i - 1] + offset[i]
            for j in range(m):
                way += length[between[j]]
            if way > most_way:
                m = -1
        for j in range(max(m, 0) + 1):
            v_origin[k + 1] = v_origin[k] + v_length[k]
            k += 1
            v_edge[k] = between[j] if j < m else b
            v_length[k] = length[v_edge[k]] if v_edge[k] >= 0 else 0.0
            v_joined[k] = m >= 0
        place[i] = v_origin[k] + (offset[i] if b >= 0 else 0.0)
        if m < 0 and link[i] == ON:
            link[i] = JUMP
    return k + 1


@outer
def stays(t: Floats, x: Floats, y: Floats, link: Codes, radius: float, shortest: float, out: Mask) -> None:
    """Mark rows of a standstill: runs within ``radius`` of their running mean for ``shortest``."""
    n = len(t)
    i = 0
    while i < n:
        sx, sy, m = x[i], y[i], 1
        j = i + 1
        while j < n and link[j] != BREAK and math.hypot(x[j] - sx / m, y[j] - sy / m) <= radius:
            sx += x[j]
            sy += y[j]
            m += 1
            j += 1
        if j - i > 2 and t[j - 1] - t[i] >= shortest:
            # the ends of the run may still move: they are within the radius too
            margin = max((j - i) // 20, 1)
            for k in range(i + margin, j - margin):
                out[k] = True
            i = j
        else:
            i += max((j - i) // 8, 1)


@outer
def on_edges(
    edge: Index, offset: Floats, x: Floats, y: Floats, points: Floats, first: Index, distance: Floats,
    out: Floats,
) -> None:  # fmt: skip
    """Heading and slope of the edge [rad] at N places on it, how far (x, y) lie ahead of them [m], into
    ``out`` (3, N); nothing where off the map (edge -1)."""
    last, k = -1, 0
    for i in range(len(edge)):
        e = edge[i]
        if e < 0:
            continue
        top = first[e + 1] - 2
        if e != last or offset[i] < distance[k]:
            last, k = e, first[e]
        while k < top and distance[k + 1] <= offset[i]:
            k += 1
        dx, dy = points[k + 1, 0] - points[k, 0], points[k + 1, 1] - points[k, 1]
        flat = math.hypot(dx, dy)
        run = distance[k + 1] - distance[k]
        share = min(max((offset[i] - distance[k]) / run, 0.0), 1.0) if run > 0.0 else 0.0
        out[0, i] = math.atan2(dy, dx)
        out[1, i] = math.atan2(points[k + 1, 2] - points[k, 2], max(flat, 1e-9))
        if flat > 0.0:
            off_x, off_y = x[i] - points[k, 0] - share * dx, y[i] - points[k, 1] - share * dy
            out[2, i] = (off_x * dx + off_y * dy) / flat


@outer
def dead_band(value: Floats, band: float) -> None:
    """Take the jitter out of ``value``: followed only where it leaves a band of half-width ``band``."""
    for i in range(1, len(value)):
        value[i] = min(max(value[i - 1], value[i] - band), value[i] + band)

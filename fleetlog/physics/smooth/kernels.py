"""The compiled smoother and the loops about it; imported only where they run.

State (s, v, a): path coordinate [m], speed [m/s], acceleration [m/s2] under white jerk of density q [m2/s5].  Over a step
h the state moves by F = [[1, h, h2/2], [0, 1, h], [0, 0, 1]] and gains Q = q [[h5/20, h4/8, h3/6], [., h3/3, h2/2], [., ., h]]
(Bar-Shalom, Li and Kirubarajan 2001, Estimation with Applications to Tracking and Navigation, section 6.2.3).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Codes = NDArray[np.uint8]
Index = NDArray[np.int32]

ON, JUMP, BREAK = 0, 1, 2
"""How a row follows the one before: on the same coordinate; on a new one, at the same speed; after a gap."""
START_SPEED_VAR, START_ACCEL_VAR = 400.0, 1.0
NEW_COORDINATE_VAR = 1e4
REST_SPEED_VAR, REST_ACCEL_VAR = 4e-4, 2.5e-3


@njit(cache=True)
def filter_forward(
    t: Floats, seen: Floats, seen_var: float, speed: Floats, speed_var: float, rest: Flags, link: Codes, q: float,
    mean: Floats, cov: Floats,
) -> float:  # fmt: skip
    """Kalman filter; writes filtered means (N, 3) and covariances (N, 6: ss, sv, sa, vv, va, aa), returns the log likelihood.

    ``seen`` and ``speed`` are NaN where not measured.  At ``rest`` speed and acceleration are observed to be zero.  With
    (1, 3) and (1, 6) arrays nothing is kept but the likelihood.
    """
    n = len(t)
    keep = len(mean) == n
    total = 0.0
    s = v = a = ss = sv = sa = vv = va = aa = 0.0
    for i in range(n):
        if link[i] == BREAK or i == 0:
            s, v, a = 0.0 if math.isnan(seen[i]) else seen[i], 0.0, 0.0
            ss, sv, sa, vv, va, aa = NEW_COORDINATE_VAR, 0.0, 0.0, START_SPEED_VAR, 0.0, START_ACCEL_VAR
        else:
            h = t[i] - t[i - 1]
            h2 = 0.5 * h * h
            ss += 2.0 * (h * sv + h2 * sa) + h * h * vv + 2.0 * h * h2 * va + h2 * h2 * aa
            sv += h * vv + h2 * va + h * sa + h * h * va + h * h2 * aa
            sa += h * va + h2 * aa
            vv += 2.0 * h * va + h * h * aa
            va += h * aa
            h3 = h * h * h
            ss += q * h3 * h * h / 20.0
            sv += q * h3 * h / 8.0
            sa += q * h3 / 6.0
            vv += q * h3 / 3.0
            va += q * h2
            aa += q * h
            s += h * v + h2 * a
            v += h * a
            if link[i] == JUMP:
                s = s if math.isnan(seen[i]) else seen[i]
                ss, sv, sa = NEW_COORDINATE_VAR, 0.0, 0.0
        fresh = link[i] != ON or i == 0
        if not math.isnan(seen[i]):
            r = seen[i] - s
            c = ss + seen_var
            if not fresh:
                total -= 0.5 * (math.log(c) + r * r / c)
            ks, kv, ka = ss / c, sv / c, sa / c
            s += ks * r
            v += kv * r
            a += ka * r
            aa -= ka * sa
            va -= kv * sa
            vv -= kv * sv
            sa -= ks * sa
            sv -= ks * sv
            ss -= ks * ss
        for kind in range(3):
            if kind == 0:
                if math.isnan(speed[i]) or rest[i]:
                    continue
                r, var = speed[i] - v, speed_var
            elif not rest[i]:
                break
            elif kind == 1:
                r, var = -v, REST_SPEED_VAR
            else:
                c = aa + REST_ACCEL_VAR
                ks, kv, ka = sa / c, va / c, aa / c
                s -= ks * a
                v -= kv * a
                a -= ka * a
                ss -= ks * sa
                sv -= ks * va
                vv -= kv * va
                sa -= ks * aa
                va -= kv * aa
                aa -= ka * aa
                break
            c = vv + var
            if kind == 0 and link[i] != BREAK and i > 0:
                total -= 0.5 * (math.log(c) + r * r / c)
            ks, kv, ka = sv / c, vv / c, va / c
            s += ks * r
            v += kv * r
            a += ka * r
            ss -= ks * sv
            sa -= ks * va
            aa -= ka * va
            va -= kv * va
            sv -= ks * vv
            vv -= kv * vv
        if keep:
            mean[i, 0], mean[i, 1], mean[i, 2] = s, v, a
            cov[i, 0], cov[i, 1], cov[i, 2], cov[i, 3], cov[i, 4], cov[i, 5] = ss, sv, sa, vv, va, aa
    return total


@njit(cache=True, fastmath={"contract", "reassoc", "nsz"})
def smooth_backward(t: Floats, link: Codes, q: float, mean: Floats, cov: Floats) -> None:
    """Rauch, Tung and Striebel's backward pass: filtered means and covariances become smoothed ones, in place."""
    for i in range(len(t) - 2, -1, -1):
        if link[i + 1] == BREAK:
            continue
        h = t[i + 1] - t[i]
        h2, h3 = 0.5 * h * h, h * h * h
        ss, sv, sa, vv, va, aa = cov[i, 0], cov[i, 1], cov[i, 2], cov[i, 3], cov[i, 4], cov[i, 5]
        # columns of P F': covariance of the state now with the coordinate, speed and acceleration to come
        a0, a1, a2 = ss + h * sv + h2 * sa, sv + h * vv + h2 * va, sa + h * va + h2 * aa
        b0, b1, b2 = sv + h * sa, vv + h * va, va + h * aa
        c0, c1, c2 = sa, va, aa
        p00 = a0 + h * a1 + h2 * a2 + q * h3 * h * h / 20.0
        p01 = a1 + h * a2 + q * h3 * h / 8.0
        p02 = a2 + q * h3 / 6.0
        p11 = b1 + h * b2 + q * h3 / 3.0
        p12 = b2 + q * h2
        p22 = c2 + q * h
        m0, m1, m2 = mean[i, 0] + h * mean[i, 1] + h2 * mean[i, 2], mean[i, 1] + h * mean[i, 2], mean[i, 2]
        if link[i + 1] == JUMP:
            a0 = a1 = a2 = p01 = p02 = 0.0
            p00 = NEW_COORDINATE_VAR
            m0 = mean[i + 1, 0]
        # inverse of the predicted covariance by cofactors
        i00, i01, i02 = p11 * p22 - p12 * p12, p02 * p12 - p01 * p22, p01 * p12 - p02 * p11
        i11, i12, i22 = p00 * p22 - p02 * p02, p01 * p02 - p00 * p12, p00 * p11 - p01 * p01
        one = 1.0 / (p00 * i00 + p01 * i01 + p02 * i02)
        g00, g01, g02 = (
            (a0 * i00 + b0 * i01 + c0 * i02) * one,
            (a0 * i01 + b0 * i11 + c0 * i12) * one,
            (a0 * i02 + b0 * i12 + c0 * i22) * one,
        )
        g10, g11, g12 = (
            (a1 * i00 + b1 * i01 + c1 * i02) * one,
            (a1 * i01 + b1 * i11 + c1 * i12) * one,
            (a1 * i02 + b1 * i12 + c1 * i22) * one,
        )
        g20, g21, g22 = (
            (a2 * i00 + b2 * i01 + c2 * i02) * one,
            (a2 * i01 + b2 * i11 + c2 * i12) * one,
            (a2 * i02 + b2 * i12 + c2 * i22) * one,
        )
        r0, r1, r2 = mean[i + 1, 0] - m0, mean[i + 1, 1] - m1, mean[i + 1, 2] - m2
        mean[i, 0] += g00 * r0 + g01 * r1 + g02 * r2
        mean[i, 1] += g10 * r0 + g11 * r1 + g12 * r2
        mean[i, 2] += g20 * r0 + g21 * r1 + g22 * r2
        d00, d01, d02 = cov[i + 1, 0] - p00, cov[i + 1, 1] - p01, cov[i + 1, 2] - p02
        d11, d12, d22 = cov[i + 1, 3] - p11, cov[i + 1, 4] - p12, cov[i + 1, 5] - p22
        e00, e01, e02 = (
            g00 * d00 + g01 * d01 + g02 * d02,
            g00 * d01 + g01 * d11 + g02 * d12,
            g00 * d02 + g01 * d12 + g02 * d22,
        )
        e10, e11, e12 = (
            g10 * d00 + g11 * d01 + g12 * d02,
            g10 * d01 + g11 * d11 + g12 * d12,
            g10 * d02 + g11 * d12 + g12 * d22,
        )
        e20, e21, e22 = (
            g20 * d00 + g21 * d01 + g22 * d02,
            g20 * d01 + g21 * d11 + g22 * d12,
            g20 * d02 + g21 * d12 + g22 * d22,
        )
        cov[i, 0] = ss + e00 * g00 + e01 * g01 + e02 * g02
        cov[i, 1] = sv + e00 * g10 + e01 * g11 + e02 * g12
        cov[i, 2] = sa + e00 * g20 + e01 * g21 + e02 * g22
        cov[i, 3] = vv + e10 * g10 + e11 * g11 + e12 * g12
        cov[i, 4] = va + e10 * g20 + e11 * g21 + e12 * g22
        cov[i, 5] = aa + e20 * g20 + e21 * g21 + e22 * g22


MOST_EXTRA = 8.0
"""Length that a way may exceed twice the distance of the positions by [m]: noise, and corners."""
NEAR_REACH = 3
"""Edges between two rows at most that the walk below finds; farther apart the coordinate starts anew."""


@njit(cache=True)
def way_between(
    a: int,
    b: int,
    next_first: NDArray[np.int32],
    next_edges: NDArray[np.int32],
    length: Floats,
    between: NDArray[np.int32],
) -> int:
    """The shortest way from the end of edge a to the start of b over at most ``NEAR_REACH`` edges, into ``between``.

    Returns how many edges lie between, -1 where there is no such way.
    """
    best, count = np.inf, -1
    for i in range(next_first[a], next_first[a + 1]):
        e = next_edges[i]
        if e == b:
            return 0
    for i in range(next_first[a], next_first[a + 1]):
        e = next_edges[i]
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


@njit(cache=True)
def path_coordinate(
    edge: Index, offset: Floats, x: Floats, y: Floats, next_first: Index, next_edges: Index, length: Floats, reverse: Index,
    back: float, link: Codes, coordinate: Floats,
) -> None:  # fmt: skip
    """Way travelled along the matched edges into ``coordinate``; marks ``JUMP`` in ``link`` where no short way joins two rows.

    A way much longer than the positions are apart is not the one that was driven.
    """
    between = np.empty(NEAR_REACH, np.int32)
    coordinate[0] = 0.0
    for i in range(1, len(edge)):
        a, b = edge[i - 1], edge[i]
        step = np.nan
        if a >= 0 and b >= 0:
            if a == b and offset[i] - offset[i - 1] >= -back:
                step = offset[i] - offset[i - 1]
            elif reverse[a] == b:
                step = abs(length[a] - offset[i - 1] - offset[i])
            else:
                m = way_between(a, b, next_first, next_edges, length, between)
                if m >= 0:
                    step = length[a] - offset[i - 1] + offset[i]
                    for j in range(m):
                        step += length[between[j]]
        if not step <= 2.0 * math.hypot(x[i] - x[i - 1], y[i] - y[i - 1]) + MOST_EXTRA:
            step = 0.0
            if link[i] == ON:
                link[i] = JUMP
        coordinate[i] = coordinate[i - 1] + step


@njit(cache=True)
def stays(t: Floats, x: Floats, y: Floats, link: Codes, radius: float, min_duration: float) -> Flags:
    """Rows of a standstill: runs within ``radius`` of their running mean for ``min_duration``."""
    n = len(t)
    out = np.zeros(n, np.bool_)
    i = 0
    while i < n:
        sx, sy, m = x[i], y[i], 1
        j = i + 1
        while j < n and link[j] != BREAK and math.hypot(x[j] - sx / m, y[j] - sy / m) <= radius:
            sx += x[j]
            sy += y[j]
            m += 1
            j += 1
        if j - i > 2 and t[j - 1] - t[i] >= min_duration:
            # the ends of the run may still move: they are within the radius too
            margin = max((j - i) // 20, 1)
            out[i + margin : j - margin] = True
            i = j
        else:
            i += max((j - i) // 8, 1)
    return out

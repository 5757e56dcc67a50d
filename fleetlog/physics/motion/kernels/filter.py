"""The compiled smoother and the loops about it; imported only where they run.

State (s, v, a): path coordinate [m], speed [m/s], acceleration [m/s2].  The acceleration dies away while
white jerk of density q [m2/s5] drives it (R. A. Singer, Estimating optimal tracking filter performance for
manned maneuvering targets, IEEE Trans. Aerospace and Electronic Systems 6 (1970) 473)."""

import math

import numpy as np
from numpy.typing import NDArray

from fleetlog.compiling import inner, outer, sum_inner, sum_outer
from fleetlog.core.arrays import Floats, Ints, Mask
from fleetlog.physics.motion.rows import Codes

Singles = NDArray[np.float32]
State = tuple[float, float, float]  # Of way, speed and acceleration
Covariance = tuple[float, float, float, float, float, float]  # ss, sv, sa, vv, va, aa

ON, JUMP, BREAK = 0, 1, 2
"""How a row follows the one before: on the same coordinate; on a new one, at the same speed; after a gap."""
BLOCK = 1.0  # The jerk of a truck is as strong as it is for about this long [s]
FREEDOM = 1.0  # Of its strength: nearly none in a cruise, a hundred times the usual where braking begins
START_SPEED_VAR, START_ACCEL_VAR = 400.0, 1.0
NEW_COORDINATE_VAR = 1e4
REST_SPEED_VAR, REST_ACCEL_VAR = 4e-4, 2.5e-3


@inner
def transition(h: float, q: float, decay: float) -> tuple[State, Covariance]:
    """How acceleration acts on way, speed and itself over a step ``h``, and what covariance is added.

    Acceleration decays at ``decay`` [1/s] under white jerk of density ``q``.  For short steps the limit, in
    which nothing cancels (Bar-Shalom, Li and Kirubarajan 2001, Estimation with Applications to Tracking and
    Navigation, sections 6.2.3 and 8.2.3)."""
    x = decay * h
    if x < 0.02:
        h2, h3, r = 0.5 * h * h, q * h * h * h, 1.0 - x
        move = h2 * (1.0 - x / 3.0), h * (1.0 - 0.5 * x), r
        return move, (h3 * h * h / 20.0, h3 * h / 8.0, h3 / 6.0, h3 / 3.0, q * h2, q * h * r)
    e = math.exp(-x)
    e2, c = e * e, 0.5 * q / decay
    return ((x - 1.0 + e) / decay**2, (1.0 - e) / decay, e), (
        c * (1.0 - e2 + 2.0 * x + x * x * (2.0 * x / 3.0 - 2.0) - 4.0 * x * e) / decay**4,
        c * (e2 + 1.0 - 2.0 * e + 2.0 * x * e - 2.0 * x + x * x) / decay**3,
        c * (1.0 - e2 - 2.0 * x * e) / decay**2,
        c * (4.0 * e - 3.0 - e2 + 2.0 * x) / decay**2, c * (e2 + 1.0 - 2.0 * e) / decay, c * (1.0 - e2),
    )  # fmt: skip


@inner
def corrected(x: State, p: Covariance, row: State, r: float, c: float) -> tuple[State, Covariance]:
    """State and covariance after an innovation ``r`` of variance ``c`` in the state whose row is given."""
    s, v, a = row
    ks, kv, ka = s / c, v / c, a / c
    return (x[0] + ks * r, x[1] + kv * r, x[2] + ka * r), (
        p[0] - ks * s, p[1] - ks * v, p[2] - ks * a, p[3] - kv * v, p[4] - kv * a, p[5] - ka * a,
    )  # fmt: skip


@outer
def filter_forward(
    t: Floats, seen: Floats, seen_var: float, speed: Floats, speed_var: float, rest: Mask, link: Codes,
    jerk: Floats, decay: float, mean: Floats, cov: Floats,
) -> float:  # fmt: skip
    """Kalman filter: the log likelihood of the innovations. Writes filtered means (N, 3) and covariances
    (N, 6); empty arrays keep nothing. ``seen`` and ``speed`` are NaN where not measured. At ``rest`` speed
    and acceleration are observed to be zero. ``jerk`` is its density in the step to each row."""
    keep = len(mean) == len(t)
    total, last, lastq = 0.0, -1.0, -1.0
    for i in range(len(t)):
        first = link[i] == BREAK or i == 0
        if first:
            x = (0.0 if math.isnan(seen[i]) else seen[i], 0.0, 0.0)
            p = (NEW_COORDINATE_VAR, 0.0, 0.0, START_SPEED_VAR, 0.0, START_ACCEL_VAR)
        else:
            h, q = t[i] - t[i - 1], jerk[i]
            if h != last or q != lastq:
                (fs, fv, fa), added = transition(h, q, decay)
                last, lastq = h, q
            (s, v, a), (ss, sv, sa, vv, va, aa) = x, p
            moved, gone = h * v + fs * a, sa + h * va + fs * aa
            x = (s + moved, v + fv * a, a * fa)
            p = (
                ss + (2.0 * (h * sv + fs * sa) + h * h * vv + 2.0 * h * fs * va + fs * fs * aa + added[0]),
                sv + (h * vv + fs * va + fv * gone + added[1]), fa * gone + added[2],
                vv + (2.0 * fv * va + fv * fv * aa + added[3]), fa * (va + fv * aa) + added[4],
                fa * fa * aa + added[5],
            )  # fmt: skip
            if link[i] == JUMP:
                x = (x[0] if math.isnan(seen[i]) else seen[i], x[1], x[2])
                p = (NEW_COORDINATE_VAR, 0.0, 0.0, p[3], p[4], p[5])
        if not math.isnan(seen[i]):
            r, c = seen[i] - x[0], p[0] + seen_var
            if link[i] == ON and not first:
                total -= 0.5 * (math.log(c) + r * r / c)
            x, p = corrected(x, p, (p[0], p[1], p[2]), r, c)
        if rest[i]:
            x, p = corrected(x, p, (p[1], p[3], p[4]), -x[1], p[3] + REST_SPEED_VAR)
            x, p = corrected(x, p, (p[2], p[4], p[5]), -x[2], p[5] + REST_ACCEL_VAR)
        elif not math.isnan(speed[i]):
            r, c = speed[i] - x[1], p[3] + speed_var
            if not first:
                total -= 0.5 * (math.log(c) + r * r / c)
            x, p = corrected(x, p, (p[1], p[3], p[4]), r, c)
        if keep:
            mean[i, 0], mean[i, 1], mean[i, 2] = x
            cov[i, 0], cov[i, 1], cov[i, 2], cov[i, 3], cov[i, 4], cov[i, 5] = p
    return total


@sum_inner
def times(row: State, m: Covariance) -> State:
    """A row by a symmetric matrix."""
    a, b, c = row
    return a * m[0] + b * m[1] + c * m[2], a * m[1] + b * m[3] + c * m[4], a * m[2] + b * m[4] + c * m[5]


@sum_outer
def smooth_backward(
    t: Floats, link: Codes, jerk: Floats, decay: float, mean: Floats, cov: Floats, gain: Singles
) -> None:
    """Rauch, Tung and Striebel's backward pass: filtered means and covariances become smoothed ones, in
    place.  ``gain`` (N, 9) takes the gains."""
    last = lastq = -1.0
    for i in range(len(t) - 2, -1, -1):
        if link[i + 1] == BREAK:
            for j in range(9):
                gain[i, j] = 0.0
            continue
        h, q = t[i + 1] - t[i], jerk[i + 1]
        if h != last or q != lastq:
            (fs, fv, fa), (q0, q1, q2, q3, q4, q5) = transition(h, q, decay)
            last, lastq = h, q
        ss, sv, sa, vv, va, aa = cov[i, 0], cov[i, 1], cov[i, 2], cov[i, 3], cov[i, 4], cov[i, 5]
        # columns of P F': covariance of the state now with the coordinate, speed and acceleration to come
        a0, a1, a2 = ss + h * sv + fs * sa, sv + fv * sa, fa * sa
        b0, b1, b2 = sv + h * vv + fs * va, vv + fv * va, fa * va
        c0, c1, c2 = sa + h * va + fs * aa, va + fv * aa, fa * aa
        p00, p01, p02 = a0 + h * b0 + fs * c0 + q0, a1 + h * b1 + fs * c1 + q1, a2 + h * b2 + fs * c2 + q2
        p11, p12, p22 = b1 + fv * c1 + q3, b2 + fv * c2 + q4, fa * c2 + q5
        m0 = mean[i, 0] + h * mean[i, 1] + fs * mean[i, 2]
        m1, m2 = mean[i, 1] + fv * mean[i, 2], fa * mean[i, 2]
        if link[i + 1] == JUMP:
            a0 = b0 = c0 = p01 = p02 = 0.0
            p00 = NEW_COORDINATE_VAR
            m0 = mean[i + 1, 0]
        # inverse of the predicted covariance by cofactors
        i00, i01, i02 = p11 * p22 - p12 * p12, p02 * p12 - p01 * p22, p01 * p12 - p02 * p11
        i11, i12, i22 = p00 * p22 - p02 * p02, p01 * p02 - p00 * p12, p00 * p11 - p01 * p01
        one = 1.0 / (p00 * i00 + p01 * i01 + p02 * i02)
        inverse = (i00, i01, i02, i11, i12, i22)
        g00, g01, g02 = times((a0, a1, a2), inverse)
        g10, g11, g12 = times((b0, b1, b2), inverse)
        g20, g21, g22 = times((c0, c1, c2), inverse)
        g00, g01, g02 = g00 * one, g01 * one, g02 * one
        g10, g11, g12 = g10 * one, g11 * one, g12 * one
        g20, g21, g22 = g20 * one, g21 * one, g22 * one
        r0, r1, r2 = mean[i + 1, 0] - m0, mean[i + 1, 1] - m1, mean[i + 1, 2] - m2
        mean[i, 0] += g00 * r0 + g01 * r1 + g02 * r2
        mean[i, 1] += g10 * r0 + g11 * r1 + g12 * r2
        mean[i, 2] += g20 * r0 + g21 * r1 + g22 * r2
        gain[i, 0], gain[i, 1], gain[i, 2] = g00, g01, g02
        gain[i, 3], gain[i, 4], gain[i, 5] = g10, g11, g12
        gain[i, 6], gain[i, 7], gain[i, 8] = g20, g21, g22
        n = cov[i + 1]
        change = (n[0] - p00, n[1] - p01, n[2] - p02, n[3] - p11, n[4] - p12, n[5] - p22)
        e00, e01, e02 = times((g00, g01, g02), change)
        e10, e11, e12 = times((g10, g11, g12), change)
        e20, e21, e22 = times((g20, g21, g22), change)
        cov[i, 0] = ss + e00 * g00 + e01 * g01 + e02 * g02
        cov[i, 1] = sv + e00 * g10 + e01 * g11 + e02 * g12
        cov[i, 2] = sa + e00 * g20 + e01 * g21 + e02 * g22
        cov[i, 3] = vv + e10 * g10 + e11 * g11 + e12 * g12
        cov[i, 4] = va + e10 * g20 + e11 * g21 + e12 * g22
        cov[i, 5] = aa + e20 * g20 + e21 * g21 + e22 * g22


@outer
def jerk_scales(
    t: Floats, link: Codes, rest: Mask, q: float, decay: float, mean: Floats, cov: Floats, gain: Singles,
    jerk: Floats,
) -> float:  # fmt: skip
    """One step of expectation and maximisation for a jerk of varying strength.

    Its density is q / w, with w random and constant for ``BLOCK`` seconds: Student's t with ``FREEDOM``
    degrees of freedom as a scale mixture of normals (Lange, Little and Taylor 1989), for the changes of
    acceleration given all rows.  Densities into ``jerk``, returns the next q; where the truck stands q holds.
    """
    total, steps = 0.0, 0
    inside, squares, first = 0, 0.0, 1
    for i in range(1, len(t) + 1):
        if i == len(t) or link[i] == BREAK or t[i] - t[first - 1] > BLOCK + 1e-6:
            w = (FREEDOM + inside) / (FREEDOM + squares / q)
            for j in range(first, i):
                jerk[j] = q / w
            total += w * squares
            steps += inside
            inside, squares, first = 0, 0.0, i
        if i < len(t) and link[i] != BREAK and not (rest[i] and rest[i - 1]):
            move, added = transition(t[i] - t[i - 1], 1.0, decay)
            fa, g, now, before = move[2], gain[i - 1], cov[i], cov[i - 1]
            shared = g[6] * now[2] + g[7] * now[4] + g[8] * now[5]
            change = mean[i, 2] - fa * mean[i - 1, 2]
            spread = max(now[5] + fa * fa * before[5] - 2.0 * fa * shared, 0.0)
            squares += (change * change + spread) / added[5]
            inside += 1
    return total / steps if steps else q


@outer
def energy_variance(
    cov: Floats, gain: Singles, by_speed: Floats, by_acceleration: Floats, window: Ints, out: Floats,
) -> None:  # fmt: skip
    """Variance of the sum over each window of ``by_speed`` v + ``by_acceleration`` a, (N,) each.

    Exact: backwards, with c = cov(x_i, sum of the window from i on), which the gains carry on."""
    c0 = c1 = c2 = total = 0.0
    inside = -1
    for i in range(len(window) - 1, -1, -1):
        p, g = cov[i], gain[i]
        if window[i] != inside:
            if inside >= 0:
                out[inside] = total
            inside = window[i]
            c0 = c1 = c2 = total = 0.0
        n0 = g[0] * c0 + g[1] * c1 + g[2] * c2
        n1 = g[3] * c0 + g[4] * c1 + g[5] * c2
        n2 = g[6] * c0 + g[7] * c1 + g[8] * c2
        bv, ba = by_speed[i], by_acceleration[i]
        total += 2.0 * (bv * n1 + ba * n2) + bv * bv * p[3] + 2.0 * bv * ba * p[4] + ba * ba * p[5]
        c0 = n0 + p[1] * bv + p[2] * ba
        c1 = n1 + p[3] * bv + p[4] * ba
        c2 = n2 + p[4] * bv + p[5] * ba
    if inside >= 0:
        out[inside] = total

"""Plane curves: lanes beside a centre line, corners rounded with a radius, even samples."""

import numpy as np

from fleetlog.simulate.arrays import Floats

BOW = 0.1
"""A gentle kink is rounded as widely as it can be while the curve stays this close to the corner [m]."""
FINE = 0.1
"""Length of the chords that stand for a curve [m]."""


def shifted(points: Floats, left: float) -> Floats:
    """The (n, 2) polyline moved ``left`` metres to its left, corners mitred."""
    if left == 0.0:
        return points
    step = np.diff(points, axis=0)
    step = step / np.maximum(np.linalg.norm(step, axis=1), 1e-12)[:, None]
    normal = np.column_stack([-step[:, 1], step[:, 0]])
    at = np.concatenate([normal[:1], normal[:-1] + normal[1:], normal[-1:]])
    size = np.linalg.norm(at, axis=1)
    at = at / np.maximum(size, 1e-9)[:, None]
    mitre = np.concatenate([[1.0], 2.0 / np.maximum(size[1:-1], 1.0), [1.0]])
    return np.asarray(points + left * mitre[:, None] * at)


def simplified(points: Floats) -> Floats:
    """Without vertices that repeat the one before."""
    x, y = points[:, 0], points[:, 1]
    repeats = np.flatnonzero(np.hypot(x[1:] - x[:-1], y[1:] - y[:-1]) <= 1e-6) + 1
    if not len(repeats):
        return points
    kept = np.delete(points, repeats, axis=0)
    return kept if len(kept) >= 2 else points[[0, -1]]


def rounded(points: Floats, radius: float) -> Floats:
    """The (n, 2) polyline, corners rounded with ``radius`` or more as far as the legs are long enough."""
    points = simplified(points)
    if len(points) < 3:
        return points
    out = [points[:1]]
    leg = np.linalg.norm(np.diff(points, axis=0), axis=1)
    for i in range(1, len(points) - 1):
        a, b = (points[i] - points[i - 1]) / leg[i - 1], (points[i + 1] - points[i]) / leg[i]
        turn = np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b)
        if abs(turn) < 1e-4 or abs(turn) > 3.0:
            out.append(points[i : i + 1])
            continue
        half = np.tan(abs(turn) / 2.0)
        reach = max(radius * half, BOW / np.tan(abs(turn) / 4.0))
        out.append(arc(points[i], a, turn, min(reach, 0.499 * leg[i - 1], 0.499 * leg[i])))
    return np.concatenate([*out, points[-1:]])


def arc(corner: Floats, into: Floats, turn: float, reach: float) -> Floats:
    """An arc that turns by ``turn`` [rad] from ``reach`` [m] before ``corner`` on, heading ``into``."""
    radius = reach / np.tan(abs(turn) / 2.0)
    begin = corner - reach * into
    normal = np.array([-into[1], into[0]]) * np.sign(turn)
    centre = begin + radius * normal
    n = max(2, int(np.ceil(radius * abs(turn) / FINE)))
    angle = np.linspace(0.0, turn, n + 1)
    spoke = begin - centre
    c, s = np.cos(angle), np.sin(angle)
    return np.column_stack([centre[0] + c * spoke[0] - s * spoke[1], centre[1] + s * spoke[0] + c * spoke[1]])


def joined(start: Floats, out: float, end: Floats, into: float) -> Floats:
    """Straight, arc, straight from ``start`` heading ``out`` to ``end`` heading ``into``, else a cubic."""
    a, b = np.array([np.cos(out), np.sin(out)]), np.array([np.cos(into), np.sin(into)])
    gap = end - start
    cross = a[0] * b[1] - a[1] * b[0]
    turn = float(np.arctan2(cross, a @ b))
    if abs(turn) < 1e-3 and abs(a[0] * gap[1] - a[1] * gap[0]) < 1e-3 * max(np.hypot(*gap), 1e-9):
        return np.array([start, end])
    if abs(cross) > 1e-6:
        first = (gap[0] * b[1] - gap[1] * b[0]) / cross
        last = (a[0] * gap[1] - a[1] * gap[0]) / cross
        if first > 1e-3 and last > 1e-3 and abs(turn) < 2.6:
            bow = arc(start + first * a, a, turn, min(first, last))
            return np.concatenate([[start], bow, [end]])
    return _cubic(start, a, end, b)


def _cubic(start: Floats, a: Floats, end: Floats, b: Floats) -> Floats:
    handle = max(0.65 * float(np.hypot(*(end - start))), 0.5)
    u = np.linspace(0.0, 1.0, 41)[:, None]
    p1, p2 = start + handle * a, end - handle * b
    return np.asarray((1 - u) ** 3 * start + 3 * u * (1 - u) ** 2 * p1 + 3 * u**2 * (1 - u) * p2 + u**3 * end)


def even(points: Floats, spacing: float) -> tuple[Floats, float]:
    """(n, 4) x, y, heading, curvature evenly, at most ``spacing`` [m] apart, along a polyline; its length."""
    x, y = simplified(points).T
    dx, dy = np.diff(x), np.diff(y)
    along = np.concatenate([[0.0], np.cumsum(np.sqrt(dx * dx + dy * dy))])
    chord = np.arctan2(dy, dx)
    chord[1:] -= 2.0 * np.pi * np.cumsum(np.round(np.diff(chord) / (2.0 * np.pi)))
    length = max(float(along[-1]), 1e-3)
    n = max(2, int(np.ceil(length / spacing)) + 1)
    s = np.arange(n) * (length / (n - 1))
    # A chord's direction is that of the curve at its middle.
    heading = np.interp(s, 0.5 * (along[:-1] + along[1:]), chord)
    curvature = np.gradient(heading, length / (n - 1))
    return np.column_stack([np.interp(s, along, x), np.interp(s, along, y), heading, curvature]), length


def moved(shape: Floats, x: float, y: float, heading: float) -> Floats:
    """(n, 4) x, y, heading, curvature of a curve that begins at the origin along x, begun elsewhere."""
    c, s = np.cos(heading), np.sin(heading)
    along, left, turn, curvature = shape.T
    return np.column_stack([x + c * along - s * left, y + s * along + c * left, turn + heading, curvature])

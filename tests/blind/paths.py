"""Driven paths: corners are arcs a little wider than the turning circle, blurred as steering takes time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d
from sites import Site

STEP = 0.1
"""Between the points of a path [m]."""


@dataclass
class Path:
    """Arrays every ``STEP`` metres: position, way to the next, heading, curvature, road, direction."""

    x: np.ndarray
    y: np.ndarray
    step: np.ndarray
    heading: np.ndarray
    bend: np.ndarray
    road: np.ndarray
    sense: np.ndarray


def path(site: Site, legs: list[tuple[int, int]]) -> Path:
    """Drive along ``legs`` (road, +1 or -1)."""
    xy, leg = _joined(site, legs)
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))]) + np.arange(len(xy)) * 1e-9
    grid = np.arange(0.0, s[-1], STEP)
    x, y = (np.interp(grid, s, xy[:, i]) for i in (0, 1))
    leg = leg[np.clip(np.searchsorted(s, grid), 0, len(s) - 1)]
    road, sense = np.array(legs)[leg].T
    for width in (13, 9):
        x, y = _slide(x, width), _slide(y, width)
    dx, dy = np.gradient(x), np.gradient(y)
    step = np.hypot(dx, dy)
    heading = np.unwrap(np.arctan2(dy, dx))
    bend = _slide(np.gradient(heading) / np.maximum(step, 0.3 * STEP), 9)
    return Path(x, y, step, heading, bend, road, sense)


def _joined(site: Site, legs: list[tuple[int, int]]) -> tuple[np.ndarray, np.ndarray]:
    """Points of the legs with their corners rounded, and the leg of each."""
    lines = [site.line(road, 160)[::sense] for road, sense in legs]
    shortest = min(site.length[road] for road, _ in legs)
    points, which = [lines[0]], [np.zeros(len(lines[0]), int)]
    for k in range(1, len(lines)):
        wider = 0.5 * (legs[k][0] * 0.618 % 1.0)
        before, arc, after = _rounded(points.pop(), lines[k], site.layout.radius + wider, 0.48 * shortest)
        which.pop()
        points += [before, arc, after]
        turned = np.where(np.arange(len(arc)) < len(arc) // 2, k - 1, k)
        which += [np.full(len(before), k - 1), turned, np.full(len(after), k)]
    return np.concatenate(points), np.concatenate(which)


def _rounded(
    a: np.ndarray, b: np.ndarray, radius: float, room: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two lines that meet, with the corner between them an arc that cuts at most ``room`` off each."""
    u, v = a[-1] - a[-6], b[5] - b[0]
    u, v = u / np.hypot(*u), v / np.hypot(*v)
    angle = float(np.arctan2(u[0] * v[1] - u[1] * v[0], u @ v))
    half = np.tan(abs(angle) / 2.0)
    cut = min(radius * half, room)
    if cut < 0.15:
        return a, a[-1:], b
    radius = cut / half
    side = np.sign(angle) * np.array([-u[1], u[0]])
    centre = b[0] - cut * u + radius * side
    turn = np.linspace(0.0, angle, 24)[:, None]
    spoke = -radius * side
    arc = centre + np.cos(turn) * spoke + np.sin(turn) * np.array([-spoke[1], spoke[0]])
    apart_a, apart_b = np.hypot(*(a - a[-1]).T), np.hypot(*(b - b[0]).T)
    return a[apart_a > cut], arc, b[apart_b > cut]


def _slide(values: np.ndarray, width: int) -> np.ndarray:
    return np.asarray(uniform_filter1d(values, width, mode="nearest")) if len(values) > width else values

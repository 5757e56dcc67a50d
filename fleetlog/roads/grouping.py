"""Rows of a track, and the groups that one step of the matching model sees."""

from typing import Any

import numpy as np

from fleetlog.compiling import outer
from fleetlog.core.arrays import Floats, Ints, Mask
from fleetlog.core.trajectory import Trajectory
from fleetlog.roads.kernels.records import Groups, Track, Wide

STANDING_SPEED = 0.1  # a log speed below this is a standstill [m/s]
MOST_ACCELERATION = 15.0  # no vehicle on wheels exceeds it [m/s2]
LONGEST_SPAN = 2.0  # longest motion that one group may hold [s]
LONGEST_STEP = 3.0  # and the farthest [m]: longer ones would cut the corners of aisles
SHORTEST_STEP = 1.0  # dense rows of clean positions are grouped to this much: more tell nothing new [m]


def track_of(trajectory: Trajectory) -> tuple[Track, Ints, Ints]:
    """The rows with a believable position, their indices, and those of rows out of line."""
    t, (x, y) = trajectory.seconds(), (trajectory.floats(name) for name in ("x", "y"))
    rows = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    spike = out_of_line(t[rows], x[rows], y[rows])
    rows, outliers = rows[~spike], rows[spike]
    speed, heading = (trajectory.floats(name)[rows] for name in ("speed", "heading"))
    columns = t[rows], x[rows], y[rows], speed, heading, np.zeros(len(rows), np.int64)
    return Track(*columns, _interval(t[rows])), rows, outliers


def _interval(t: Floats) -> float:
    return float(np.median(np.diff(t))) if len(t) > 1 else 1.0


def with_gap(track: Track, gap: float) -> Track:
    """Numbered anew: a chain ends where the log is silent for longer than ``gap``."""
    return track._replace(chain=np.cumsum(np.diff(track.t, prepend=track.t[:1]) > gap))


def _usual_speed(track: Track, noise: float) -> float:
    """Median speed while moving, from the log or from positions some noise apart [m/s]."""
    known, n, interval = track.speed[track.speed > 0.3], len(track.t), track.interval
    if len(known) > 10:
        return float(np.median(known))
    if n < 3:
        return 1.0
    apart = int(np.clip(round(max(2.0, 6.0 * noise) / interval), 1, max(n // 2, 1)))
    h, dx, dy = (column[apart:] - column[:-apart] for column in track[:3])
    v = np.hypot(dx, dy) / h
    moving = v[v > max(0.3, 2.0 * noise / (apart * interval))]
    return float(np.median(moving)) if len(moving) > 3 else 1.0


def sample(track: Track, groups: int, noise: float) -> Track:
    """About ``groups`` groups' worth of rows in up to eight runs, each a chain of its own."""
    runs, n = 8, len(track.t)
    if (rows := groups * max(1, round(group_span(track, noise) / track.interval))) >= n:
        return track
    starts = np.linspace(0, n - rows // runs, runs).astype(int)
    index = np.concatenate([np.arange(s, s + rows // runs) for s in starts])
    picked = Track._make([*(column[index] for column in track[:6]), _interval(track.t[index])])
    run = np.repeat(np.arange(runs), rows // runs)
    new = (np.diff(picked.chain, prepend=picked.chain[:1]) != 0) | (np.diff(run, prepend=0) != 0)
    return picked._replace(chain=np.cumsum(new))


def out_of_line(t: Floats, x: Floats, y: Floats) -> Mask:
    """(N,) rows that jump aside and back, with impossible accelerations worse than their neighbours'."""
    spike = np.zeros(len(t), np.bool_)
    if len(t) < 8:
        return spike
    h0, h1 = t[1:-1] - t[:-2], t[2:] - t[1:-1]
    share = h0 / (h0 + h1)
    dx, dy = x[2:] - x[:-2], y[2:] - y[:-2]
    aside = np.hypot(x[1:-1] - x[:-2] - share * dx, y[1:-1] - y[:-2] - share * dy)
    usual = float(np.median(aside))
    worst = (aside >= np.append(0.0, aside[:-1])) & (aside >= np.append(aside[1:], 0.0))
    worst &= aside > np.hypot(dx, dy)  # else a neighbour may be the one that is wrong
    spike[1:-1] = worst & (2.0 * aside > MOST_ACCELERATION * h0 * h1) & (aside > 8.0 * usual + 1.0)
    return spike


def white_noise(track: Track) -> float:
    """Spread of the part of the position noise that differs from row to row, per axis [m]. From third
    differences, which steady turning and speeding up hardly reach: their variance is 20 times that of white
    noise. At long intervals motion adds to it, so it is an upper bound."""
    if len(track.t) < 8:
        return 1.0
    third = np.hypot(np.diff(track.x, 3), np.diff(track.y, 3))[track.chain[3:] == track.chain[:-3]]
    third = third[third != 0.0]
    # the median of a two-dimensional normal length is 1.1774 sigma
    return 0.05 if len(third) < 5 else float(np.clip(np.median(third) / 1.1774 / np.sqrt(20.0), 0.01, 30.0))


def group_span(track: Track, noise: float) -> float:
    """Seconds of motion in a group: a step twice the noise of the mean of its k rows, noise / sqrt(k)."""
    h, v = track.interval, _usual_speed(track, noise)
    rows = max((2.0 * noise / (v * h)) ** (2.0 / 3.0), 1.0)
    return float(min(max(rows * h, SHORTEST_STEP / v), LONGEST_SPAN, LONGEST_STEP / v))


def direction_of(groups: Groups, sigma: float) -> tuple[Floats, Floats]:
    """(2, G) unit direction of motion, and how sharply it is known (0: not at all, at most 4)."""
    g, chain = np.arange(len(groups.t)), groups.chain
    before, after = np.maximum(g - 1, 0), np.minimum(g + 1, len(g) - 1)
    before = np.where(chain[before] == chain, before, g)
    after = np.where(chain[after] == chain, after, g)
    dx, dy = groups.x[after] - groups.x[before], groups.y[after] - groups.y[before]
    far = np.hypot(dx, dy)
    unsure = (1.5 * sigma / np.maximum(far, 1e-9)) ** 2
    sharp = np.where(groups.still | (unsure > 0.5), 0.0, 1.0 / (unsure + 0.25))
    return np.vstack([dx, dy]) / np.maximum(far, 1e-9), sharp


def group_track(track: Track, noise: float, sigma: float) -> Groups:
    """Groups of a track: standstills that speed or positions show, and steps of motion between."""
    span = group_span(track, noise)
    first, still = np.empty(len(track.t) + 1, np.int64), np.zeros(len(track.t), np.bool_)
    count = group_points(track.t, track.speed, track.chain, span - 1e-6, STANDING_SPEED, first, still)
    if not np.isfinite(track.speed).any():
        radius, points = 2.5 * sigma + 0.1, first[: count + 1].copy()
        x, y = (_mean(v, points) for v in (track.x, track.y))
        still[:] = False
        count = find_stops(points, track, x, y, radius, max(5.0, 4.0 * radius), first, still)
    first, still = first[: count + 1].copy(), still[:count].copy()
    t, x, y = (_mean(v, first) for v in (track.t, track.x, track.y))
    chord = np.hypot(np.diff(x), np.diff(y))
    blur = 2.0 * noise**2 / np.maximum(np.minimum(np.diff(first)[1:], np.diff(first)[:-1]), 1)
    steps = np.diff(_mean(_travelled(track), first))
    moved = np.where(np.isfinite(steps), steps, np.sqrt(np.maximum(chord**2 - blur, 0.0)))
    # a heading may point against the motion, so only its axis counts
    axis = _axis(track.heading, first)
    return Groups(first, t, x, y, np.append(moved, 0.0), axis, still, track.chain[first[:-1]])


def _mean(values: Floats, first: Ints) -> Floats:
    """(G,) means of groups, about the first of each: large coordinates lose no digits."""
    begin, size = values[first[:-1]], np.diff(first)
    return np.asarray(begin + np.add.reduceat(values - np.repeat(begin, size), first[:-1]) / size)


def _axis(heading: Floats, first: Ints) -> Floats:
    """(2, G) mean cosine and sine of twice the heading; 0 where no row of a group knows it."""
    if not (known := np.isfinite(heading)).any():
        return np.zeros((2, len(first) - 1))
    parts = np.vstack([known, np.where(known, [np.cos(2.0 * heading), np.sin(2.0 * heading)], 0.0)])
    count, *axis = np.add.reduceat(parts, first[:-1], axis=1)
    return np.asarray(np.vstack(axis) / np.maximum(count, 1.0))


def _travelled(track: Track) -> Floats:
    """(N,) distance from the log's speed, trapezoids [m]; NaN where more than a tenth of them is missing."""
    if (known := np.isfinite(track.speed)).mean() < 0.9:
        return np.full(len(track.t), np.nan)
    v = np.interp(track.t, track.t[known], track.speed[known])
    return np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(track.t))])


@outer
def group_points(
    t: Floats, speed: Floats, chain: Wide, span: float, standing_speed: float, first: Wide, still: Mask
) -> Any:
    """First row of every group into ``first`` (G + 1,), whether it stands into ``still``; their number G. A
    group is at most ``span`` seconds of motion, or one whole standstill that the log's speed shows."""
    n = len(t)
    count = 0
    for i in range(n):
        stands = speed[i] < standing_speed
        goes_on = i > 0 and chain[i] == chain[i - 1] and stands == still[count - 1]
        if goes_on and (stands or t[i] - t[first[count - 1]] < span):
            continue
        first[count] = i
        still[count] = stands
        count += 1
    first[count] = n
    return count


@outer
def find_stops(
    first: Wide, track: Track, gx: Floats, gy: Floats, radius: float, min_duration: float, merged: Wide,
    still: Mask,
) -> Any:  # fmt: skip
    """First rows of groups, those merged that stay within ``radius`` of their mean; which stand; how many."""
    t, chain = track.t, track.chain
    count = len(first) - 1
    out = 0
    g = 0
    while g < count:
        sx, sy, m = gx[g], gy[g], 1
        h = g + 1
        while h < count and chain[first[h]] == chain[first[g]]:
            if np.hypot(gx[h] - sx / m, gy[h] - sy / m) > radius:
                break
            sx += gx[h]
            sy += gy[h]
            m += 1
            h += 1
        # the truck came and left within the radius too: the run begins and ends close to its mean
        a, b = g, h
        while b - a > 2 and np.hypot(gx[a] - sx / m, gy[a] - sy / m) > 0.6 * radius:
            a += 1
        while b - a > 2 and np.hypot(gx[b - 1] - sx / m, gy[b - 1] - sy / m) > 0.6 * radius:
            b -= 1
        stands = b - a > 2 and t[first[b] - 1] - t[first[a]] >= min_duration
        for k in range(g, a if stands else g + 1):
            merged[out] = first[k]
            out += 1
        if stands:
            merged[out] = first[a]
            still[out] = True
            out += 1
        g = b if stands else g + 1
    merged[out] = first[count]
    return out

"""Points to groups: what one step of the hidden Markov model sees."""

from typing import Any

import numpy as np

from fleetlog.compiling import outer
from fleetlog.core.arrays import Floats, Mask
from fleetlog.roads.kernels.records import Track, Wide


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

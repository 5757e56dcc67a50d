"""Centre lines fitted to the traces: the middle across the way at every metre, straight into junctions."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree

from fleetlog.core.arrays import Floats, Indices, Mask
from fleetlog.core.network import reduced
from fleetlog.learn.cells import Driven
from fleetlog.learn.lines import Chain, ends, way

STEP = 1.0  # distance of the stations of a centre line [m]
SMOOTH = 2.0  # standard deviation of the smoothing along a line [m]
CLEAR = 3.5  # turning trucks cut corners up to this far from a junction [m]
TANGENT = 5.0  # metres of line beyond that which say where it enters a junction
HEADED = 4.0  # a turn by one radian counts as this distance [m]
TILT = 0.5  # a cell's heading is this near to its road's [rad]
PULL = 0.3  # weight of where a junction was against a line through it: roads that meet flatly do not slide
FINE = 0.1  # vertices that are not needed to stay within this of a line are left out [m]
FARTHEST_END = 6.0  # a dead end is carried on by this at most [m]
FARTHEST = 2.5  # a junction moves no farther than this [m]
SELDOM = 0.06  # a direction with a smaller share of the other one's passes is not one in which trucks drive


@dataclass(frozen=True)
class Fit:
    """A chain on its traces; across it, forth and back, their mean distance to the left and spread [m]."""

    chain: Chain
    left: Floats
    spread: Floats

    def covered(self, senses: Mask, noise: float = 0.0) -> float:
        """Width [m] of floor that trucks' middles cover in ``senses``, forth and back, less the ``noise``."""
        spread = np.sqrt(np.maximum(self.spread[senses] ** 2 - noise**2, 0.0))
        return float(np.ptp(self.left[senses]) + 4.0 * spread.max())


def refined(chains: list[Chain], driven: Mask, cells: Driven, reach: float, rounds: int = 3) -> list[Fit]:
    """The chains moved onto the traces: in the middle of both directions where both are driven. ``driven``
    (n, 2) says which way each is, forth and back; cells farther than ``reach`` [m] are another road's."""
    fits = [Fit(c, np.zeros(2), np.zeros(2)) for c in chains]
    for _ in range(rounds):
        chains = [_resampled(f.chain) for f in fits]
        fits = _meeting(_fitted(chains, driven, cells, reach))
    at = ends([f.chain for f in fits])
    for k, f in enumerate(fits):
        points = f.chain.points
        # Dead ends as far as trucks drove: thinning takes a little of every end.
        for node in (f.chain.end, f.chain.start):
            points = (_extended(points, cells, reach) if len(at[node]) == 1 else points)[::-1]
        fits[k] = replace(f, chain=replace(f.chain, points=reduced(points, FINE)))
    return fits


def _extended(points: Floats, cells: Driven, reach: float) -> Floats:
    """A line carried on to where nine tenths of what was driven straight ahead of its end lie behind."""
    if _entry(points[::-1]) is None:
        return points
    back = points[:-1][np.hypot(*(points[:-1] - points[-1]).T) > TANGENT]
    direction = points[-1] - (back[-1] if len(back) else points[0])
    direction = direction / np.hypot(*direction)
    dx, dy = cells.x - points[-1, 0], cells.y - points[-1, 1]
    ahead, left = dx * direction[0] + dy * direction[1], dy * direction[0] - dx * direction[1]
    axis = np.abs(np.cos(cells.heading) * direction[0] + np.sin(cells.heading) * direction[1])
    use = (ahead > 0.0) & (ahead < FARTHEST_END) & (np.abs(left) < reach) & (axis > np.cos(TILT))
    if not use.any():
        return points
    order = np.argsort(ahead[use])
    share = np.cumsum(cells.weight[use][order]) / cells.weight[use].sum()
    far = float(ahead[use][order][np.searchsorted(share, 0.9)])
    return np.concatenate([points[:-1], [points[-1] + far * direction]]) if far > 0.3 else points


def _resampled(c: Chain) -> Chain:
    s = way(c.points)
    at = np.linspace(0.0, s[-1], max(round(s[-1] / STEP), 1) + 1)
    return replace(c, points=np.column_stack([np.interp(at, s, v) for v in c.points.T]))


def _owners(
    chains: list[Chain], senses: Mask, cells: Driven, reach: float
) -> tuple[Floats, Indices, Indices, Indices]:
    """Tangents at the points of all chains, end to end, and the cells that lie on them in their ``senses``.
    Those are (n, 2), forth and back; of a cell its number, the point nearest to it, and 1 if back."""
    points = np.concatenate([c.points for c in chains])
    ahead = np.concatenate([np.gradient(_softened(c.points), axis=0) for c in chains])
    tangent = ahead / np.maximum(np.hypot(*ahead.T), 1e-9)[:, None]
    sense = np.repeat(senses, [len(c.points) for c in chains], axis=0)
    station = np.concatenate([np.flatnonzero(sense[:, 0]), np.flatnonzero(sense[:, 1])])
    sign = np.repeat([1.0, -1.0], sense.sum(axis=0))
    known = np.column_stack([points[station], HEADED * sign[:, None] * tangent[station]])
    facing = HEADED * np.cos(cells.heading), HEADED * np.sin(cells.heading)
    wanted = np.column_stack([cells.x, cells.y, *facing])
    far, near = cKDTree(known).query(wanted, distance_upper_bound=float(np.hypot(reach, HEADED * TILT)))
    use = np.flatnonzero(np.isfinite(far))
    return tangent, use, station[near[use]], (sign[near[use]] < 0.0).astype(np.intp)


def ways_driven(chains: list[Chain], cells: Driven, reach: float) -> Mask:
    """(n, 2) whether trucks drive each chain forth and back, by the passes over it, manoeuvres aside."""
    chains = [_resampled(c) for c in chains]
    _, use, at, back = _owners(chains, np.ones((len(chains), 2), bool), cells, reach)
    owner = np.repeat(np.arange(len(chains)), [len(c.points) for c in chains])[at]
    metres = np.bincount(2 * owner + back, cells.weight[use], 2 * len(chains)).reshape(-1, 2)
    passes = metres / np.array([max(c.length, STEP) for c in chains])[:, None]
    return np.asarray(passes > SELDOM * passes[:, ::-1])


def _fitted(chains: list[Chain], driven: Mask, cells: Driven, reach: float) -> list[Fit]:
    points = np.concatenate([c.points for c in chains])
    tangent, use, at, back = _owners(chains, driven, cells, reach)
    dx, dy, n = cells.x[use] - points[at, 0], cells.y[use] - points[at, 1], len(points)
    left = dy * tangent[at, 0] - dx * tangent[at, 1]
    moments = [np.bincount(back * n + at, cells.weight[use] * left**k, 2 * n).reshape(2, n) for k in range(3)]
    sums = np.stack(moments, axis=1).astype(np.float64)
    bounds = np.cumsum([len(c.points) for c in chains])[:-1]
    return list(map(_fit, chains, np.split(sums, bounds, axis=2), np.split(tangent, bounds)))


def _softened(points: Floats) -> Floats:
    """Points smoothed along their line, the ends where they are."""
    if len(points) < 4:
        return points
    # reflected through the end points, so that the ends stay
    n = len(points) - 1
    padded = np.pad(points, ((n, n), (0, 0)), "reflect", reflect_type="odd")
    return np.asarray(gaussian_filter1d(padded, SMOOTH / STEP, axis=0)[n : 2 * n + 1])


def _fit(c: Chain, sums: Floats, tangent: Floats) -> Fit:
    """One chain from the sums of weight, distance and square of its stations."""
    total = sums[:, 0].sum(axis=1)
    weight = total / max(c.length, STEP)
    run = gaussian_filter1d(sums, SMOOTH / STEP, axis=2, mode="nearest") if len(c.points) > 3 else sums
    used = weight > max(0.02 * weight.max(), 1e-9)
    mean = run[:, 1] / np.maximum(run[:, 0], 1e-9)
    seen = run[:, 0] > 0.05 * max(float(weight.max()), 1e-9)
    offset = _middle(mean, seen & used[:, None])
    left = np.array([np.average(m, weights=s + 1e-9) for m, s in zip(mean - offset, sums[:, 0], strict=True)])
    first, second = (sums[:, k].sum(axis=1) / np.maximum(total, 1e-9) for k in (1, 2))
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    moved = replace(c, points=c.points + offset[:, None] * normal)
    return Fit(moved, left, np.sqrt(np.maximum(second - first**2, 0.0)))


def _middle(mean: Floats, seen: Mask) -> Floats:
    """(n,) the middle of the directions that are seen; between stations where none is, interpolated."""
    both, known = seen.all(axis=0), seen.any(axis=0)
    if not known.any():
        return np.zeros(mean.shape[1])
    place, half = np.arange(mean.shape[1]), 0.5 * (mean[0] - mean[1])
    # where only one is seen its distance from the middle is that of where both are
    aside = np.interp(place, place[both], half[both]) if both.any() else np.zeros(len(place))
    value = np.where(both, 0.5 * (mean[0] + mean[1]), np.where(seen[0], mean[0] - aside, mean[1] + aside))
    return np.asarray(np.interp(place, place[known], value[known]))


def _meeting(fits: list[Fit]) -> list[Fit]:
    """Every junction where the roads point to, and the roads straight into it; two that meet just go on."""
    at = ends([f.chain for f in fits]).items()
    where = {n: _node([fits[k].chain.points[:: 1 if begins else -1] for k, begins in arms]) for n, arms in at}
    onward, out = {n for n, arms in at if len(arms) == 2}, []
    for f in fits:
        # What lies within a junction's reach gives way to a straight line.
        c, s = f.chain, way(f.chain.points)
        first, last = (0.0 if n in onward else min(CLEAR, 0.3 * s[-1]) for n in (c.start, c.end))
        inner = c.points[(s > first) & (s < s[-1] - last)]
        points = np.vstack([where[c.start], inner, where[c.end]])
        out.append(replace(f, chain=replace(c, points=points)))
    return out


def _node(arms: list[Floats]) -> Floats:
    """The place nearest to the lines along which the arms come in."""
    old = np.asarray(np.mean([a[0] for a in arms], axis=0))
    if len(arms) == 2:
        return old
    matrix, value = PULL * np.eye(2), PULL * old
    for point, direction in filter(None, map(_entry, arms)):
        across = np.eye(2) - np.outer(direction, direction)
        matrix, value = matrix + across, value + across @ point
    step = np.linalg.solve(matrix, value) - old
    return np.asarray(old + step * min(1.0, FARTHEST / max(float(np.hypot(*step)), 1e-9)))


def _entry(arm: Floats) -> tuple[Floats, Floats] | None:
    """Point and direction of an arm clear of its junction; None where it is too short."""
    s = way(arm)
    clear = min(CLEAR, 0.3 * s[-1])
    if len(piece := arm[(s >= clear) & (s <= clear + TANGENT)]) < 3:
        return None
    middle = piece.mean(axis=0)
    _, _, axes = np.linalg.svd(piece - middle)
    return middle, axes[0]

"""Metres driven per square of the floor and sector of heading, and gathered on lines that trucks agree on.

The table grows with the roads of a site, not with the length of its log."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from fleetlog.compiling import kernel
from fleetlog.core.arrays import Floats, Ints, Mask
from fleetlog.core.trajectory import Trajectory
from fleetlog.physics.motion import reconstruct

SECTORS = 16  # sectors of heading
SIDE = 0.5  # side of a square [m]
LIMIT = 2.0e6  # no coordinate of a site is larger [m]
DWELL = 8.0  # who stands longer than this manoeuvres before and after [s]
MANOEUVRE = 8.0  # ... for this many metres
ASIDE = 0.1  # weight of a metre of manoeuvre: it counts only where nothing else was driven
ALIKE = np.cos(np.radians(35.0))  # headings closer than this go one way
ALONG = 1.0  # standard deviation along the way of what is averaged [m]
ROUNDS = 12
SCATTER = 0.1  # directions with a smaller share of what is driven there pull by that share, others alike


@dataclass(frozen=True)
class Driven:
    """What was driven (N,): ``weight`` metres, at a mean position [m] and ``heading`` [rad]."""

    x: Floats
    y: Floats
    heading: Floats
    weight: Floats

    def __len__(self) -> int:
        return len(self.x)


def moving(trajectory: Trajectory) -> tuple[Driven, float]:
    """The samples of a trajectory at which the truck moved, and the noise of its positions [m]."""
    found = reconstruct(trajectory)
    m = found.motion
    metres = np.where(found.standing, 0.0, m.speed * m.dt)
    weight = metres * np.where(_manoeuvres(metres, m.dt, found.standing), ASIDE, 1.0)
    keep = np.flatnonzero((metres > 0.0) & (np.abs(m.x) < LIMIT) & (np.abs(m.y) < LIMIT))
    # who drives fast is sampled at places farther apart than what makes a line: several stand for one
    count = np.ceil(metres[keep] / ALONG).astype(int)
    row, nth = np.repeat(keep, count), np.concatenate([np.arange(n) for n in [0, *count]])
    count, heading = np.repeat(count, count), m.heading[row]
    ahead = ((nth + 0.5) / count - 0.5) * metres[row]
    x, y = m.x[row] + np.cos(heading) * ahead, m.y[row] + np.sin(heading) * ahead
    return Driven(x, y, heading, weight[row] / count), float(found.noise.position)


def _manoeuvres(metres: Floats, dt: Floats, standing: Mask) -> Mask:
    """(n,) whether a sample lies within a manoeuvre of a long stand."""
    way = np.cumsum(metres)
    turn = np.flatnonzero(np.diff(standing.astype(np.int8), prepend=0, append=0)).reshape(-1, 2)
    time = np.concatenate([[0.0], np.cumsum(dt)])
    long = time[turn[:, 1]] - time[turn[:, 0]] >= DWELL
    stands = np.concatenate([[-np.inf], way[turn[long, 0]], [np.inf]])
    after = np.searchsorted(stands, way)
    return np.asarray(np.minimum(stands[after] - way, way - stands[after - 1]) <= MANOEUVRE)


def gather(tracks: Iterable[Driven]) -> Driven:
    """The samples of all tracks, added up by square and sector."""
    keys, sums = np.zeros(0, np.int64), np.zeros((0, 5))
    width = int(2 * LIMIT / SIDE)
    for t in tracks:
        i, j = (np.floor((v + LIMIT) / SIDE).astype(np.int64) for v in (t.x, t.y))
        sector = np.floor(t.heading % (2.0 * np.pi) / (2.0 * np.pi) * SECTORS).astype(np.int64) % SECTORS
        keys, of = np.unique(np.append(keys, (i * width + j) * SECTORS + sector), return_inverse=True)
        own = [t.weight * v for v in (1.0, t.x, t.y, np.cos(t.heading), np.sin(t.heading))]
        rows = np.concatenate([sums, np.column_stack(own)])
        sums = np.column_stack([np.bincount(of, column, len(keys)) for column in rows.T])
    weight, x, y, cos, sin = sums.T
    return Driven(x / weight, y / weight, np.arctan2(sin, cos), weight)


def gathered(cells: Driven, noise: float, lane: float) -> Driven:
    """``cells`` on the lines that they follow by direction; lines closer than ``lane`` [m] are one. ``noise``
    [m] is that of the positions. The weight is then in passes: by metre of a line, the trips over it."""
    one_way, _ = _shifted(cells, max(0.5, 0.8 * noise), either=False)
    own = _shifted(one_way, 0.5, either=False, rounds=1)[1]
    around = _shifted(one_way, lane, either=True, rounds=1)[1]
    even = replace(one_way, weight=one_way.weight / np.maximum(own, SCATTER * around))
    both, _ = _shifted(even, lane, either=True)
    return replace(both, weight=one_way.weight)


def _shifted(cells: Driven, across: float, *, either: bool, rounds: int = ROUNDS) -> tuple[Driven, Floats]:
    """Cells moved across their heading to the local mean, in their order; and the weight about each."""
    side = max(3.0 * ALONG, across if either else 3.0 * across) + 1.0
    low = np.array([cells.x.min(), cells.y.min()])
    at = ((np.column_stack([cells.x, cells.y]) - low) // side).astype(np.int64)
    shape = at.max(axis=0) + 1
    block = at @ [shape[1], 1]
    order = np.argsort(block, kind="stable")
    first = np.searchsorted(block[order], np.arange(shape.prod() + 1))
    rows = np.stack([cells.x, cells.y, np.cos(cells.heading), np.sin(cells.heading), cells.weight])[:, order]
    left, near = np.empty((2, len(cells)))
    left[order], near[order] = _shift(rows, first, shape, low, side, across, either, rounds)
    moved = replace(cells, x=cells.x - np.sin(cells.heading) * left, y=cells.y + np.cos(cells.heading) * left)
    return moved, near


@kernel()
def _shift(
    cells: Floats, first: Ints, shape: Ints, low: Floats, side: float, across: float, either: bool,
    rounds: int,
) -> tuple[Floats, Floats]:  # fmt: skip
    """(N,) metres to the left to the local mean of cells that head alike, and the weight about there.

    ``cells`` (5, N) are x, y, cosine and sine of the heading, and weight, by block of ``side`` m, column
    after column; block b owns ``first[b]`` to ``first[b + 1]``.  ``across`` is the kernel's deviation across
    the way [m].  With ``either`` the opposite direction counts too, and the kernel is flat up to ``across``:
    lines farther apart do not pull at one another at all."""
    x, y, cos, sin, weight = cells
    columns, rows = shape
    out, near = np.zeros(len(x)), np.zeros(len(x))
    for i in range(len(x)):
        moved = 0.0
        for _ in range(rounds):
            px, py = x[i] - sin[i] * moved, y[i] + cos[i] * moved
            bi, bj = int((px - low[0]) / side), int((py - low[1]) / side)
            total = value = 0.0
            for a in range(max(bi - 1, 0), min(bi + 2, columns)):
                begin, end = max(bj - 1, 0), min(bj + 2, rows)
                if begin >= end:
                    continue
                for k in range(first[a * rows + begin], first[a * rows + end]):
                    facing = cos[k] * cos[i] + sin[k] * sin[i]
                    if facing < ALIKE and not (either and facing < -ALIKE):
                        continue
                    dx, dy = x[k] - px, y[k] - py
                    ahead = (dx * cos[i] + dy * sin[i]) / ALONG
                    left = dy * cos[i] - dx * sin[i]
                    far = ahead * ahead
                    if not either:
                        far += (left / across) ** 2
                    elif abs(left) > across:
                        continue
                    if far < 9.0:
                        w = weight[k] * np.exp(-0.5 * far)
                        total += w
                        value += w * left
            near[i] = total
            if total == 0.0:
                break
            step = value / total
            moved += step
            if abs(step) < 0.01:
                break
        out[i] = moved
    return out, near

"""Sites for the blind benchmark: scattered junctions, bent roads, some of them one-way.  Nothing of fleetlog is used here."""

from __future__ import annotations

import numpy as np

STEP = 0.1
"""Between the points of a path [m]."""
RADIUS = 2.5
"""Of the tightest corner [m]."""
SHARPEST = -0.2
"""Cosine of the sharpest corner that is driven."""


class Plant:
    """Junctions ``xy`` (n, 2), roads ``ends`` (m, 2) with ``curve`` (m,) sideways bow [m], ``limit`` [m/s], ``oneway``."""

    def __init__(self, rng: np.random.Generator) -> None:
        while True:
            self.xy = self._scatter(rng)
            self.ends = self._gabriel()
            if 18 <= len(self.ends) <= 46:
                break
        m = len(self.ends)
        self.curve = np.where(rng.random(m) < 0.35, rng.uniform(-7.0, 7.0, m), 0.0)
        self.limit = rng.choice([2.5, 3.5, 4.5], m, p=[0.25, 0.45, 0.3])
        self.oneway = self._one_way(rng)
        self.length = np.array([self._measure(i) for i in range(m)])

    def _scatter(self, rng: np.random.Generator) -> np.ndarray:
        points: list[np.ndarray] = []
        for _ in range(4000):
            p = rng.uniform([0.0, 0.0], [230.0, 150.0])
            if all(np.hypot(*(p - q)) > 34.0 for q in points):
                points.append(p)
            if len(points) == 19:
                break
        return np.array(points)

    def _gabriel(self) -> np.ndarray:
        """Roads between junctions whose circle holds no third: planar, connected, no sharp clutter."""
        out = []
        for i in range(len(self.xy)):
            for j in range(i + 1, len(self.xy)):
                middle, radius = (self.xy[i] + self.xy[j]) / 2.0, np.hypot(*(self.xy[i] - self.xy[j])) / 2.0
                apart = np.hypot(*(self.xy - middle).T)
                apart[[i, j]] = np.inf
                if (apart > radius).all():
                    out.append((i, j))
        return np.array(out)

    def _one_way(self, rng: np.random.Generator) -> np.ndarray:
        oneway = np.zeros(len(self.ends), bool)
        for k in rng.permutation(len(self.ends))[: len(self.ends) // 8]:
            oneway[k] = True
            if not self._strong(oneway):
                oneway[k] = False
        return oneway

    def _strong(self, oneway: np.ndarray) -> bool:
        n = len(self.xy)
        for backward in (False, True):
            seen, todo = {0}, [0]
            while todo:
                u = todo.pop()
                for (a, b), one in zip(self.ends, oneway, strict=True):
                    steps = [(b, a)] if backward else [(a, b)]
                    if not one:
                        steps.append(steps[0][::-1])
                    for start, end in steps:
                        if start == u and end not in seen:
                            seen.add(int(end))
                            todo.append(int(end))
            if len(seen) < n:
                return False
        return True

    def line(self, road: int, count: int = 30) -> np.ndarray:
        """(count, 2) points of a road as it is drawn on the map."""
        a, b = self.xy[self.ends[road, 0]], self.xy[self.ends[road, 1]]
        u = np.linspace(0.0, 1.0, count)[:, None]
        along = (b - a) / np.hypot(*(b - a))
        side = np.array([-along[1], along[0]])
        return a + u * (b - a) + side * np.sin(np.pi * u) ** 2 * self.curve[road]

    def steepest(self, hill: dict[str, float]) -> float:
        """Largest slope along any road over a Gaussian hill; its flank may be steeper where no road is."""
        most = 0.0
        for road in range(len(self.ends)):
            line = self.line(road, 160)
            apart = ((line - [hill["x"], hill["y"]]) ** 2).sum(axis=1)
            height = hill["height"] * np.exp(-apart / hill["width"] ** 2)
            most = max(most, float(np.abs(np.diff(height) / np.hypot(*np.diff(line, axis=0).T)).max()))
        return most

    def _measure(self, road: int) -> float:
        return float(np.hypot(*np.diff(self.line(road), axis=0).T).sum())

    def route(self, start: int, end: int, rng: np.random.Generator) -> list[tuple[int, int]]:
        """(road, +1 or -1) from junction to junction; drivers do not all take the shortest way."""
        import heapq

        cost = self.length * rng.uniform(0.7, 1.6, len(self.length))
        best, came, heap = {start: 0.0}, {}, [(0.0, start)]
        while heap:
            d, u = heapq.heappop(heap)
            if u == end:
                break
            for k, (a, b) in enumerate(self.ends):
                for sense, x, y in ((1, a, b), (-1, b, a)):
                    if (
                        x != u
                        or (sense < 0 and self.oneway[k])
                        or (u in came and self._sharp(came[u][0], u, int(y)))
                    ):
                        continue
                    if d + cost[k] < best.get(int(y), np.inf):
                        best[int(y)] = d + cost[k]
                        came[int(y)] = (u, k, sense)
                        heapq.heappush(heap, (best[int(y)], int(y)))
        out = []
        u = end
        while u != start:
            if u not in came:
                return []
            u, k, sense = came[u]
            out.append((k, sense))
        return out[::-1]

    def _sharp(self, before: int, here: int, after: int) -> bool:
        """Whether no truck gets round this corner; turning back is one."""
        a, b = self.xy[here] - self.xy[before], self.xy[after] - self.xy[here]
        return bool(a @ b < SHARPEST * np.hypot(*a) * np.hypot(*b))

    def path(self, legs: list[tuple[int, int]]) -> dict[str, np.ndarray]:
        """A driven path: corners are arcs a little wider than the truck's turning circle, blurred as steering takes time.

        Arrays every ``STEP`` metres.
        """
        lines = [self.line(road, 160)[::sense] for road, sense in legs]
        points, which = [lines[0]], [np.zeros(len(lines[0]), int)]
        for k in range(1, len(lines)):
            before, arc, after = _rounded(points.pop(), lines[k], RADIUS + 0.5 * (legs[k][0] * 0.618 % 1.0))
            which.pop()
            points += [before, arc, after]
            half = len(arc) // 2
            which += [
                np.full(len(before), k - 1),
                np.where(np.arange(len(arc)) < half, k - 1, k),
                np.full(len(after), k),
            ]
        xy, leg = np.concatenate(points), np.concatenate(which)
        s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))]) + np.arange(len(xy)) * 1e-9
        grid = np.arange(0.0, s[-1], STEP)
        x, y = (np.interp(grid, s, xy[:, i]) for i in (0, 1))
        leg = leg[np.clip(np.searchsorted(s, grid), 0, len(s) - 1)]
        road, sense = np.array(legs)[leg].T
        for width in (13, 9):
            x, y = _slide(x, width), _slide(y, width)
        step = np.hypot(np.gradient(x), np.gradient(y))
        heading = np.unwrap(np.arctan2(np.gradient(y), np.gradient(x)))
        bend = _slide(np.gradient(heading) / np.maximum(step, 0.3 * STEP), 9)
        return {"x": x, "y": y, "step": step, "heading": heading, "bend": bend, "road": road, "sense": sense}


def _rounded(a: np.ndarray, b: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two lines that meet, with the corner between them an arc."""
    u, v = a[-1] - a[-6], b[5] - b[0]
    u, v = u / np.hypot(*u), v / np.hypot(*v)
    angle = float(np.arctan2(u[0] * v[1] - u[1] * v[0], u @ v))
    cut = radius * np.tan(abs(angle) / 2.0)
    if cut < 0.15:
        return a, a[-1:], b
    side = np.sign(angle) * np.array([-u[1], u[0]])
    centre = b[0] - cut * u + radius * side
    turn = np.linspace(0.0, angle, 24)[:, None]
    spoke = -radius * side
    arc = centre + np.cos(turn) * spoke + np.sin(turn) * np.array([-spoke[1], spoke[0]])
    apart_a, apart_b = np.hypot(*(a - a[-1]).T), np.hypot(*(b - b[0]).T)
    return a[apart_a > cut], arc, b[apart_b > cut]


def _slide(values: np.ndarray, width: int) -> np.ndarray:
    if len(values) <= width:
        return values
    padded = np.concatenate(
        [np.full(width // 2, values[0]), values, np.full(width - 1 - width // 2, values[-1])]
    )
    total = np.cumsum(np.concatenate([[0.0], padded]))
    return (total[width:] - total[:-width]) / width

"""Sites for the blind benchmark: scattered junctions, bent roads, some of them one-way.  Nothing of fleetlog is used here."""

from __future__ import annotations

import numpy as np

STEP = 0.1
"""Between the points of a path [m]."""
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
        """A driven path: corners rounded by a sliding mean, as a driver cuts them; arrays every ``STEP`` metres."""
        points, roads, senses = [], [], []
        for road, sense in legs:
            line = self.line(road, 160)[::sense]
            points.append(line)
            roads.append(np.full(len(line), road))
            senses.append(np.full(len(line), sense))
        xy, road, sense = np.concatenate(points), np.concatenate(roads), np.concatenate(senses)
        s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))]) + np.arange(len(xy)) * 1e-9
        grid = np.arange(0.0, s[-1], STEP)
        x, y = (np.interp(grid, s, xy[:, i]) for i in (0, 1))
        near = np.clip(np.searchsorted(s, grid), 0, len(s) - 1)
        road, sense = road[near], sense[near]
        for width in (33, 21):
            x, y = _slide(x, width), _slide(y, width)
        step = np.hypot(np.gradient(x), np.gradient(y))
        heading = np.unwrap(np.arctan2(np.gradient(y), np.gradient(x)))
        bend = _slide(np.gradient(heading) / np.maximum(step, 0.3 * STEP), 9)
        return {"x": x, "y": y, "step": step, "heading": heading, "bend": bend, "road": road, "sense": sense}


def _slide(values: np.ndarray, width: int) -> np.ndarray:
    if len(values) <= width:
        return values
    padded = np.concatenate(
        [np.full(width // 2, values[0]), values, np.full(width - 1 - width // 2, values[-1])]
    )
    total = np.cumsum(np.concatenate([[0.0], padded]))
    return (total[width:] - total[:-width]) / width

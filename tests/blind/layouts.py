"""Layouts of sites, drawn from a seed: a plant, a corridor, a ring of one-way roads, dense aisles, a yard."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components


@dataclass
class Layout:
    """Junctions ``xy`` (n, 2) [m]; roads ``ends`` (m, 2), their bow ``curve`` [m], ``limit`` [m/s]."""

    xy: np.ndarray
    ends: np.ndarray
    curve: np.ndarray
    limit: np.ndarray
    oneway: np.ndarray
    radius: float = 2.5
    """Of the tightest corner [m]."""


def plant(rng: np.random.Generator) -> Layout:
    """Scattered junctions, bent roads, one road in eight one-way."""
    while True:
        xy = _scatter(rng)
        ends = _gabriel(xy)
        if 18 <= len(ends) <= 46:
            break
    m = len(ends)
    curve = np.where(rng.random(m) < 0.35, rng.uniform(-7.0, 7.0, m), 0.0)
    limit = rng.choice([2.5, 3.5, 4.5], m, p=[0.25, 0.45, 0.3])
    return Layout(xy, ends, curve, limit, _one_way(ends, rng))


def corridor(rng: np.random.Generator) -> Layout:
    """One long way with short arms on both sides; every trip passes the same roads."""
    along = np.cumsum(rng.uniform(26.0, 42.0, 9))
    spine = np.column_stack([along, np.cumsum(rng.normal(0.0, 3.0, 9))])
    stems = rng.choice(9, 6, replace=False)
    sides = np.where(np.arange(6) % 2, 1.0, -1.0) * rng.uniform(14.0, 26.0, 6)
    arms = spine[stems] + np.column_stack([rng.normal(0.0, 2.0, 6), sides])
    ends = [(k, k + 1) for k in range(8)] + [(int(s), 9 + k) for k, s in enumerate(stems)]
    limit = np.where(np.arange(14) < 8, rng.choice([3.5, 4.5], 14), 2.5)
    return _straight(np.vstack([spine, arms]), ends, limit)


def ring(rng: np.random.Generator) -> Layout:
    """One-way roads round a block, with two one-way short cuts through it."""
    n = 12
    angle = 2 * np.pi * (np.arange(n) + rng.uniform(-0.15, 0.15, n)) / n
    xy = np.column_stack([rng.uniform(75.0, 95.0) * np.cos(angle), rng.uniform(50.0, 65.0) * np.sin(angle)])
    ends = [(k, (k + 1) % n) for k in range(n)] + [(3, 9), (10, 4)]
    whole = _straight(xy, ends, rng.choice([2.5, 3.5, 4.5], len(ends)))
    whole.oneway[:] = True
    return whole


def aisles(rng: np.random.Generator) -> Layout:
    """Racks with an aisle every five metres between two main roads, places half-way down each aisle."""
    n, deep = 11, rng.uniform(36.0, 48.0)
    rows = [np.column_stack([5.0 * np.arange(n), np.full(n, y)]) for y in (0.0, deep / 2.0, deep)]
    ends = [(a + k, a + k + 1) for a in (0, 2 * n) for k in range(n - 1)]
    ends += [(a + k, a + n + k) for k in range(n) for a in (0, n)]
    main = np.arange(len(ends)) < 2 * (n - 1)
    whole = _straight(np.vstack(rows), ends, np.where(main, 3.5, 2.5))
    whole.radius = 1.9
    return whole


def yard(rng: np.random.Generator) -> Layout:
    """Few long wide roads outdoors."""
    nx, ny = 4, 3
    grid = np.array([(x, y) for y in range(ny) for x in range(nx)], float)
    xy = grid * [95.0, 75.0] + rng.uniform(-14.0, 14.0, (nx * ny, 2))
    ends = [(k, k + 1) for k in range(nx * ny) if k % nx < nx - 1]
    ends += [(k, k + nx) for k in range(nx * (ny - 1))]
    whole = _straight(xy, ends, rng.choice([3.5, 4.5, 5.0], len(ends)))
    whole.curve[:] = np.where(rng.random(len(ends)) < 0.4, rng.uniform(-10.0, 10.0, len(ends)), 0.0)
    return whole


LAYOUTS: dict[str, Callable[[np.random.Generator], Layout]] = {
    "plant": plant, "corridor": corridor, "ring": ring, "aisles": aisles, "yard": yard,
}  # fmt: skip


def _straight(xy: np.ndarray, ends: list[tuple[int, int]], limit: np.ndarray) -> Layout:
    m = len(ends)
    return Layout(xy, np.array(ends), np.zeros(m), np.asarray(limit, float), np.zeros(m, bool))


def _scatter(rng: np.random.Generator) -> np.ndarray:
    points: list[np.ndarray] = []
    for _ in range(4000):
        p = rng.uniform([0.0, 0.0], [230.0, 150.0])
        if all(np.hypot(*(p - q)) > 34.0 for q in points):
            points.append(p)
        if len(points) == 19:
            break
    return np.array(points)


def _gabriel(xy: np.ndarray) -> np.ndarray:
    """Roads between junctions whose circle holds no third: planar, connected, no sharp clutter."""
    out = []
    for i in range(len(xy)):
        for j in range(i + 1, len(xy)):
            middle, radius = (xy[i] + xy[j]) / 2.0, np.hypot(*(xy[i] - xy[j])) / 2.0
            apart = np.hypot(*(xy - middle).T)
            apart[[i, j]] = np.inf
            if (apart > radius).all():
                out.append((i, j))
    return np.array(out)


def _one_way(ends: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    oneway = np.zeros(len(ends), bool)
    for k in rng.permutation(len(ends))[: len(ends) // 8]:
        oneway[k] = True
        oneway[k] = _reaches_all(ends, oneway)
    return oneway


def _reaches_all(ends: np.ndarray, oneway: np.ndarray) -> bool:
    both = np.vstack([ends, ends[~oneway][:, ::-1]])
    n = int(ends.max()) + 1
    graph = csr_matrix((np.ones(len(both)), tuple(both.T)), shape=(n, n))
    return int(connected_components(graph, connection="strong")[0]) == 1

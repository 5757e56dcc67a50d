"""Sites of the benchmark: junctions, bent roads, some of them one-way, and what a map says of them.

Nothing of fleetlog is used here.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from layouts import LAYOUTS, Layout
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

LATITUDE, LONGITUDE = 49.97, 9.15
METRE, METRE_EAST = 1.0 / 111_229.0, 1.0 / 71_740.0
"""Degrees per metre of the ellipsoid there, north and east."""
SHARPEST = -0.2
"""Cosine of the sharpest corner that is driven."""
KINDS = (*LAYOUTS, "ramps", "none")
"""``ramps``: a plant whose map knows its hill; ``none``: a plant of which no map is given."""


@dataclass
class Hill:
    """A round hill of the floor."""

    x: float
    y: float
    height: float
    width: float

    def at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Height [m]."""
        return self.height * np.exp(-((x - self.x) ** 2 + (y - self.y) ** 2) / self.width**2)

    def slope(self, x: np.ndarray, y: np.ndarray, heading: np.ndarray) -> np.ndarray:
        """Rise per metre in the direction of travel."""
        dx, dy = x - self.x, y - self.y
        along = dx * np.cos(heading) + dy * np.sin(heading)
        return -2.0 / self.width**2 * self.at(x, y) * along


@dataclass
class Site:
    """A layout with its names, ways and map."""

    kind: str
    layout: Layout
    hill: Hill | None = None
    """In the map."""
    _ways: dict[tuple[int, int], list[tuple[int, int]]] = field(default_factory=dict)

    @classmethod
    def draw(cls, kind: str, rng: np.random.Generator) -> Site:
        """Draw a site of one of ``KINDS``."""
        layout = LAYOUTS.get(kind, LAYOUTS["plant"])(rng)
        middle = layout.xy.mean(axis=0) + rng.uniform(-20.0, 20.0, 2)
        hill = Hill(*map(float, middle), float(rng.uniform(1.5, 2.5)), float(rng.uniform(30.0, 40.0)))
        return cls(kind, layout, hill if kind == "ramps" else None)

    @property
    def roads(self) -> int:
        """Number of roads."""
        return len(self.layout.ends)

    def names(self, roads: list[int]) -> list[str]:
        """Road ids of the map."""
        return [f"r{k:02d}" for k in roads]

    def line(self, road: int, count: int = 30) -> np.ndarray:
        """(count, 2) points of a road as it is drawn on the map."""
        a, b = self.layout.xy[self.layout.ends[road]]
        u = np.linspace(0.0, 1.0, count)[:, None]
        along = (b - a) / np.hypot(*(b - a))
        side = np.array([-along[1], along[0]])
        return np.asarray(a + u * (b - a) + side * np.sin(np.pi * u) ** 2 * self.layout.curve[road])

    @cached_property
    def length(self) -> np.ndarray:
        """(m,) metres."""
        return np.array([np.hypot(*np.diff(self.line(k), axis=0).T).sum() for k in range(self.roads)])

    def touching(self, road: int) -> list[int]:
        """Roads that share a junction with ``road``."""
        ends = self.layout.ends
        return [k for k in range(self.roads) if k != road and set(ends[k]) & set(ends[road])]

    def central(self, count: int) -> list[int]:
        """Roads nearest to the middle of the site, which most trips pass."""
        middles = self.layout.xy[self.layout.ends].mean(axis=1)
        return [int(k) for k in np.argsort(np.hypot(*(middles - self.layout.xy.mean(axis=0)).T))[:count]]

    def steepest(self, hill: Hill) -> float:
        """Largest slope along any road; the flank of a hill may be steeper where no road is."""
        most = 0.0
        for road in range(self.roads):
            line = self.line(road, 160)
            rise = np.diff(hill.at(*line.T)) / np.hypot(*np.diff(line, axis=0).T)
            most = max(most, float(np.abs(rise).max()))
        return most

    @cached_property
    def turns(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Directed roads (begin, end junction), and the pairs of them that meet without a sharp corner."""
        ends = self.layout.ends
        begin = np.concatenate([ends[:, 0], np.where(self.layout.oneway, -1, ends[:, 1])])
        finish = np.concatenate([ends[:, 1], np.where(self.layout.oneway, -2, ends[:, 0])])
        way = self.layout.xy[finish.clip(0)] - self.layout.xy[begin.clip(0)]
        way = way / np.maximum(np.hypot(*way.T), 1e-9)[:, None]
        follows = (finish[:, None] == begin[None, :]) & (way @ way.T > SHARPEST)
        first, second = np.nonzero(follows)
        return begin, finish, first, second

    def dead_ends(self) -> bool:
        """Whether any road leads where no truck gets on without turning back."""
        begin, _, first, _ = self.turns
        return bool((begin[np.setdiff1d(np.arange(len(begin)), first)] >= 0).any())

    def route(self, start: int, goal: int, rng: np.random.Generator) -> list[tuple[int, int]]:
        """(road, +1 or -1) from junction to junction, not always the shortest way.  Empty: no way."""
        begin, finish, first, second = self.turns
        cost = np.tile(self.length * rng.uniform(0.7, 1.6, self.roads), 2)
        graph = csr_matrix((cost[second], (first, second)), shape=(len(begin), len(begin)))
        starts = np.flatnonzero(begin == start)
        apart, came = dijkstra(graph, indices=starts, return_predecessors=True)
        total = apart + cost[starts][:, None]
        total[:, finish != goal] = np.inf
        row, at = np.unravel_index(int(np.argmin(total)), total.shape)
        if not np.isfinite(total[row, at]):
            return []
        out = [int(at)]
        while came[row, out[-1]] >= 0:
            out.append(int(came[row, out[-1]]))
        return [(k % self.roads, 1 if k < self.roads else -1) for k in reversed(out)]

    def write(self, folder: Path) -> None:
        """Write ``roads.geojson`` and ``site.toml``."""
        features = [self._feature(k) for k in range(self.roads)]
        whole = {"type": "FeatureCollection", "features": features}
        (folder / "roads.geojson").write_text(json.dumps(whole))
        (folder / "site.toml").write_text(
            f'name = "{self.kind}"\n[frame]\nlatitude = {LATITUDE}\nlongitude = {LONGITUDE}\n'
            '[network]\nfile = "roads.geojson"\n'
        )

    def _feature(self, road: int) -> dict[str, Any]:
        a, b = self.layout.ends[road]
        line = self.line(road)
        points = np.column_stack([LONGITUDE + line[:, 0] * METRE_EAST, LATITUDE + line[:, 1] * METRE]).round(
            9
        )
        if self.hill:
            points = np.column_stack([points, self.hill.at(*line.T).round(3)])
        properties = {
            "id": f"r{road:02d}",
            "from": f"j{a}",
            "to": f"j{b}",
            "oneway": bool(self.layout.oneway[road]),
            "speed_limit": float(self.layout.limit[road]),
        }
        shape = {"type": "LineString", "coordinates": points.tolist()}
        return {"type": "Feature", "properties": properties, "geometry": shape}

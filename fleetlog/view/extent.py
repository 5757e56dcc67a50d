"""What of the floor must be seen."""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.core.result import Flows, Grid, Marks, MovingLines, Result
from fleetlog.core.site import Site
from fleetlog.store import Dataset

Extent = tuple[float, float, float, float]  # xmin, ymin, xmax, ymax [m]


def around(outline: Floats) -> Extent:
    """The rectangle about points (N, 2 or 3); 20 m about the origin where there is none."""
    if not len(outline):
        return (-10.0, -10.0, 10.0, 10.0)
    (x0, y0), (x1, y1) = outline[:, :2].min(axis=0), outline[:, :2].max(axis=0)
    return float(x0), float(y0), float(x1), float(y1)


def _stack(parts: Sequence[Any]) -> Floats:
    """(N, 3) finite points of parts (..., 2 or 3); the floor is at height 0."""
    flat = [np.asarray(p, float).reshape(-1, np.shape(p)[-1]) for p in parts if np.size(p)]
    whole = np.concatenate([np.zeros((0, 3)), *(np.pad(p, ((0, 0), (0, 3 - p.shape[1]))) for p in flat)])
    return np.asarray(whole[np.isfinite(whole).all(axis=1)], dtype=np.float64)


def _site_parts(site: Site) -> list[Any]:
    parts: list[Any] = [z.polygon[:, :2] for z in site.zones]
    parts += [np.column_stack([b.polygon[:, :2], np.full(len(b.polygon), b.height)]) for b in site.buildings]
    parts += [(p.x, p.y) for p in site.places]
    return parts if site.network is None else [*parts, site.network.points]


def dataset_outline(dataset: Dataset) -> Floats:
    """(N, 3) points that must be seen [m]: of the site, or without a map also of the positions driven."""
    parts = _site_parts(dataset.site)
    for t in dataset.days(("x", "y")) if dataset.site.network is None else ():
        if t.has("x") and t.has("y"):
            x, y = ((np.nanmin(t.floats(c)), np.nanmax(t.floats(c))) for c in "xy")
            parts.append(list(itertools.product(x, y)))
    return _stack(parts)


def shapes_outline(result: Result, site: Site) -> Floats:
    """(N, 3) points that must be seen [m]: of the site and of everything that a result draws on it."""
    parts = _site_parts(site)
    for shape in result.shapes:
        if isinstance(shape, Marks):
            parts.append(shape.xy)
        elif isinstance(shape, Flows):
            parts += [shape.start, shape.end]
        elif isinstance(shape, MovingLines):
            parts += shape.lines[:1000]
        elif isinstance(shape, Grid):
            cells = np.argwhere(np.isfinite(shape.values) & (shape.values != 0.0))[:, ::-1]
            ends = [cells.min(axis=0), cells.max(axis=0) + 1] if len(cells) else []
            parts += [np.array([shape.x0, shape.y0]) + shape.cell * end for end in ends]
    return _stack(parts)

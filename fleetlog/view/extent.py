"""What of the floor must be seen."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from fleetlog.core.result import Flows, Grid, Marks, MovingLines, Result
from fleetlog.core.site import Site
from fleetlog.core.trajectory import Floats
from fleetlog.store import Dataset

Extent = tuple[float, float, float, float]
"""xmin, ymin, xmax, ymax [m]."""


def around(outline: Floats) -> Extent:
    """The rectangle about points (N, 2 or 3); 20 m about the origin where there is none."""
    if not len(outline):
        return (-10.0, -10.0, 10.0, 10.0)
    (x0, y0), (x1, y1) = outline[:, :2].min(axis=0), outline[:, :2].max(axis=0)
    return float(x0), float(y0), float(x1), float(y1)


def _stack(parts: Sequence[Any]) -> Floats:
    """(N, 3) finite points of parts in two or three coordinates; the floor is at height 0."""
    every = [np.zeros((0, 3))]
    for part in parts:
        p = np.asarray(part, float)
        p = p.reshape(-1, p.shape[-1] if p.ndim > 1 else 2)
        every.append(np.column_stack([p, np.zeros(len(p))]) if p.shape[1] == 2 else p)
    whole = np.concatenate(every)
    return np.asarray(whole[np.isfinite(whole).all(axis=1)], dtype=np.float64)


def _site_parts(site: Site) -> list[Any]:
    parts: list[Any] = [z.polygon[:, :2] for z in site.zones]
    parts += [np.column_stack([b.polygon[:, :2], np.full(len(b.polygon), b.height)]) for b in site.buildings]
    parts += [[(p.x, p.y)] for p in site.places]
    return parts if site.network is None else [*parts, site.network.points]


def dataset_outline(dataset: Dataset) -> Floats:
    """(N, 3) points that must be seen [m]: of the site, or without a map also of the positions driven."""
    parts = _site_parts(dataset.site)
    return _stack(parts if dataset.site.network is not None else [*parts, _driven(dataset)])


def _driven(dataset: Dataset) -> Floats:
    """Corners of the positions, from the statistics in the files' footers."""
    import pyarrow.parquet as pq

    corners = []
    for vehicle in dataset.vehicles:
        for part in dataset.parts(vehicle):
            with part.open("rb") as stream:
                meta = pq.ParquetFile(stream).metadata
            names = meta.schema.names
            for group in range(meta.num_row_groups):
                x, y = (meta.row_group(group).column(names.index(c)).statistics for c in ("x", "y"))
                if x is not None and x.has_min_max and y is not None and y.has_min_max:
                    corners += [(a, b) for a in (x.min, x.max) for b in (y.min, y.max)]
    return np.array(corners, dtype=np.float64).reshape(-1, 2)


def shapes_outline(result: Result, site: Site) -> Floats:
    """(N, 3) points that must be seen [m]: of the site and of everything that a result draws on it."""
    parts = _site_parts(site)
    for shape in result.shapes:
        if isinstance(shape, Marks):
            parts.append(np.asarray(shape.xy, float).reshape(-1, 2))
        elif isinstance(shape, Flows):
            parts += [shape.start, shape.end]
        elif isinstance(shape, Grid):
            parts.append(_grid_corners(shape))
        elif isinstance(shape, MovingLines):
            parts += [np.asarray(s, float).reshape(-1, 2) for s in shape.lines[:1000] if len(s)]
    return _stack(parts)


def _grid_corners(grid: Grid) -> Floats:
    """South-west and north-east corner of the cells that hold a value."""
    rows, columns = np.nonzero(np.isfinite(grid.values) & (grid.values != 0.0))
    if not len(rows):
        return np.zeros((0, 2))
    cells = np.array([[columns.min(), rows.min()], [columns.max() + 1, rows.max() + 1]])
    return np.array([grid.x0, grid.y0]) + grid.cell * cells

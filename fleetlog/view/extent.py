"""What of the floor must be seen."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.result import Grid, Marks, MovingLines, Result
from fleetlog.core.site import Site
from fleetlog.store import Dataset

Floats = NDArray[np.float64]
Extent = tuple[float, float, float, float]
"""xmin, ymin, xmax, ymax [m]."""


def _around(points: Sequence[Any]) -> Extent:
    known = [np.asarray(p, float).reshape(-1, 2) for p in points]
    known = [p[np.isfinite(p).all(axis=1)] for p in known]
    whole = np.concatenate(known) if known else np.zeros((0, 2))
    if not len(whole):
        return (-10.0, -10.0, 10.0, 10.0)
    (x0, y0), (x1, y1) = whole.min(axis=0), whole.max(axis=0)
    return float(x0), float(y0), float(x1), float(y1)


def _site_points(site: Site) -> list[Any]:
    areas: list[Any] = [z.polygon[:, :2] for z in site.zones] + [b.polygon[:, :2] for b in site.buildings]
    areas += [[(p.x, p.y)] for p in site.places]
    return areas if site.network is None else [*areas, site.network.points[:, :2]]


def dataset_extent(dataset: Dataset) -> Extent:
    """The site, or without a map the positions driven."""
    points = _site_points(dataset.site)
    return _around(points if dataset.site.network is not None else [*points, _driven(dataset)])


def _driven(dataset: Dataset) -> Floats:
    """Corners of the positions, from the statistics in the files' footers."""
    import pyarrow.parquet as pq

    corners = []
    for vehicle in dataset.vehicles:
        for part in dataset.parts(vehicle):
            meta = pq.ParquetFile(part).metadata
            names = meta.schema.names
            for group in range(meta.num_row_groups):
                x, y = (meta.row_group(group).column(names.index(c)).statistics for c in ("x", "y"))
                if x is not None and x.has_min_max and y is not None and y.has_min_max:
                    corners += [(x.min, y.min), (x.max, y.max)]
    return np.array(corners, dtype=np.float64).reshape(-1, 2)


def shapes_extent(result: Result, site: Site) -> Extent:
    """The site and everything that a result draws on it."""
    points = _site_points(site)
    for shape in result.shapes:
        if isinstance(shape, Marks):
            points.append(shape.xy)
        elif isinstance(shape, Grid):
            points.append(_grid_corners(shape))
        elif isinstance(shape, MovingLines):
            points += [s for s in shape.lines[:1000] if len(s)]
    return _around(points)


def _grid_corners(grid: Grid) -> Floats:
    """South-west and north-east corner of the cells that hold a value."""
    seen = np.isfinite(grid.values) & (grid.values != 0.0)
    if not seen.any():
        return np.zeros((0, 2))
    rows, cols = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
    low = (grid.x0 + cols[0] * grid.cell, grid.y0 + rows[0] * grid.cell)
    return np.array([low, (grid.x0 + (cols[-1] + 1) * grid.cell, grid.y0 + (rows[-1] + 1) * grid.cell)])

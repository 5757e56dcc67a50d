"""A grid of a result as a GeoTIFF: 32-bit floats, NaN where empty, placed on the earth.

The tags of OGC GeoTIFF 1.1 (OGC 19-008r4): azimuthal equidistant metres about the site's origin; a turned
site by a full transformation.  Without a frame the raster lies in local metres.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.result import Grid
from fleetlog.core.site import Frame

PIXEL_SCALE, TIEPOINT, TRANSFORMATION, KEYS, DOUBLES, NODATA = 33550, 33922, 34264, 34735, 34736, 42113


def write_geotiff(grid: Grid, path: str | Path, frame: Frame | None = None) -> None:
    """The values as band 1, north up; a mask, where there is one, as band 2 (1 inside, 0 outside)."""
    import tifffile

    bands = grid.values if grid.mask is None else np.stack([grid.values, grid.mask], axis=-1)
    tags = {**_placing(grid, frame), **_system(frame), NODATA: "nan"}
    kinds = {str: "s", int: "H", float: "d"}
    tifffile.imwrite(
        path, bands[::-1].astype("<f4"), byteorder="<", photometric="minisblack", compression="zlib",
        planarconfig=None if grid.mask is None else "contig", metadata=None, software=False,
        description=f"{grid.name}: {grid.label}".encode(),
        extratags=[(number, kinds[type(v[0])], len(v), v, True) for number, v in tags.items()],
    )  # fmt: skip


def transformation(grid: Grid, rotation: float = 0.0) -> NDArray[np.float64]:
    """(2, 3) from (column, row, 1), from the north-west corner, to metres east and north of the origin."""
    c, s = np.cos(rotation), np.sin(rotation)
    top = grid.y0 + len(grid.values) * grid.cell
    turn = np.array([[c, -s], [s, c]])
    return np.asarray(turn @ np.array([[grid.cell, 0.0, grid.x0], [0.0, -grid.cell, top]]), dtype=np.float64)


def _placing(grid: Grid, frame: Frame | None) -> dict[int, Any]:
    rotation = 0.0 if frame is None else frame.rotation
    (a, b, x), (d, e, y) = transformation(grid, rotation).tolist()
    if rotation == 0.0:
        return {PIXEL_SCALE: (a, -e, 0.0), TIEPOINT: (0.0, 0.0, 0.0, x, y, 0.0)}
    return {TRANSFORMATION: (a, b, 0.0, x, d, e, 0.0, y, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)}


def _system(frame: Frame | None) -> dict[int, Any]:
    """Azimuthal equidistant (12) metres (9001) on WGS 84 (4326), or a model of the user's own (32767)."""
    if frame is None:
        return {KEYS: (1, 1, 0, 2, 1024, 0, 1, 32767, 1025, 0, 1, 1)}
    keys = [
        (1024, 0, 1, 1), (1025, 0, 1, 1), (2048, 0, 1, 4326), (3072, 0, 1, 32767), (3074, 0, 1, 32767),
        (3075, 0, 1, 12), (3076, 0, 1, 9001), (3082, 34736, 1, 0), (3083, 34736, 1, 0), (3088, 34736, 1, 1),
        (3089, 34736, 1, 2),
    ]  # fmt: skip
    flat = [v for key in [(1, 1, 0, len(keys)), *keys] for v in key]
    return {KEYS: tuple(flat), DOUBLES: (0.0, frame.longitude, frame.latitude)}

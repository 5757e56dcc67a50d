"""The floor that is road: a picture of the gathered cells, and its middle lines."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from fleetlog.learn.cells import Cells
from fleetlog.learn.kernels.thinning import thin

Floats = NDArray[np.float64]
PIXEL = 0.25
"""Side of a pixel [m]."""
MOST_PIXELS = 30_000_000
"""Pixels of a picture; of a larger site they are coarser."""
BLUR = 0.6
"""Standard deviation of the blur that turns cells into passes [m]."""
STRAY = 0.06
"""What is driven less than this share of what the floor nearby is, is scatter about it."""
NEARBY = 2.0
"""... within this [m]."""
RIM = 4
"""Empty pixels about the picture."""


@dataclass(frozen=True)
class Picture:
    """Road pixels; pixel (row, column) has its middle at (x0 + column * side, y0 + row * side)."""

    road: NDArray[np.uint8]
    x0: float
    y0: float
    side: float

    def middle(self, pixel: NDArray[np.int64]) -> Floats:
        """(N, 2) metres of (N, 2) rows and columns."""
        return np.column_stack([self.x0 + pixel[:, 1] * self.side, self.y0 + pixel[:, 0] * self.side])


def centre_lines(cells: Cells, tube: float, least: float) -> Picture:
    """The middle lines of what is driven, one pixel wide.

    Parameters
    ----------
    cells : gathered on their lines.
    tube : lines closer than this are one road [m].
    least : passes below which a line is none.
    """
    picture, passes = _passes(cells)
    near = ndimage.maximum_filter(passes, size=2 * int(NEARBY / picture.side) + 1)
    line = (picture.road > 0) & (passes >= np.maximum(least * 0.5, STRAY * near))
    road = ndimage.distance_transform_edt(~line) <= max(0.5 * tube / picture.side, 2.0)
    picture.road[:] = _without_islets(road, picture.side)
    thin(picture.road)
    return picture


def _passes(cells: Cells) -> tuple[Picture, Floats]:
    x0, y0 = float(cells.x.min()), float(cells.y.min())
    width, height = float(np.ptp(cells.x)), float(np.ptp(cells.y))
    rim = 10.0
    side = max(PIXEL, np.sqrt((width + 2 * rim) * (height + 2 * rim) / MOST_PIXELS))
    x0, y0 = x0 - rim, y0 - rim
    shape = int((height + 2 * rim) / side) + 1, int((width + 2 * rim) / side) + 1
    flat = np.round((cells.y - y0) / side).astype(np.int64) * shape[1]
    flat += np.round((cells.x - x0) / side).astype(np.int64)
    metres = np.bincount(flat, cells.weight, shape[0] * shape[1]).reshape(shape).astype(np.float32)
    blur = max(BLUR / side, 0.7)
    # a line that is driven once has one metre a metre: blurred, 1 / (sqrt(2 pi) sigma) a metre across
    passes = ndimage.gaussian_filter(metres, blur) * np.sqrt(2.0 * np.pi) * blur / side
    return Picture((metres > 0.0).astype(np.uint8), x0, y0, side), passes


ISLET = 4.0
"""Floor within a road smaller than this is part of it [m2]."""


def _without_islets(road: NDArray[np.bool_], side: float) -> NDArray[np.bool_]:
    label, count = ndimage.label(~road)
    area = np.bincount(label.ravel(), minlength=count + 1)
    small = area * side**2 < ISLET
    small[0] = False
    return np.asarray(road | small[label])

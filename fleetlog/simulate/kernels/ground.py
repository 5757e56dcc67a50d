"""Free ground beside the roads: what is taken is kept in lists of square cells."""

from typing import NamedTuple

import numpy as np
from numba import njit

from fleetlog.simulate.arrays import Floats, Index, Ints
from fleetlog.simulate.kernels.geometry import boxes_meet


class Cells(NamedTuple):
    """Boxes of one size in square cells: ``head`` (cells,) is the last box of a cell, ``after`` (N,) the one
    before it, -1: none.

    ``shape`` x0, y0, cell [m], columns, rows;  ``box`` (N, 3) x, y, heading;  ``group`` (N,) what a box
    belongs to;  ``size`` (1,) boxes in use.  Boxes outside the cells lie in the nearest one.
    """

    shape: Floats
    head: Ints
    after: Ints
    box: Floats
    group: Index
    size: Ints


def new_cells(x: Floats, y: Floats, cell: float, room: int) -> Cells:
    """Empty cells over the extent of points (x, y), for up to ``room`` boxes."""
    columns, rows = int(np.ptp(x) / cell) + 1, int(np.ptp(y) / cell) + 1
    shape = np.array([x.min(), y.min(), cell, columns, rows], dtype=np.float64)
    none = np.full(columns * rows, -1, np.int64)
    return Cells(
        shape,
        none,
        np.full(room, -1, np.int64),
        np.zeros((room, 3)),
        np.zeros(room, np.int32),
        np.zeros(1, np.int64),
    )


@njit(cache=True)
def _at(value: float, low: float, cell: float, count: int) -> int:
    return min(max(int(np.floor((value - low) / cell)), 0), count - 1)


@njit(cache=True)
def put(c: Cells, boxes: Floats, group: Index) -> None:
    """Add (n, 3+) boxes of (n,) groups; there must be room."""
    columns, rows = int(c.shape[3]), int(c.shape[4])
    for i in range(len(boxes)):
        k = c.size[0]
        c.size[0] += 1
        where = _at(boxes[i, 1], c.shape[1], c.shape[2], rows) * columns + _at(
            boxes[i, 0], c.shape[0], c.shape[2], columns
        )
        c.box[k, 0], c.box[k, 1], c.box[k, 2] = boxes[i, 0], boxes[i, 1], boxes[i, 2]
        c.group[k], c.after[k], c.head[where] = group[i], c.head[where], k


@njit(cache=True)
def meets_group(
    c: Cells, x: float, y: float, heading: float, half_l: float, half_w: float, one: int, other: int
) -> bool:
    """Whether a box meets one of a group other than ``one`` and ``other``; cells are wider than two boxes."""
    columns, rows = int(c.shape[3]), int(c.shape[4])
    column, row = _at(x, c.shape[0], c.shape[2], columns), _at(y, c.shape[1], c.shape[2], rows)
    for r in range(max(row - 1, 0), min(row + 2, rows)):
        for q in range(max(column - 1, 0), min(column + 2, columns)):
            k = c.head[r * columns + q]
            while k >= 0:
                if c.group[k] != one and c.group[k] != other:
                    if boxes_meet(x, y, heading, c.box[k, 0], c.box[k, 1], c.box[k, 2], half_l, half_w):
                        return True
                k = c.after[k]
    return False


@njit(cache=True)
def spur_is_free(
    path: Floats, every: Cells, safe: Cells, parked: Cells, swept: Cells, half_l: float, half_w: float,
    lane: int, reverse: int
) -> bool:  # fmt: skip
    """Whether a spur (n, 4) touches no parked truck and no safe part of other lanes than ``lane`` and
    ``reverse``, its end nothing.

    From the bay outwards: most ground that is taken is taken there.
    """
    last = len(path) - 1
    x, y, h = path[last, 0], path[last, 1], path[last, 2]
    if meets_group(every, x, y, h, half_l, half_w, -1, -1) or meets_group(
        swept, x, y, h, half_l, half_w, -1, -1
    ):
        return False
    for i in range(last, -1, -1):
        x, y, h = path[i, 0], path[i, 1], path[i, 2]
        if meets_group(parked, x, y, h, half_l, half_w, -1, -1):
            return False
        if i < last and meets_group(safe, x, y, h, half_l, half_w, lane, reverse):
            return False
    return True


def grown(c: Cells, more: int) -> Cells:
    """The same cells with room for ``more`` boxes."""
    if c.size[0] + more <= len(c.after):
        return c
    room, n = 2 * len(c.after) + more, len(c.after)
    after, box, group = np.full(room, -1, np.int64), np.zeros((room, 3)), np.zeros(room, np.int32)
    after[:n], box[:n], group[:n] = c.after, c.box, c.group
    return Cells(c.shape, c.head, after, box, group, c.size)

"""Thinning of a picture to lines one pixel wide (Zhang and Suen, 1984, doi:10.1145/357994.358023)."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

AROUND = np.array([[-1, 0], [-1, 1], [0, 1], [1, 1], [1, 0], [1, -1], [0, -1], [-1, -1]])


@njit(cache=True)
def _removable(picture: NDArray[np.uint8], r: int, c: int, second: bool) -> bool:
    n = np.empty(8, np.uint8)
    for k in range(8):
        n[k] = picture[r + AROUND[k, 0], c + AROUND[k, 1]]
    count = rises = 0
    for k in range(8):
        count += n[k]
        rises += n[k] == 0 and n[(k + 1) % 8] == 1
    if count < 2 or count > 6 or rises != 1:
        return False
    if second:
        return n[0] * n[2] * n[6] == 0 and n[0] * n[4] * n[6] == 0
    return n[0] * n[2] * n[4] == 0 and n[2] * n[4] * n[6] == 0


@njit(cache=True)
def thin(picture: NDArray[np.uint8]) -> None:
    """Thin ``picture`` (0 or 1, its rim 0) in place; the work follows the pixels that are left."""
    rows, columns = np.nonzero(picture)
    while True:
        removed = 0
        for second in (False, True):
            going = np.zeros(len(rows), np.bool_)
            for k in range(len(rows)):
                going[k] = _removable(picture, rows[k], columns[k], second)
            for k in range(len(rows)):
                if going[k]:
                    picture[rows[k], columns[k]] = 0
                    removed += 1
            rows, columns = rows[~going], columns[~going]
        if removed == 0:
            return

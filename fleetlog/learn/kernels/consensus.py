"""Mean shift across the direction of travel: traces of one lane gather on its centre line."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@njit(cache=True)
def shift(
    x: Floats, y: Floats, cos: Floats, sin: Floats, weight: Floats, first: Ints, columns: int, rows: int,
    x0: float, y0: float, side: float, along: float, across: float, alike: float, either: bool, rounds: int,
) -> tuple[Floats, Floats]:  # fmt: skip
    """(N,) metres to the left to the local mean of cells that head alike, and the weight about there.

    Cells are sorted by block of ``side`` m, column after column; block b owns ``first[b]`` to ``first[b +
    1]``. ``along``, ``across`` are the standard deviations of the kernel [m], ``alike`` the least cosine
    between headings that count as one direction.  With ``either`` the opposite one counts too, and the kernel
    is flat up to ``across``: lines farther apart than that do not pull at one another at all.
    """
    out, near = np.zeros(len(x)), np.zeros(len(x))
    for i in range(len(x)):
        moved = 0.0
        for _ in range(rounds):
            px, py = x[i] - sin[i] * moved, y[i] + cos[i] * moved
            bi, bj = int((px - x0) / side), int((py - y0) / side)
            total = value = 0.0
            for a in range(max(bi - 1, 0), min(bi + 2, columns)):
                low, high = max(bj - 1, 0), min(bj + 2, rows)
                if low >= high:
                    continue
                for k in range(first[a * rows + low], first[a * rows + high - 1 + 1]):
                    facing = cos[k] * cos[i] + sin[k] * sin[i]
                    if facing < alike and not (either and facing < -alike):
                        continue
                    dx, dy = x[k] - px, y[k] - py
                    ahead = (dx * cos[i] + dy * sin[i]) / along
                    left = dy * cos[i] - dx * sin[i]
                    far = ahead * ahead
                    if not either:
                        far += (left / across) ** 2
                    elif abs(left) > across:
                        continue
                    if far < 9.0:
                        w = weight[k] * np.exp(-0.5 * far)
                        total += w
                        value += w * left
            near[i] = total
            if total == 0.0:
                break
            step = value / total
            moved += step
            if abs(step) < 0.01:
                break
        out[i] = moved
    return out, near

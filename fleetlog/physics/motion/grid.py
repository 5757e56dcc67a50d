"""Where a motion is evaluated.

Every row's share of time in pieces short enough for the convex switch of the drive.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

FINEST = 0.25
"""Length of a step that resolves a braking truck [s]."""


@dataclass(frozen=True)
class Grid:
    """n samples of some rows, in order of time; (n,) each.

    ``row`` that a sample belongs to; it stands for ``dt`` [s] from ``begin`` on by the clock of the rows,
    ``time`` is its middle or its row's stamp; ``moment`` is when the truck did what is logged then (earlier
    where power lags).
    """

    row: Ints
    time: Floats
    begin: Floats
    dt: Floats
    moment: Floats


def row_spans(t: Floats, breaks: Flags) -> tuple[Floats, Floats]:
    """(rows,) seconds that each row stands for before and after its stamp.

    Half-way to its neighbours, nothing across a break.
    """
    half = 0.5 * np.where(breaks[1:], 0.0, np.diff(t))
    return np.append(0.0, half), np.append(half, 0.0)


def sample_grid(t: Floats, breaks: Flags, quiet: Flags, lag: float) -> Grid:
    """The samples of (rows,) times.

    None longer than ``FINEST``, but one for each ``quiet`` row, in which nothing moves.
    """
    before, after = row_spans(t, breaks)
    whole = quiet | (before + after <= FINEST * (1.0 + 1e-6))
    left, right = (
        np.where(whole, n, np.ceil(part / FINEST - 1e-6)).astype(np.int64)
        for n, part in ((1, before), (0, after))
    )
    # A row that stands for no time keeps one sample, so that every row has a place.
    left = np.where(left + right == 0, 1, left)
    count = left + right
    row = np.repeat(np.arange(len(t)), count)
    place = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    back, early, late = (
        place < left[row],
        (before / np.maximum(left, 1))[row],
        (after / np.maximum(right, 1))[row],
    )
    begin = np.where(back, early * place - before[row], late * (place - left[row]))
    dt = np.where(back, early, late)
    single = whole[row]
    begin = t[row] + np.where(single, -before[row], begin)
    dt = np.where(single, (before + after)[row], dt)
    time = np.where(single, t[row], begin + 0.5 * dt)
    return Grid(row, time, begin, dt, _within(time - lag, t, breaks, row))


def _within(moment: Floats, t: Floats, breaks: Flags, row: Ints) -> Floats:
    """Moments held within the stretch of their row."""
    first = np.flatnonzero(breaks)
    stretch = (np.cumsum(breaks) - 1)[row]
    last = np.append(first[1:], len(t)) - 1
    return np.clip(moment, t[first][stretch], t[last][stretch])


def quiet_rows(rest: Flags, breaks: Flags, height: Floats) -> Flags:
    """(rows,) about which nothing moves, neither the truck nor its forks."""
    still = rest[1:] & rest[:-1] & (np.diff(height) == 0.0) | breaks[1:]
    return np.asarray(rest & np.append(still, True) & np.append(True, still))

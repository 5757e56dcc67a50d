"""Where a motion is evaluated: every row's time in pieces short enough for the convex switch of the drive."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.trajectory import Floats, Ints

Flags = NDArray[np.bool_]

FINEST = 0.25  # Length of a step that resolves a braking truck [s]


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
    """(rows,) seconds that each row stands for before and after its stamp: half-way to its neighbours."""
    half = 0.5 * np.where(breaks[1:], 0.0, np.diff(t))
    return np.append(0.0, half), np.append(half, 0.0)


def sample_grid(t: Floats, breaks: Flags, quiet: Flags, lag: float) -> Grid:
    """The samples of (rows,) times, none longer than ``FINEST``; one for each ``quiet`` row."""
    before, after = row_spans(t, breaks)
    whole = quiet | (before + after <= FINEST * (1.0 + 1e-6))
    left, right = (
        np.where(whole, n, np.ceil(part / FINEST - 1e-6)).astype(np.int64)
        for n, part in ((1, before), (0, after))
    )
    row = np.repeat(np.arange(len(t)), left + right)
    place = np.arange(len(row)) - np.repeat(np.cumsum(left + right) - left - right, left + right)
    back, single = place < left[row], whole[row]
    early, late = (before / np.maximum(left, 1))[row], (after / np.maximum(right, 1))[row]
    begin = t[row] + np.where(back, early * place - before[row], late * (place - left[row]))
    dt = np.where(single, (before + after)[row], np.where(back, early, late))
    time = np.where(single, t[row], begin + 0.5 * dt)
    # When it was done lies within the stretch of the row.
    first = np.flatnonzero(breaks)
    last, stretch = np.append(first[1:], len(t)) - 1, (np.cumsum(breaks) - 1)[row]
    return Grid(row, time, begin, dt, np.clip(time - lag, t[first][stretch], t[last][stretch]))


def quiet_rows(rest: Flags, breaks: Flags, height: Floats) -> Flags:
    """(rows,) about which nothing moves, neither the truck nor its forks."""
    still = rest[1:] & rest[:-1] & (np.diff(height) == 0.0) | breaks[1:]
    return np.asarray(rest & np.append(still, True) & np.append(True, still))

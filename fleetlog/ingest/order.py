"""The order of time within a file: late rows are sorted in, wrong clocks refused, restarted logs kept.

The rows of a vehicle fall into *runs*: a run ends where time steps back by more than ``WINDOW`` or leaps
ahead by more than ``LEAP``.  A run of fewer than ``SHORT`` rows beside a step back is a clock gone wrong and
is refused; a longer one is the log starting again (files put together in another order) and is kept.
"""

import numpy as np

from fleetlog.core.trajectory import Ints, Trajectory
from fleetlog.importers._times import EARLIEST
from fleetlog.ingest.rows import join

WINDOW = 60_000_000  # A row may come this late and is still sorted in [us]
LEAP = 3600_000_000  # A longer silence begins a new run [us]
SHORT = 5  # Rows; a run with fewer beside a step back is refused
BACKWARDS = "time runs backwards"


class Order:
    """The rows of one vehicle in one file, batch by batch; the last short run waits for the next batch."""

    def __init__(self) -> None:
        self._waiting: list[Trajectory] = []
        self._end, self._size = EARLIEST - 2 * LEAP, 0
        """Latest time of the last run that was kept [us], and its rows so far."""

    def sift(self, rows: Trajectory, *, last: bool = False) -> tuple[Trajectory, Trajectory]:
        """Rows to keep and rows to refuse."""
        rows, self._waiting = join([*self._waiting, rows]), []
        begin = run_starts(rows.time)
        keep = np.ones(len(rows), bool)
        for start, stop in zip(begin, [*begin[1:], len(rows)], strict=True):
            run, size, final = rows.time[start:stop], stop - start, stop == len(rows)
            goes_on = start == 0 and self._end - WINDOW <= run[0] <= self._end + LEAP
            if goes_on:
                size += self._size
            if size < SHORT and final and not last:
                self._waiting = [rows[start:]]
                rows, keep = rows[:start], keep[:start]
                break
            back = run[0] < self._end - WINDOW or (not final and rows.time[stop] < run.max() - WINDOW)
            if size < SHORT and back:
                keep[start:stop] = False
            else:
                self._end = max(int(run.max()), self._end) if goes_on else int(run.max())
                self._size = size
        return rows[keep], rows[~keep]

    def flush(self) -> list[tuple[Trajectory, Trajectory]]:
        """What still waits at the end of the file."""
        waiting, self._waiting = self._waiting, []
        return [self.sift(rows, last=True) for rows in waiting]


def run_starts(time: Ints) -> list[int]:
    """First rows of the runs."""
    step = np.diff(time)
    late = (time < np.maximum.accumulate(time) - WINDOW).any()  # small steps back may add up
    if not late and not (step > LEAP).any():
        return [0][: len(time)]
    starts, high, before = [0], int(time[0]), 0
    for at in (np.flatnonzero((step < 0) | (step > LEAP)) + 1).tolist():
        high = max(high, int(time[before:at].max()))
        if not high - WINDOW <= time[at] <= high + LEAP:
            starts.append(at)
            high = int(time[at])
        before = at
    return starts

"""The order of time within a file: late rows are sorted in, wrong clocks refused, restarted logs kept.

The rows of a vehicle fall into *runs*: a run ends where time steps back by more than ``WINDOW`` or leaps
ahead by more than ``LEAP``.  A run of fewer than ``SHORT`` rows beside a step back is a clock gone wrong and
is refused; a longer one is the log starting again (files put together in another order) and is kept.
"""

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.trajectory import Ints, Trajectory
from fleetlog.ingest.rows import join

WINDOW = 60_000_000
"""A row may come this late and is still sorted in [us]."""
LEAP = 3600_000_000
"""A longer silence begins a new run [us]."""
SHORT = 5
"""Rows; a run with fewer beside a step back is refused."""
BACKWARDS = "time runs backwards"

Mask = NDArray[np.bool_]


class Order:
    """The rows of one vehicle in one file, batch by batch; the last short run waits for the next batch."""

    def __init__(self) -> None:
        self._waiting: Trajectory | None = None
        self._end: int | None = None
        """Latest time of the last run that was kept [us]."""
        self._size = 0
        """Rows of that run so far."""

    def sift(self, rows: Trajectory, *, last: bool = False) -> tuple[Trajectory, Trajectory]:
        """Rows to keep and rows to refuse."""
        if self._waiting is not None:
            rows, self._waiting = join([self._waiting, rows]), None
        begin = run_starts(rows.time)
        ends = np.append(begin[1:], len(rows))
        keep = np.ones(len(rows), bool)
        for k, (start, stop) in enumerate(zip(begin.tolist(), ends.tolist(), strict=True)):
            run = rows.time[start:stop]
            size = stop - start + (self._size if k == 0 and self._goes_on(int(run[0])) else 0)
            final = k == len(begin) - 1
            if size < SHORT and final and not last:
                self._waiting = rows[start:stop]
                rows, keep = rows[:start], keep[:start]
                break
            if size < SHORT and self._alone(run, None if final else int(rows.time[stop])):
                keep[start:stop] = False
            else:
                self._end = max(int(run.max()), self._end or 0) if size > stop - start else int(run.max())
                self._size = size
        return rows[keep], rows[~keep]

    def _goes_on(self, time: int) -> bool:
        """Whether a row belongs to the run before it."""
        return self._end is not None and self._end - WINDOW <= time <= self._end + LEAP

    def _alone(self, run: Ints, after: int | None) -> bool:
        """Whether a short run is out of order with its neighbours."""
        back = self._end is not None and int(run[0]) < self._end - WINDOW
        return back or (after is not None and after < int(run.max()) - WINDOW)

    def flush(self) -> tuple[Trajectory, Trajectory] | None:
        """What still waits at the end of the file."""
        if self._waiting is None:
            return None
        rows, self._waiting = self._waiting, None
        return self.sift(rows, last=True)


def run_starts(time: Ints) -> NDArray[np.int64]:
    """First rows of the runs."""
    if not len(time):
        return np.zeros(0, np.int64)
    step = np.diff(time)
    late = (time < np.maximum.accumulate(time) - WINDOW).any()  # small steps back may add up
    if not late and not (step > LEAP).any():
        return np.zeros(1, np.int64)
    starts, high = [0], int(time[0])
    suspicious = np.flatnonzero((step < 0) | (step > LEAP)) + 1
    before = 0
    for at in suspicious.tolist():
        high = max(high, int(time[before:at].max()))
        if time[at] < high - WINDOW or time[at] > high + LEAP:
            starts.append(at)
            high = int(time[at])
        before = at
    return np.array(starts, dtype=np.int64)

"""A timeline without the silences of a log, beside that of the clock: weeks play as their shifts."""

from dataclasses import dataclass

import numpy as np

from fleetlog.core.trajectory import Ints
from fleetlog.store import Dataset

SKIPPED = "gaps skipped"
"""Name of the timeline."""
MINUTE, QUIET = 60_000_000, 30
"""A silence of the whole fleet longer than so many minutes is skipped; a minute [us]."""
MOST_LINES = 20


@dataclass(frozen=True)
class Clock:
    """The periods with data: ``starts`` and ``ends`` (N,) [us]."""

    starts: Ints
    ends: Ints

    def __call__(self, time: Ints) -> Ints:
        """(M,) time since the first start, silences left out [us]."""
        before = np.cumsum(self.ends - self.starts) - (self.ends - self.starts)
        k = np.maximum(np.searchsorted(self.starts, time, side="right") - 1, 0)
        return np.asarray(before[k] + np.clip(time, self.starts[k], self.ends[k]) - self.starts[k])

    @property
    def seconds(self) -> float:
        """Length of all periods."""
        return float((self.ends - self.starts).sum()) * 1e-6

    def lines(self) -> list[str]:
        """When each period begins, on either timeline."""
        out = [f"{len(self.starts)} periods with data, which the timeline *{SKIPPED}* plays in turn:"]
        for start, at in zip(self.starts[:MOST_LINES], self(self.starts[:MOST_LINES]), strict=True):
            shown = str(np.datetime64(int(start), "us"))[:16].replace("T", " ")
            out.append(f"{int(at) // 60 // MINUTE}:{int(at) // MINUTE % 60:02d} h is {shown} UTC")
        more = len(self.starts) - MOST_LINES
        return [*out, f"and {more} more"] if more > 0 else out


def clock_of(dataset: Dataset) -> Clock | None:
    """The clock that skips the silences of a recording; None where it has none."""
    if dataset.kind != "recorded":
        return None
    days = [np.unique(t.time // MINUTE) for t in dataset.days(())]
    minutes = np.unique(np.concatenate([np.zeros(0, np.int64), *days]))
    later = np.flatnonzero(np.diff(minutes) > QUIET)
    if not len(later):
        return None
    starts, ends = minutes[np.append(0, later + 1)], minutes[np.append(later, len(minutes) - 1)] + 1
    return Clock(starts * MINUTE, ends * MINUTE)

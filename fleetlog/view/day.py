"""One day of a dataset, for a replay of it alone."""

from pathlib import Path

import numpy as np

from fleetlog.errors import InputError
from fleetlog.store import Dataset

MOST = 7
"""Days that an error names."""


class Day(Dataset):
    """A dataset as if it held the rows of one day (UTC, YYYY-MM-DD) alone."""

    def __init__(self, path: str | Path, date: str) -> None:
        super().__init__(path)
        if date not in self.dates:
            more = f" and {len(self.dates) - MOST} more" if self.dates[MOST:] else ""
            do = f"choose from {', '.join(self.dates[:MOST])}{more}"
            raise InputError(f"no rows on {date} (UTC)", where=path, do=do)
        self.dates = [date]
        self.vehicle_days = [day for day in self.vehicle_days if day[1] == date]
        times = {t.vehicle_id: t.time for t in self.days(())}
        self.span = int(min(t[0] for t in times.values())), int(max(t[-1] for t in times.values()))
        """First and last time [us]."""
        start, end = (f"{np.datetime64(moment, 'us')}Z" for moment in self.span)
        self.meta |= {
            "start": start, "end": end, "rows": sum(map(len, times.values())),
            "vehicles": {name: about for name, about in self.meta["vehicles"].items() if name in times},
        }  # fmt: skip


def opened(path: str | Path, day: str | None) -> Dataset:
    """The dataset, or one ``day`` of it."""
    return Dataset(path) if day is None else Day(path, day)

"""Repeat the first days of a dataset with later dates and trip ids: a month from a few simulated days.

python tests/benchmarks/repeat.py SOURCE TARGET DAYS TOTAL
"""

import sys

from fleetlog.core.trajectory import Trajectory
from fleetlog.store import Dataset, DatasetWriter

DAY = 86_400_000_000


def repeat(source: Dataset, target: str, days: int, total: int) -> None:
    """Write ``total`` days, the first ``days`` of the source again and again."""
    with DatasetWriter.create(target, "recorded", source.site) as writer:
        for vehicle in source.vehicles:
            own = [source.read(vehicle, date) for date in source.dates[:days]]
            trips = max(int(t.trip_ids().max()) for t in own) + 1
            for number in range(total):
                turn, t = number // days, own[number % days]
                moved = Trajectory(vehicle, t.time + turn * days * DAY, dict(t.columns))
                writer.write(moved.with_columns(trip_id=t.trip_ids() + turn * trips))
        writer.provenance = source.meta["provenance"]


if __name__ == "__main__":
    repeat(Dataset(sys.argv[1]), sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))

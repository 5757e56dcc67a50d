"""What a dataset holds: of rows that were just written, or of those that were there before."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.store.dataset import Dataset


@dataclass
class Written:
    """What is known of some rows, by vehicle; times [us]."""

    rows: dict[str, int] = field(default_factory=dict)
    first: dict[str, int] = field(default_factory=dict)
    last: dict[str, int] = field(default_factory=dict)
    columns: dict[str, str] = field(default_factory=dict)
    """The unit of every column."""
    trips: list[dict[str, NDArray[Any]]] = field(default_factory=list)
    """Of rows that were just written; those of a dataset are in its table."""
    next_trip: dict[str, int] = field(default_factory=dict)
    """The first trip id that a vehicle of a dataset has not had."""
    parts: dict[tuple[str, str], int] = field(default_factory=dict)
    """Files by vehicle and date."""

    def add(self, other: Written) -> None:
        """Take in what another writer has written, of other vehicles or later."""
        for vehicle, rows in other.rows.items():
            self.rows[vehicle] = self.rows.get(vehicle, 0) + rows
        self.first = {**other.first, **self.first}
        self.last |= other.last
        self.columns |= {name: unit for name, unit in other.columns.items() if name not in self.columns}
        self.trips += other.trips


def before_of(dataset: Dataset) -> Written:
    """What is known of a dataset before rows are added to it."""
    rows, start = dict(dataset.meta["vehicles"]), dataset.meta["start"]
    out = Written(rows, columns=dataset.meta["columns"])
    out.parts = {day: len(dataset.parts(*day)) for day in dataset.vehicle_days}
    if start is not None:
        out.first = dict.fromkeys(rows, int(np.datetime64(start[:-1], "us").astype(np.int64)))
    if len(dataset.trips):
        by_vehicle = dataset.trips.groupby("vehicle_id")
        end = by_vehicle.end.max().dt.tz_localize(None).astype("datetime64[us]").astype(np.int64)
        out.last = dict(zip(end.index, end.tolist(), strict=True))
        out.next_trip = dict(zip(end.index, (by_vehicle.trip_id.max() + 1).tolist(), strict=True))
    return out

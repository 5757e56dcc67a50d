"""What a dataset holds: of rows that were just written, and of those that were there before."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.store.dataset import Dataset

if TYPE_CHECKING:
    import pandas as pd


@dataclass
class Written:
    """What a writer knows of the rows that it has written, by vehicle."""

    rows: dict[str, int] = field(default_factory=dict)
    first: dict[str, int] = field(default_factory=dict)
    last: dict[str, int] = field(default_factory=dict)
    columns: dict[str, str] = field(default_factory=dict)
    """The unit of every column."""
    trips: list[dict[str, NDArray[Any]]] = field(default_factory=list)

    def add(self, other: Written) -> None:
        """Take in what another writer has written, of other vehicles or later."""
        for vehicle, rows in other.rows.items():
            self.rows[vehicle] = self.rows.get(vehicle, 0) + rows
            self.first.setdefault(vehicle, other.first[vehicle])
            self.last[vehicle] = other.last[vehicle]
        self.columns.update({n: u for n, u in other.columns.items() if n not in self.columns})
        self.trips += other.trips


def before_of(dataset: Dataset) -> Before:
    """What is known of a dataset before rows are added to it."""
    trips, meta = dataset.trips, dataset.meta
    ends: Any = trips.groupby("vehicle_id").end.max() if len(trips) else {}
    last = {str(v): int(np.datetime64(t.tz_localize(None), "us").astype(np.int64)) for v, t in ends.items()}
    first = None if meta["start"] is None else int(np.datetime64(meta["start"][:-1], "us").astype(np.int64))
    parts = {d: len(dataset.parts(*d)) for d in dataset.vehicle_days}
    told = meta["columns"], trips, meta["provenance"], meta["summary"], dataset.path / "rejected.parquet"
    return Before(dict(meta["vehicles"]), first, last, parts, *told)


@dataclass(frozen=True)
class Before:
    """What a dataset that is added to holds: by vehicle rows and times [us]; units of columns; trips."""

    rows: dict[str, int] = field(default_factory=dict)
    first: int | None = None
    last: dict[str, int] = field(default_factory=dict)
    parts: dict[tuple[str, str], int] = field(default_factory=dict)
    columns: dict[str, str] = field(default_factory=dict)
    trips: pd.DataFrame | None = None
    provenance: dict[str, Any] = field(default_factory=dict)
    summary: dict[str, Any] = field(default_factory=dict)
    rejected: Path | None = None
    """The file of the rows that were refused, if there is one."""

    def next_trip(self, vehicle: str) -> int:
        """The first trip id that a vehicle has not had."""
        if self.trips is None or not len(self.trips):
            return 0
        own = self.trips.trip_id[self.trips.vehicle_id == vehicle]
        return int(own.max()) + 1 if len(own) else 0

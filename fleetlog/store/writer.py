"""Writing a dataset: Parquet parts by day and vehicle, trips, description; whole or not at all."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from fleetlog.core.columns import HIVE_NULL
from fleetlog.core.site import Site, site_to_dict
from fleetlog.core.trajectory import Trajectory, to_arrow
from fleetlog.errors import DataError
from fleetlog.store.dataset import Dataset
from fleetlog.store.documents import write_json
from fleetlog.store.events import Tables
from fleetlog.store.output import PARTIALS, atomic_output, share
from fleetlog.store.places import is_url, located, uploaded
from fleetlog.store.trips import table_of, trip_columns
from fleetlog.store.written import Before, Written, before_of
from fleetlog.version import FORMAT_VERSION

Kind = Literal["recorded", "simulated"]
DAY = 86_400_000_000
ROW_GROUP, BATCH = 1 << 17, 1 << 13
REPEATED = {"payload", "fork_height", "ambient_temperature"}
"""Numbers that stay the same for many rows."""
SELECTED = ["timestamp", "x", "y", "edge_id", "trip_id"]
"""Columns by which rows are selected: statistics of all columns would cost a fifth of writing."""


class DatasetWriter:
    """A dataset being written in the scratch folder ``path``; made by :meth:`create`.

    ``write`` takes trajectories in order of time for each vehicle, any number of pieces; vehicles in any
    order, and in several threads as long as each vehicle is written by one at a time: files and tables come
    out the same.
    """

    def __init__(self, path: Path, kind: Kind, site: Site, before: Before | None = None) -> None:
        self.before = before or Before()
        self.path, self.kind, self.site = path, kind, site
        self.compression: Literal["zstd", "snappy"] = "zstd"
        self.provenance: dict[str, Any] = {}
        self.summary: dict[str, Any] = {}
        self.tables = Tables(path)
        self.written = Written()
        self._parts: dict[tuple[str, str], int] = {}

    @classmethod
    @contextmanager
    def create(
        cls,
        target: str | Path,
        kind: Kind,
        site: Site,
        *,
        overwrite: bool = False,
        inputs: Iterable[Path] = (),
    ) -> Iterator[DatasetWriter]:
        """A writer whose dataset appears as ``target`` when the block ends well; ``inputs`` are read."""
        if is_url(target):
            place = uploaded(located(target), overwrite=overwrite)
        else:
            place = atomic_output(target, f"{kind} dataset", overwrite=overwrite, inputs=inputs)
        with place as scratch:
            writer = cls(scratch, kind, site)
            yield writer
            writer.finish()

    @classmethod
    @contextmanager
    def append(cls, target: str | Path, *, inputs: Iterable[Path] = ()) -> Iterator[DatasetWriter]:
        """A writer whose rows are added to the recorded dataset ``target`` when the block ends well.

        No file of its rows is written again: the new dataset takes the place of the older one at once, and
        shares them with it (as hard links; copies where the file system has none).
        """
        old = Dataset(target)
        if old.kind != "recorded":
            raise DataError(f"is {old.kind}, not recorded: nothing can be added", where=target)
        before, remote = before_of(old), is_url(target)
        local = partial(atomic_output, target, "recorded dataset", overwrite=True, inputs=inputs)
        with uploaded(old.path, new=False) if remote else local() as scratch:
            if not remote:
                for name in ("trajectories", PARTIALS):
                    share(old.path / name, scratch / name)
            writer = cls(scratch, "recorded", old.site, before)
            yield writer
            writer.finish()

    def write(self, trajectory: Trajectory) -> None:
        """Append the rows of one vehicle; they must be later than those already written for it."""
        self.write_together((trajectory.vehicle_id,), trajectory)

    def write_together(self, vehicles: Sequence[str], rows: Trajectory) -> None:
        """Append rows of several vehicles, as many of each, one vehicle after the other, as one table."""
        each = len(rows) // len(vehicles)
        if not each:
            return
        pieces = [slice(k * each, (k + 1) * each) for k in range(len(vehicles))]
        for vehicle, piece in zip(vehicles, pieces, strict=True):
            self._check(replace(rows, vehicle_id=vehicle)[piece])
        table = to_arrow(rows, part=True)
        self._name_columns(table.schema)
        for vehicle, piece in zip(vehicles, pieces, strict=True):
            time = rows.time[piece]
            for begin, end in _day_ranges(time):
                rows_of_day = table[piece.start + begin : piece.start + end]
                self._write_part(vehicle, int(time[begin]) // DAY, rows_of_day)
            self.written.first.setdefault(vehicle, int(time[0]))
            self.written.last[vehicle] = int(time[-1])
            self.written.rows[vehicle] = self.written.rows.get(vehicle, 0) + each
        if rows.has("trip_id"):
            self.written.trips.append(trip_columns(rows, vehicles))

    def _check(self, piece: Trajectory) -> None:
        piece.check()
        vehicle = piece.vehicle_id
        if piece.time[0] <= self.written.last.get(vehicle, self.before.last.get(vehicle, -(1 << 62))):
            raise DataError(f"vehicle {vehicle}: rows are not later than those already written")

    def _name_columns(self, schema: pa.Schema) -> None:
        for name in schema.names:
            if name not in self.written.columns:
                self.written.columns[name] = (schema.field(name).metadata or {}).get(b"unit", b"").decode()

    def _write_part(self, vehicle: str, day: int, table: pa.Table) -> None:
        date = str(np.datetime64(day, "D"))
        folder = self.path / "trajectories" / f"date={date}" / f"vehicle_id={quote(vehicle, safe='')}"
        number = self._parts.get((vehicle, date), self.before.parts.get((vehicle, date), 0))
        self._parts[vehicle, date] = number + 1
        if number == self.before.parts.get((vehicle, date), 0):
            if vehicle == HIVE_NULL:
                do = "rename it: readers take it for unknown"
                raise DataError(f"no vehicle can be called {HIVE_NULL}", do=do)
            folder.mkdir(parents=True, exist_ok=True)
        with pa.OSFile(str(folder / f"part-{number:05d}.parquet"), "wb") as file:
            pq.write_table(
                table, file, compression=self.compression, row_group_size=ROW_GROUP,
                use_dictionary=_repeated(table.schema), column_encoding={"timestamp": "DELTA_BINARY_PACKED"},
                write_statistics=SELECTED, write_batch_size=BATCH,
            )  # fmt: skip

    def finish(self) -> None:
        """Write trips, site and description; :meth:`create` calls it."""
        self._write_trips()
        write_json(self.path / "site.json", site_to_dict(self.site))
        before, written = self.before, self.written
        columns = {"vehicle_id": "", **before.columns, **written.columns}
        rows = {v: before.rows.get(v, 0) + written.rows.get(v, 0) for v in {**before.rows, **written.rows}}
        first = [*written.first.values(), *([] if before.first is None else [before.first])]
        last = [*written.last.values(), *before.last.values()]
        start, end = (_iso(min(first)), _iso(max(last))) if rows else (None, None)
        frame = None if self.site.frame is None else asdict(self.site.frame)
        edges = 0 if self.site.network is None else len(self.site.network)
        description = {
            "format_version": FORMAT_VERSION, "kind": self.kind,
            "site": {"name": self.site.name, "frame": frame, "edges": edges},
            "vehicles": dict(sorted(rows.items())), "start": start, "end": end, "rows": sum(rows.values()),
            "columns": columns, "provenance": self.provenance, "summary": self.summary,
        }  # fmt: skip
        if tables := self.tables.close():
            description["tables"] = tables
        # Written last: a folder without it is no dataset.
        write_json(self.path / "dataset.json", description, indent=1)

    def _write_trips(self) -> None:
        import pandas as pd

        from fleetlog.store.trips import merge_split_trips

        table = table_of(self.written.trips)
        trips = merge_split_trips(table) if len(table) else pd.DataFrame({"vehicle_id": [], "trip_id": []})
        if self.before.trips is not None and len(self.before.trips):
            trips = pd.concat([self.before.trips, trips]) if len(trips) else self.before.trips
            trips = trips.sort_values(["vehicle_id", "trip_id"], ignore_index=True)
        trips.to_parquet(self.path / "trips.parquet", index=False)


@lru_cache(maxsize=64)
def _repeated(schema: pa.Schema) -> list[str]:
    """Columns worth a dictionary: one of measured numbers, all different, costs more than it saves."""
    measured = ("double", "timestamp[us, tz=UTC]")
    return [f.name for f in schema if f.name in REPEATED or str(f.type) not in measured]


def _day_ranges(time: NDArray[np.int64]) -> list[tuple[int, int]]:
    if time[0] // DAY == time[-1] // DAY:
        return [(0, len(time))]
    cuts = [0, *(np.flatnonzero(np.diff(time // DAY)) + 1).tolist(), len(time)]
    return list(itertools.pairwise(cuts))


def _iso(microseconds: int) -> str:
    return str(np.datetime64(microseconds, "us")) + "Z"

"""Writing a dataset: Parquet parts by day and vehicle, trips, description; whole or not at all."""

import itertools
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple
from urllib.parse import quote

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fleetlog.core.arrays import DAY
from fleetlog.core.columns import HIVE_NULL
from fleetlog.core.files import is_url, located
from fleetlog.core.site import Site, site_to_dict
from fleetlog.core.trajectory import Trajectory, to_arrow
from fleetlog.errors import DataError
from fleetlog.store.dataset import Dataset, uploaded
from fleetlog.store.documents import write_json
from fleetlog.store.events import Tables
from fleetlog.store.output import PARTIALS, atomic_output, share
from fleetlog.store.trips import Columns, contents_of, trip_pieces, trips_of
from fleetlog.version import FORMAT_VERSION

Kind = Literal["recorded", "simulated"]
ROW_GROUP, BATCH = 1 << 17, 1 << 13
MEASURED = (pa.float64(), pa.timestamp("us", "UTC"))
REPEATED = {"payload", "fork_height", "ambient_temperature"}  # Numbers that stay the same for many rows
SELECTED = ["timestamp", "x", "y", "edge_id", "trip_id"]
"""Columns by which rows are selected: statistics of all columns would cost a fifth of writing."""


class Older(NamedTuple):
    """What a dataset holds to which rows are added."""

    last: dict[str, int]  # By vehicle the time of its last row [us]
    next_trip: dict[str, int]  # The first trip id that a vehicle has not had
    parts: dict[tuple[str, str], int]  # Files by vehicle and date


NOTHING = Older({}, {}, {})


class DatasetWriter:
    """A dataset being written in the scratch folder ``path``; made by :meth:`create`.

    ``write`` takes trajectories in order of time for each vehicle, any number of pieces; vehicles in any
    order, and in several threads, each vehicle by one at a time: files and tables come out the same."""

    def __init__(self, path: Path, kind: Kind, site: Site, before: Older = NOTHING) -> None:
        self.path, self.kind, self.site, self.before = path, kind, site, before
        self.old: Dataset | None = None  # That is added to; ``before`` is what it holds
        self.compression: Literal["zstd", "snappy"] = "zstd"
        self.provenance: dict[str, Any] = {}
        self.summary: dict[str, Any] = {}
        self.tables = Tables(path)
        self.columns: dict[str, str] = {}  # The unit of every column written
        self.pieces: list[Columns] = []  # Of the trips written
        self._last, self._parts = dict(before.last), Counter(before.parts)

    @classmethod
    @contextmanager
    def create(
        cls, target: str | Path, kind: Kind, site: Site, *, overwrite: bool = False,
        inputs: Iterable[Path] = (), old: Dataset | None = None,
    ) -> Iterator["DatasetWriter"]:  # fmt: skip
        """A writer whose dataset appears as ``target`` when the block ends well; ``inputs`` are read. ``old``
        is what stands there, where rows are added to it (:meth:`append`)."""
        if is_url(target):
            place = uploaded(located(target), overwrite=overwrite, new=old is None)
        else:
            place = atomic_output(target, f"{kind} dataset", overwrite=overwrite, inputs=inputs)
        with place as scratch:
            writer = cls(scratch, kind, site, NOTHING if old is None else _older(old))
            writer.old = old
            if old is not None and not is_url(target):
                for name in ("trajectories", PARTIALS):
                    share(old.path / name, scratch / name)
            yield writer
            writer.finish()

    @classmethod
    def append(
        cls, target: str | Path, *, inputs: Iterable[Path] = ()
    ) -> AbstractContextManager["DatasetWriter"]:
        """A writer whose rows are added to the recorded dataset ``target`` when the block ends well. No file
        of its rows is written again: the new dataset takes the place of the older one at once, and shares
        them with it (as hard links; copies where the file system has none)."""
        old = Dataset(target)
        if old.kind != "recorded":
            raise DataError(f"is {old.kind}, not recorded: nothing can be added", where=target)
        return cls.create(target, "recorded", old.site, overwrite=not is_url(target), inputs=inputs, old=old)

    def write(self, trajectory: Trajectory) -> None:
        """Append the rows of one vehicle; they must be later than those already written for it."""
        self.write_together((trajectory.vehicle_id,), trajectory)

    def write_together(self, vehicles: Sequence[str], rows: Trajectory) -> None:
        """Append rows of several vehicles, as many of each, one vehicle after the other, as one table."""
        if not (each := len(rows) // len(vehicles)):
            return
        pieces = [slice(k * each, (k + 1) * each) for k in range(len(vehicles))]
        for vehicle, piece in zip(vehicles, pieces, strict=True):
            replace(rows, vehicle_id=vehicle)[piece].check()
            if vehicle == HIVE_NULL:
                do = "rename it: readers take it for unknown"
                raise DataError(f"no vehicle can be called {HIVE_NULL}", do=do)
            if rows.time[piece.start] <= self._last.get(vehicle, -(1 << 62)):
                what = f"rows of vehicle {vehicle} are not later than those that are there"
                raise DataError(what, where=self.path, do="leave out the logs of that time")
        table = to_arrow(rows, part=True)
        for one in table.schema:
            self.columns.setdefault(one.name, (one.metadata or {}).get(b"unit", b"").decode())
        for vehicle, piece in zip(vehicles, pieces, strict=True):
            time = rows.time[piece]
            cuts = [0, *(np.flatnonzero(np.diff(time // DAY)) + 1).tolist(), each]
            for begin, end in itertools.pairwise(cuts):
                part = table[piece.start + begin : piece.start + end]
                self._write_part(vehicle, str(np.datetime64(int(time[begin]) // DAY, "D")), part)
            self._last[vehicle] = int(time[-1])
        self.pieces.append(trip_pieces(rows, vehicles))

    def _write_part(self, vehicle: str, date: str, table: pa.Table) -> None:
        folder = self.path / "trajectories" / f"date={date}" / f"vehicle_id={quote(vehicle, safe='')}"
        number = self._parts[vehicle, date]
        self._parts[vehicle, date] += 1
        folder.mkdir(parents=True, exist_ok=True)
        # A dictionary of measured numbers, all different, costs more than it saves.
        repeated = [f.name for f in table.schema if f.name in REPEATED or f.type not in MEASURED]
        with pa.OSFile(str(folder / f"part-{number:05d}.parquet"), "wb") as file:
            pq.write_table(
                table, file, compression=self.compression, row_group_size=ROW_GROUP,
                use_dictionary=repeated, column_encoding={"timestamp": "DELTA_BINARY_PACKED"},
                write_statistics=SELECTED, write_batch_size=BATCH,
            )  # fmt: skip

    def finish(self) -> None:
        """Write trips, site and description; :meth:`create` calls it."""
        trips, (rows, start, end), site = trips_of(self.pieces), contents_of(self.pieces), self.site
        trips, columns = trips[trips.trip_id >= 0], {"vehicle_id": "", **self.columns}
        if self.old is not None:
            meta, older = self.old.meta, self.old.trips
            rows = {v: rows.get(v, 0) + meta["vehicles"].get(v, 0) for v in {**meta["vehicles"], **rows}}
            start = min((t for t in (meta["start"], start) if t), default=None)
            end = max((t for t in (meta["end"], end) if t), default=None)
            columns = {**meta["columns"], **columns}
            if len(older):
                import pandas as pd

                trips = pd.concat([older, trips]) if len(trips) else older
                trips = trips.sort_values(["vehicle_id", "trip_id"], ignore_index=True)
        trips.to_parquet(self.path / "trips.parquet", index=False)
        write_json(self.path / "site.json", site_to_dict(site))
        frame = None if site.frame is None else asdict(site.frame)
        edges = 0 if site.network is None else len(site.network)
        description = {
            "format_version": FORMAT_VERSION, "kind": self.kind,
            "site": {"name": site.name, "frame": frame, "edges": edges},
            "vehicles": dict(sorted(rows.items())), "start": start, "end": end, "rows": sum(rows.values()),
            "columns": columns, "provenance": self.provenance, "summary": self.summary,
        }  # fmt: skip
        if tables := self.tables.close():
            description["tables"] = tables
        # Written last: a folder without it is no dataset.
        write_json(self.path / "dataset.json", description, indent=1)


def _older(dataset: Dataset) -> Older:
    """What is known of a dataset before rows are added to it."""
    parts = {day: len(dataset.parts(*day)) for day in dataset.vehicle_days}
    if not len(dataset.trips):
        return Older({}, {}, parts)
    trips = dataset.trips.groupby("vehicle_id")
    end = trips.end.max().dt.tz_localize(None).astype("datetime64[us]").astype(np.int64)
    last, following = ({str(v): int(n) for v, n in c.items()} for c in (end, trips.trip_id.max() + 1))
    return Older(last, following, parts)

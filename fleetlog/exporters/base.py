"""What every export format gives, and the one function that runs it.

A format is one module of this package, by its name, with a function ``write(selection, path)``.  It writes a
:class:`Selection` to a scratch file that appears under the wanted name when it is whole, and returns what the
summary should say beyond the counts of rows, if anything."""

import itertools
import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fleetlog import interrupt
from fleetlog.core.arguments import PartOf
from fleetlog.core.arrays import DAY, Floats, Ints, microseconds
from fleetlog.core.columns import SCHEMA
from fleetlog.core.trajectory import Trajectory, from_arrow, to_arrow
from fleetlog.errors import DataError, InputError, nearest
from fleetlog.store import Dataset
from fleetlog.store.output import atomic_output

FORMATS = PartOf("fleetlog.exporters", "write")
WINDOW = 600_000_000  # Stretch of time of which the rows of all vehicles are held at once [us]


@dataclass
class Selection:
    """The vehicles of a dataset that are exported, the file's name to be, and the rows written so far."""

    dataset: Dataset
    vehicles: tuple[str, ...]
    target: Path
    beside: Callable[[str], Path]  # Where a second file of this name is written, in the same folder
    counts: Counter[str] = field(default_factory=Counter)

    def days(self, columns: Sequence[str] | None = None) -> Iterator[Trajectory]:
        """One trajectory per vehicle and day, vehicle by vehicle."""
        return self.dataset.days(columns, self.vehicles)

    def windows(self, columns: Sequence[str]) -> Iterator[list[Trajectory]]:
        """All vehicles' rows side by side, in stretches of time that follow one another."""
        first, last = self.dataset.span or (0, -1)
        for date, t in itertools.product(self.dataset.dates, range(0, DAY, WINDOW)):
            begin = microseconds(date) + t
            if begin > last or begin + WINDOW <= first:
                continue
            low, high = (pa.scalar(us, pa.timestamp("us", tz="UTC")) for us in (begin, begin + WINDOW))
            # Row groups outside are not read.
            inside = [("timestamp", ">=", low), ("timestamp", "<", high)]
            pieces = []
            for vehicle, part in ((v, part) for v in self.vehicles for part in self.dataset.parts(v, date)):
                want = [name for name in pq.read_schema(part).names if name in ("timestamp", *columns)]
                table = pq.read_table(part, columns=want, filters=inside, partitioning=None)
                pieces += [from_arrow(table, vehicle)] if len(table) else []
            if pieces:
                yield pieces

    def placed(self, trajectory: Trajectory) -> Trajectory:
        """The rows that have a position; they and the others are counted."""
        known = np.isfinite(trajectory.floats("x")) & np.isfinite(trajectory.floats("y"))
        self.counts["rows"] += int(known.sum())
        self.counts["rows_without_position"] += int((~known).sum())
        return trajectory[known]

    def schema(self) -> pa.Schema:
        """The contract's columns, then every further one of any part, from the files' descriptions only."""
        fields = {f.name: _plain(f) for f in SCHEMA}
        for part in (p for v in self.vehicles for p in self.dataset.parts(v)):
            for f in pq.read_schema(part):
                if f.name not in fields or pa.types.is_null(fields[f.name].type):
                    fields[f.name] = _plain(f)
        return pa.schema([f for f in fields.values() if f.name != "date"])

    def tables(self, schema: pa.Schema) -> Iterator[pa.Table]:
        """One table per vehicle and day, all of ``schema``."""
        for table in map(to_arrow, self.days()):
            for missing in (f for f in schema if f.name not in table.column_names):
                table = table.append_column(missing, pa.nulls(len(table), missing.type))
            self.counts["rows"] += len(table)
            yield table.select(schema.names).cast(schema, safe=False)

    def places(self, t: Trajectory) -> list[Floats]:
        """x, y, z as maps have them: longitude, latitude [degrees, to 0.1 mm] and metres, or local metres."""
        x, y, z = (t.floats(c) for c in "xyz")
        if (frame := self.dataset.site.frame) is None:
            return [x, y, z]
        latitude, longitude = frame.to_geographic(x, y)
        return [np.round(longitude, 9), np.round(latitude, 9), np.round(z, 4)]

    def need_one_vehicle(self, name: str) -> str:
        """The only vehicle, or an error that says to choose one."""
        if len(self.vehicles) != 1:
            what = f"a {name} file holds one vehicle, the dataset has {len(self.vehicles)}"
            do = f"choose one with --vehicle {self.vehicles[0] if self.vehicles else 'ID'}"
            raise DataError(what, where=self.dataset.path, do=do)
        return self.vehicles[0]


def _plain(field: pa.Field) -> pa.Field:
    """Labels as plain strings: dictionaries differ from part to part."""
    return field.with_type(pa.string()) if pa.types.is_dictionary(field.type) else field


def export_dataset(
    dataset: str | Path | Dataset, to: str, output: str | Path, *, vehicles: Sequence[str] = (),
    overwrite: bool = False,
) -> dict[str, Any]:  # fmt: skip
    """Write a dataset, or its folder, in the format ``to``; the file appears whole or not at all.
    ``vehicles`` are those to export (all by default); ``overwrite`` says whether an older file may be
    replaced. Returns a summary: format, file, vehicles, rows, bytes and what the format adds."""
    if to not in FORMATS.names():
        raise InputError(f"no export format {to!r}", do=nearest(to, FORMATS.names()))
    output, source = Path(output), dataset if isinstance(dataset, Dataset) else Dataset(dataset)
    for vehicle in vehicles:
        source.parts(vehicle)
    chosen = tuple(vehicles) or tuple(source.vehicles)
    options: dict[str, Any] = {"overwrite": overwrite, "folder": False, "inputs": [source.path]}
    with ExitStack() as files:

        def made(name: Path) -> Path:
            return files.enter_context(atomic_output(name, f"{to} export", **options))

        selection = Selection(source, chosen, output, lambda name: made(output.with_name(name)))
        scratch = made(output)
        more = FORMATS.part(to)(selection, scratch) or {}
        size = scratch.stat().st_size
        with interrupt.held():
            files.close()
    told = {"format": to, "file": str(output), "vehicles": len(chosen), "bytes": size}
    return {**told, **selection.counts, **more}


def write_features(path: Path, head: dict[str, Any], features: Iterable[dict[str, Any]]) -> None:
    """A FeatureCollection: its members but the features, then those one by one."""
    with path.open("w", encoding="utf-8") as out:
        out.write(json.dumps({"type": "FeatureCollection", **head})[:-1] + ', "features": [')
        for number, feature in enumerate(features):
            out.write((",\n" if number else "\n") + json.dumps(feature, allow_nan=False, default=str))
        out.write("\n]}\n")


def iso_times(time: Ints) -> list[str]:
    """Times [us] as ISO 8601 in UTC, with a fraction only where there is one."""
    fine = bool((time % 1_000_000).any())
    stamps = time.view("datetime64[us]") if fine else (time // 1_000_000).view("datetime64[s]")
    return [f"{t}Z" for t in np.datetime_as_string(stamps).tolist()]


def cells(trajectory: Trajectory, names: Sequence[str]) -> list[list[Any]]:
    """The columns called ``names`` as Python lists, None for null."""
    return [column.to_pylist() for column in to_arrow(trajectory).select(names).columns]

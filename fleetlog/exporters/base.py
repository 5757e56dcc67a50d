"""What every export format gives, and the one function that runs it.

A format is one module of this package that holds ``EXPORTER``, an :class:`Exporter`.  It writes a scratch
file that appears under the wanted name when it is whole.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.site import Frame
from fleetlog.core.trajectory import Trajectory, to_arrow
from fleetlog.errors import DataError, InputError, nearest
from fleetlog.registry import parts
from fleetlog.store import Dataset
from fleetlog.store.output import atomic_output


@dataclass(frozen=True)
class Exporter:
    """An export format: its name as ``--to`` takes it, the usual suffix of its files, and what it is."""

    name: str
    suffix: str
    meaning: str
    write: Callable[[Selection, Path], dict[str, Any]]
    """Writes the selection to a path; gives what the summary should say, ``rows`` included."""
    network: bool = False
    """Whether it writes the road network, not the motion."""


@dataclass
class Selection:
    """The vehicles of a dataset that are exported, the file's name to be, and the rows written so far."""

    dataset: Dataset
    vehicles: tuple[str, ...]
    target: Path
    counts: dict[str, Any] = field(default_factory=lambda: {"rows": 0, "rows_without_position": 0})

    def days(self, columns: Sequence[str] | None = None) -> Iterator[Trajectory]:
        """One trajectory per vehicle and day, vehicle by vehicle."""
        for vehicle, date in itertools.product(self.vehicles, self.dataset.dates):
            trajectory = self.dataset.read(vehicle, date, columns)
            if len(trajectory):
                yield trajectory

    def placed(self, trajectory: Trajectory) -> Trajectory:
        """The rows that have a position; they and the others are counted."""
        known = np.isfinite(trajectory.floats("x")) & np.isfinite(trajectory.floats("y"))
        self.counts["rows"] += int(known.sum())
        self.counts["rows_without_position"] += int((~known).sum())
        return trajectory[known]

    @property
    def frame(self) -> Frame | None:
        """Where on earth the site lies, if known."""
        return self.dataset.site.frame

    def need_one_vehicle(self, name: str) -> str:
        """The only vehicle, or an error that says to choose one."""
        if len(self.vehicles) != 1:
            what = f"a {name} file holds one vehicle, the dataset has {len(self.vehicles)}"
            do = f"choose one with --vehicle {self.vehicles[0] if self.vehicles else 'ID'}"
            raise DataError(what, where=self.dataset.path, do=do)
        return self.vehicles[0]


def exporters() -> dict[str, Exporter]:
    """Every known format by name."""
    return parts("fleetlog.exporters", "EXPORTER")


def export_dataset(
    dataset: str | Path | Dataset, to: str, output: str | Path, *, vehicles: Sequence[str] = (),
    overwrite: bool = False,
) -> dict[str, Any]:  # fmt: skip
    """Write a dataset, or its folder, in the format ``to``; the file appears whole or not at all.

    ``vehicles`` are those to export (all by default); ``overwrite`` says whether an older file may be
    replaced.  Returns a summary: format, file, vehicles, rows, bytes and what the format adds.
    """
    if to not in (known := exporters()):
        raise InputError(f"no export format {to!r}", do=nearest(to, known))
    output, source = Path(output), dataset if isinstance(dataset, Dataset) else Dataset(dataset)
    for vehicle in vehicles:
        if vehicle not in source.vehicles:
            raise DataError(f"no vehicle {vehicle!r} in {source.path}", do=nearest(vehicle, source.vehicles))
    chosen = tuple(vehicles) or tuple(source.vehicles)
    options: dict[str, Any] = {"overwrite": overwrite, "folder": False, "inputs": [source.path]}
    with atomic_output(output, f"{to} export", **options) as scratch:
        more = known[to].write(Selection(source, chosen, output), scratch)
        size = scratch.stat().st_size
    return {"format": to, "file": str(output), "vehicles": len(chosen), "bytes": size, **more}


def write_features(path: Path, head: dict[str, Any], features: Iterable[dict[str, Any]]) -> None:
    """A FeatureCollection: its members but the features, then those one by one."""
    with path.open("w", encoding="utf-8") as out:
        out.write(json.dumps({"type": "FeatureCollection", **head})[:-1] + ', "features": [')
        for number, feature in enumerate(features):
            out.write((",\n" if number else "\n") + json.dumps(feature, allow_nan=False, default=str))
        out.write("\n]}\n")


def iso_times(time: NDArray[np.int64]) -> list[str]:
    """Times [us] as ISO 8601 in UTC, with a fraction only where there is one."""
    fine = bool((time % 1_000_000).any())
    stamps = time.view("datetime64[us]") if fine else (time // 1_000_000).view("datetime64[s]")
    return [f"{t}Z" for t in np.datetime_as_string(stamps).tolist()]


def cells(trajectory: Trajectory, names: Sequence[str]) -> list[list[Any]]:
    """The columns called ``names`` as Python lists, None for null."""
    table = to_arrow(trajectory)
    return [table.column(name).to_pylist() for name in names]

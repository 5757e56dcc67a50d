"""Reading a dataset by vehicle and day."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from fleetlog.core.site import Site, site_from_dict
from fleetlog.core.trajectory import Trajectory, concatenate, from_arrow
from fleetlog.errors import DataError, InputError, nearest
from fleetlog.version import FORMAT_VERSION

if TYPE_CHECKING:
    import pandas as pd


class Dataset:
    """A trajectory dataset on disk; nothing but its description is read until asked for."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        description = self.path / "dataset.json"
        if not description.is_file():
            what = "is not a dataset (it has no dataset.json)" if self.path.exists() else "no such dataset"
            raise InputError(what, where=self.path, do="make one with fleetlog import or fleetlog simulate")
        try:
            self.meta: dict[str, Any] = json.loads(description.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise InputError(f"not readable: {error}", where=description) from None
        version = self.meta.get("format_version")
        if version != FORMAT_VERSION:
            raise InputError(
                f"format version {version}, this fleetlog reads {FORMAT_VERSION}", where=description
            )

    @property
    def kind(self) -> str:
        """``recorded`` or ``simulated``."""
        return str(self.meta["kind"])

    @property
    def rows(self) -> int:
        """Rows in all."""
        return int(self.meta["rows"])

    @property
    def vehicles(self) -> list[str]:
        """Vehicle ids, sorted."""
        return sorted(self.meta["vehicles"])

    @cached_property
    def dates(self) -> list[str]:
        """Days with rows (UTC), sorted, as YYYY-MM-DD."""
        return sorted(p.name.removeprefix("date=") for p in (self.path / "trajectories").glob("date=*"))

    @cached_property
    def site(self) -> Site:
        """The site that it was made with."""
        return site_from_dict(json.loads((self.path / "site.json").read_text(encoding="utf-8")))

    @cached_property
    def trips(self) -> pd.DataFrame:
        """One row a trip; see :func:`fleetlog.store.trips.trip_table`."""
        import pandas as pd

        return pd.read_parquet(self.path / "trips.parquet")

    def parts(self, vehicle: str, date: str | None = None) -> list[Path]:
        """The Parquet files of a vehicle, in order of time."""
        if vehicle not in self.meta["vehicles"]:
            raise DataError(f"no vehicle {vehicle!r} in {self.path}", do=nearest(vehicle, self.vehicles))
        days = self.dates if date is None else [date]
        name = f"vehicle_id={quote(vehicle, safe='')}"
        return [
            p
            for d in days
            for p in sorted((self.path / "trajectories" / f"date={d}" / name).glob("part-*.parquet"))
        ]

    def read(self, vehicle: str, date: str | None = None, columns: Sequence[str] | None = None) -> Trajectory:
        """All rows of a vehicle (of one day); ``columns`` to read only some beside the time."""
        pieces = [p for p in (read_part(f, vehicle, columns) for f in self.parts(vehicle, date)) if len(p)]
        if not pieces:
            import numpy as np

            return Trajectory(vehicle, np.zeros(0, np.int64))
        return concatenate(pieces)

    def pieces(
        self, vehicle: str, date: str, columns: Sequence[str] | None = None, rows: int = 100_000
    ) -> Iterator[Trajectory]:
        """The rows of a vehicle's day in pieces of whole trips, of about ``rows`` rows each: bounded memory
        for any rate.

        A trip longer than ``rows`` comes as one piece.
        """
        import numpy as np

        rest: list[Trajectory] = []
        for batch in (b for f in self.parts(vehicle, date) for b in read_batches(f, vehicle, columns, rows)):
            piece = concatenate([*rest, batch])
            begins = np.flatnonzero(np.diff(piece.trip_ids()))
            cut = int(begins[-1]) + 1 if len(begins) else 0
            if cut:
                yield piece[:cut]
            rest = [piece[cut:]]
        yield from rest

    def days(self, columns: Sequence[str] | None = None) -> Iterator[Trajectory]:
        """One trajectory per vehicle and day, vehicle by vehicle: bounded memory for any length."""
        for vehicle in self.vehicles:
            for date in self.dates:
                trajectory = self.read(vehicle, date, columns)
                if len(trajectory):
                    yield trajectory


def read_batches(path: Path, vehicle: str, columns: Sequence[str] | None, rows: int) -> Iterator[Trajectory]:
    """The rows of one Parquet file of a dataset, at most ``rows`` at a time."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        file = pq.ParquetFile(path)
        for batch in file.iter_batches(rows, columns=_present(file, columns)):
            yield from_arrow(pa.Table.from_batches([batch]), vehicle)
    except (OSError, pa.ArrowInvalid) as error:
        raise InputError(f"damaged: {error}", where=path, do="make the dataset again") from None


def _present(file: Any, columns: Sequence[str] | None) -> list[str] | None:
    """Those of the wanted columns that a file has, with the time."""
    have = set(file.schema_arrow.names)
    if columns is None:
        return None
    return ["timestamp", *(c for c in columns if c in have and c != "timestamp")]


def read_part(path: Path, vehicle: str, columns: Sequence[str] | None = None) -> Trajectory:
    """The rows of one Parquet file of a dataset."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        file = pq.ParquetFile(path)
        return from_arrow(file.read(columns=_present(file, columns)), vehicle)
    except (OSError, pa.ArrowInvalid) as error:
        raise InputError(f"damaged: {error}", where=path, do="make the dataset again") from None

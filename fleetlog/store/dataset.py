"""Reading a dataset by vehicle and day, from a folder or a URL (``s3://``, ``gs://``, ``az://``)."""

import hashlib
import json
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cached_property, lru_cache
from itertools import chain, pairwise, product
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fleetlog import scratch
from fleetlog.core.arrays import DataFrame, microseconds
from fleetlog.core.files import is_url, located
from fleetlog.core.site import Site, site_from_dict
from fleetlog.core.trajectory import Trajectory, concatenate, from_arrow
from fleetlog.errors import DataError, FleetlogError, InputError, OutputError, chosen
from fleetlog.version import FORMAT_VERSION

REMAKE = "make the dataset again"
DESCRIPTION = {"kind": str, "site": dict, "vehicles": dict, "rows": int, "columns": dict, "provenance": dict}
"""Keys of ``dataset.json`` that everything relies on, and what they are."""
ALONE = "every truck was simulated by itself, in nobody's way"  # Such a mission says nothing of traffic


class Dataset:
    """A trajectory dataset on disk; nothing but its description is read until asked for."""

    def __init__(self, path: str | Path) -> None:
        self.path = located(path)
        description = self.path / "dataset.json"
        if not description.is_file():
            what = "is not a dataset (it has no dataset.json)" if self.path.exists() else "no such dataset"
            raise InputError(what, where=self.path, do="make one with fleetlog import or fleetlog simulate")
        with undamaged(description):
            self._text = description.read_text(encoding="utf-8")
            self.meta: dict[str, Any] = json.loads(self._text)
            if (version := self.meta["format_version"]) != FORMAT_VERSION:
                what = f"format version {version}, this fleetlog reads {FORMAT_VERSION}"
                do = f"read it with the fleetlog that wrote it, or {REMAKE}"
                raise InputError(what, where=description, do=do)
            if wrong := [k for k, kind in DESCRIPTION.items() if not isinstance(self.meta.get(k), kind)]:
                raise InputError(f"damaged: {wrong[0]} is missing or wrong", where=description, do=REMAKE)

    def __reduce__(self) -> tuple[Any, ...]:
        """For another process: by its name; the description tells a dataset that was made again."""
        return _reopened, (str(self.path) if is_url(self.path) else self.path, self._text)

    def here(self) -> "Dataset":
        """The dataset in this process, where it was handed to it as it was: connections do not fork."""
        return _reopened(str(self.path), self._text) if is_url(self.path) else self

    @property
    def kind(self) -> str:
        """``recorded`` or ``simulated``."""
        return str(self.meta["kind"])

    @property
    def alone(self) -> bool:
        """Whether each truck drove by itself: a mission driven again, and not ``together``."""
        summary = self.meta.get("summary") or {}
        return "distance_ratio" in summary and "lost_share" not in summary

    @property
    def rows(self) -> int:
        """Rows in all."""
        return int(self.meta["rows"])

    @property
    def span(self) -> tuple[int, int] | None:
        """First and last time [us]; None without rows."""
        start, end = self.meta["start"], self.meta["end"]
        return (microseconds(start), microseconds(end)) if start and end else None

    @property
    def vehicles(self) -> list[str]:
        """Vehicle ids, sorted."""
        return sorted(self.meta["vehicles"])

    @cached_property
    def dates(self) -> list[str]:
        """Days with rows (UTC), sorted, as YYYY-MM-DD."""
        return sorted({date for _, date in self._parts})

    @cached_property
    def vehicle_days(self) -> list[tuple[str, str]]:
        """Vehicle and date of all rows, by vehicle and then by date."""
        return sorted(self._parts)

    @cached_property
    def _parts(self) -> dict[tuple[str, str], list[Path]]:
        """The Parquet files of every vehicle and date, in order of time."""
        out: dict[tuple[str, str], list[Path]] = {}
        for file in sorted((self.path / "trajectories").glob("date=*/vehicle_id=*/part-*.parquet")):
            date, vehicle = (folder.name.partition("=")[2] for folder in (file.parent.parent, file.parent))
            out.setdefault((unquote(vehicle), date), []).append(file)
        return out

    def folder_of(self, vehicle: str, date: str) -> str:
        """The name of the folder of a vehicle-day in ``trajectories``."""
        return f"date={date}/vehicle_id={quote(vehicle, safe='')}"

    def source(self, days: Iterable[tuple[str, str]]) -> bytes:
        """The digest (32 bytes) of what some vehicle-days are: names, sizes and times of their files."""
        return hashlib.sha256(repr([self._told(*day) for day in days]).encode()).digest()

    @lru_cache(maxsize=100_000)  # noqa: B019 - a dataset lives as long as a question
    def _told(self, vehicle: str, date: str) -> tuple[Any, ...]:
        derived = self.meta.get("summary", {}).get("derived_by_vehicle", {}).get(vehicle)
        files = [(p.name, s.st_size, s.st_mtime) for p in self._parts[vehicle, date] for s in [p.stat()]]
        return self.folder_of(vehicle, date), derived, files

    @cached_property
    def site(self) -> Site:
        """The site that it was made with."""
        with undamaged(self.path / "site.json"):
            return site_from_dict(json.loads(self.site_text))

    @cached_property
    def site_text(self) -> str:
        """The file of the site."""
        with undamaged(self.path / "site.json"):
            return (self.path / "site.json").read_text(encoding="utf-8")

    @cached_property
    def trips(self) -> DataFrame:
        """One row a trip; see :func:`fleetlog.store.trips.trips_of`."""
        import pandas as pd

        file = self.path / "trips.parquet"
        with undamaged(file), file.open("rb") as stream:
            return pd.read_parquet(stream)

    def parts(self, vehicle: str, date: str | None = None) -> list[Path]:
        """The Parquet files of a vehicle, in order of time."""
        chosen(self.meta["vehicles"], vehicle, f"no vehicle {vehicle!r} in {self.path}", DataError)
        days = self.dates if date is None else [date]
        return [p for d in days for p in self._parts.get((vehicle, d), ())]

    def read(self, vehicle: str, date: str | None = None, columns: Sequence[str] | None = None) -> Trajectory:
        """All rows of a vehicle (of one day); ``columns`` to read only some beside the time."""
        pieces = [piece for piece in _pieces(self.parts(vehicle, date), vehicle, columns) if len(piece)]
        return concatenate(pieces) if pieces else Trajectory(vehicle, np.zeros(0, np.int64))

    def pieces(
        self, vehicle: str, date: str, columns: Sequence[str] | None = None, rows: int = 100_000, *,
        joined: bool = False,
    ) -> Iterator[Trajectory]:  # fmt: skip
        """The rows of a vehicle's day in whole trips, about ``rows`` at a time unless a trip is longer.

        ``joined`` to the vehicle's next row, of the same day or a later one: no time between them is lost."""
        if joined:
            later = next((d for v, d in self.vehicle_days if v == vehicle and d > date), "")
            none = Trajectory(vehicle, np.zeros(0, np.int64))
            after = next(_pieces(self.parts(vehicle, later), vehicle, columns, 1), none)
            for piece, more in pairwise(chain(self.pieces(vehicle, date, columns, rows), [after])):
                goes_on = len(more) and more.time[0] > piece.time[-1]
                yield concatenate([piece, more[:1]]) if goes_on else piece
            return
        rest: list[Trajectory] = []
        for batch in _pieces(self.parts(vehicle, date), vehicle, columns, rows):
            for piece in rest:  # A day is cut only where more of it follows.
                if cut := int(np.max(np.flatnonzero(np.diff(piece.trip_ids())) + 1, initial=0)):
                    yield piece[:cut]
                rest = [piece[cut:]]
            rest = [concatenate([*rest, batch])]
        yield from rest

    def days(self, columns: Sequence[str] | None = None, only: Sequence[str] = ()) -> Iterator[Trajectory]:
        """One trajectory per vehicle (all, or ``only`` these) and day, vehicle by vehicle: bounded memory."""
        for vehicle, date in product(only, self.dates) if only else self.vehicle_days:
            if len(trajectory := self.read(vehicle, date, columns)):
                yield trajectory


@lru_cache(maxsize=4)
def _reopened(path: str | Path, text: str) -> Dataset:
    """A dataset in another process, of which the site is read once; ``text`` is its description."""
    return Dataset(path)


@contextmanager
def undamaged(path: Path) -> Iterator[None]:
    """Whatever goes wrong while a file of a dataset is read is damage of that file."""
    try:
        yield
    except (FleetlogError, MemoryError):
        raise
    except Exception as error:
        kind = f"{type(error).__name__} " if isinstance(error, LookupError) else ""
        raise InputError(f"damaged: {kind}{error}", where=path, do=REMAKE) from None


def _pieces(
    files: Sequence[Path], vehicle: str, columns: Sequence[str] | None, rows: int | None = None
) -> Iterator[Trajectory]:
    """The rows of files in order of time, file by file or ``rows`` at a time, of ``columns`` those there."""
    before, asked = -(1 << 62), None if columns is None else dict.fromkeys(["timestamp", *columns])
    for file in files:
        row = 1
        with undamaged(file), file.open("rb") as stream, pq.ParquetFile(stream) as part:
            have = {*part.schema_arrow.names, "timestamp"}
            wanted = None if asked is None else [name for name in asked if name in have]
            batches = () if rows is None else part.iter_batches(rows, columns=wanted)
            tables = (pa.Table.from_batches([batch]) for batch in batches)
            for table in [part.read(columns=wanted)] if rows is None else tables:
                piece = from_arrow(table, vehicle)
                if (late := np.diff(piece.time, prepend=before) <= 0).any():
                    what, do = "a row is not later than the one before it", f"sort by timestamp, or {REMAKE}"
                    raise InputError(what, where=file, place=f"row {row + int(late.argmax())}", do=do)
                before, row = max(before, *piece.time[-1:].tolist()), row + len(piece)
                yield piece


@contextmanager
def uploaded(target: Any, *, overwrite: bool = False, new: bool = True) -> Iterator[Path]:
    """A folder of this machine whose files are put under the URL ``target`` when the block ends well.
    ``dataset.json`` is put last: until then there is no dataset, or the older one. ``new``: there must be
    none, since objects cannot be exchanged at once."""
    if overwrite or (new and (target / "dataset.json").exists()):
        what = "a dataset behind a URL is not replaced" if overwrite else "is already there"
        raise OutputError(what, where=str(target), do="choose another name, or remove it yourself")
    with tempfile.TemporaryDirectory(dir=scratch.folder()) as folder:
        yield Path(folder)
        files = [p for p in Path(folder).rglob("*") if p.is_file()]
        done = []
        try:
            for file in sorted(files, key=lambda p: (p.name == "dataset.json", p)):
                where = target / file.relative_to(folder).as_posix()
                done.append(where)
                where.fs.put_file(str(file), where.path)
        except BaseException as error:
            for where in done:  # of an older dataset nothing is replaced before its rows are there
                if where.name.startswith("part-"):
                    with suppress(Exception):
                        where.unlink()
            if isinstance(error, OSError):
                what = f"cannot be written ({error})"
                raise OutputError(what, where=str(target), do="check the rights") from None
            raise

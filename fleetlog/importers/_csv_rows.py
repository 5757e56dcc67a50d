"""Blocks of a delimited log to batches: typed columns, times, units, and the rows that do not fit."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from fleetlog.core.trajectory import Ints, Labels, Values
from fleetlog.importers._csv_blocks import Block
from fleetlog.importers._csv_cells import Floats, Mask, degrees, numbers
from fleetlog.importers._csv_clock import Clock
from fleetlog.importers._csv_layout import Layout
from fleetlog.importers._csv_table import TableReader
from fleetlog.importers._open import plain_stem
from fleetlog.importers._profile import Profile, Source
from fleetlog.importers._report import ReadReport
from fleetlog.importers._rows import renamed
from fleetlog.importers._times import MISSING, NONE, SKIPPED, UNREADABLE
from fleetlog.importers.base import RawBatch, Reject

Masks = dict[str, Mask]
_MUST = ("latitude", "longitude", "x", "y")
"""A row whose position is not a number is refused; of other columns only the value is."""


class RowReader:
    """Reads the blocks of one file in order."""

    def __init__(self, layout: Layout, path: Path, profile: Profile, report: ReadReport) -> None:
        self.layout, self.path, self.profile, self.report = layout, path, profile, report
        self.clock = Clock(layout.fields.time, layout.fields.epoch, path, profile, report)
        self.vehicle = self._constant_vehicle()
        sentinels = [*profile.sentinels, *(s for v in layout.values.values() for s in v.sentinels)]
        self.reader = TableReader(layout, [s for s in sentinels if isinstance(s, str)], report)
        self._missing = Source("", sentinels=profile.sentinels)
        self._types: dict[str, Any] = {}
        self._percent = False
        self._angles: set[str] = set()
        self._blank: set[str] = set()
        """Own columns without a value so far; text until the first value says what they are."""

    def _constant_vehicle(self) -> str:
        """The id of every row where no column has it."""
        stem = plain_stem(self.path)
        if self.layout.fields.vehicle:
            return ""
        if self.profile.vehicle:
            return str(self.profile.vehicle_of(self.path))
        self.report.note(f"no column of vehicle ids: every row is of vehicle {stem!r}, after the file's name")
        return stem

    def batch(self, block: Block) -> RawBatch:
        """The rows of a block."""
        if not self._types:
            self._decide(block)
        table, lines, rejects = self.reader.read(block, self._types)
        bad: Masks = {}
        columns = self._columns(table, bad)
        vehicle = self._vehicles(table)
        time = self.clock.times(table, vehicle)
        reason = self._reasons(table, time, vehicle, bad)
        for name, mask in bad.items():
            if name not in _MUST:
                gone, why = lines[mask & (reason == "")].tolist(), f"{name} is not a number"
                texts = zip(gone, block.texts(gone), strict=True)
                rejects += [Reject(n, why, text, False) for n, text in texts]
        keep = reason == ""
        if not keep.all():
            gone = lines[~keep].tolist()
            rejects += map(Reject, gone, reason[~keep].tolist(), block.texts(gone))
        kept: dict[str, Values] = {n: v[keep] for n, v in columns.items()} if not keep.all() else columns
        vehicle = vehicle if keep.all() else vehicle[keep]
        return RawBatch(vehicle, time[keep], kept, lines[keep], sorted(rejects), block.progress)

    def close(self) -> None:
        """Say what only the whole file tells."""
        self.clock.close()

    # ----------------------------------------------------------------------- text to table

    def _decide(self, block: Block) -> None:
        """Types of the columns, from the first block."""
        layout, fields = self.layout, self.layout.fields
        inferred = self.reader.inferred(block)
        text = {*fields.time, *layout.labels.values(), fields.vehicle}
        for name in layout.names:
            kind = inferred.field(name).type
            figures = pa.types.is_floating(kind) or pa.types.is_integer(kind)
            if pa.types.is_null(kind) and name in fields.kept:
                self._blank.add(name)
            self._types[name] = pa.float64() if name not in text and figures else pa.string()
        for target, source in layout.values.items():
            if target in ("latitude", "longitude") and self._types[source.column] == pa.string():
                self._angles.add(source.column)
            else:
                self._types[source.column] = pa.float64()

    # ----------------------------------------------------------------------- table to columns

    def _columns(self, table: pa.Table, bad: Masks) -> dict[str, Values]:
        columns: dict[str, Values] = {}
        for target, source in self.layout.values.items():
            columns[target] = self._si(target, source, self._figures(table, source.column, target, bad))
        for target, name in self.layout.labels.items():
            if target == "trip_id":
                trip = self._figures(table, name, target, bad)
                columns[target] = np.where(np.isfinite(trip), trip, -1).astype(np.int64)
            else:
                columns[target] = _labels(table.column(name))
        for name in self.layout.fields.kept:
            if name in self._blank:
                self._decide_blank(table.column(name), name)
            if name in self._blank:
                columns[name] = np.full(table.num_rows, np.nan)
            elif self._types[name] == pa.float64():
                columns[name] = self._figures(table, name, name, bad)
            else:
                columns[name] = _labels(table.column(name))
        return columns

    def _decide_blank(self, chunk: pa.ChunkedArray, name: str) -> None:
        if chunk.null_count == len(chunk):
            return
        self._blank.discard(name)
        if not numbers(chunk.combine_chunks(), self.layout.decimal)[1].any():
            self._types[name] = pa.float64()

    def _figures(self, table: pa.Table, name: str, target: str, bad: Masks) -> Floats:
        chunk = table.column(name)
        if pa.types.is_floating(chunk.type):
            values = np.array(chunk.fill_null(np.nan) if chunk.null_count else chunk, dtype=np.float64)
        else:
            read = degrees if name in self._angles else numbers
            values, wrong = read(chunk.combine_chunks(), self.layout.decimal)
            if wrong.any():
                bad[target] = wrong
        endless = np.isinf(values)
        if endless.any():
            bad[target] = bad.get(target, False) | endless
            values = np.where(endless, np.nan, values)
        return self._missing.known(values)

    def _si(self, target: str, source: Source, values: Floats) -> Floats:
        values = source.known(values)
        if target == "soc" and source.unit is None:
            values = self._share(source.column, values)
        return source.to_si(values)

    def _share(self, name: str, values: Floats) -> Floats:
        """A state of charge without a unit is in per cent where it is above 1; said aloud."""
        if not self._percent and len(values) and np.nanmax(values, initial=0.0) > 1.5:
            self._percent = True
            self.report.recognised[name] = "soc, from % (it goes beyond 1)"
        return values / 100.0 if self._percent else values

    def _vehicles(self, table: pa.Table) -> Labels:
        if self.layout.fields.vehicle is None:
            return Labels(np.zeros(table.num_rows, np.int32), (self.vehicle,))
        labels = _labels(table.column(self.layout.fields.vehicle))
        return renamed(labels, [name.strip() or None for name in labels.names])

    # ----------------------------------------------------------------------- what is refused

    def _reasons(self, table: pa.Table, time: Ints, vehicle: Labels, bad: Masks) -> NDArray[np.str_]:
        """Why each row is refused; empty where it is not."""
        reason = np.full(len(time), "", dtype="<U64")
        reason[vehicle.codes < 0] = "the vehicle id is missing"
        reason[time == NONE] = UNREADABLE
        reason[(time == NONE) & self.clock.missing] = MISSING
        reason[(time == NONE) & self.clock.skipped] = SKIPPED
        for name in _MUST:
            if name in bad:
                reason[bad[name]] = f"{name} is not a number"
        again = np.ones(len(time), bool)
        for name in self.layout.names:
            chunk = table.column(name)
            if str(chunk.type) != "string":
                return reason
            again &= np.asarray(chunk.combine_chunks().to_pandas() == name, dtype=bool)
            if not again.any():
                return reason
        reason[again] = "the header line again"
        return reason


def _labels(chunk: pa.ChunkedArray) -> Labels:
    array = chunk.combine_chunks().dictionary_encode()
    codes = np.asarray(array.indices.fill_null(-1), dtype=np.int32)
    return Labels(codes, tuple(str(n) for n in array.dictionary.to_pylist()))

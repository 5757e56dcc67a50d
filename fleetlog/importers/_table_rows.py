"""Arrow tables to batches: known columns, times, units, and the rows that do not fit."""

from collections.abc import Callable

import numpy as np
import pyarrow as pa

from fleetlog.core.arrays import Floats, Ints, Mask
from fleetlog.core.trajectory import Labels, Values, labels_of
from fleetlog.importers._csv_clock import Clock, degrees, numbers
from fleetlog.importers._fields import Fields
from fleetlog.importers._open import ReadReport
from fleetlog.importers._profile import Source
from fleetlog.importers._rows import REJECT_TEXT, renamed
from fleetlog.importers._times import MISSING, NONE, SKIPPED, UNREADABLE
from fleetlog.importers._units import KINDS
from fleetlog.importers.base import GEOGRAPHIC, LOCAL, RawBatch, Reject

Masks = dict[str, Mask]
Texts = Callable[[list[int]], list[str]]
_MUST = (*GEOGRAPHIC, *LOCAL)  # A row whose position is no number is refused; of others only the value is


class TableRows:
    """The rows of one file's tables, in order; columns are figures or text. ``vehicle`` is that of every row
    where no column says it, ``decimal`` the point of figures in text, ``angles`` what may hold minutes."""

    def __init__(self, fields: Fields, vehicle: str, angles: set[str], decimal: str = ".") -> None:
        self.fields, self.vehicle, self.angles, self.decimal = fields, vehicle, angles, decimal
        self.report: ReadReport = fields.report
        self.clock = Clock(fields)
        self._missing = Source("", sentinels=fields.profile.sentinels)
        self._percent = False
        self._figures_of: dict[str, bool] = {}  # Whether a column has figures; unknown before a value

    def batch(
        self, table: pa.Table, record: Ints, texts: Texts, rejects: list[Reject], progress: float
    ) -> RawBatch:
        """The rows of a table by their numbers; ``texts`` gives those of some of them as they are written."""
        bad: Masks = {}
        columns = self._columns(table, bad)
        vehicle = self._vehicles(table)
        time = self.clock.times(table, vehicle)
        reasons = self._reasons(table, time, vehicle, bad)
        keep = reasons.codes < 0
        for name in bad.keys() - {*_MUST}:
            rejects += _refused(record, bad[name] & keep, f"{name} is not a number", texts, False)
        for code in set(reasons.codes[~keep].tolist()):
            rejects += _refused(record, reasons.codes == code, reasons.names[code], texts)
        if not keep.all():
            columns = {n: v[keep] for n, v in columns.items()}
            vehicle, time, record = vehicle[keep], time[keep], record[keep]
        return RawBatch(vehicle, time, columns, record, sorted(rejects), progress)

    def _columns(self, table: pa.Table, bad: Masks) -> dict[str, Values]:
        columns: dict[str, Values] = {}
        for target, source in self.fields.columns.items():
            chunk = table.column(source.column)
            if target in KINDS:
                columns[target] = self._si(target, source, self._figures(chunk, source.column, target, bad))
            elif target == "trip_id":
                trip = self._figures(chunk, source.column, target, bad)
                columns[target] = np.where(np.isfinite(trip), trip, -1).astype(np.int64)
            else:
                columns[target] = labels_of(chunk)
        for name in self.fields.kept:
            chunk = table.column(name)
            if name not in self._figures_of and chunk.null_count < len(chunk):
                text = pa.types.is_dictionary(chunk.type) or self._read(chunk, name)[1].any()
                self._figures_of[name] = not text
            figures = self._figures_of.get(name, True)
            columns[name] = self._figures(chunk, name, name, bad) if figures else labels_of(chunk)
        return columns

    def _figures(self, chunk: pa.ChunkedArray, name: str, target: str, bad: Masks) -> Floats:
        values, wrong = self._read(chunk, name)
        wrong |= np.isinf(values)
        if wrong.any():
            bad[target] = wrong
            values = np.where(wrong, np.nan, values)
        return self._missing.known(values)

    def _read(self, chunk: pa.ChunkedArray, name: str) -> tuple[Floats, Mask]:
        """Figures of a column, NaN for unknown, and which cells are none."""
        if pa.types.is_null(chunk.type) or pa.types.is_floating(chunk.type):
            known = chunk.cast(pa.float64()).fill_null(np.nan) if chunk.null_count else chunk
            return np.array(known, dtype=np.float64), np.zeros(len(chunk), bool)
        text = labels_of(chunk)
        read = degrees if name in self.angles else numbers
        values, wrong = read(pa.array(text.names, pa.string()), self.decimal)
        return np.append(values, np.nan)[text.codes], np.append(wrong, False)[text.codes]

    def _si(self, target: str, source: Source, values: Floats) -> Floats:
        """In SI; a state of charge without a unit is in per cent where it goes beyond 1; said aloud."""
        values = source.known(values)
        if target == "soc" and source.unit is None:
            if not self._percent and len(values) and np.nanmax(values, initial=0.0) > 1.5:
                self._percent = True
                self.report.recognised[source.column] = "soc, from % (it goes beyond 1)"
            values = values / 100.0 if self._percent else values
        return source.to_si(values)

    def _vehicles(self, table: pa.Table) -> Labels:
        if self.fields.vehicle is None:
            return Labels(np.zeros(table.num_rows, np.int32), (self.vehicle,))
        found = labels_of(table.column(self.fields.vehicle))
        if cut := [name for name in found.names if name.strip() and name != name.strip()]:
            self.report.note(f"blanks about vehicle ids are left out, as of {cut[0]!r}")
        return renamed(found, [name.strip() or None for name in found.names])

    def _reasons(self, table: pa.Table, time: Ints, vehicle: Labels, bad: Masks) -> Labels:
        """Why each row is refused; null where it is not."""
        again = np.ones(len(time), bool)
        for name in self.fields.names:
            chunk = table.column(name)
            if again.any():
                text = pa.types.is_string(chunk.type)
                again &= np.asarray(chunk.to_pandas() == name, dtype=bool) if text else False
        none, clock = time == NONE, self.clock
        found = {"the vehicle id is missing": vehicle.codes < 0, UNREADABLE: none}
        found |= {MISSING: none & clock.missing, SKIPPED: none & clock.skipped}
        found |= {f"{name} is not a number": bad[name] for name in _MUST if name in bad}
        found |= {"the header line again": again}
        codes = np.full(len(time), -1, np.int32)
        for code, mask in enumerate(found.values()):
            codes[mask] = code
        return Labels(codes, tuple(found))


def _refused(record: Ints, which: Mask, why: str, texts: Texts, whole: bool = True) -> list[Reject]:
    gone = record[which].tolist()
    return [Reject(n, why, text[:REJECT_TEXT], whole) for n, text in zip(gone, texts(gone), strict=True)]

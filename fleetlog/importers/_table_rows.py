"""Arrow tables to batches: known columns, times, units, and the rows that do not fit.

How the times of a table are written its first rows decide."""

import re
from collections.abc import Callable
from datetime import UTC, datetime
from operator import eq

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from fleetlog.core.arrays import Floats, Ints, Mask
from fleetlog.core.trajectory import Labels, Values, labels_of
from fleetlog.errors import FormatError, InputError
from fleetlog.importers import _units
from fleetlog.importers._profile import Fields, Source, has_date
from fleetlog.importers._rows import REJECT_TEXT
from fleetlog.importers.base import GEOGRAPHIC, LOCAL, RawBatch, Reject, renamed

Masks = dict[str, Mask]
GPS = 315_964_800_000_000  # 1980-01-06, from which GPS time counts [us]
DOTTED = ("%d.%m.%Y %H:%M:%S", "%d.%m.%Y %H:%M:%S.%f", "%d.%m.%Y %H:%M:%S,%f", "%d.%m.%Y %H:%M")
Texts = Callable[[list[int]], list[str]]
_MUST = (*GEOGRAPHIC, *LOCAL)  # A row whose position is no number is refused; of others only the value is


class Clock:
    """Times of one file, table by table, from the columns and in the unit that its fields name."""

    def __init__(self, fields: Fields) -> None:
        self.names, self.path = fields.time, fields.report.path
        self.profile, self.report = fields.profile, fields.report
        self.unit, self.style = fields.epoch, fields.profile.time_format or ""
        self.local = _units.LocalClock(self.profile.zone) if self.profile.zone else None
        self.days: _units.Days | None = None
        self.missing = self.skipped = np.zeros(0, bool)

    def times(self, table: pa.Table, vehicle: Labels) -> Ints:
        """(N,) microseconds UTC; ``NONE`` where a cell cannot be read."""
        time = self._times(table, vehicle)
        return self.to_utc(time, time != _units.NONE, vehicle) if self.days or self.style == "days" else time

    def _times(self, table: pa.Table, vehicle: Labels) -> Ints:
        parts = [table.column(n).combine_chunks() for n in self.names]
        cells = pc.binary_join_element_wise(*parts, " ") if len(parts) > 1 else parts[0]
        self.missing = np.asarray(cells.is_null(), dtype=bool)
        self.skipped = np.zeros(len(cells), bool)
        if not pa.types.is_string(cells.type):
            return self._typed(cells, vehicle)
        self.style = self.style or self._decide(cells)
        if not self.style:
            return np.full(len(cells), _units.NONE)
        if self.style in _units.EPOCH_UNITS:
            try:
                return self._whole(cells.cast(pa.int64()), self.style, self.profile.origin)
            except pa.ArrowInvalid:
                return _units.from_counts(numbers(cells)[0], self.style, self.profile.origin)
        if self.style == "of day" or not has_date(self.style):
            if self.days is None:
                # On the days from the profile's origin: a date is never made up.
                if (origin := self.profile.time_origin) is None:
                    do = 'name a column of dates too, or state the first day: [time] origin = "2026-03-02"'
                    raise FormatError("the times are times of day without a date", where=self.path, do=do)
                here = origin.astimezone(self.profile.zone or UTC) if origin.tzinfo else origin
                self.days = _units.Days(_units.microseconds(datetime(here.year, here.month, here.day)))
            return self.days.dated(_units.of_day(cells, self.style))
        if self.profile.time_origin is not None:
            what, where = "the times have dates of their own", self.profile.path
            raise InputError(what, where=where, place="time.origin", do="leave the origin out")
        time, bare = _units.from_iso(cells) if self.style == "iso" else _units.from_format(cells, self.style)
        return self.to_utc(time, bare & (time != _units.NONE), vehicle)

    def _typed(self, cells: pa.Array, vehicle: Labels) -> Ints:
        """Times that are no text: dates, stamps (local where they state no zone), counts."""
        if pa.types.is_date(cells.type):
            cells = cells.cast(pa.timestamp("s" if pa.types.is_date32(cells.type) else "ms"))
        if pa.types.is_timestamp(cells.type):
            time = self._whole(cells.cast(pa.int64()), cells.type.unit, 0)
            return time if cells.type.tz else self.to_utc(time, time != _units.NONE, vehicle)
        figures = np.asarray(cells.cast(pa.float64(), safe=False).fill_null(np.nan), dtype=np.float64)
        if self.style not in _units.EPOCH_UNITS:
            self.style = self.decide_count(figures)
        if pa.types.is_integer(cells.type):
            return self._whole(cells.cast(pa.int64(), safe=False), self.style, self.profile.origin)
        return _units.from_counts(figures, self.style, self.profile.origin)

    def _whole(self, counts: pa.Array, unit: str, origin: int) -> Ints:
        time = _units.from_counts(np.asarray(counts.fill_null(0), dtype=np.int64), unit, origin)
        return np.where(self.missing, _units.NONE, time)

    def _decide(self, cells: pa.Array) -> str:
        """ISO 8601, a count from 1970 or a time of day, from the first cells; else an error."""
        if not len(sample := cells.drop_null().slice(0, 1000)):
            return ""
        if np.isfinite(figures := numbers(sample)[0]).mean() > 0.5:
            return self.decide_count(figures)
        if (_units.of_day(sample, "of day") != _units.NONE).mean() > 0.5:
            return "of day"
        if (_units.from_iso(sample)[0] != _units.NONE).any():
            return "iso"
        for style in DOTTED:
            if (_units.from_format(sample, style)[0] != _units.NONE).all():
                self.report.recognised[self.names[0]] = "timestamp, the day before the month as dots have it"
                return style
        do = "state its format in a profile (--profile FILE.toml), as [time] format = '%d.%m.%Y %H:%M:%S'"
        shown = str(sample[0])[:60]
        raise FormatError(f"times as {shown!r} can be read in several ways", where=self.path, do=do)

    def decide_count(self, figures: Floats) -> str:
        """The unit of a count from 1970, or from the profile's origin: a start is never made up."""
        known = np.sort(figures[np.isfinite(figures)])
        middle = float(known[len(known) // 2]) if len(known) else np.nan
        origin, name = self.profile.time_origin, self.names[0]
        likely = _units.epoch_unit(middle)
        if self.unit is not None and (origin is not None or likely == self.unit):
            self.report.recognised[name] = f"timestamp, counted in {self.unit} from {origin or 1970}"
            return self.unit
        if likely is None or origin is not None or self.unit is not None:
            what = f"the time {middle:.12g} counts {self.unit or 'in an unknown unit'} from an unknown start"
            do = 'state both in a profile: [time] format = "s", origin = "2026-03-02T05:00:00Z"'
            do += ' (days of a spreadsheet: "days", "1899-12-30")' if 25_569 < middle < 73_051 else ""
            raise FormatError(what, where=self.path, do=do)
        why = "no other unit gives a date near ours"
        self.report.recognised[name] = f"timestamp, counted in {likely} from 1970 ({why})"
        old = middle * _units.EPOCH_UNITS[likely] + GPS < _units.microseconds(datetime.now(UTC))
        if old and "gps" in name.lower():
            self.report.note(f"{name!r} is counted from 1970; GPS time, from 1980, needs origin in a profile")
        return likely

    def to_utc(self, time: Ints, bare: Mask, vehicle: Labels) -> Ints:
        """Times of which the ``bare`` ones are local (UTC without a zone in the profile)."""
        if not bare.any():
            return time
        if self.local is None:
            otherwise = "(a profile says otherwise: [time] zone = ...)"
            self.report.note(f"the times state no zone: taken as UTC {otherwise}")
            return time
        names = np.array([*vehicle.names, ""], dtype=object)[vehicle.codes]
        out = time.copy()
        out[bare] = self.local.to_utc(time[bare], names[bare])
        self.skipped = (time != _units.NONE) & (out == _units.NONE)
        return out

    def close(self) -> None:
        """Report how the clock changes were handled."""
        if self.local is None:
            return
        self.report.note(f"times are local of {self.local.zone.key}")
        self.report.tally(self.local.twice, "row", "of an hour that comes twice, told apart by their order")


_NUMBER = r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$"
_DEGREES = re.compile(
    r"^\s*(?P<head>[NSEWnsew])?\s*(?P<sign>[+-])?\s*"
    r"(?P<d>\d{1,3}(?:\.\d+)?)\s*(?:°|d|deg|:|\s|(?=[NSEWnsew]?\s*$))\s*"
    r"(?:(?P<m>\d{1,2}(?:\.\d+)?)\s*(?:'|′|m|min|:|\s|$)\s*)?"
    r"(?:(?P<s>\d{1,2}(?:\.\d+)?)\s*(?:\"|″|''|s|sec)?\s*)?(?P<tail>[NSEWnsew])?\s*$"
)


def numbers(cells: pa.Array, decimal: str = ".") -> tuple[Floats, Mask]:
    """Values of text cells, NaN where empty or ``nan``, and which cells are no numbers (infinity is none)."""
    text = pc.utf8_trim_whitespace(cells)
    # What separates thousands cannot be the decimal point; 1,234 alone could, where that is the point.
    group, after = (",", r"\.") if decimal == "." else (r"\.", ",|$")
    thousands = rf"^([+-]?[1-9]\d{{0,2}}){group}(\d{{3}})({after})"
    text = pc.replace_substring_regex(text, thousands, r"\1\2\3")
    text = text if decimal == "." else pc.replace_substring(text, decimal, ".")
    good = pc.fill_null(pc.match_substring_regex(text, _NUMBER), False)
    kept = pc.if_else(good, pc.replace_substring_regex(text, r"^\+", ""), pa.scalar(None, pa.string()))
    values = np.array(kept.cast(pa.float64()).fill_null(np.nan), dtype=np.float64)
    nan = pc.fill_null(pc.match_substring_regex(text, "(?i)^[+-]?nan$"), False)
    return values, ~np.asarray(pc.or_(pc.or_(good, nan), pc.fill_null(pc.equal(text, ""), True)))


def degrees(cells: pa.Array, decimal: str = ".") -> tuple[Floats, Mask]:
    """Degrees of cells as ``49.977``, ``49 58.614 N`` or ``49°58'36.8"N``, and which cells are neither."""
    values, bad = numbers(cells, decimal)
    for row in np.flatnonzero(bad).tolist():
        if (value := one_angle(str(cells[row].as_py()).replace(decimal, "."))) is not None:
            values[row], bad[row] = value, False
    return values, bad


def one_angle(text: str) -> float | None:
    """One angle in degrees, minutes and seconds, south and west negative; None where it is not one."""
    match = _DEGREES.match(text)
    if match is None or (match["head"] and match["tail"]):
        return None
    minutes, seconds = float(match["m"] or 0.0), float(match["s"] or 0.0)
    if minutes >= 60.0 or seconds >= 60.0:
        return None
    value = float(match["d"]) + minutes / 60.0 + seconds / 3600.0
    letter = (match["head"] or match["tail"] or "N").upper()
    return -value if (letter in "SW") != (match["sign"] == "-") else value


class TableRows:
    """The rows of one file's tables, in order; columns are figures or text. ``vehicle`` is that of every row
    where no column says it, ``decimal`` the point of figures in text, ``angles`` what may hold minutes."""

    def __init__(self, fields: Fields, vehicle: str, angles: set[str], decimal: str = ".") -> None:
        self.fields, self.vehicle, self.angles, self.decimal = fields, vehicle, angles, decimal
        self.report, self.clock = fields.report, Clock(fields)
        self._missing = Source("", sentinels=fields.profile.sentinels)
        self._percent = self._degrees = False
        self._figures_of: dict[str, bool] = {}  # Whether a column has figures; unknown before a value

    def batch(
        self, table: pa.Table, record: Ints, texts: Texts, rejects: list[Reject], progress: float
    ) -> RawBatch:
        """The rows of a table by their numbers; ``texts`` gives those of some of them as they are written."""
        bad: Masks = {}
        vehicle, columns = self._vehicles(table), self._columns(table, bad)
        time = self.clock.times(table, vehicle)
        reasons = self._reasons(table, time, vehicle, bad, record)
        keep = reasons.codes < 0
        refused = [(bad[n] & keep, f"{n} is not a number", False) for n in bad.keys() - {*_MUST}]
        for code in set(reasons.codes[~keep].tolist()):
            refused.append((reasons.codes == code, reasons.names[code], True))
        for which, why, whole in refused:
            gone = record[which].tolist()
            told = zip(gone, texts(gone), strict=True)
            rejects += [Reject(n, why, text[:REJECT_TEXT], whole) for n, text in told]
        if not keep.all():
            columns = {n: v[keep] for n, v in columns.items()}
            vehicle, time, record = vehicle[keep], time[keep], record[keep]
        return RawBatch(vehicle, time, columns, record, sorted(rejects), progress)

    def _columns(self, table: pa.Table, bad: Masks) -> dict[str, Values]:
        columns: dict[str, Values] = {}
        for target, source in self.fields.columns.items():
            chunk = table.column(source.column)
            if target in _units.KINDS:
                figures = self._figures(chunk, source.column, target, bad)
                if target == "heading" and source.unit is None:
                    self._degrees |= bool((np.abs(figures) > 2.0 * np.pi + 1e-3).any())
                    if self._degrees:  # of the compass or of mathematics
                        target, source = f"{source.column}_log", Source(source.column)
                        what = f"degrees of an unknown sense (beyond a turn of radians), kept as {target}"
                        self.report.recognised[source.column] = what
                columns[target] = self._si(target, source, figures)
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
            plain = self._figures_of.get(name, True)
            columns[name] = self._figures(chunk, name, name, bad) if plain else labels_of(chunk)
        names = self.fields.names
        for target, pair in ("latitude", "NS"), ("longitude", "EW"):  # their letters may stand behind them
            column = self.fields.columns[target].column if target in columns else ""
            if column in names[:-1]:
                beside = names[names.index(column) + 1]
                chunk, figures = table.column(beside), np.asarray(columns[target], dtype=np.float64)
                side = Labels.of([]) if pa.types.is_floating(chunk.type) else labels_of(chunk)
                if side.names and {*side.names} <= {*pair}:
                    self.report.recognised[beside] = f"the sign of {target}, {pair[1]} is negative"
                    away = np.array([*(n == pair[1] for n in side.names), False])[side.codes]
                    columns[target] = np.where(away, -np.abs(figures), figures)
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
        text, read = labels_of(chunk), degrees if name in self.angles else numbers
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
        if target == "payload" and source.unit is None and 0.0 < np.nanmax(values, initial=0.0) <= 1.0:
            self.report.note(f"{source.column!r} is at most 1 kg: if it is a flag or in t, a profile says it")
        values = source.to_si(values)
        return _units.si_unit(target).to_si(values) if target == "heading" else values

    def _vehicles(self, table: pa.Table) -> Labels:
        if (name := self.fields.vehicle) is None:
            return Labels(np.zeros(table.num_rows, np.int32), (self.vehicle,))
        found = labels_of(table.column(name))
        if _units.normal(name) == "id" and "vehicle_id" not in self.fields.profile.columns:
            moments = labels_of(table.column(self.clock.names[-1])).names
            if 2 < len(found.names) == len(table) == len(moments):  # each row has its own, and its own time
                self.fields.vehicle, self.fields.kept = None, [*self.fields.kept, name]
                self.report.recognised[name] = f"the row's (each has another): it is of {self.vehicle!r}"
                return self._vehicles(table)
        if cut := [n for n in found.names if n.strip() and n != n.strip()]:
            self.report.note(f"blanks about vehicle ids are left out, as of {cut[0]!r}")
        return renamed(found, [n.strip() or None for n in found.names])

    def _reasons(self, table: pa.Table, time: Ints, vehicle: Labels, bad: Masks, record: Ints) -> Labels:
        """Why each row is refused; null where it is not."""
        none, clock, names = time == _units.NONE, self.clock, self.fields.names
        header = np.zeros(len(time), bool)
        for row in np.flatnonzero(none)[:1000].tolist():
            cells = [str(c[row]).strip() if c.type == pa.string() else "" for c in map(table.column, names)]
            known = sum(cell in names for cell in cells)
            header[row] = 2 * known > len(names)
            if header[row] and sum(map(eq, cells, names)) < known:
                what, place = "another header line, its columns in another order", f"line {record[row]}"
                raise FormatError(what, where=self.report.path, place=place, do="cut the file before it")
        found = {"the vehicle id is missing": vehicle.codes < 0, _units.UNREADABLE: none}
        found |= {_units.MISSING: none & clock.missing, _units.SKIPPED: none & clock.skipped}
        found |= {f"{name} is not a number": bad[name] for name in _MUST if name in bad}
        found |= {"the header line again": header}
        codes = np.full(len(time), -1, np.int32)
        for code, mask in enumerate(found.values()):
            codes[mask] = code
        return Labels(codes, tuple(found))

"""How all logs are read: whatever goes wrong within a reader is damage, and rows come out sound."""

from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.core.columns import BY_NAME, HIVE_NULL
from fleetlog.core.trajectory import Labels, Values, as_labels
from fleetlog.errors import REPORT, FleetlogError, FormatError, fault
from fleetlog.importers._open import ReadReport
from fleetlog.importers._profile import TARGETS
from fleetlog.importers._rows import renamed
from fleetlog.importers._times import EARLIEST, EARLIEST_LOG, LATEST, OFF_TIME
from fleetlog.importers.base import GEOGRAPHIC, LOCAL, Importer, RawBatch, ReadOptions, Reject

LONGEST_ID = 200  # Characters of a vehicle's id as the name of a folder
_OTHERWISE = "a profile may say when it was ([time] origin = ...)"
UNKNOWN_START = f"the times count from an unknown start, placed at 1970-01-01: {_OTHERWISE}"
NO_NAME = f"the vehicle id is missing, longer than {LONGEST_ID} characters, or the word for unknown"


def read_guarded(importer: Importer, path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """The batches of a file, each checked; :class:`~fleetlog.errors.FleetlogError` where no row is usable.

    What cannot be read after the first row, for whatever reason, is damage in ``options.report``."""
    last, latest = 0, -1
    try:
        for batch in importer.read(path, options):
            yield _sound(batch, options)
            last = max(last, int(batch.record.max(initial=0)))
            latest = max(latest, int(batch.time.max(initial=-1)))
    except FleetlogError as error:
        if not last:
            raise
        options.report.damaged(f"breaks off after record {last:,}: {error.what}")
    except Exception as error:
        what = fault(f"the reader of {importer.name}", error)
        if isinstance(error, MemoryError):
            what = "needs more memory than there is"
        if not last:
            raise FormatError(what, where=path, place="before the first row", do=REPORT) from error
        options.report.damaged(f"breaks off after record {last:,}: {what}; {REPORT}")
    else:
        if 0 <= latest < EARLIEST_LOG and not options.origin:
            options.report.note(UNKNOWN_START)


def _sound(batch: RawBatch, options: ReadOptions) -> RawBatch:
    """The batch with times that can be counted, names that can be written, and columns of their kind."""
    withheld = options.profile is not None and not options.profile.keep
    shown = (lambda _: "") if withheld else _text
    rejects = [r._replace(reason=_text(r.reason), text=shown(r.text)) for r in batch.rejects]
    columns: dict[str, Values] = {}
    nowhere = np.zeros(len(batch), bool)
    for given, values in batch.columns.items():
        if withheld and given not in TARGETS:
            continue
        name, found = _column(_text(given), values, options.report)
        columns[name] = found
        if isinstance(found, Labels) or not (wrong := np.isinf(found)).any():
            continue
        columns[name] = np.where(wrong, np.nan, found)
        if name in (*GEOGRAPHIC, *LOCAL):
            nowhere |= wrong
        elif name in BY_NAME:
            said = ((int(batch.record[i]), _said(values, i)) for i in np.flatnonzero(wrong).tolist())
            rejects += [Reject(n, f"{name} is not a number", text, False) for n, text in said]
    off = (batch.time < EARLIEST) | (batch.time > LATEST)
    vehicle = _named(batch.vehicle)
    sizes = [0 if v == HIVE_NULL else len(quote(v.strip(), safe="")) for v in vehicle.names]
    nameless = np.array([*(not 0 < size <= LONGEST_ID for size in sizes), True])[vehicle.codes]
    keep = ~(off | nowhere | nameless)
    for n in np.flatnonzero(~keep).tolist():
        reason = OFF_TIME if off[n] else NO_NAME if nameless[n] else "the position is not a number"
        cells = {"vehicle_id": _said(vehicle, n), "timestamp": f"{batch.time[n]} us"}
        cells |= {name: _said(values, n) for name, values in columns.items()}
        text = " ".join(f"{name}={cell}" for name, cell in cells.items())[:4000]
        rejects.append(Reject(int(batch.record[n]), reason, text))
    rows = slice(None) if keep.all() else keep
    columns = {n: v[rows] for n, v in columns.items()}
    return RawBatch(vehicle[rows], batch.time[rows], columns, batch.record[rows], rejects, batch.progress)


def _column(name: str, values: Values, report: ReadReport) -> tuple[str, Values]:
    """A column brought to its kind; whole numbers are -1 where unknown, or else the log's own."""
    kind = BY_NAME[name].kind if name in BY_NAME else "double" if name in GEOGRAPHIC else ""
    if kind == "double":
        return name, _figures(values)
    if kind == "int64":
        figures = values if not isinstance(values, Labels) and values.dtype.kind == "i" else _figures(values)
        known = figures[~np.isnan(figures)]
        if (np.abs(known) < 2**53).all() and not (known % 1).any():
            return name, np.where(np.isnan(figures), -1, figures).astype(np.int64)
        report.note(f"{name!r} holds more than whole numbers: kept as {name + '_log'!r}")
        return f"{name}_log", values
    is_text = kind or isinstance(values, Labels)
    return name, _named(as_labels(values, len(values))) if is_text else values


def _figures(values: Values) -> Floats:
    """(N,) numbers, NaN for unknown, infinite for what is none."""
    if not isinstance(values, Labels):
        return np.asarray(values, dtype=np.float64)
    return np.array([*map(_number, values.names), np.nan])[values.codes]


def _number(text: str) -> float:
    try:
        value = float(text.replace("_", "?")) if text.strip() else np.nan
    except ValueError:
        return np.nan if text.lower() in ("na", "n/a", "null", "none", "-") else np.inf
    return value if np.isfinite(value) or np.isnan(value) else np.inf


def _said(values: Values, row: int) -> str:
    if not isinstance(values, Labels):
        return str(values[row])
    return values.names[values.codes[row]][:400] if values.codes[row] >= 0 else ""


def _named(labels: Labels) -> Labels:
    """Labels whose names are valid text, each once."""
    return renamed(labels, [_text(name) for name in labels.names])


def _text(name: str) -> str:
    """Valid Unicode; half a surrogate pair is shown as a replacement character."""
    return name if name.isascii() else name.encode("utf-16", "surrogatepass").decode("utf-16", "replace")

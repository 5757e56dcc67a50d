"""The one way in which logs are read: whatever goes wrong within a reader is damage of that file, and rows come out sound."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from fleetlog.core.columns import BY_NAME
from fleetlog.core.trajectory import Labels, Values
from fleetlog.errors import REPORT, FleetlogError, FormatError, fault
from fleetlog.importers._profile import TARGETS
from fleetlog.importers._times import EARLIEST, LATEST, OFF_TIME
from fleetlog.importers.base import Importer, RawBatch, ReadOptions, Reject



def read_guarded(importer: Importer, path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """The batches of a file, each checked; :class:`~fleetlog.errors.FleetlogError` where not one row is usable.

    What comes after the first row and cannot be read, for whatever reason, is damage in ``options.report``.
    """
    batches, last = importer.read(path, options), 0
    while True:
        try:
            batch = next(batches, None)
        except FleetlogError as error:
            if not last:
                raise
            options.report.damaged(f"breaks off after record {last:,}: {error.what}")
            return
        except Exception as error:
            what = "needs more memory than there is" if isinstance(error, MemoryError) else fault(f"the reader of {importer.name}", error)
            if not last:
                raise FormatError(what, where=path, place="before the first row", do=REPORT) from error
            options.report.damaged(f"breaks off after record {last:,}: {what}; {REPORT}")
            return
        if batch is None:
            return
        last = max(last, int(batch.record.max(initial=0)))
        yield _sound(batch, options)


def _sound(batch: RawBatch, options: ReadOptions) -> RawBatch:
    """The batch with times that can be counted, names that can be written, and every known column of its kind."""
    rejects = list(batch.rejects)
    columns = {_text(name): values for name, values in batch.columns.items()}
    withheld = options.profile is not None and not options.profile.keep
    if withheld:
        columns = {n: v for n, v in columns.items() if n in TARGETS}
    for name in [n for n in columns if n in BY_NAME or n in ("latitude", "longitude")]:
        _typed(name, columns, batch, rejects, options)
    columns = {n: _writable(v) for n, v in columns.items()}
    if withheld:
        rejects = [r._replace(text="") for r in rejects]
    batch = replace(batch, vehicle=_named(batch.vehicle), columns=columns, rejects=rejects)
    off = (batch.time < EARLIEST) | (batch.time > LATEST)
    return _without(batch, off, OFF_TIME) if off.any() else batch


def _typed(name: str, columns: dict[str, Values], batch: RawBatch, rejects: list[Reject], options: ReadOptions) -> None:
    """Bring a column of the dataset to its kind; what is no number becomes unknown and is kept as a refused value."""
    values, kind = columns[name], BY_NAME[name].kind if name in BY_NAME else "double"
    if kind == "label" and not isinstance(values, Labels):
        columns[name] = Labels.of([None if v != v else f"{v:g}" for v in values.tolist()])
    elif kind == "double" and isinstance(values, Labels):
        numbers = np.array([*map(_number, values.names), np.nan])
        for code in np.flatnonzero(np.isnan(numbers[:-1])).tolist():
            gone = batch.record[values.codes == code].tolist()
            rejects += [Reject(n, f"{name} is not a number", values.names[code][:400], False) for n in gone]
        columns[name] = numbers[values.codes]
    elif kind == "int64" and (isinstance(values, Labels) or values.dtype.kind == "f"):
        numbers = np.array([*map(_number, values.names), np.nan])[values.codes] if isinstance(values, Labels) else values
        lost = (values.codes >= 0 if isinstance(values, Labels) else ~np.isnan(numbers)) & ~(np.abs(numbers) < 2**53)
        if lost.any() or (np.nan_to_num(numbers) % 1.0).any():
            options.report.note(f"{name!r} holds more than whole numbers: kept as {name + '_log'!r}")
            columns[f"{name}_log"] = columns.pop(name)
        else:
            columns[name] = np.where(np.isnan(numbers), -1, numbers).astype(np.int64)


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        return np.nan
    return value if np.isfinite(value) else np.nan


def _writable(values: Values) -> Values:
    if isinstance(values, Labels):
        return _named(values)
    if values.dtype.kind == "f" and np.isinf(values).any():
        return np.where(np.isinf(values), np.nan, values)
    return values


def _named(labels: Labels) -> Labels:
    """Labels whose names are valid text, each once."""
    names = [_text(n) for n in labels.names]
    if names == list(labels.names):
        return labels
    order = {n: i for i, n in enumerate(dict.fromkeys(names))}
    table = np.array([*(order[n] for n in names), -1], np.int32)
    return Labels(table[labels.codes], tuple(order))


def _text(name: str) -> str:
    """Valid Unicode; half a surrogate pair is shown as a replacement character."""
    return name if name.isascii() else name.encode("utf-16", "surrogatepass").decode("utf-16", "replace")


def _without(batch: RawBatch, gone: np.ndarray[tuple[int], np.dtype[np.bool_]], reason: str) -> RawBatch:
    keep = ~gone
    refused = [Reject(int(n), reason, "") for n in batch.record[gone]]
    columns: dict[str, Values] = {n: v[keep] for n, v in batch.columns.items()}
    return RawBatch(
        batch.vehicle[keep], batch.time[keep], columns, batch.record[keep], [*batch.rejects, *refused], batch.progress
    )

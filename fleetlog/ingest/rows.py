"""Rows of a vehicle on their way into a dataset: unsorted, with where each came from."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.trajectory import Labels, Trajectory, Values

FILE, RECORD, CHANNEL, STUCK, HELD = INTERNAL = ("_file", "_record", "_channel", "_stuck", "_held")
"""Columns of the import itself, never written: number of the file, line or record in it; 1 for rows without
positions, of a stuck sensor, and whose position repeats an older one."""


def join(pieces: Sequence[Trajectory]) -> Trajectory:
    """Pieces of one vehicle as one, in the given order; a column missing in a piece is null there."""
    if len(pieces) == 1:
        return pieces[0]
    columns = {n: _joined(n, pieces) for n in dict.fromkeys(n for p in pieces for n in p.columns)}
    return Trajectory(pieces[0].vehicle_id, np.concatenate([p.time for p in pieces]), columns)


def _joined(name: str, pieces: Sequence[Trajectory]) -> Values:
    values = [p.columns.get(name) for p in pieces]
    if any(isinstance(v, Labels) for v in values):
        labels = [_as_labels(v, len(p)) for v, p in zip(values, pieces, strict=True)]
        order = {n: i for i, n in enumerate(dict.fromkeys(n for piece in labels for n in piece.names))}
        return Labels(np.concatenate([piece.recode(order) for piece in labels]), tuple(order))
    null = -1 if name == "trip_id" else np.nan
    given = zip(values, pieces, strict=True)
    return np.concatenate([np.full(len(p), null) if v is None else v for v, p in given])


def _as_labels(values: Values | None, n: int) -> Labels:
    """Labels as they are, null where there is no column, figures as text."""
    if isinstance(values, Labels):
        return values
    if values is None:
        return Labels(np.full(n, -1, np.int32), ())
    return Labels.of([None if v != v else f"{v:g}" for v in values])


def set_unknown(rows: Trajectory, where: NDArray[np.bool_], *names: str) -> Trajectory:
    """A copy with some values of float columns unknown."""
    return rows.with_columns(**{name: np.where(where, np.nan, rows.floats(name)) for name in names})


def without(rows: Trajectory, *names: str) -> Trajectory:
    """A copy without some columns."""
    return Trajectory(rows.vehicle_id, rows.time, {k: v for k, v in rows.columns.items() if k not in names})


def with_own_columns(rows: Trajectory, own: dict[str, bool]) -> Trajectory:
    """Every own column of the logs, null where this vehicle has none, text where any vehicle has text.

    So all files of a dataset have the same columns, and databases read them together.
    """
    new: dict[str, Values] = {}
    for name, text in own.items():
        values = rows.columns.get(name)
        if text and not isinstance(values, Labels):
            new[name] = _as_labels(values, len(rows))
        elif values is None:
            new[name] = np.full(len(rows), np.nan)
    return rows.with_columns(**new) if new else rows


def picture(rows: Trajectory, row: int) -> str:
    """One row as text, for ``rejected.parquet``."""
    cells = [f"vehicle_id={rows.vehicle_id}", f"timestamp={np.datetime64(int(rows.time[row]), 'us')}Z"]
    for name, values in rows.columns.items():
        if name in (FILE, RECORD):
            continue
        if isinstance(values, Labels):
            value = values.names[values.codes[row]] if values.codes[row] >= 0 else None
        else:
            value = f"{float(values[row]):.10g}" if values[row] == values[row] else None
        if value is not None:
            cells.append(f"{name}={value}")
    return " ".join(cells)

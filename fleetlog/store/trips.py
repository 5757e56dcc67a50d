"""Trips: a truck sets off, drives, and stands until it sets off again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.trajectory import Trajectory

if TYPE_CHECKING:
    import pandas as pd

STANDING_SPEED = 0.2
"""Below this a truck stands [m/s]."""
MIN_STOP = 15.0
"""A shorter standstill does not end a trip: it is a wait on the way [s]."""
MAX_GAP = 60.0
"""A longer silence of the log ends a trip [s]."""
MIN_LOAD_CHANGE = 25.0
"""A change of payload at a standstill ends a trip, however short the stop [kg]."""

Ints = NDArray[np.int64]


def trip_ids(trajectory: Trajectory, first: int = 0) -> Ints:
    """(N,) trip of every row, counting up from ``first``.

    A trip begins where the truck sets off after a standstill of ``MIN_STOP`` or with a load change, or after a gap of
    ``MAX_GAP``; the standstill at its end belongs to it, so that lifting and waiting there are part of its energy and the
    trips of a vehicle cover all its rows.
    """
    n = len(trajectory)
    if n == 0:
        return np.zeros(0, np.int64)
    t = trajectory.seconds()
    speed = trajectory.floats("speed")
    moving = np.nan_to_num(speed, nan=1.0) > STANDING_SPEED
    begins = np.zeros(n, dtype=bool)
    begins[1:] |= np.diff(t) > MAX_GAP
    for start, stop in runs(~moving):
        if (
            start > 0
            and stop < n
            and (t[stop] - t[start] >= MIN_STOP or _load_changes(trajectory, start, stop))
        ):
            begins[stop] = True
    return np.asarray(first + np.cumsum(begins), dtype=np.int64)


def runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Half-open row ranges in which ``mask`` holds."""
    edge = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return list(zip(edge[::2].tolist(), edge[1::2].tolist(), strict=True))


def _load_changes(t: Trajectory, start: int, stop: int) -> bool:
    payload = t.columns.get("payload")
    if payload is None:
        return False
    load = np.asarray(payload, dtype=np.float64)
    return bool(abs(load[stop] - load[max(start - 1, 0)]) > MIN_LOAD_CHANGE)


def trip_table(*trajectories: Trajectory) -> pd.DataFrame:
    """One row a trip: vehicle_id, trip_id, start, end, duration [s], distance [m], from/to [m], payload, energy [J], SOC."""
    return table_of([trip_columns(t) for t in trajectories])


def table_of(trips: list[dict[str, NDArray[Any]]]) -> pd.DataFrame:
    """The table of all trips that :func:`trip_columns` gave: one table for many vehicles, since making one is slow."""
    import pandas as pd

    trips = [t for t in trips if t]
    if not trips:
        return pd.DataFrame()
    out = pd.DataFrame({name: np.concatenate([t[name] for t in trips]) for name in trips[0]})
    for name in ("start", "end"):
        out[name] = pd.to_datetime(out[name], unit="us", utc=True)
    return out


def trip_columns(trajectory: Trajectory, vehicles: Sequence[str] | None = None) -> dict[str, NDArray[Any]]:
    """The columns of :func:`trip_table`, times in microseconds; empty where there are no rows.

    With ``vehicles`` the rows are those of several, one after the other and as many of each.
    """
    vehicles = vehicles or (trajectory.vehicle_id,)
    ids = trajectory.trip_ids()
    new = np.diff(ids, prepend=ids[:1] - 1) != 0
    new[:: max(len(ids) // len(vehicles), 1)] = True
    begin = np.flatnonzero(new)
    if not len(begin):
        return {}
    end = np.append(begin[1:], len(ids)) - 1
    t = trajectory.seconds()
    dt = np.empty_like(t)
    np.minimum(np.diff(t), MAX_GAP, out=dt[:-1])
    dt[end] = 0.0
    x, y, speed = trajectory.floats("x"), trajectory.floats("y"), np.nan_to_num(trajectory.floats("speed"))
    power, soc, payload = (trajectory.floats(c) for c in ("battery_power", "soc", "payload"))
    moves = speed > STANDING_SPEED
    matched = (trajectory.labels("edge_id").codes >= 0).astype(float)
    sums = np.stack([moves * dt, speed * dt, np.where(moves, payload * dt, 0.0), power * dt, matched])
    driven, distance, load, energy, fit = np.add.reduceat(sums, begin, axis=1)
    return {
        "vehicle_id": np.array(vehicles, object)[begin * len(vehicles) // len(ids)], "trip_id": ids[begin],
        "start": trajectory.time[begin], "end": trajectory.time[end],
        "rows": end - begin + 1, "duration": t[end] - t[begin], "driving_time": driven,
        "distance": distance, "max_speed": np.maximum.reduceat(speed, begin),
        "x_start": x[begin], "y_start": y[begin], "x_end": x[end], "y_end": y[end],
        "payload": load / np.where(driven > 0, driven, np.nan),
        "energy": energy, "soc_start": soc[begin], "soc_end": soc[end], "matched": fit / (end - begin + 1),
    }  # fmt: skip


def merge_split_trips(trips: pd.DataFrame) -> pd.DataFrame:
    """One row a trip where a trip was written in several pieces (at a chunk's edge), in order of vehicle and trip."""
    if not trips.duplicated(["vehicle_id", "trip_id"]).any():
        return trips.sort_values(["vehicle_id", "trip_id"], ignore_index=True)
    trips = trips.assign(_load=trips.payload * trips.driving_time, _fit=trips.matched * trips.rows)
    first, last, total = "first", "last", "sum"
    how = dict(
        start=first, end=last, rows=total, driving_time=total, distance=total, max_speed="max", x_start=first, y_start=first,
        x_end=last, y_end=last, energy=total, soc_start=first, soc_end=last, _load=total, _fit=total,
    )  # fmt: skip
    out = (
        trips.sort_values(["vehicle_id", "trip_id", "start"])
        .groupby(["vehicle_id", "trip_id"], as_index=False)
        .agg(how)
    )
    out["duration"] = (out.end - out.start).dt.total_seconds()
    out["payload"] = out._load / out.driving_time.where(out.driving_time > 0)
    out["matched"] = out._fit / out.rows
    return out[[c for c in trips.columns if not c.startswith("_")]]

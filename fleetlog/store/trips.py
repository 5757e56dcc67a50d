"""Trips: a truck sets off, drives, and stands until it sets off again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.trajectory import Trajectory

if TYPE_CHECKING:
    import pandas as pd

STANDING_SPEED = 0.2  # Below this a truck stands [m/s]
MIN_STOP = 15.0  # A shorter standstill does not end a trip: it is a wait on the way [s]
MAX_GAP = 60.0  # A longer silence of the log ends a trip [s]
MIN_LOAD_CHANGE = 25.0  # A change of payload at a standstill ends a trip, however short the stop [kg]

LAST = ("last_speed", "last_power", "last_payload")
"""Of a piece of a trip, beside its columns: the time to the next piece is driven with them."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def trip_ids(trajectory: Trajectory, first: int = 0) -> Ints:
    """(N,) trip of every row, counting up from ``first``.

    A trip begins where the truck sets off after a standstill of ``MIN_STOP`` or with a load change, or after
    a gap of ``MAX_GAP``; the standstill at its end belongs to it, so that lifting and waiting there are part
    of its energy and the trips of a vehicle cover all its rows.
    """
    n, t = len(trajectory), trajectory.seconds()
    moving = np.nan_to_num(trajectory.floats("speed"), nan=1.0) > STANDING_SPEED
    begins = np.diff(t, prepend=t[:1]) > MAX_GAP
    load = trajectory.floats("payload")
    for start, stop in runs(~moving):
        if start > 0 and stop < n:
            loads = abs(load[stop] - load[start - 1]) > MIN_LOAD_CHANGE
            begins[stop] |= t[stop] - t[start] >= MIN_STOP or loads
    return np.asarray(first + np.cumsum(begins), dtype=np.int64)


def runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Half-open row ranges in which ``mask`` holds."""
    edge = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return list(zip(edge[::2].tolist(), edge[1::2].tolist(), strict=True))


def table_of(trips: list[dict[str, NDArray[Any]]]) -> pd.DataFrame:
    """One table of all trips that :func:`trip_columns` gave, since making one is slow."""
    import pandas as pd

    trips = [t for t in trips if t]
    if not trips:
        return pd.DataFrame({"vehicle_id": [], "trip_id": []})
    out = pd.DataFrame({name: np.concatenate([t[name] for t in trips]) for name in trips[0]})
    for name in ("start", "end"):
        out[name] = pd.to_datetime(out[name], unit="us", utc=True)
    return out


def trip_columns(trajectory: Trajectory, vehicles: Sequence[str] | None = None) -> dict[str, NDArray[Any]]:
    """Of every trip: times [us], distance [m], energy [J] and more, and ``LAST``; empty without rows.

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
    time, x, y = trajectory.time, trajectory.floats("x"), trajectory.floats("y")
    speed = trajectory.floats("speed")
    if np.isnan(speed).any():
        speed = np.nan_to_num(speed)
    power, soc, payload = (trajectory.floats(c) for c in ("battery_power", "soc", "payload"))
    # One array is filled again and again: fresh memory would take as long as the sums.
    dt, product = np.zeros(len(ids)), np.empty(len(ids))
    np.subtract(time[1:], time[:-1], out=dt[:-1], casting="unsafe")
    dt *= 1e-6
    np.minimum(dt, MAX_GAP, out=dt)
    dt[end] = 0.0

    def add(values: Floats, weight: Floats) -> Floats:
        return np.asarray(np.add.reduceat(np.multiply(values, weight, out=product), begin))

    distance, energy = add(speed, dt), add(power, dt)
    dt[speed <= STANDING_SPEED] = 0.0
    driven, load = np.add.reduceat(dt, begin), add(payload, dt)
    if np.isnan(load).any():
        # Only loads that were driven count.
        load = add(np.where(dt > 0.0, payload, 0.0), dt)
    codes = trajectory.labels("edge_id").codes
    fit = np.add.reduceat((codes >= 0).view(np.int8), begin, dtype=np.int64)
    return {
        "vehicle_id": np.array(vehicles, object)[begin * len(vehicles) // len(ids)], "trip_id": ids[begin],
        "start": trajectory.time[begin], "end": trajectory.time[end],
        "rows": end - begin + 1, "duration": (time[end] - time[begin]) * 1e-6, "driving_time": driven,
        "distance": distance, "max_speed": np.maximum.reduceat(speed, begin),
        "x_start": x[begin], "y_start": y[begin], "x_end": x[end], "y_end": y[end],
        "payload": load / np.where(driven > 0, driven, np.nan),
        "energy": energy, "soc_start": soc[begin], "soc_end": soc[end], "matched": fit / (end - begin + 1),
        **dict(zip(LAST, (speed[end], power[end], payload[end]), strict=True)),
    }  # fmt: skip


def merge_split_trips(pieces: pd.DataFrame) -> pd.DataFrame:
    """One row a trip, in order of vehicle and trip, where some were written in several pieces."""
    trip = ["vehicle_id", "trip_id"]
    trips = pieces.sort_values([*trip, "start"], ignore_index=True)
    begin = np.flatnonzero(~trips.duplicated(trip))
    if len(begin) < len(trips):
        trips = _merged(trips, begin)
    return trips[[c for c in pieces.columns if c not in LAST]]


def _merged(pieces: pd.DataFrame, begin: NDArray[np.intp]) -> pd.DataFrame:
    """Sorted pieces as trips, which begin at the rows ``begin``; what a piece lacks its trip lacks."""
    end = np.append(begin[1:], len(pieces)) - 1
    column = {name: pieces[name].to_numpy() for name in pieces}
    gap = np.append((pieces.start.shift(-1) - pieces.end).dt.total_seconds().to_numpy()[:-1], 0.0)
    gap[end] = 0.0
    gap = np.minimum(gap, MAX_GAP)
    moves = np.where(column["last_speed"] > STANDING_SPEED, gap, 0.0)

    def add(values: Floats, last: str | None = None, time: Floats = gap) -> Floats:
        """Sums over the pieces, and over the time from the last row of each to the next."""
        between = 0.0 if last is None else np.where(time > 0.0, column[last] * time, 0.0)
        return np.asarray(np.add.reduceat(values + between, begin))

    driven = column["driving_time"]
    load = np.where(driven > 0.0, column["payload"] * driven, 0.0)
    out = pieces.iloc[begin].reset_index(drop=True)
    for name in ("end", "x_end", "y_end", "soc_end"):
        out[name] = pieces[name].iloc[end].array
    out["rows"] = np.add.reduceat(column["rows"], begin)
    out["duration"] = (out.end - out.start).dt.total_seconds()
    out["driving_time"] = add(driven + moves)
    out["distance"] = add(column["distance"], "last_speed")
    out["max_speed"] = np.maximum.reduceat(column["max_speed"], begin)
    out["payload"] = add(load, "last_payload", moves) / out.driving_time.where(out.driving_time > 0.0)
    out["energy"] = add(column["energy"], "last_power")
    out["matched"] = add(column["matched"] * column["rows"]) / out.rows
    return out

"""Trips: a truck sets off, drives, and stands until it sets off again."""

from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np

from fleetlog.core.arrays import Array, DataFrame, Floats, Ints, Mask
from fleetlog.core.trajectory import Trajectory

STANDING_SPEED = 0.2  # Below this a truck stands [m/s]
MIN_STOP = 15.0  # A shorter standstill does not end a trip: it is a wait on the way [s]
MAX_GAP = 60.0  # A longer silence of the log ends a trip [s]
MIN_LOAD_CHANGE = 25.0  # A change of payload at a standstill ends a trip, however short the stop [kg]

Columns = dict[str, Array]


def trip_ids(trajectory: Trajectory, first: int = 0) -> Ints:
    """(N,) trip of every row, counting up from ``first``.

    A trip begins where the truck sets off after a standstill of ``MIN_STOP`` or with a load change, or after
    a gap of ``MAX_GAP``; the standstill at its end belongs to it, so that lifting and waiting there are part
    of its energy and the trips of a vehicle cover all its rows."""
    n, t = len(trajectory), trajectory.seconds()
    moving = np.nan_to_num(trajectory.floats("speed"), nan=1.0) > STANDING_SPEED
    begins = np.diff(t, prepend=t[:1]) > MAX_GAP
    load = trajectory.floats("payload")
    for start, stop in runs(~moving):
        if start > 0 and stop < n:
            loads = abs(load[stop] - load[start - 1]) > MIN_LOAD_CHANGE
            begins[stop] |= t[stop] - t[start] >= MIN_STOP or loads
    return np.asarray(first + np.cumsum(begins), dtype=np.int64)


def runs(mask: Mask) -> list[tuple[int, int]]:
    """Half-open row ranges in which ``mask`` holds."""
    edge = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return list(zip(edge[::2].tolist(), edge[1::2].tolist(), strict=True))


def trip_pieces(trajectory: Trajectory, vehicles: Sequence[str] | None = None) -> Columns:
    """Of every trip what adds up: times [us], metres, joules, seconds driven and more; empty without rows.

    With ``vehicles`` the rows are those of several, one after the other and as many of each.  ``load`` is
    payload by seconds driven, ``on_road`` counts matched rows; with the ``last_`` values the time to the
    next piece of the trip is driven."""
    vehicles = vehicles or (trajectory.vehicle_id,)
    ids = trajectory.trip_ids()
    new = np.diff(ids, prepend=ids[:1] - 1) != 0
    new[:: max(len(ids) // len(vehicles), 1)] = True
    if not len(begin := np.flatnonzero(new)):
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
    return {
        "vehicle_id": np.array(vehicles, object)[begin * len(vehicles) // len(ids)], "trip_id": ids[begin],
        "start": time[begin], "end": time[end], "rows": end - begin + 1, "driving_time": driven,
        "distance": distance, "max_speed": np.maximum.reduceat(speed, begin),
        "x_start": x[begin], "y_start": y[begin], "x_end": x[end], "y_end": y[end], "load": load,
        "energy": energy, "soc_start": soc[begin], "soc_end": soc[end],
        "on_road": np.add.reduceat((codes >= 0).view(np.int8), begin, dtype=np.int64),
        "last_speed": speed[end], "last_power": power[end], "last_payload": payload[end],
    }  # fmt: skip


def contents_of(pieces: Iterable[Columns]) -> tuple[dict[str, int], str | None, str | None]:
    """Rows by vehicle, and first and last time (UTC); None without rows."""
    rows, pieces = Counter[str](), [p for p in pieces if p]
    for piece in pieces:
        for vehicle, number in zip(piece["vehicle_id"], piece["rows"].tolist(), strict=True):
            rows[vehicle] += number
    if not pieces:
        return {}, None, None
    ends = min(p["start"].min() for p in pieces), max(p["end"].max() for p in pieces)
    start, end = (f"{np.datetime64(int(time), 'us')}Z" for time in ends)
    return dict(rows), start, end


def trips_of(pieces: Sequence[Columns]) -> DataFrame:
    """One row a trip, by vehicle and trip; -1 are rows without one. What a piece lacks its trip lacks."""
    import pandas as pd

    if not (pieces := [p for p in pieces if p]):
        return pd.DataFrame({"vehicle_id": [], "trip_id": []})
    table = pd.DataFrame({name: np.concatenate([p[name] for p in pieces]) for name in pieces[0]})
    table = table.sort_values(["vehicle_id", "trip_id", "start"], ignore_index=True)
    begin = np.flatnonzero(~table.duplicated(["vehicle_id", "trip_id"]))
    end = np.append(begin[1:], len(table)) - 1
    of = {name: table[name].to_numpy() for name in table}
    gap = np.minimum(np.append(of["start"][1:] - of["end"][:-1], 0) * 1e-6, MAX_GAP)
    gap[end] = 0.0
    moves = np.where(of["last_speed"] > STANDING_SPEED, gap, 0.0)

    def add(name: str, last: str, time: Floats = gap) -> Floats:
        """Sums over the pieces, and over the time from the last row of each to the next."""
        return np.asarray(np.add.reduceat(of[name] + np.where(time > 0.0, of[last] * time, 0.0), begin))

    driven, rows = (np.add.reduceat(v, begin) for v in (of["driving_time"] + moves, of["rows"]))
    start, stop = of["start"][begin], of["end"][end]
    return pd.DataFrame({
        "vehicle_id": of["vehicle_id"][begin], "trip_id": of["trip_id"][begin],
        "start": pd.to_datetime(start, unit="us", utc=True), "end": pd.to_datetime(stop, unit="us", utc=True),
        "rows": rows, "duration": (stop - start) * 1e-6, "driving_time": driven,
        "distance": add("distance", "last_speed"), "max_speed": np.maximum.reduceat(of["max_speed"], begin),
        "x_start": of["x_start"][begin], "y_start": of["y_start"][begin], "x_end": of["x_end"][end],
        "y_end": of["y_end"][end],
        "payload": add("load", "last_payload", moves) / np.where(driven > 0.0, driven, np.nan),
        "energy": add("energy", "last_power"), "soc_start": of["soc_start"][begin],
        "soc_end": of["soc_end"][end], "matched": np.add.reduceat(of["on_road"], begin) / rows,
    })  # fmt: skip

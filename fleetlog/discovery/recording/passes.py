"""Whether a recording sees a place, or a trip's own floor, more than once; what is seen once needs pieces
held out."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.trajectory import Trajectory

Floats = NDArray[np.float64]
Days = Sequence[tuple[int, Trajectory]]

FEWEST, MOST = 6, 150
"""Trips that may each have something of their own: fewer say little, more are no longer one column each."""
LONG = 30.0  # Mean seconds of a trip that can be judged by its own parts
RETURN = 10  # Windows after which a truck that is at a place again has come back to it


def passed_once(days: Days, window: float) -> bool:
    """Return whether most places are passed once only; ``window`` [s]."""
    parts = [_moving(v, t) for v, t in days if t.has("x") and t.has("speed")]
    x, y, time, speed, vehicle = np.concatenate([*parts, np.zeros((5, 0))], axis=1)
    if len(x) == 0:
        return False
    side = 2.0 * window * float(np.median(speed))
    place = (x // side).astype(np.int64) * 1_000_003 + (y // side).astype(np.int64)
    order = np.lexsort((time, place))
    place, time, vehicle = place[order], time[order], vehicle[order]
    again = (np.diff(place) == 0) & ((np.diff(time) > RETURN * window) | (np.diff(vehicle) != 0.0))
    return bool(np.isin(place, place[1:][again]).mean() < 0.5)


def _moving(vehicle: int, t: Trajectory) -> Floats:
    """(5, n) place, time, speed and vehicle of the rows in motion whose place is known."""
    table = np.stack([
        t.floats("x"), t.floats("y"), t.time * 1e-6, t.floats("speed"), np.full(len(t), float(vehicle)),
    ])  # fmt: skip
    return np.asarray(table[:, np.isfinite(table).all(axis=0) & (table[3] > 0.0)])


def trips_apart(days: Days) -> tuple[tuple[int, int], ...]:
    """Return (vehicle, trip) of trips that may each have a floor of their own: few, long, and nothing says
    where they went."""
    if any(t.has("x") or t.has("edge_id") for _, t in days):
        return ()
    trips = tuple(sorted({(v, int(k)) for v, t in days for k in np.unique(t.trip_ids())}))
    seconds = sum(float(np.diff(t.time)[np.diff(t.trip_ids()) == 0].sum()) * 1e-6 for _, t in days)
    return trips if FEWEST <= len(trips) <= MOST and seconds > LONG * len(trips) else ()

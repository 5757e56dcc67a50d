"""What is held out: whole trips, stretches of time, places, vehicles; never rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fleetlog.discovery.windows import Windows

Ints = NDArray[np.int64]

FOLDS = 5
FEWEST_BLOCKS = 12
"""With fewer vehicle-days than this each is cut into hours, as slow variables need some independent samples."""
TEST = 0.2
"""Share that no step of the search sees."""
FEWEST_TRIPS, MOST_TRIPS = 6, 150
LONG_TRIP = 30.0
"""Mean seconds of a trip that can be held against another by its own parts."""
PIECE = 3
"""Windows of a piece of road that is held out where every place is passed once, so that its neighbours speak for it."""
RETURN = 10
"""Windows after which a truck that is at a place again has come back to it."""


def slow_blocks(w: Windows) -> Ints:
    """(W,) the vehicle-day of every window, cut into shorter stretches of time where there are few."""
    day = w.vehicle * 100_000 + (w.day - w.day.min())
    count = len(np.unique(day))
    if count >= FEWEST_BLOCKS:
        return np.asarray(np.unique(day, return_inverse=True)[1])
    parts = int(np.ceil(2 * FEWEST_BLOCKS / count))
    out = np.zeros(len(w), np.int64)
    for k, d in enumerate(np.unique(day)):
        m = day == d
        rank = np.argsort(np.argsort(w.time[m], kind="stable"), kind="stable")
        out[m] = k * parts + rank * parts // max(int(m.sum()), 1)
    return out


def independent(w: Windows) -> Windows:
    """The windows with stretches of time in place of trips, where a log hardly ever stops.

    Where it never comes back to a place either, pieces of road of a few windows take their place: what is said of a piece
    that was held out can only come from its neighbours.  So it is with trips that may each have something of their own.
    """
    trips = {int(t) for t in np.unique(w.trip)}
    if apart(trips, float(w.duration.sum()), bool(np.isfinite(w.x).any())):
        return replace(w, trip=_pieces(w), pieces=True)
    if len(trips) >= FEWEST_BLOCKS:
        return w
    if passed_once(w):
        return replace(w, trip=_pieces(w), pieces=True)
    return replace(w, trip=slow_blocks(w))


def apart(trips: set[int], seconds: float, placed: bool) -> tuple[int, ...]:
    """Trips that may each have something of their own (a floor, a trailer): few and long, and nothing known of where they went."""
    fits = not placed and FEWEST_TRIPS <= len(trips) <= MOST_TRIPS and seconds > LONG_TRIP * len(trips)
    return tuple(sorted(trips)) if fits else ()


def passed_once(w: Windows) -> bool:
    """Whether most places off any map are passed once only."""
    drove = np.flatnonzero(w.moving & np.isfinite(w.x) & np.isfinite(w.y))
    if (w.edge >= 0).any() or len(drove) < 2 * RETURN:
        return False
    side = 2.0 * float(np.median(w.distance[drove]))
    place = (w.x[drove] // side).astype(np.int64) * 1_000_003 + (w.y[drove] // side).astype(np.int64)
    order = np.lexsort((w.time[drove], place))
    place, time, vehicle = place[order], w.time[drove][order], w.vehicle[drove][order]
    long = RETURN * float(np.median(w.duration[drove]))
    again = (np.diff(place) == 0) & ((np.diff(time) > long) | (np.diff(vehicle) != 0))
    return bool(np.isin(place, place[1:][again]).mean() < 0.5)


def _pieces(w: Windows) -> Ints:
    """(W,) number of the piece of ``PIECE`` windows, trip by trip."""
    order = np.lexsort((w.time, w.trip))
    begin = np.flatnonzero(np.concatenate([[True], np.diff(w.trip[order]) != 0]))
    inside = np.arange(len(w)) - np.repeat(begin, np.diff(np.append(begin, len(w))))
    out = np.zeros(len(w), np.int64)
    out[order] = np.cumsum(inside % PIECE == 0) - 1
    return out


def test_windows(w: Windows, holdout: str, rng: np.random.Generator) -> NDArray[np.bool_]:
    """(W,) windows of the trips (vehicles, days) that are kept back for the last judgement."""
    unit = {"trips": w.trip, "vehicles": w.vehicle, "days": w.day}[holdout]
    if holdout != "trips" and len(np.unique(unit)) < 2:
        unit = slow_blocks(w)
    if w.pieces and holdout == "trips":
        return np.asarray(_interleave(w.trip, round(1.0 / TEST), rng) == 0)
    names = np.unique(unit)
    # A log that never stops is one trip: then stretches of time take the place of trips.
    if holdout == "trips" and len(names) < 5:
        unit = slow_blocks(w)
        names = np.unique(unit)
    chosen = rng.permutation(names)[: max(1, round(TEST * len(names)))]
    return np.isin(unit, chosen)


def folds(w: Windows, block: Ints, rng: np.random.Generator) -> dict[str, Ints]:
    """(W,) fold numbers of every kind of split that these data allow; ``trip`` is always there."""
    trips = w.trip if len(np.unique(w.trip)) >= 2 * FOLDS else block
    if w.pieces:
        # A stretch of hours is then a place never seen, which a map of places cannot be asked to predict.
        return {
            "trip": _interleave(w.trip, FOLDS, rng),
            "place": _deal(block, min(2 * FOLDS, len(np.unique(block))), rng),
        }
    out = {
        "trip": _deal(trips, FOLDS, rng),
        "block": _deal(block, min(2 * FOLDS, len(np.unique(block))), rng),
    }
    place = w.edge if (w.edge >= 0).any() else _squares(w)
    if len(np.unique(place[w.moving])) >= 2 * FOLDS:
        dealt = _deal(place, FOLDS, rng)
        # Standing says nothing of a place: deal those windows at random.
        out["place"] = np.where(w.moving, dealt, rng.integers(0, FOLDS, len(w)))
    if len(np.unique(w.vehicle)) >= 3:
        out["vehicle"] = _deal(w.vehicle, min(FOLDS, len(np.unique(w.vehicle))), rng)
    return out


def _squares(w: Windows) -> Ints:
    x, y = np.nan_to_num(w.x), np.nan_to_num(w.y)
    size = max(np.ptp(x), np.ptp(y), 1.0) / 8.0
    return np.asarray((x // size).astype(np.int64) * 1000 + (y // size).astype(np.int64))


def _interleave(piece: Ints, count: int, rng: np.random.Generator) -> Ints:
    """Fold of every window: of ``count`` pieces in a row each goes to another fold, so that one held out has neighbours."""
    _, which = np.unique(piece, return_inverse=True)
    rounds = rng.permuted(np.tile(np.arange(count), (which.max() // count + 1, 1)), axis=1)
    return np.asarray(rounds.ravel()[which], dtype=np.int64)


def _deal(unit: Ints, count: int, rng: np.random.Generator) -> Ints:
    names, which = np.unique(unit, return_inverse=True)
    return np.asarray((rng.permutation(len(names)) % count)[which], dtype=np.int64)

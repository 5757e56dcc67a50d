"""What is held out: whole trips, vehicles, days, or stretches of time where trips are few; never rows.

Where every place is passed once, only its neighbours can speak for a piece of road: stretches are then as
short as windows allow. Trips are dealt by vehicle-day, so that a day can be read without the others."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from fleetlog.core.arrays import Floats, Ints, Mask
from fleetlog.discovery.recording.blocks import Windows
from fleetlog.discovery.recording.day import Day

Kind = Literal["trips", "stretches", "vehicles", "days"]

HELD_OUT = -1  # Fold number of what nothing but the final scores reads
FEWEST = 20  # Trips from which on they are the unit of what is held out: two for each fold
PIECES = 60  # Stretches into which a recording of few trips is cut
SLOW = 36  # Stretches of time that are the independent samples of what changes over hours
SHORTEST, LONGEST = 3.0, 86400.0  # Of a stretch: windows, and seconds
FEW, MANY = 6, 150  # Trips that may each have something of their own: fewer say little, more are no columns
LONG = 30.0  # Mean seconds of a trip that can be judged by its own parts
RETURN = 10  # Windows after which a truck that is at a place again has come back to it


@dataclass(frozen=True)
class Split:
    """How windows are dealt; ``length`` [s] of a stretch, ``slow`` [s] of a slow one."""

    kind: Kind
    length: float
    slow: float
    folds: int
    held_out: float
    seed: int
    test_units: frozenset[int] = frozenset()
    once: bool = False  # Whether pieces are held out that only their neighbours speak for

    def unit(self, w: Windows) -> Ints:
        """Return the code of what is held out together, (W,)."""
        return self._units(w.trip, w.time, w.vehicle)

    def fold(self, w: Windows) -> Ints:
        """Return the fold of every window, (W,); ``HELD_OUT`` for those of the final scores."""
        if not len(w):
            return np.zeros(0, np.int64)
        return self.rows(w.trip, w.time, int(w.vehicle[0]), int(w.day[0]))

    def rows(self, trip: Ints, time: Floats, vehicle: int, day: int, share: float = 1.0) -> Ints:
        """Return the same for the rows of a vehicle-day; ``HELD_OUT`` beside an even sample of them, too."""
        unit = self._units(trip, time, np.full(len(trip), vehicle))
        if (vehicle if self.kind == "vehicles" else day) in self.test_units:
            return np.full(len(unit), HELD_OUT)
        codes, which = np.unique(unit, return_inverse=True)
        out = self._dealt(codes, self.folds, 0)
        if not self.test_units:
            out[self._dealt(codes, max(2, round(1.0 / self.held_out)), 1) == 0] = HELD_OUT
        return np.where(_evenly(unit, share), out[which], HELD_OUT)

    def _units(self, trip: Ints, time: Floats, vehicle: Ints) -> Ints:
        if self.kind == "trips":
            return trip
        return np.asarray(vehicle * (1 << 32) + (time // self.length).astype(np.int64))

    def drawn(self, w: Windows, share: float) -> Mask:
        """Return which windows belong to an even sample, (W,)."""
        return _evenly(self.unit(w), share)

    def _dealt(self, codes: Ints, count: int, salt: int) -> Ints:
        """Return the share of each code: of ``count`` in a row each has another: neighbours remain."""
        out = np.zeros(len(codes), np.int64)
        for r in np.unique(codes // count):
            mine = codes // count == r
            out[mine] = _order(self.seed, salt, int(r), count)[codes[mine] % count]
        return out

    def slow_fold(self, w: Windows) -> Ints:
        """Return the fold of the stretch of hours of every window, (W,)."""
        return _mixed(w.vehicle * 1_000_003 + (w.time // self.slow).astype(np.int64)) % self.folds


@lru_cache(4096)
def _order(seed: int, salt: int, run: int, count: int) -> Ints:
    """The shares of one run of codes, in an order of chance."""
    return np.random.default_rng([seed, salt, run]).permutation(count)


def _evenly(codes: Ints, share: float) -> Mask:
    """Which codes belong to an even sample of such a share."""
    return np.asarray(_mixed(codes) % 1000 < 1000.0 * share)


def _mixed(codes: Ints) -> Ints:
    """Return numbers that share no pattern with codes (Fibonacci hashing, Knuth 1973)."""
    return ((codes.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(33)).astype(np.int64)


def make_split(
    holdout: Kind, trips: int, seconds: float, vehicles: list[int], days: list[int], folds: int,
    held_out: float, seed: int, window: float = 10.0, once: bool = False,
) -> Split:  # fmt: skip
    """Return the split for a recording of so many trips and seconds in all. ``window`` [s] is the shortest
    that any channel looks at; ``once`` where most places are passed once."""
    shortest = SHORTEST * window
    length = shortest if once else float(np.clip(seconds / PIECES, shortest, LONGEST))
    slow = float(np.clip(seconds / SLOW, shortest, LONGEST))
    units = vehicles if holdout == "vehicles" else days
    if holdout in ("vehicles", "days") and len(units) >= 2:
        chosen = np.random.default_rng(seed).permutation(units)[: max(1, round(held_out * len(units)))]
        return Split(holdout, length, slow, folds, held_out, seed, frozenset(int(u) for u in chosen), once)
    kind: Kind = "trips" if trips >= FEWEST and not once else "stretches"
    return Split(kind, length, slow, folds, held_out, seed, once=once)


def passed_once(days: Sequence[Day], window: float) -> bool:
    """Return whether most places are passed once only; ``window`` [s]."""
    parts = [np.zeros((5, 0))]  # Place, time, speed and vehicle of rows in motion whose place is known
    for day in (d for d in days if {"x", "speed"} <= d.known):
        x, y, speed = (day.few.floats(name) for name in ("x", "y", "speed"))
        table = np.stack([x, y, day.few.time * 1e-6, speed, np.full(len(x), float(day.vehicle))])
        parts.append(table[:, np.isfinite(table).all(axis=0) & (speed > 0.0)])
    x, y, time, speed, vehicle = np.concatenate(parts, axis=1)
    if len(x) == 0:
        return False
    side = 2.0 * window * float(np.median(speed))
    place = (x // side).astype(np.int64) * 1_000_003 + (y // side).astype(np.int64)
    order = np.lexsort((time, place))
    place, time, vehicle = place[order], time[order], vehicle[order]
    again = (np.diff(place) == 0) & ((np.diff(time) > RETURN * window) | (np.diff(vehicle) != 0.0))
    return bool(np.isin(place, place[1:][again]).mean() < 0.5)


def trips_apart(days: Sequence[Day]) -> tuple[tuple[int, int], ...]:
    """Return (vehicle, trip) of trips with own floors: few, long, and nothing says where they went."""
    if any({"x", "edge_id"} & d.known for d in days):
        return ()
    trips = tuple(sorted({(d.vehicle, int(k)) for d in days for k in d.trips}))
    return trips if FEW <= len(trips) <= MANY and sum(d.driven for d in days) > LONG * len(trips) else ()

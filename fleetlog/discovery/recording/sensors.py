"""Faults of the recording come first: a late clock looks like slope or inertia, a wrong speed scale like
drag.

Late positions: the speed channel is shifted until its ways are as long as those between places.
Clock: the predicted power is compared with the measured one at every shift, piece by piece, with a parabola
at the best; and with its mean over the last seconds, which is what some loggers report.  Scale: integrated
speed against progress along the map, on the middle of edges; without a map against chords of straights.
Held-out trips are not looked at."""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from fleetlog.core.arrays import Floats, Mask
from fleetlog.core.trajectory import Trajectory
from fleetlog.discovery.recording.blocks import TRIP, Block
from fleetlog.discovery.recording.day import pooled, step_of
from fleetlog.discovery.recording.fleet import Fleet
from fleetlog.discovery.recording.splits import HELD_OUT, Split
from fleetlog.physics.motion.rows import elsewhere, metres_driven, updates
from fleetlog.physics.power import Physics, all_terms, battery_power
from fleetlog.physics.term import Term
from fleetlog.store.trips import STANDING_SPEED

FINE = 1.0  # Step of the shifts that are tried, at most [s]: trucks start and brake within seconds
LONGEST = 40.0  # Largest shift that is tried [s]: clocks of two loggers that are set by hand
ALIKE = 0.01  # Correlations this close to the best are as good: repeated work matches at many shifts
SURE = 4.0  # Standard errors that a fault must reach
END = 6.0  # Metres at the ends of an edge where corners are cut
SHORTEST = 12.0  # Metres of progress that are worth comparing
MISMATCHED = 0.25  # A ratio of speed to progress that is off by this is a wrong match
FEWEST = 20  # Ways of a vehicle that show by how much its speed is off
STRAIGHT = 20.0  # Metres of such a way without a map, where rows are dense
MANY = 2000  # Rows that show well enough which shift to look at closely
INTERVALS = np.linspace(0.85, 1.15, 13)
"""Intervals of a mean that are tried, over twice the shift that fits best; and shifts, over that."""
SHIFTS = np.linspace(-3.0, 3.0, 25)  # Of the speed channel against positions that are tried [s]
LATE = 0.3  # Least shift that counts [s], as of the clock of the power
COARSE = 0.01  # Share of the speed that its step may hide where shifts are told
DENSE = 2.0  # Step of rows [s] up to which they tell of shifts: trucks start and brake within seconds
LOOKED_AT = 2  # Days of a vehicle whose clock is looked at: twelve pieces tell how late it is
PIECE = 200  # Rows of a piece whose clock is looked at by itself


@dataclass(frozen=True)
class Off:
    """What is off in some vehicles: the value of each, by code, and the standard error of all together."""

    by_vehicle: dict[int, float]
    error: float
    all_vehicles: bool
    p_value: float

    @property
    def value(self) -> float:
        """The usual value."""
        return float(np.median(list(self.by_vehicle.values())))


@dataclass(frozen=True)
class Fault:
    """A fault of one kind; ``before`` and ``after`` it is put right, by the ``metric`` of its ``channel``."""

    term: str
    channel: str
    metric: str
    off: Off
    before: float
    after: float


@dataclass(frozen=True)
class _Look:
    """What a piece of a vehicle's log says: how late it is [s], and the share unexplained with it or not."""

    value: float
    before: float
    after: float
    interval: float
    averaged: float  # The same with the mean over the last ``interval`` seconds


def examine(fleet: Fleet, split: Split, only: tuple[str, ...] = ()) -> tuple[Fleet, list[Fault]]:
    """Return the fleet with its sensors put right, and the faults found; ``only`` restricts them by term."""
    faults: list[Fault] = []
    known = (t for t in all_terms().values() if t.acts == "sensor" and (not only or t.name in only))
    terms: dict[str, Term] = {t.fault: t for t in known}
    if "scale" in terms:
        late, scaled = _speed(fleet, split, terms["scale"])
        fleet = replace(fleet, speed_late=late)
        if scaled is not None:
            faults.append(scaled)
            fleet = replace(fleet, scale=scaled.off.by_vehicle)
    if {"clock", "mean"} & set(terms) and fleet.has("battery_power"):
        found, fleet = _clock(fleet, split, terms)
        faults += found
        if found:
            fleet = replace(fleet, load_with_power=_load_runs_with_power(fleet))
    # A value that is held stands for the time about the first row that has it.
    lag = {v: fleet.lag.get(v, 0.0) + 0.5 * (held - fleet.steps[v]) for v, held in fleet.held.items()}
    return replace(fleet, lag=fleet.lag | lag), faults


def _clock(fleet: Fleet, split: Split, terms: dict[str, Term]) -> tuple[list[Fault], Fleet]:
    """How far the power channel runs behind the positions, or that it is a mean, and the fleet with that put
    right. Nothing where no vehicle's is late."""
    looks: dict[int, list[_Look]] = {}
    for vehicle, look in itertools.chain.from_iterable(fleet.each(partial(_looked, fleet, split))):
        looks.setdefault(vehicle, []).append(look)
    finest, least = 0.06 * fleet.steps, terms["clock"].parameters[0].tolerance if "clock" in terms else 0.3
    shifts = {v: [k.value for k in ks] for v, ks in looks.items() if len(ks) >= 2}
    middle = {v: (float(np.median(s)), max(_spread(s), finest[v])) for v, s in shifts.items()}
    if (late := _off(middle, 0.0, least * np.maximum(1.0, 1.5 * fleet.steps))) is None:
        return [], fleet

    def fault(kind: str, of: dict[int, float], error: float, after: str) -> Fault:
        every = [k for v in of for k in looks[v]]
        before, after_it = (float(np.mean([getattr(k, name) for k in every])) for name in ("before", after))
        error = max(error, *finest[[*of]])
        off = replace(late, by_vehicle=of, all_vehicles=len(of) == len(middle), error=error)
        metric = "share of the power that the model does not explain"
        return Fault(terms[kind].name, "battery_power", metric, off, before, after_it)

    told: dict[int, float] = {}
    for kind in fleet.loggers if "mean" in terms else ():
        # By how much a mean runs behind is known poorly: what its own pieces say tells of each vehicle, and
        # where all of one kind of logger are late alike what the pieces of all say.
        own = [v for v in kind if v in late.by_vehicle]
        at, error = np.array([middle[v] for v in own] or [(0.0, 0.0)]).T
        alike = np.ptp(at) < SURE * error.max()
        every = [k for v in own for k in looks[v]]
        if mean := [v for v in own if _averaged(every if alike else looks[v])]:
            mean += [v for v in kind if v in middle and v not in own and _averaged(looks[v])]
            told |= dict.fromkeys(mean, float(np.median([k.interval for v in mean for k in looks[v]])))
    # A mean that is held stands for all the time that it is held.
    lag = {v: 0.5 * (told[v] if v in fleet.held else fleet.steps[v]) for v in told}
    spread = _spread([k.interval for v in told for k in looks[v]]) if told else 0.0
    faults = [fault("mean", told, spread, "averaged")] if told else []
    if "clock" in terms and (shifted := {v: m for v, m in late.by_vehicle.items() if v not in told}):
        faults.append(fault("clock", shifted, late.error, "after"))
        lag |= shifted
    return faults, replace(fleet, lag=lag, interval=told)


def _averaged(looks: list[_Look]) -> bool:
    """Whether a mean over the last seconds says more of the pieces of a log than a late clock does."""
    return float(np.median([k.averaged - k.after for k in looks])) < 0.0


def _off(found: dict[int, tuple[float, float]], right: float, least: Floats) -> Off | None:
    """Judge a value and its error, by vehicle, from ``least`` (V,) on; None where none is off."""
    off = {v: m for v, (m, e) in found.items() if abs(m - right) > max(least[v], SURE * e)}
    if not off:
        return None
    # What is off by less than counts, but nearer to the others than to none, has the same logger as they.
    usual = float(np.median(list(off.values())))
    off = {v: m for v, (m, e) in found.items() if v in off or abs(m - right) > max(abs(m - usual), SURE * e)}
    values, errors = np.array(list(off.values())), np.array([found[v][1] for v in off])
    whole = len(off) == len(found)
    if whole and np.ptp(values) < SURE * errors.max():
        # One logger for all: the common value is better known than each vehicle's own.
        if abs(float(np.median(values)) - right) <= least[[*off]].max():
            return None
        off = dict.fromkeys(off, float(np.median(values)))
    worst = float(np.max(np.abs(values - right) / errors))
    p_value = max(math.erfc(min(worst, 37.0) / math.sqrt(2.0)), 1e-300)
    return Off(off, float(np.sqrt(np.mean(errors**2) / len(errors))), whole, p_value)


def _spread(values: list[float]) -> float:
    a = np.array(values)
    return float(1.4826 * np.median(np.abs(a - np.median(a))) / np.sqrt(len(a)) + 0.02)


def _looked(fleet: Fleet, split: Split, date: int) -> list[tuple[int, _Look]]:
    some, out = fleet.some(LOOKED_AT), []
    for b in (fleet.merged(fleet.block(d.vehicle, d.load())) for k, d in fleet.on(date) if k in some):
        power = battery_power(b.motion, Physics(fleet.truck))
        train = split.rows(b.trip, b.time, b.vehicle, b.day) != HELD_OUT
        ends = np.linspace(0, len(b), int(np.clip(len(b) // PIECE, 1, 6)) + 1).astype(int).tolist()
        pieces = itertools.starmap(slice, itertools.pairwise(ends))
        looks = (_best_shift(b, power, piece, train, fleet.steps[b.vehicle]) for piece in pieces)
        out += [(b.vehicle, look) for look in looks if look is not None]
    return out


def _best_shift(block: Block, power: Floats, piece: slice, train: Mask, step: float) -> _Look | None:
    """The best shift of a piece, by correlation."""
    measured = block.power[piece]
    known = np.isfinite(measured) & train[piece]
    if known.sum() < PIECE // 2 or np.ptp(measured[known]) == 0.0:
        return None
    clock, power_then = block.time[piece][known], measured[known]
    time = block.motion.time
    energy = np.concatenate([[0.0], np.cumsum(power * block.motion.dt)])
    ends = np.append(time - 0.5 * block.motion.dt, time[-1] + 0.5 * block.motion.dt[-1])

    def alike(begin: Floats, end: Floats, told: Floats) -> float:
        x = (np.interp(end, ends, energy) - np.interp(begin, ends, energy)) / np.maximum(end - begin, 1e-9)
        x, y = x - x.mean(), told - told.mean()
        return float(x @ y / np.sqrt((x @ x) * (y @ y) + 1e-12))

    def shifted(shift: float, every: int = 1) -> float:
        at, half = clock[::every] - shift, 0.5 * min(step, 1.0)
        return alike(at - half, at + half, power_then[::every])

    wide = min(max(step, 0.5), FINE)
    coarse = np.arange(-LONGEST, LONGEST + 0.1, wide)
    scores = np.array([shifted(s, len(clock) // MANY + 1) for s in coarse])
    good = np.flatnonzero(scores >= scores.max() - ALIKE)
    best = float(coarse[good[np.argmin(np.abs(coarse[good]))]])
    for nearby in (best - wide, best + wide):
        best = nearby if shifted(nearby) > shifted(best) else best
    near = best + wide * np.linspace(-0.8, 0.8, 9)
    curve = np.polyfit(near - best, [shifted(s) for s in near], 2)
    if curve[0] >= 0 or scores.max() < 0.5:
        return None
    shift = best + float(np.clip(-curve[1] / (2.0 * curve[0]), -wide, wide))
    # A mean over an interval lags by half of it; where that says more, no single shift says how late it is.
    intervals = [step, *(2.0 * shift * INTERVALS if shift > 0.5 * step else ())]
    averaged = [alike(clock - i, clock, power_then) for i in intervals]
    # As many shifts are tried as intervals: the best of many is better by chance.
    late = max(shifted(s) for s in shift * INTERVALS)
    left = [float(np.sqrt(max(1.0 - c**2, 0.0))) for c in (shifted(0.0), late, max(averaged))]
    interval = float(intervals[int(np.argmax(averaged))])
    return _Look(0.5 * interval if left[2] < left[1] else shift, left[0], left[1], interval, left[2])


def _load_runs_with_power(fleet: Fleet) -> bool:
    """Whether fork height and payload were logged by the late clock: the better fit at standstill decides."""
    if not fleet.has("fork_height"):
        return False
    missed = [sum(fleet.each(partial(_missed, fleet, t))) for t in (False, True)]
    return missed[1] < missed[0]


def _missed(fleet: Fleet, together: bool, date: int) -> float:
    """What the model misses of the power at standstills."""
    total = 0.0
    for _, block in replace(fleet, load_with_power=together).each_block(date):
        still = block.rows(block.motion.speed) <= 0.0
        off = np.nan_to_num(block.power - block.rows(battery_power(block.motion, Physics(fleet.truck))))
        total += float((off[still] ** 2).sum())
    return total


def _speed(fleet: Fleet, split: Split, term: Term) -> tuple[dict[int, float], Fault | None]:
    """How far the speed channel runs behind the positions, by vehicle [s], and what it then reads over the
    true speed; None where no vehicle's is off."""
    ways: dict[int, list[Floats]] = {}
    for vehicle, way in itertools.chain.from_iterable(fleet.each(partial(_ways, fleet, split))):
        ways.setdefault(vehicle, []).append(way)
    # A speed in whole km/h is off by as much all the time that a truck keeps to one speed.
    moving, steps = (speeds := pooled(fleet.days, "speed"))[speeds > STANDING_SPEED], fleet.steps
    coarse = step_of(fleet.days, "speed") / math.sqrt(12.0) / float(np.median(moving)) if len(moving) else 0.0
    least = np.where((steps <= DENSE) & (coarse < COARSE), LATE * np.maximum(1.0, 1.5 * steps), math.inf)
    found = {v: _ratio(np.array(w), least[v]) for v, w in ways.items() if len(w) >= FEWEST}
    late = {v: -shift for v, (_, _, _, shift) in found.items() if shift}
    # How trucks drive between rows is alike in all of them, and so is what the integral misses, by its step.
    missed = float(np.sqrt(np.mean([(m / steps[v] ** 2) ** 2 for v, (_, _, m, _) in found.items()] or [0.0])))
    miss = np.hypot(missed * steps**2, coarse)
    errors = {v: (ratio, math.hypot(error, miss[v])) for v, (ratio, error, _, _) in found.items()}
    if (off := _off(errors, 1.0, np.full(len(steps), 1.5 * term.parameters[0].tolerance))) is None:
        return late, None
    metric = "deviation of travelled distance"
    return late, Fault(term.name, "speed", metric, off, abs(off.value - 1.0), off.error)


def _ways(fleet: Fleet, split: Split, date: int) -> list[tuple[int, Floats]]:
    """Vehicles with ways of a date, (2 + K,) [m]: by places, by the speed of every second row, and by that of
    all rows K moments earlier."""
    out = []
    for _, day in fleet.on(date):
        if day.vehicle in fleet.speed_from_positions | fleet.rarely_placed or "x" not in day.known:
            continue
        t = day.load()
        time, speed = np.asarray(t.time * 1e-6, dtype=np.float64), np.nan_to_num(t.floats("speed"))
        fold = split.rows(t.trip_ids() + TRIP * day.vehicle, time, day.vehicle, date)
        travelled = metres_driven(t.seconds(), speed)
        on_map = fleet.network is not None and "edge_id" in day.known
        step = float(fleet.steps[day.vehicle])
        for a, b, gone in _on_edges(t, fleet, step) if on_map else _on_chords(t, travelled):
            # Noise about a standstill adds up to metres, and says nothing of how speed is scaled.
            if fold[a] != HELD_OUT and speed[a : b + 1].min() > STANDING_SPEED:
                few = np.append(np.arange(a, b, 2), b)
                sparsely = metres_driven(time[few], speed[few])[-1]
                ends = (np.interp(time[k] - SHIFTS, time, travelled) for k in (b, a))
                out.append((day.vehicle, np.array([gone, sparsely, *np.subtract(*ends)])))
    return out


def _ratio(ways: Floats, least: float) -> tuple[float, float, float, float]:
    """By how much the speed is off, the error of that, what rows are too sparse to tell, and by how much the
    positions are late, from ``least`` [s] on.  Integrals by trapezoids miss four times as much over steps
    twice as long.  Ways that end more slowly than they begin are too short where positions are late."""
    gone, sparsely, driven = ways[:, 0], ways[:, 1], ways[:, 2:].T
    now = len(SHIFTS) // 2
    ratio = driven[now] / gone
    good = np.abs(ratio - np.median(ratio)) < MISMATCHED
    gone, sparsely, driven = gone[good], sparsely[good], driven[:, good]
    whole, value = float(gone.sum()), driven.sum(axis=1) / gone.sum()
    left = ((driven - value[:, None] * gone) ** 2).sum(axis=1)
    # The least of a parabola through the best shift and its neighbours, and how sharp it is.
    k, step = int(np.clip(np.argmin(left), 1, len(SHIFTS) - 2)), float(SHIFTS[1] - SHIFTS[0])
    bend = max(float(left[k - 1] - 2.0 * left[k] + left[k + 1]), 1e-12)
    shift = float(SHIFTS[k] + np.clip(0.5 * (left[k - 1] - left[k + 1]) / bend, -1.0, 1.0) * step)
    known = step * math.sqrt(2.0 * left[k] / len(gone) / bend)
    shift = shift if abs(shift) > max(least, SURE * known) else 0.0
    error = math.sqrt(float(np.interp(shift, SHIFTS, left))) / whole + 0.001
    missed = float((sparsely - driven[now]).sum()) / (3.0 * whole)
    return float(np.interp(shift, SHIFTS, value)), error, missed, shift


def _on_edges(trajectory: Trajectory, fleet: Fleet, step: float) -> Iterator[tuple[int, int, float]]:
    """Yield first row, last row and progress [m] of every traversal of the middle of an edge."""
    assert fleet.network is not None
    network = fleet.network
    edge = trajectory.labels("edge_id").recode(network.index)
    offset, time = trajectory.floats("edge_offset"), trajectory.seconds()
    length = network.length[np.maximum(edge, 0)]
    fresh = updates(time, trajectory.floats("x"), trajectory.floats("y"), trajectory.floats("speed"))
    inside = fresh & (edge >= 0) & (offset > END) & (offset < length - END) & np.isfinite(offset)
    begin = np.flatnonzero(np.concatenate([[True], np.diff(edge) != 0]))
    for a, b in zip(begin, np.append(begin[1:], len(edge)), strict=True):
        rows = np.flatnonzero(inside[a:b]) + a
        if len(rows) < 4 or np.diff(time[rows]).max(initial=0.0) > 3.5 * step:
            continue
        gone = float(offset[rows[-1]] - offset[rows[0]])
        if gone > SHORTEST:
            yield int(rows[0]), int(rows[-1]), gone


def _on_chords(trajectory: Trajectory, travelled: Floats) -> Iterator[tuple[int, int, float]]:
    """Yield first row, last row and chord [m] of straight runs, for logs without a map: of longer ones some
    that look straight by their middle bend to and fro."""
    x, y = trajectory.floats("x"), trajectory.floats("y")
    rows = np.flatnonzero(elsewhere(x, y) & np.isfinite(x))
    if len(rows) < 50:
        return
    s = travelled[rows]
    reach = max(STRAIGHT, 10.0 * float(np.median(np.diff(s))))
    i = 0
    while i < len(rows) - 2 and (j := int(np.searchsorted(s, s[i] + reach))) < len(rows):
        a, m, b = rows[i], rows[(i + j) // 2], rows[j]
        chord = float(np.hypot(x[b] - x[a], y[b] - y[a]))
        halves = float(np.hypot(x[m] - x[a], y[m] - y[a]) + np.hypot(x[b] - x[m], y[b] - y[m]))
        if chord > 0.5 * reach and halves < 1.002 * chord:
            yield int(a), int(b), chord
        i = j

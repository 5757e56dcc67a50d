"""Faults of the recording come first: a late clock looks like slope or inertia, a wrong speed scale like
drag.

Clock: the predicted power is compared with the measured one at every shift, piece by piece, with a parabola
at the best; and with its mean over the last seconds, which is what some loggers report.  Scale: integrated
speed against progress along the map, on the middle of edges; without a map against chords of straights.
Held-out trips are not looked at.
"""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.trajectory import Trajectory
from fleetlog.discovery.recording.blocks import TRIP, Block
from fleetlog.discovery.recording.fleet import Fleet
from fleetlog.discovery.recording.splits import HELD_OUT, Split
from fleetlog.physics.power import Physics, all_terms, battery_power
from fleetlog.physics.term import Term

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

LONGEST = 40.0  # Largest shift that is tried [s]: clocks of two loggers that are set by hand
ALIKE = 0.01
"""Correlations this close to the best are as good: work that repeats itself matches at many shifts."""
SURE = 4.0  # Standard errors that a fault must reach
END = 6.0  # Metres at the ends of an edge where corners are cut
SHORTEST = 12.0  # Metres of progress that are worth comparing
MISMATCHED = 0.25  # A ratio of speed to progress that is off by this is a wrong match
SLOT = 0.1  # Length of a slot of time in which shifts are compared at first [s]
MANY = 2000  # Rows that show well enough which shift to look at closely
INTERVALS = np.linspace(0.85, 1.15, 13)
"""Intervals of a mean that are tried, over twice the shift that fits best."""
PIECE = 200  # Rows of a piece whose clock is looked at by itself


@dataclass(frozen=True)
class Fault:
    """A fault of one kind: ``value`` and ``error`` over all vehicles, ``by_vehicle`` each one's own
    value, by name."""

    term: str
    channel: str
    metric: str
    value: float
    error: float
    by_vehicle: dict[str, float]
    all_vehicles: bool
    p_value: float
    before: float
    after: float


@dataclass(frozen=True)
class _Look:
    """What a piece of one vehicle's log says: a value, and the share of the channel unexplained without
    and with it."""

    value: float
    before: float
    after: float
    interval: float
    averaged: float  # The same with the mean over the last ``interval`` seconds


def examine(fleet: Fleet, split: Split, only: tuple[str, ...] = ()) -> tuple[Fleet, list[Fault]]:
    """Return the fleet with its sensors put right, and the faults found; ``only`` restricts them by term."""
    faults = []
    terms: dict[str, Term] = {
        t.fault: t for t in all_terms().values() if t.acts == "sensor" and (not only or t.name in only)
    }
    if "scale" in terms:
        found = _speed_scale(fleet, split, terms["scale"])
        if found is not None:
            faults.append(found[0])
            fleet = replace(fleet, scale=found[1])
    if "clock" in terms or "mean" in terms:
        late = _clock(fleet, split, terms)
        if late is not None:
            faults.append(late[0])
            fleet = replace(late[1], load_with_power=_load_runs_with_power(late[1]))
    return fleet, faults


def _clock(fleet: Fleet, split: Split, terms: dict[str, Term]) -> tuple[Fault, Fleet] | None:
    """How far the power channel runs behind the positions, or that it is a mean, and the fleet with that put
    right.

    None where no vehicle's is late.
    """
    if not fleet.has("battery_power"):
        return None
    looks: dict[int, list[_Look]] = {}
    for block in fleet.each_block():
        looks.setdefault(block.vehicle, []).extend(_looks(block, fleet, split))
    middle = {v: float(np.median([k.value for k in ks])) for v, ks in looks.items() if len(ks) >= 2}
    error = {v: max(_spread([k.value for k in looks[v]]), 0.06 * fleet.step) for v in middle}
    least = (terms["clock"].parameters[0].tolerance if "clock" in terms else 0.3) * max(1.0, 1.5 * fleet.step)
    late = {v: m for v, m in middle.items() if abs(m) > least and abs(m) > SURE * error[v]}
    if not late:
        return None
    every = [k for v in late for k in looks[v]]
    joint = float(np.sqrt(np.mean([error[v] ** 2 for v in late]) / len(late)))
    worst = max(abs(m) / error[v] for v, m in late.items())
    whole, p_value = len(late) == len(middle), _tail(worst)
    metric, before = (
        "share of the power that the model does not explain",
        float(np.mean([k.before for k in every])),
    )

    def fault(kind: str, told: dict[int, float], off: float, after: list[float]) -> Fault:
        by_name = {fleet.vehicles[v]: x for v, x in told.items()}
        value = float(np.median(list(told.values())))
        return Fault(
            terms[kind].name, "battery_power", metric, value, off, by_name, whole, p_value, before,
            float(np.mean(after)),
        )  # fmt: skip

    if "mean" in terms and float(np.median([k.averaged - k.after for k in every])) < 0.0:
        interval = float(np.median([k.interval for k in every]))
        told = dict.fromkeys(late, interval)
        off = max(0.06 * fleet.step, _spread([k.interval for k in every]))
        averaged = fault("mean", told, off, [k.averaged for k in every])
        return averaged, replace(fleet, lag=dict.fromkeys(late, 0.5 * fleet.step), interval=told)
    if "clock" not in terms:
        return None
    values = _in_common(late, error, whole)
    shifted = fault("clock", values, max(joint, 0.06 * fleet.step), [k.after for k in every])
    return shifted, replace(fleet, lag=values)


def _in_common(late: dict[int, float], error: dict[int, float], all_of_them: bool) -> dict[int, float]:
    """One logger for all: the common value is better known than each vehicle's own."""
    values = np.array(list(late.values()))
    alike = np.ptp(values) < SURE * max(error.values())
    return dict.fromkeys(late, float(np.median(values))) if all_of_them and alike else late


def _spread(values: list[float]) -> float:
    a = np.array(values)
    return float(1.4826 * np.median(np.abs(a - np.median(a))) / np.sqrt(len(a)) + 0.02)


def _tail(z: float) -> float:
    return max(math.erfc(min(z, 37.0) / math.sqrt(2.0)), 1e-300)


def _looks(block: Block, fleet: Fleet, split: Split) -> Iterator[_Look]:
    power = battery_power(block.motion, Physics(fleet.truck))
    train = split.rows(block.trip, block.time, block.vehicle, block.day) != HELD_OUT
    count = int(np.clip(len(block) // PIECE, 1, 6))
    cuts = np.linspace(0, len(block), count + 1).astype(int)
    for a, b in itertools.pairwise(cuts):
        look = _best_shift(block, power, slice(int(a), int(b)), train, fleet.step)
        if look is not None:
            yield look


def _best_shift(block: Block, power: Floats, piece: slice, train: Mask, step: float) -> _Look | None:
    """The best shift of a piece, by correlation."""
    measured = block.power[piece]
    known = np.isfinite(measured) & train[piece]
    if known.sum() < PIECE // 2 or np.ptp(measured[known]) == 0.0:
        return None
    clock, y = block.time[piece][known], measured[known] - measured[known].mean()
    time = block.motion.time
    energy = np.concatenate([[0.0], np.cumsum(power * block.motion.dt)])
    ends = np.append(time - 0.5 * block.motion.dt, time[-1] + 0.5 * block.motion.dt[-1])

    def alike(begin: Floats, end: Floats) -> float:
        x = (np.interp(end, ends, energy) - np.interp(begin, ends, energy)) / np.maximum(end - begin, 1e-9)
        x = x - x.mean()
        return float(x @ y / np.sqrt((x @ x) * (y @ y) + 1e-12))

    def shifted(shift: float) -> float:
        half = 0.5 * min(step, 1.0)
        return alike(clock - shift - half, clock - shift + half)

    coarse = np.arange(-LONGEST, LONGEST + 0.1, max(step, 0.5))
    scores = _coarsely(clock, y, ends, energy, coarse, 0.5 * min(step, 1.0))
    good = np.flatnonzero(scores >= scores.max() - ALIKE)
    best = float(coarse[good[np.argmin(np.abs(coarse[good]))]])
    wide = max(step, 0.5)
    for nearby in (best - wide, best + wide):
        best = nearby if shifted(nearby) > shifted(best) else best
    near = best + wide * np.linspace(-0.8, 0.8, 9)
    curve = np.polyfit(near - best, [shifted(s) for s in near], 2)
    if curve[0] >= 0 or scores.max() < 0.5:
        return None
    shift = best + float(np.clip(-curve[1] / (2.0 * curve[0]), -wide, wide))
    # A mean over an interval lags by half of it.
    intervals = [step, *(2.0 * shift * INTERVALS if shift > 0.5 * step else ())]
    averaged = [alike(clock - i, clock) for i in intervals]
    left = [float(np.sqrt(max(1.0 - c**2, 0.0))) for c in (shifted(0.0), shifted(shift), max(averaged))]
    return _Look(shift, left[0], left[1], float(intervals[int(np.argmax(averaged))]), left[2])


def _coarsely(clock: Floats, y: Floats, ends: Floats, energy: Floats, shifts: Floats, half: float) -> Floats:
    """The correlation at every shift, to a slot of ``SLOT`` seconds, on ``MANY`` rows at most."""
    some = slice(None, None, len(clock) // MANY + 1)
    clock, y = clock[some], y[some] - y[some].mean()
    slots = np.arange(clock[0] - LONGEST - 2.0, clock[-1] + LONGEST + 2.0, SLOT)
    paid = np.interp(slots, ends, energy)
    at = np.rint((clock[None, :] - shifts[:, None] - slots[0]) / SLOT).astype(np.int64)
    wide = max(round(half / SLOT), 1)
    x = paid[at + wide] - paid[at - wide]
    x -= x.mean(axis=1, keepdims=True)
    return np.asarray(x @ y / np.sqrt((x**2).sum(axis=1) * (y @ y) + 1e-12))


def _load_runs_with_power(fleet: Fleet) -> bool:
    """Whether fork height and payload were logged by the late clock: the better fit at standstill decides."""
    if not fleet.has("fork_height"):
        return False
    missed = []
    for together in (False, True):
        total = 0.0
        for block in replace(fleet, load_with_power=together).each_block():
            still = block.rows(block.motion.speed) <= 0.0
            off = np.nan_to_num(block.power - block.rows(battery_power(block.motion, Physics(fleet.truck))))
            total += float((off[still] ** 2).sum())
        missed.append(total)
    return missed[1] < missed[0]


def _speed_scale(fleet: Fleet, split: Split, term: Term) -> tuple[Fault, dict[int, float]] | None:
    """What the speed channel reads over the true speed; None where no vehicle's is off."""
    found: dict[int, tuple[float, float]] = {}
    pairs: dict[int, list[tuple[float, float]]] = {}
    for vehicle, trajectory in fleet.days:
        if vehicle in fleet.speed_from_positions | fleet.rarely_placed or not trajectory.has("x"):
            continue
        day = int(trajectory.time[0] // 86_400_000_000)
        fold = split.rows(
            trajectory.trip_ids() + TRIP * vehicle,
            np.asarray(trajectory.time * 1e-6, dtype=np.float64),
            vehicle,
            day,
        )
        on_map = fleet.network is not None and trajectory.has("edge_id")
        looked = _edge_pairs(trajectory, fleet) if on_map else _chord_pairs(trajectory)
        pairs.setdefault(vehicle, []).extend((d, g) for row, d, g in looked if fold[row] != HELD_OUT)
    for vehicle, p in pairs.items():
        if len(p) >= 20:
            found[vehicle] = _ratio(np.array(p))
    least = 1.5 * term.parameters[0].tolerance
    off = {v: m for v, (m, e) in found.items() if abs(m - 1.0) > least and abs(m - 1.0) > SURE * e}
    if not off:
        return None
    values = list(off.values())
    if len(off) == len(found) and np.ptp(values) < SURE * max(e for _, e in found.values()):
        off = dict.fromkeys(off, float(np.median(values)))
    worst = max(abs(found[v][0] - 1.0) / found[v][1] for v in off)
    joint = float(np.sqrt(np.mean([found[v][1] ** 2 for v in off]) / len(off)))
    middle = float(np.median(values))
    fault = Fault(
        term.name, "speed", "deviation of travelled distance", middle, joint, {fleet.vehicles[v]: x for v, x
        in off.items()},
        len(off) == len(found), _tail(worst), abs(middle - 1.0), joint,
    )  # fmt: skip
    return fault, off


def _ratio(pairs: Floats) -> tuple[float, float]:
    driven, gone = pairs.T
    ratio = driven / gone
    good = np.abs(ratio - np.median(ratio)) < MISMATCHED
    value = float(driven[good].sum() / gone[good].sum())
    return value, float(np.sqrt(((driven - value * gone)[good] ** 2).sum()) / gone[good].sum()) + 0.001


def _edge_pairs(trajectory: Trajectory, fleet: Fleet) -> Iterator[tuple[int, float, float]]:
    """Yield row, integrated speed and progress [m] of every traversal of the middle of an edge."""
    assert fleet.network is not None
    network = fleet.network
    edge = trajectory.labels("edge_id").recode(network.index)
    offset, time = trajectory.floats("edge_offset"), trajectory.seconds()
    travelled = _travelled(time, trajectory.floats("speed"))
    length = network.length[np.maximum(edge, 0)]
    inside = (edge >= 0) & (offset > END) & (offset < length - END) & np.isfinite(offset)
    begin = np.flatnonzero(np.concatenate([[True], np.diff(edge) != 0]))
    for a, b in zip(begin, np.append(begin[1:], len(edge)), strict=True):
        rows = np.flatnonzero(inside[a:b]) + a
        if len(rows) < 4 or np.diff(time[rows]).max(initial=0.0) > 3.5 * fleet.step:
            continue
        gone = float(offset[rows[-1]] - offset[rows[0]])
        if gone > SHORTEST:
            yield int(rows[0]), float(travelled[rows[-1]] - travelled[rows[0]]), gone


def _chord_pairs(trajectory: Trajectory) -> Iterator[tuple[int, float, float]]:
    """Yield row, integrated speed and chord [m] of straight runs, for logs without a map."""
    x, y = trajectory.floats("x"), trajectory.floats("y")
    new = np.concatenate([[True], (np.diff(x) != 0) | (np.diff(y) != 0)]) & np.isfinite(x)
    travelled = _travelled(trajectory.seconds(), trajectory.floats("speed"))
    rows = np.flatnonzero(new)
    if len(rows) < 50:
        return
    s = travelled[rows]
    reach = max(60.0, 30.0 * float(np.median(np.diff(s))))
    i = 0
    while i < len(rows) - 2:
        j = int(np.searchsorted(s, s[i] + reach))
        if j >= len(rows):
            break
        a, m, b = rows[i], rows[(i + j) // 2], rows[j]
        chord = float(np.hypot(x[b] - x[a], y[b] - y[a]))
        halves = float(np.hypot(x[m] - x[a], y[m] - y[a]) + np.hypot(x[b] - x[m], y[b] - y[m]))
        if chord > 0.5 * reach and halves < 1.002 * chord:
            yield int(a), float(s[j] - s[i]), chord
        i = j


def _travelled(time: Floats, speed: Floats) -> Floats:
    v = np.nan_to_num(speed)
    return np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(time))])

"""Faults of the recording come first: a late clock looks like slope or inertia, a wrong speed scale like drag.

Clock: the predicted power is compared with the measured one at every shift, vehicle-day by vehicle-day, with a parabola at the
best.  Scale: integrated speed against progress along the map, on the middle of edges; without a map against chords of straights.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.trajectory import Trajectory
from fleetlog.discovery.fleet import Fleet
from fleetlog.discovery.replay import Block
from fleetlog.physics.power import Physics, battery_power

Floats = NDArray[np.float64]

LONGEST = 40.0
"""Largest shift that is tried [s]."""
LEAST_OFFSET = 0.45
"""A smaller offset, in seconds or in sampling steps if they are longer, is left to the nuisances [s]."""
LEAST_SCALE = 0.015
"""A smaller deviation of the speed scale does not matter."""
ALIKE = 0.01
"""Correlations this close to the best are as good."""
END = 6.0
"""Metres at the ends of an edge where corners are cut."""
SHORTEST = 12.0
"""Metres of progress that are worth comparing."""


@dataclass(frozen=True)
class Fault:
    """A fault of one kind on some vehicles: ``value`` and ``error`` their median, ``by_vehicle`` each one's own value."""

    term: str
    value: float
    error: float
    by_vehicle: dict[int, float]
    p_value: float
    before: float
    after: float


def examine(fleet: Fleet) -> tuple[Fleet, list[Fault]]:
    """The fleet with its sensors put right, and the faults found."""
    faults = []
    scale = speed_scale(fleet)
    if scale is not None:
        fleet = replace(fleet, scale=scale.by_vehicle)
        faults.append(scale)
    clock = clock_offset(fleet)
    if clock is not None:
        fleet = replace(fleet, lag=clock.by_vehicle)
        fleet = replace(fleet, load_with_power=_load_runs_with_power(fleet))
        faults.append(clock)
    return fleet, faults


def clock_offset(fleet: Fleet) -> Fault | None:
    """How far the power channel runs behind the positions; None where no vehicle's is shifted."""
    if not fleet.has("battery_power"):
        return None
    shifts: dict[int, list[float]] = {}
    fit: dict[int, list[tuple[float, float]]] = {}
    for block in fleet.each_block():
        smooth = _row_means(battery_power(block.motion, Physics(fleet.truck)), block.steps)
        for piece in _pieces(block):
            found = _best_shift(block, smooth, piece, fleet)
            if found is not None:
                shifts.setdefault(block.vehicle, []).append(found[0])
                fit.setdefault(block.vehicle, []).append(found[1:])
    middle = {v: float(np.median(s)) for v, s in shifts.items() if len(s) >= 2}
    error = {v: _spread(shifts[v]) for v in middle}
    least = LEAST_OFFSET * max(1.0, fleet.step)
    late = {v: m for v, m in middle.items() if abs(m) > least and abs(m) > 4.0 * error[v]}
    if not late:
        return None
    values = list(late.values())
    if len(late) == len(middle) and np.ptp(values) < 0.5:
        # One logger for all: the common value is better known than each vehicle's own.
        late = dict.fromkeys(late, float(np.median(values)))
    worst = max(abs(m) / max(error[v], 1e-3) for v, m in middle.items() if v in late)
    before, after = (float(np.mean([f[i] for v in late for f in fit[v]])) for i in (0, 1))
    joint = float(np.sqrt(np.mean([error[v] ** 2 for v in late]) / len(late)))
    return Fault(
        "clock_offset",
        float(np.median(values)),
        max(joint, 0.06 * fleet.step),
        late,
        _tail(worst),
        before,
        after,
    )


def _spread(values: list[float]) -> float:
    a = np.array(values)
    return float(1.4826 * np.median(np.abs(a - np.median(a))) / np.sqrt(len(a)) + 0.02)


def _tail(z: float) -> float:
    return max(math.erfc(min(z, 37.0) / math.sqrt(2.0)), 1e-300)


def _pieces(block: Block) -> list[slice]:
    """A block in at most six pieces of at least two hundred rows: the independent looks at its clock."""
    count = int(np.clip(len(block) // 200, 1, 6))
    cuts = np.linspace(0, len(block), count + 1).astype(int)
    return [slice(int(a), int(b)) for a, b in itertools.pairwise(cuts)]


def _best_shift(
    block: Block, smooth: Floats, piece: slice, fleet: Fleet
) -> tuple[float, float, float] | None:
    """Shift [s] at the best correlation, and the share of power left unexplained without and with it."""
    measured = block.power[piece]
    known = np.isfinite(measured)
    if known.sum() < 100 or measured[known].std() < 100.0:
        return None
    clock = block.time[piece][known]
    y = measured[known] - measured[known].mean()
    step = max(fleet.step, 0.5)

    def alike(shift: float) -> float:
        x = np.interp(clock - shift, block.motion.time, smooth)
        x = x - x.mean()
        return float(x @ y / np.sqrt((x @ x) * (y @ y) + 1e-12))

    coarse = np.arange(-LONGEST, LONGEST + 0.1, step)
    scores = np.array([alike(s) for s in coarse])
    # Work that repeats itself matches at many shifts: the smallest of those that are as good.
    good = np.flatnonzero(scores >= scores.max() - ALIKE)
    best = float(coarse[good[np.argmin(np.abs(coarse[good]))]])
    for nearby in (best - step, best + step):
        best = nearby if alike(nearby) > alike(best) else best
    near = best + step * np.linspace(-0.8, 0.8, 9)
    curve = np.polyfit(near - best, [alike(s) for s in near], 2)
    if curve[0] >= 0 or scores.max() < 0.5:
        return None
    shift = best + float(np.clip(-curve[1] / (2.0 * curve[0]), -step, step))
    return (
        shift,
        float(np.sqrt(max(1.0 - alike(0.0) ** 2, 0.0))),
        float(np.sqrt(max(1.0 - alike(shift) ** 2, 0.0))),
    )


def _row_means(fine: Floats, steps: int) -> Floats:
    """Running mean over the sub-samples of one row."""
    total = np.concatenate(
        [[0.0], np.cumsum(np.pad(fine, (steps // 2, steps - steps // 2 - 1), mode="edge"))]
    )
    return np.asarray((total[steps:] - total[:-steps]) / steps)


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


def speed_scale(fleet: Fleet) -> Fault | None:
    """What the speed channel reads over the true speed; None where no vehicle's is off."""
    pairs: dict[int, list[tuple[float, float]]] = {}
    for vehicle, trajectory in fleet.days:
        if vehicle in fleet.speed_from_positions | fleet.rarely_placed:
            continue
        own = pairs.setdefault(vehicle, [])
        if fleet.network is not None and trajectory.has("edge_id"):
            own.extend(_edge_pairs(trajectory, fleet))
        else:
            own.extend(_chord_pairs(trajectory))
    found: dict[int, tuple[float, float]] = {}
    for vehicle, p in pairs.items():
        if len(p) < 20:
            continue
        driven, gone = np.array(p).T
        ratio = driven / gone
        # Traversals that were matched wrongly are far off; they must not decide.
        good = np.abs(ratio - np.median(ratio)) < 0.25
        value = float(driven[good].sum() / gone[good].sum())
        error = float(np.sqrt(((driven - value * gone)[good] ** 2).sum()) / gone[good].sum()) + 0.002
        found[vehicle] = (value, error)
    off = {v: m for v, (m, e) in found.items() if abs(m - 1.0) > LEAST_SCALE and abs(m - 1.0) > 4.0 * e}
    if not off:
        return None
    values = list(off.values())
    if len(off) == len(found) and np.ptp(values) < 0.02:
        off = dict.fromkeys(off, float(np.median(values)))
    worst = max(abs(found[v][0] - 1.0) / found[v][1] for v in off)
    joint = float(np.sqrt(np.mean([found[v][1] ** 2 for v in off]) / len(off)))
    middle = float(np.median(values))
    return Fault("speed_scale", middle, max(joint, 0.003), off, _tail(worst), abs(middle - 1.0), joint)


def _edge_pairs(trajectory: Trajectory, fleet: Fleet) -> list[tuple[float, float]]:
    """(integrated speed, progress) [m] of every traversal of the middle of an edge."""
    assert fleet.network is not None
    network = fleet.network
    edge = trajectory.labels("edge_id").recode(network.index)
    offset, speed, time = trajectory.floats("edge_offset"), trajectory.floats("speed"), trajectory.seconds()
    travelled = _travelled(time, speed)
    length = network.length[np.maximum(edge, 0)]
    inside = (edge >= 0) & (offset > END) & (offset < length - END) & np.isfinite(offset)
    out = []
    begin = np.flatnonzero(np.concatenate([[True], np.diff(edge) != 0]))
    for a, b in zip(begin, np.append(begin[1:], len(edge)), strict=True):
        rows = np.flatnonzero(inside[a:b]) + a
        if len(rows) < 4 or np.diff(time[rows]).max(initial=0.0) > 3.5 * fleet.step:
            continue
        gone = float(offset[rows[-1]] - offset[rows[0]])
        if gone > SHORTEST:
            out.append((float(travelled[rows[-1]] - travelled[rows[0]]), gone))
    return out


def _chord_pairs(trajectory: Trajectory) -> list[tuple[float, float]]:
    """(integrated speed, chord) [m] of straight runs, for logs without a map."""
    x, y, speed, time = (
        trajectory.floats("x"),
        trajectory.floats("y"),
        trajectory.floats("speed"),
        trajectory.seconds(),
    )
    new = np.concatenate([[True], (np.diff(x) != 0) | (np.diff(y) != 0)]) & np.isfinite(x)
    travelled = _travelled(time, speed)
    rows = np.flatnonzero(new)
    if len(rows) < 50:
        return []
    s = travelled[rows]
    reach = max(60.0, 30.0 * float(np.median(np.diff(s))) if len(s) > 2 else 60.0)
    out = []
    i = 0
    while i < len(rows) - 2:
        j = int(np.searchsorted(s, s[i] + reach))
        if j >= len(rows):
            break
        k = (i + j) // 2
        a, m, b = rows[i], rows[k], rows[j]
        chord = float(np.hypot(x[b] - x[a], y[b] - y[a]))
        halves = float(np.hypot(x[m] - x[a], y[m] - y[a]) + np.hypot(x[b] - x[m], y[b] - y[m]))
        if chord > 0.5 * reach and halves < 1.002 * chord:
            out.append((float(s[j] - s[i]), chord))
        i = j
    return out


def _travelled(time: Floats, speed: Floats) -> Floats:
    v = np.nan_to_num(speed)
    return np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(time))])

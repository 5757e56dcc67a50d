"""The last judgement: errors on trips that nothing has read, of exactly the model that is written."""

from collections.abc import Iterable, Sequence
from functools import partial
from itertools import chain

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import ndtr, stdtr

from fleetlog.core.arrays import Floats, Ints, Mask
from fleetlog.discovery.channels.base import Unit
from fleetlog.discovery.hypotheses.hypothesis import Hypothesis
from fleetlog.discovery.model import Model
from fleetlog.discovery.recording.splits import HELD_OUT
from fleetlog.discovery.report.finding import NORMAL, ChannelFit, Errors, Lasting
from fleetlog.discovery.search.joint import Joint, said
from fleetlog.discovery.search.problem import Problem

FEWEST_CLUSTERS = 3
NEIGHBOURS = 10
FEWEST = 50  # Windows from which on a noise floor is told


def judge(
    problem: Problem, before: Model, after: Joint, without: dict[Hypothesis, Model], beside: dict[Hypothesis,
    Joint], strongest: Sequence[Joint] = (), share: float = 1.0,
) -> tuple[ChannelFit, dict[Hypothesis, Errors], float | None, list[Lasting]]:  # fmt: skip
    """Return the errors of a model before and after on what was held out, and of each finding: of the model
    ``without`` it, or of the fit with a free curve ``beside``; and the error after beside what sampling
    hides, as far as it is beyond chance. ``strongest`` are two fits that differ by the hypothesis which says
    most; the noise floor is measured on a ``share`` of the trips. How trucks are driven is an adjustment of
    all models."""
    channel, fits = problem.channel, [after, *beside.values(), *strongest]
    parts = channel.each(partial(_heard, problem, fits, [*without.values(), before]))
    energy, cluster, vehicle, *pooled = np.concatenate(list(parts), axis=1)
    others = [*pooled[2 * len(fits) : -1], *pooled[2 : 2 + 2 * len(beside) : 2]]
    modelled, concealed, left = *pooled[:2], energy - pooled[-1]
    if not len(energy) or not energy.any():
        reason = "too few trips to hold some out; record more"
        return ChannelFit(channel.name, channel.metric, None, None, None, reason), {}, None, []
    size, new = float(np.sqrt(np.mean(energy**2))), energy - modelled

    habit = 0.0 if channel.bends else concealed

    def error(residual: Floats) -> float:
        return float(np.sqrt(np.mean((residual - habit) ** 2))) / size

    own_error = channel.own_error[vehicle.astype(np.int64)]
    miss, told = own_error * np.abs(modelled), {}
    for h, other in zip([*without, *beside], others, strict=True):
        one, two = (energy - other, new) if h in without else (new, energy - other)
        chance = p_value(one - concealed, one - two, cluster, miss)
        told[h] = Errors(channel.metric, error(one), error(two), chance)
    # Noise is what it is: what is left beside it of a model that says less only makes the floor too high.
    noise = [_floor(problem, m, share) for m in (before, after.model)[: 1 + (before is not after.model)]]
    floor, lasts = min((f for f, _ in noise if f is not None), default=None), noise[-1][1]
    fit = ChannelFit(channel.name, channel.metric, error(left), error(new), floor and floor / size)
    if strongest:
        alone, hidden, other, more = pooled[2 + 2 * len(beside) : 2 * len(fits)]
        effect, own = other + more - alone - hidden, own_error * np.abs(alone)
        fit.p_value = p_value(energy - alone - hidden, effect, cluster, own)
    return fit, told, beyond_chance(new - concealed, cluster) / size, lasts


def beyond_chance(residual: Floats, cluster: Ints) -> float:
    """Return what a root mean square is at least, by how the (W,) squares scatter over trips: where a few
    events make most of it, other trips have more of them or fewer."""
    which = np.unique(cluster, return_inverse=True)[1]
    square, mean = np.bincount(which, residual**2), float(np.mean(residual**2))
    scatter = float(np.sqrt(np.sum((square - mean * np.bincount(which)) ** 2))) / len(residual)
    return float(np.sqrt(max(mean - NORMAL * scatter, 0.0)))


def p_value(residual: Floats, effect: Floats, cluster: Ints, own: float | Floats = 0.0) -> float:
    """Return how likely trips that nothing has read speak so much for an effect by chance (one-sided, trips
    independent). ``residual`` (W,) of the model without the effect; ``effect`` (W,) what it would add, found
    on other trips; ``own`` (W,) standard deviation of the model's own error, which all trips share."""
    _, which = np.unique(cluster, return_inverse=True)
    score = np.bincount(which, residual * effect)
    score = score[np.bincount(which, np.abs(effect)) > 0.0]
    spread = float(np.hypot(np.sqrt((score**2).sum()), np.sum(np.abs(effect) * own)))
    if len(score) < FEWEST_CLUSTERS or spread == 0.0:
        return 1.0
    return float(stdtr(len(score) - 1, -score.sum() / spread))


def _heard(problem: Problem, fits: Sequence[Joint], models: Sequence[Model], units: Iterable[Unit]) -> Floats:
    """(3 + 2 fits + models, W) of the windows held out: what was recorded, what they were held out with, the
    vehicle, what fits say and what by them sampling hides, and what models say."""

    def heard(u: Unit) -> Floats:
        told = [values for joint in fits for values in said(problem.channel, u, joint)]
        told += [problem.channel.predict(u, model) for model in models]
        return np.stack([u.recorded, problem.split.unit(u.windows), u.windows.vehicle, *told])[:, u.whole]

    none = np.zeros((3 + 2 * len(fits) + len(models), 0))
    return np.concatenate([none, *(heard(u) for u in problem.held_out(units))], axis=1)


def _floor(problem: Problem, model: Model, share: float) -> tuple[float | None, list[Lasting]]:
    """The noise in the windows held out beyond a model, None where it is not known; and what lasts, in trips
    in a row, and of every vehicle while it is at rest."""
    parts = problem.channel.each(partial(_left, problem, model, share))
    of_features, of_windows, of_trips, at_rest, whose = zip(*chain.from_iterable(parts), strict=True)
    features, told, sums = np.concatenate(of_features), np.concatenate(of_windows), np.sum(of_trips, axis=0)
    rests = {v: np.zeros(3) for v in sorted(set(whose))}
    for vehicle, own in zip(whose, at_rest, strict=True):
        rests[vehicle] += own
    residual, trip, held, noise = told.T
    wanted = held > 0.0
    repeated = noise_floor(features, residual, trip, wanted)
    # Alike windows repeat what the uncertainty of their motion does to them; that part is known without them.
    floor = None if repeated is None else max(repeated, float(np.sqrt(np.mean(noise[wanted]))))
    return floor, [lasting(sums), *(lasting(own, v) for v, own in rests.items())]


def _left(
    problem: Problem, model: Model, share: float, units: Iterable[Unit]
) -> list[tuple[Floats, Floats, Floats, Floats, int]]:
    """(W, d) features of the windows of units; (W, 4) what a model leaves of them, their trips, whether they
    are held out, and the noise that is known; what the other trips, and windows at rest, have in common with
    those next to them; and the vehicle."""
    out = []
    for unit in units:
        left, held = unit.recorded - problem.channel.predict(unit, model), unit.fold == HELD_OUT
        use = unit.whole & problem.split.drawn(unit.windows, share)
        told = np.column_stack([left, problem.split.unit(unit.windows), held, unit.noise])
        read = unit.whole & ~held
        in_a_row = common(left[read], unit.recorded[read], unit.windows.trip[read])
        rest, w = read & problem.channel.rests(unit), unit.windows
        usual = unit.recorded[read].sum() / max(float(w.duration[read].sum()), 1e-9) * w.duration[rest]
        # Nothing between two stands has nothing in common with either.
        apart = np.flatnonzero(np.diff(w.time[rest]) > 1.5 * w.duration[rest][1:]) + 1
        own, usual = (np.insert(v, apart, 0.0) for v in (left[rest], usual))
        at_rest = common(own, usual, np.arange(len(own)))
        features = problem.channel.features(unit, model)[use]
        out.append((features, told[use], in_a_row, at_rest, int(w.vehicle[0])))
    return out


def common(left: Floats, energy: Floats, trip: Ints) -> Floats:
    """Return (3,) sums over the trips of a day that follow one another: of products of what is left of their
    energies, of the squares of these, and of products of energies. All arrays (W,), in the order of time.
    What all trips of the day have in common is taken off."""
    if not len(trip):
        return np.zeros(3)
    begin = np.flatnonzero(np.diff(trip, prepend=-1))
    rest, whole = (np.add.reduceat(v, begin) for v in (left, energy))
    rest = rest - whole * (rest.sum() / max(float(whole.sum()), 1e-12))
    both = rest[1:] * rest[:-1]
    return np.array([both.sum(), (both**2).sum(), np.abs(whole[1:] * whole[:-1]).sum()])


def lasting(sums: Floats, vehicle: int | None = None) -> Lasting:
    """Return what such sums say, of one day or added over many; of windows of a ``vehicle`` at rest."""
    both, scatter, energy = np.maximum(sums, [sums[0], 1e-300, 1e-300])
    return Lasting(float(np.sqrt(max(both, 0.0) / energy)), float(ndtr(-both / np.sqrt(scatter))), vehicle)


def noise_floor(features: Floats, residual: Floats, trip: Ints, wanted: Mask) -> float | None:
    """Return the noise in the ``wanted`` windows (root mean square); None with too few windows.

    Windows that are alike (place, direction, load, pace) differ by noise alone.  Half the mean square of the
    difference of their residuals, extrapolated to windows that are alike in everything, is its variance (the
    gamma test: Stefánsson, Končar and Jones 1997, doi 10.1007/BF01413858).  ``features`` (W, d),
    ``residual`` (W,), ``trip`` (W,): windows of one trip share its noise and are not compared."""
    if len(residual) < FEWEST or wanted.sum() < NEIGHBOURS:
        return None
    distance, near = cKDTree(features).query(features[wanted], k=min(6 * NEIGHBOURS, len(residual)))
    other = trip[near] != trip[wanted][:, None]
    half = 0.5 * (residual[near] - residual[wanted][:, None]) ** 2
    rank = np.cumsum(other, axis=1)
    use = other & (rank <= NEIGHBOURS)
    if not use.any():
        return None
    count, apart, off = (np.bincount(rank[use], w)[1:] for w in (None, distance[use] ** 2, half[use]))
    delta, gamma = apart / count, off / count
    # By medians (Theil 1950, Sen 1968): one gross error among neighbours turns a line of least squares.
    rise, run = (np.subtract.outer(v, v) for v in (gamma, delta))
    slope = np.median(rise[run > 0] / run[run > 0]) if len(delta) > 2 and np.ptp(delta) > 0 else 0.0
    start, nearest = np.median(gamma) - slope * np.median(delta), float(gamma[0])
    return float(np.sqrt(np.clip(start if slope > 0 else nearest, 0.25 * nearest, nearest)))

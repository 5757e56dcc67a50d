"""The last judgement: errors on trips that nothing has read, of exactly the model that is written."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import stdtr
from scipy.stats import theilslopes

from fleetlog.core.arrays import Floats, Ints, Mask
from fleetlog.discovery.channels.base import Unit
from fleetlog.discovery.hypotheses.hypothesis import Hypothesis
from fleetlog.discovery.model import Model
from fleetlog.discovery.recording.splits import HELD_OUT
from fleetlog.discovery.report.finding import ChannelFit, Errors
from fleetlog.discovery.search.joint import Joint, hidden, predicted
from fleetlog.discovery.search.problem import Problem

FEWEST_CLUSTERS = 3
NEIGHBOURS = 10
FEWEST = 50  # Windows from which on a noise floor is told


def judge(
    problem: Problem, before: Model, after: Joint, without: dict[Hypothesis, Model], beside: dict[Hypothesis,
    Joint],
) -> tuple[ChannelFit, dict[Hypothesis, Errors], float | None]:  # fmt: skip
    """Return the errors of a model before and after on what was held out, and of each finding: of the model
    ``without`` it, or of the fit with a free curve ``beside``; and the error after beside what sampling
    hides."""
    channel, units = problem.channel, list(problem.held_out())
    energy = _pooled(units, lambda u: u.recorded)
    if not len(energy) or not energy.any():
        reason = "too few trips to hold some out; record more"
        return ChannelFit(channel.name, channel.metric, None, None, None, reason), {}, None
    size = float(np.sqrt(np.mean(energy**2)))

    def left(model: Model) -> Floats:
        return _pooled(units, lambda u: u.recorded - channel.predict(u, model))

    def error(residual: Floats) -> float:
        return float(np.sqrt(np.mean(residual**2))) / size

    new, cluster = left(after.model), _clusters(problem, units)
    miss = channel.model_error * np.abs(energy - new)
    concealed = _pooled(units, lambda u: hidden(problem, u, after))
    pairs = {h: (left(model), new) for h, model in without.items()}
    for h, joint in beside.items():
        pairs[h] = new, energy - _pooled(units, partial(predicted, problem, joint=joint))
    told = {}
    for h, (one, other) in pairs.items():
        chance = p_value(one - concealed, one - other, cluster, miss)
        told[h] = Errors(channel.metric, error(one), error(other), chance)
    floor = _floor(problem, before)
    told_floor = None if floor is None else floor / size
    fit = ChannelFit(channel.name, channel.metric, error(left(before)), error(new), told_floor)
    return fit, told, error(new - concealed)


def strongest(problem: Problem, base: Joint, joint: Joint) -> float | None:
    """Return the p-value of a hypothesis that was found on the training trips, on those held out."""
    units = list(problem.held_out())
    if not units:
        return None

    def said(fit: Joint) -> Floats:
        return _pooled(units, lambda u: predicted(problem, u, fit))

    def concealed(fit: Joint) -> Floats:
        return _pooled(units, lambda u: hidden(problem, u, fit))

    modelled = said(base)
    before, own = modelled + concealed(base), problem.channel.model_error * np.abs(modelled)
    residual = _pooled(units, lambda u: u.recorded) - before
    return p_value(residual, said(joint) + concealed(joint) - before, _clusters(problem, units), own)


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


def _pooled(units: Sequence[Unit], value: Callable[[Unit], Floats]) -> Floats:
    parts = [np.asarray(value(u))[u.whole] for u in units]
    return np.concatenate(parts) if parts else np.zeros(0)


def _clusters(problem: Problem, units: Sequence[Unit]) -> Ints:
    return np.concatenate([problem.split.unit(u.windows)[u.whole] for u in units])


def _floor(problem: Problem, before: Model) -> float | None:
    features, residual, trip, wanted = [], [], [], []
    for unit in problem.channel.units():
        use = unit.whole
        features.append(problem.channel.features(unit, before)[use])
        residual.append((unit.recorded - problem.channel.predict(unit, before))[use])
        trip.append(problem.split.unit(unit.windows)[use])
        wanted.append((problem.folds(unit) == HELD_OUT)[use])
    parts = [np.concatenate(p) for p in (features, residual, trip, wanted)]
    repeated = noise_floor(*parts)
    if repeated is None:
        return None
    # Alike windows repeat what the uncertainty of their motion does to them; that part is known without them.
    stated = np.concatenate([u.noise[u.whole] for u in problem.held_out()])
    return max(repeated, float(np.sqrt(np.mean(stated))))


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
    # By medians (Theil 1950, Sen 1968): one gross error among the neighbours of a rank turns a line of least
    # squares.
    several = len(delta) > 2 and np.ptp(delta) > 0
    slope, start = theilslopes(gamma, delta)[:2] if several else (0.0, gamma[0])
    nearest = float(gamma[0])
    return float(np.sqrt(np.clip(start if slope > 0 else nearest, 0.25 * nearest, nearest)))

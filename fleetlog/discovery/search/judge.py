"""The last judgement: errors on trips that nothing has read, of exactly the model that is written."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from fleetlog.discovery.channels.base import Unit
from fleetlog.discovery.hypotheses.hypothesis import Hypothesis
from fleetlog.discovery.model import Model
from fleetlog.discovery.recording.splits import HELD_OUT
from fleetlog.discovery.search.floor import noise_floor
from fleetlog.discovery.search.joint import Joint
from fleetlog.discovery.search.problem import Problem
from fleetlog.discovery.search.sizes import predicted

Floats = NDArray[np.float64]

FEWEST_CLUSTERS = 3


@dataclass(frozen=True)
class Scores:
    """Errors on held-out trips: ``before``, ``after``, ``floor``, and of the model without each finding;
    p-values of these.

    ``beside``: of the model with a free curve beside it.  None where too little was held out to say.
    """

    before: float | None
    after: float | None
    floor: float | None
    without: dict[Hypothesis, float]
    p_values: dict[Hypothesis, float]
    beside: dict[Hypothesis, float]


def judge(
    problem: Problem,
    before: Model,
    after: Model,
    without: dict[Hypothesis, Model],
    beside: dict[Hypothesis, Joint],
) -> Scores:
    """Return the errors of models, and of fits with a free curve beside the last of them, on what was held
    out."""
    units = list(problem.held_out())
    energy = _pooled(units, lambda u: u.recorded)
    if not len(energy) or not energy.any():
        return Scores(None, None, None, {}, {}, {})
    size = float(np.sqrt(np.mean(energy**2)))

    def left(model: Model) -> Floats:
        return _pooled(units, lambda u: u.recorded - problem.channel.predict(u, model))

    def kept_back(joint: Joint) -> Floats:
        return _pooled(units, lambda u: u.recorded - predicted(problem, u, joint))

    old, new = left(before), left(after)
    others = {h: left(model) for h, model in without.items()}
    cluster = _clusters(problem, units)
    free = {h: kept_back(joint) for h, joint in beside.items()}
    floor = _floor(problem, before)

    def error(residual: Floats) -> float:
        return float(np.sqrt(np.mean(residual**2))) / size

    return Scores(
        error(old), error(new), None if floor is None else floor / size,
        {h: error(r) for h, r in others.items()},
        {h: p_value(r, r - new, cluster) for h, r in others.items()}
        | {h: p_value(new, new - r, cluster) for h, r in free.items()},
        {h: error(r) for h, r in free.items()},
    )  # fmt: skip


def strongest(problem: Problem, base: Joint, joint: Joint) -> float | None:
    """Return the p-value of a hypothesis that was found on the training trips, on those held out."""
    units = list(problem.held_out())
    if not units:
        return None
    residual = _pooled(units, lambda u: u.recorded - predicted(problem, u, base))
    effect = _pooled(units, lambda u: predicted(problem, u, joint) - predicted(problem, u, base))
    return p_value(residual, effect, _clusters(problem, units))


def p_value(residual: Floats, effect: Floats, cluster: NDArray[np.int64]) -> float:
    """Return how likely trips that nothing has read speak so much for an effect by chance (one-sided,
    trips independent).

    ``residual`` (W,) of the model without the effect; ``effect`` (W,) what it would add, found on other
    trips.
    """
    _, which = np.unique(cluster, return_inverse=True)
    score = np.bincount(which, residual * effect)
    score = score[np.bincount(which, np.abs(effect)) > 0.0]
    spread = float(np.sqrt((score**2).sum()))
    if len(score) < FEWEST_CLUSTERS or spread == 0.0:
        return 1.0
    return float(stdtr(len(score) - 1, -score.sum() / spread))


def _pooled(units: Sequence[Unit], value: Callable[[Unit], Floats]) -> Floats:
    parts = [np.asarray(value(u))[u.whole] for u in units]
    return np.concatenate(parts) if parts else np.zeros(0)


def _clusters(problem: Problem, units: Sequence[Unit]) -> NDArray[np.int64]:
    return np.concatenate([problem.split.unit(u.windows)[u.whole] for u in units])


def _floor(problem: Problem, before: Model) -> float | None:
    features, residual, trip, wanted = [], [], [], []
    for number, unit in enumerate(problem.channel.units()):
        use = unit.whole
        features.append(problem.channel.features(unit, before)[use])
        residual.append((unit.recorded - problem.channel.predict(unit, before))[use])
        trip.append(problem.split.unit(unit.windows)[use])
        wanted.append((problem.folds(number, unit)[0] == HELD_OUT)[use])
    parts = [np.concatenate(p) for p in (features, residual, trip, wanted)]
    repeated = noise_floor(*parts)
    if repeated is None:
        return None
    # Alike windows repeat what the uncertainty of their motion does to them; that part is known without them.
    stated = np.concatenate([u.noise[u.whole] for u in problem.held_out()])
    return max(repeated, float(np.sqrt(np.mean(stated))))

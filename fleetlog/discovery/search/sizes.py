"""How large an effect is where it acts, as a share of the energy; how much of it unseen trips confirm."""

from dataclasses import dataclass, replace

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.discovery.channels.base import Unit
from fleetlog.discovery.hypotheses.hypothesis import Hypothesis
from fleetlog.discovery.model import Model
from fleetlog.discovery.search.joint import Joint
from fleetlog.discovery.search.problem import Problem


def local(h: Hypothesis) -> bool:
    """Return whether an effect may touch a part of the recording only: some places, trucks, or hours."""
    return bool({"x", "y"} & set(h.depends_on)) or not h.scope.whole


@dataclass(frozen=True)
class Size:
    """How large an effect is where it acts: the ``share`` of the energy that it makes up, and what of it
    was ``verified``.

    Verified is the root mean square, over that of the energy, that unseen trips confirm.
    """

    share: float
    verified: float


def size_of(problem: Problem, now: Joint, joint: Joint) -> Size:
    """Return the size of the last hypothesis, in the windows that it touches.

    Of a free curve only what tolerances cannot say as well: the difference that it makes beside them.
    """
    h = joint.chosen[-1]
    before = now if h.term is None else replace(joint, model=without(joint, h))

    def seen(unit: Unit) -> Floats:
        effect = predicted(problem, unit, joint) - predicted(problem, unit, before)
        there = h.scope.share(int(unit.windows.vehicle[0]), unit.windows.time)
        weight = problem.noise.weight(unit)
        return np.abs(np.stack([effect, unit.recorded, unit.level, weight, there]))[:, unit.whole]

    size, energy, level, weight, there = np.concatenate([seen(u) for u in problem.training()], axis=1)
    touched = there > 0.0
    if {"x", "y"} & set(h.depends_on):
        touched &= size > problem.settings.material * level
    gained = 2.0 * problem.noise.design * max(float((now.losses - joint.losses).sum()), 0.0)
    verified = np.sqrt(gained / max(float((weight * energy**2)[touched].sum()), 1e-12))
    return Size(float(size[touched].sum() / max(float(energy[touched].sum()), 1e-12)), float(verified))


def without(joint: Joint, h: Hypothesis) -> Model:
    """Return the model with one hypothesis taken out and everything else in place."""
    return joint.model.without(
        {*h.knobs, *h.shapes}, {h.term} if (h.field or h.patterns) and h.term else set()
    )


def predicted(problem: Problem, unit: Unit, joint: Joint) -> Floats:
    """Return what a fit says of every window, (W,): its model, and what free curves add."""
    sources = [h.sources[0] for h in joint.chosen if h.term is None]
    if not sources:
        return problem.channel.predict(unit, joint.model)
    out, x = problem.channel.columns(unit, joint.model, sources)
    own = [a.owner is not None and a.owner.term is None for a in joint.design.atoms]
    return np.asarray(out + x @ joint.fitted.beta[own])


def hidden(problem: Problem, unit: Unit, joint: Joint) -> Floats:
    """Return what sampling hides in every window by a fit, (W,): no physics, and not in the model."""
    sources = problem.channel.errors()
    if not sources:
        return np.zeros(len(unit.windows))
    own = [a.owner is None and a.knob is None for a in joint.design.atoms]
    return np.asarray(problem.channel.columns(unit, joint.model, sources)[1] @ joint.fitted.beta[own])

"""What was found, in numbers: parameters with intervals from all recorded trips, and the error on those kept back."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fleetlog.discovery.candidates import is_vector
from fleetlog.discovery.fields import Values, stands_out
from fleetlog.discovery.linear import Fit, Problem, Selection, fit
from fleetlog.discovery.settle import settle
from fleetlog.discovery.task import State, Task, posed, selection
from fleetlog.physics.term import Term

Floats = NDArray[np.float64]

SURE = 1.96
"""Standard errors of a 95 per cent interval."""
ROBUST = 2
"""Rounds of taking weight off windows that the model does not explain."""
FREELY = 100.0
OUTLYING = 3.0
"""Beyond this many robust standard deviations a window weighs less [1]."""
MODEL = 0.01
"""What a model that is right in kind still misses of a coefficient, as sampling does (relative, one standard deviation)."""
MODEL_CHANGE = 0.06
"""The same as a share of the change that was found."""
MODEL_SPEED = 0.1
"""The same of a number that governs how fast trucks drive: corners and ramps of speed are rounder than the profile's."""


@dataclass(frozen=True)
class Estimates:
    """``numbers[term][parameter]`` (value, standard error); ``fields[term]`` values with errors; ``state`` fitted to all."""

    state: State
    numbers: dict[str, dict[str, tuple[float, float]]]
    fields: dict[str, Values]

    def drop(self, name: str) -> None:
        """Forget a term: the model that is written holds only what is reported."""
        self.numbers.pop(name, None)
        self.fields.pop(name, None)
        self.state.found = self.state.found.without(name)


def estimates(task: Task, state: State, direct: dict[str, dict[str, tuple[float, float]]]) -> Estimates:
    """Everything chosen, fitted once more to all windows, with standard errors that trust only whole trips as independent.

    The error has three parts: the cluster-robust one (trips, and stretches of hours), the change that comes about when the
    small honest errors of truck file and logger are not allowed for, and a floor for what sampling leaves.
    """
    everything = task.recording.whole
    # Free companions of a term would share its effect with it.
    own = {k: v for k, v in state.curves.items() if k in state.names()}
    state = settle(task, replace(state, curves=own), everything)
    for _ in range(ROBUST if state.chosen else 0):
        state = settle(task, _reweighted(task, state, everything), everything)
    task, state = _only_where_large(task, state, everything)
    table, p = posed(task, state, everything, chosen_only=True)
    s = selection(state, p)
    f = fit(p, s)
    covariance = sandwich(p, f)
    stiff = fit(replace(p, spread=np.full_like(p.spread, 1e-9) + 0.05 * p.spread), s)
    numbers: dict[str, dict[str, tuple[float, float]]] = {}
    found_fields: dict[str, Values] = {}
    for choice in state.chosen:
        c = choice.candidate
        if c.term is None:
            continue
        part = f.part(s, c.name)
        spread, other = covariance[part, part], stiff.beta[part] - f.beta[part]
        if c.kind == "field":
            root = task.root(c.term)
            error = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", root, spread, root), 0.0))
            samples = (np.abs(table.groups[c.name]) > 0).sum(axis=0)
            deviation = state.found.fields[c.name]
            error = np.sqrt(error**2 + (0.5 * (root @ other)) ** 2 + (MODEL_CHANGE * deviation) ** 2)
            found_fields[c.name] = Values(deviation, error, samples)
            continue
        numbers[c.name] = {}
        for i, knob in enumerate(choice.knobs):
            parameter = c.term.by_name[knob.parameter]
            value = state.found.value(c.term, knob.parameter)
            moved = _moved(task, state, c.term, knob.parameter)
            model = (
                MODEL_SPEED * value
                if c.term.acts == "speed"
                else np.hypot(MODEL * value * (parameter.truck_key is not None), MODEL_CHANGE * moved)
                + task.rough * abs(value)
            )
            error = np.sqrt(max(spread[i, i], 0.0) + (0.5 * other[i]) ** 2 + model**2)
            if knob.parameter in direct.get(c.name, {}):
                value, error = direct[c.name][knob.parameter]
                error = np.hypot(error, MODEL_SPEED * value)
                state.found = state.found.with_value(c.name, knob.parameter, value)
            numbers[c.name][knob.parameter] = (value, float(error))
    return Estimates(state, numbers, found_fields)


def _moved(task: Task, state: State, term: Term, parameter: str) -> float:
    """How far a number was moved; the components of a vector as far as the vector was."""
    names = [p.name for p in term.parameters] if is_vector(term) else [parameter]
    return float(np.hypot.reduce([state.found.value(term, n) - task.base.value(term, n) for n in names]))


def _only_where_large(task: Task, state: State, use: NDArray[np.bool_]) -> tuple[Task, State]:
    """Even fields fitted once more on the places that stand out, freely there and nothing elsewhere.

    The prior that keeps a field small everywhere would keep it small where it is not, too.
    """
    roots, found, chosen = dict(task.own_roots), state.found, []
    for choice in state.chosen:
        term = choice.candidate.term
        if term is None or choice.candidate.kind != "field" or term.odd:
            chosen.append(choice)
            continue
        deviation = found.fields[term.name]
        keep = task.cells(term).closed(stands_out(deviation))
        covariance = task.root(term) @ task.root(term).T
        root = np.zeros((len(deviation), int(keep.sum())))
        root[keep] = np.linalg.cholesky(covariance[np.ix_(keep, keep)])
        roots[term.name] = root
        found = found.with_field(term.name, np.where(keep, deviation, 0.0))
        chosen.append(replace(choice, gain=replace(choice.gain, tau=FREELY * choice.gain.tau)))
    if len(roots) == len(task.own_roots):
        return task, state
    task, state = replace(task, own_roots=roots), replace(state, found=found, chosen=chosen)
    return task, settle(task, state, use)


def _reweighted(task: Task, state: State, use: NDArray[np.bool_]) -> State:
    """With less weight on windows that what was found does not explain: they must not bend its numbers."""
    state = replace(state, weight=None)
    _, p = posed(task, state, use)
    f = fit(p, selection(state, p), inverse=False)
    z = np.abs(p.y - p.x[:, f.columns] @ f.beta)
    z = z / max(1.4826 * float(np.median(z)), 1e-9)
    weight = p.weight.copy()
    weight[use] *= np.minimum(1.0, OUTLYING / np.maximum(z, 1e-9)) ** 2
    return replace(state, weight=weight)


def sandwich(p: Problem, f: Fit) -> Floats:
    """Covariance of the coefficients when residuals hang together within trips, or within stretches of hours."""
    x = p.x[:, f.columns].astype(float)
    residual = p.y - x @ f.beta
    out = f.inverse
    for cluster in (p.trip, p.block):
        scores = np.zeros((int(cluster.max()) + 1, x.shape[1]))
        np.add.at(scores, cluster, x * residual[:, None])
        robust = f.inverse @ (scores.T @ scores) @ f.inverse
        # The larger of the two, coefficient by coefficient, keeping the correlations of its own.
        grow = np.sqrt(np.maximum(np.diag(robust) / np.maximum(np.diag(out), 1e-300), 1.0))
        out = out * np.outer(grow, grow)
    return np.asarray(out)


@dataclass(frozen=True)
class Errors:
    """Root mean square error of the kept-back windows over the root mean square of what was recorded there.

    ``before`` of the nominal model as it is given, ``after`` with what was found, ``floor`` what the freest model still
    misses; ``gains`` how much each term found, by itself, lowers the error beside the others.
    """

    before: float
    after: float
    floor: float
    gains: dict[str, float]


def held_out(task: Task, state: State) -> Errors:
    """The errors on the windows that neither the search nor its fits have seen."""
    test = ~task.train & task.recording.whole
    scale = float(np.sqrt(np.mean(task.recording.recorded[test] ** 2))) or 1.0

    def error(residual: Floats) -> float:
        return float(np.sqrt(np.mean(residual[test] ** 2))) / scale

    nominal = posed(task, State(task.base, weight=state.weight), chosen_only=True)[0].y
    before, after, freest = error(nominal), error(_residual(task, state)), error(_freest(task, state))
    rest, gains = nominal - task.recording.effect(task.base, state.found), {}
    for name in (c.candidate.name for c in state.chosen if c.candidate.named):
        own = task.recording.effect(state.found.without(name), state.found)
        gains[name] = error(rest + own) - error(rest)
    return Errors(before, after, min(freest, after, before), gains)


def _residual(task: Task, state: State) -> Floats:
    """(W,) residual everywhere of the model fitted to the windows that the search saw."""
    table, p = posed(task, state, chosen_only=True)
    s = selection(state, p)
    f = fit(p, s, inverse=False)
    groups = {k: v for k, v in table.groups.items() if k in s.columns}
    return table.y - _predict(task, p, f, s, table.nuisance, groups)


def _predict(
    task: Task,
    p: Problem,
    f: Fit,
    s: Selection,
    nuisance: dict[str, NDArray[np.float32]],
    groups: dict[str, NDArray[np.float32]],
) -> Floats:
    x = np.concatenate(list(nuisance.values()), axis=1)
    total = x[:, f.columns[: f.nuisances]] @ f.beta[: f.nuisances]
    begin = f.nuisances
    for name, c in s.columns.items():
        columns = groups.get(name, task.free.get(name))
        assert columns is not None
        candidate = task.candidates[name]
        if candidate.kind == "field" and candidate.term is not None:
            columns = (columns @ task.root(candidate.term)).astype(np.float32)
        total = total + columns[:, : len(c)] @ f.beta[begin : begin + len(c)]
        begin += len(c)
    return np.asarray(total, dtype=float)


def _freest(task: Task, state: State) -> Floats:
    """(W,) residual when every free curve is allowed beside what was found, gently held."""
    curves = dict(state.curves)
    _, p = posed(task, state)
    for name, c in task.candidates.items():
        if not c.named and not c.place and name in p.at and name not in curves:
            size = float(np.mean(np.diag(p.gram)[p.at[name]]))
            curves[name] = 100.0 / max(size, 1e-9)
    return _residual(task, replace(state, curves=curves))

"""Numbers that act nonlinearly, brought to their best value: Gauss-Newton on the energy of the windows."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from fleetlog.discovery.bench import Bench
from fleetlog.discovery.candidates import Candidate, Knob
from fleetlog.discovery.linear import Problem, Selection, fit
from fleetlog.discovery.model import Found

Floats = NDArray[np.float64]

ROUNDS = 8
HALVINGS = 4
FURTHEST = 2.5
"""Largest factor by which one step changes a number that is positive by nature."""
FINER = (0.5, 0.25)
"""Steps of a shape about the best one of its grid, in spacings of the grid."""
CONVERGED = 1e-4
"""Smaller steps than this share of the plausible range end the iteration."""


def turned(found: Found, candidate: Candidate, knobs: tuple[Knob, ...], by: Floats) -> Found:
    """The model with knobs turned further, inside what is plausible."""
    term = candidate.term
    assert term is not None
    out = found
    for knob, delta in zip(knobs, by, strict=True):
        parameter = term.by_name[knob.parameter]
        now = found.value(term, knob.parameter)
        low, high = parameter.low, parameter.high
        if parameter.nominal(found.truck) > 0.0 and now > 0.0:
            low, high = max(low, now / FURTHEST), min(high, now * FURTHEST)
        value = float(np.clip(now + delta, low, high))
        for name, shape in knob.shape:
            out = out.with_value(term.name, name, shape)
        out = out.with_value(term.name, knob.parameter, value)
    return out


def polish(
    recording: Bench,
    p: Problem,
    s: Selection,
    rows: NDArray[np.bool_],
    found: Found,
    candidate: Candidate,
    knobs: tuple[Knob, ...],
) -> tuple[Found, Floats, float]:
    """The best setting of a scalar explanation beside what is selected, the (W,) kJ that it adds, and the loss then."""
    f = fit(p, s, inverse=False)
    z = p.x[:, f.columns].astype(float)
    one = replace(candidate, knobs=knobs)
    gram = z.T @ z + np.diag(_penalty(p, s))

    def left(y: Floats) -> Floats:
        return np.asarray(y - z @ np.linalg.solve(gram, z.T @ y))

    best, added = found, np.zeros(len(rows))
    rest = left(p.y)
    for _ in range(ROUNDS):
        columns = p.scaled(recording.column(best, one))
        step = _solve(left(columns), columns, p.y - p.scaled(added))
        for halving in range(HALVINGS):
            new = turned(best, candidate, knobs, step / 2.0**halving)
            more = recording.effect(found, new)
            after = p.y - p.scaled(more)
            if after @ left(after) < (p.y - p.scaled(added)) @ rest:
                break
        else:
            break
        moved = max(_distance(best, new, candidate, k) for k in knobs)
        best, added, rest = new, more, left(after)
        if moved < CONVERGED:
            break
    return best, added, float((p.y - p.scaled(added)) @ rest)


def shaped(
    recording: Bench,
    p: Problem,
    s: Selection,
    rows: NDArray[np.bool_],
    found: Found,
    candidate: Candidate,
    knobs: tuple[Knob, ...],
) -> tuple[Found, Floats, tuple[Knob, ...]]:
    """As :func:`polish`, with a shape that was scanned on a grid brought to its best value between the grid's."""
    polished = partial(polish, recording, p, s, rows, found, candidate)
    best = (*polished(knobs), knobs)
    width = spacing(candidate, knobs)
    for part in FINER if width else ():
        for side in (-part, part):
            knob = best[3][0]
            ((name, value),) = knob.shape
            assert candidate.term is not None
            parameter = candidate.term.by_name[name]
            moved = float(np.clip(value + side * width, parameter.low, parameter.high))
            other = (Knob(knob.parameter, ((name, moved),)),)
            tried = (*polished(other), other)
            best = tried if tried[2] < best[2] else best
    return best[0], best[1], best[3]


def spacing(candidate: Candidate, knobs: tuple[Knob, ...]) -> float:
    """Between the grid values of the one shape of a knob; 0 where there is none."""
    if len(knobs) != 1 or len(knobs[0].shape) != 1:
        return 0.0
    tried = sorted({k.shape[0][1] for k in candidate.knobs if k.shape})
    return tried[1] - tried[0] if len(tried) > 1 else 0.0


def _distance(a: Found, b: Found, candidate: Candidate, knob: Knob) -> float:
    """Step of a number as a share of its plausible range."""
    assert candidate.term is not None
    parameter = candidate.term.by_name[knob.parameter]
    apart = abs(a.value(candidate.term, knob.parameter) - b.value(candidate.term, knob.parameter))
    return apart / (parameter.high - parameter.low)


def _solve(left: Floats, columns: Floats, target: Floats) -> Floats:
    """Coefficients of ``columns`` after everything else is allowed for; ``left`` is what remains of them."""
    h = left.T @ columns
    h += (1e-9 * np.trace(h) / len(h) + 1e-12) * np.eye(len(h))
    return np.asarray(np.linalg.solve(h, left.T @ target))


def _penalty(p: Problem, s: Selection) -> Floats:
    keep = np.array([j not in s.drop for j in p.nuisance], dtype=bool)
    return np.concatenate(
        [1.0 / p.spread[keep] ** 2, *(np.full(len(v), 1.0 / s.tau[k]) for k, v in s.columns.items())]
    )

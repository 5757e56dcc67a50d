"""Everything chosen, fitted together, inside what is plausible."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fleetlog.discovery import polish
from fleetlog.discovery.fields import stands_out
from fleetlog.discovery.linear import Hold, Problem, fit
from fleetlog.discovery.task import Mask, State, Task, posed, selection
from fleetlog.physics.term import Term

Floats = NDArray[np.float64]

SETTLE = 2
"""Gauss-Newton rounds over everything chosen together."""


def settle(task: Task, state: State, use: Mask | None = None) -> State:
    """Everything chosen, fitted together."""
    for _ in range(SETTLE):
        _, p = posed(task, state, use, chosen_only=True)
        s = selection(state, p)
        f = fit(p, s, moment=p.moment + _pulled(task, state, p), inverse=False)
        found = state.found
        for choice in state.chosen:
            c = choice.candidate
            if c.term is None:
                continue
            beta = f.beta[f.part(s, c.name)]
            if c.kind == "field":
                found = found.with_field(c.name, np.clip(task.root(c.term) @ beta, *_span(c.term)))
            else:
                found = polish.turned(found, c, choice.knobs, beta)
        state = replace(state, found=found)
    return state


def plausible(task: Task, name: str) -> Hold | None:
    """Holds a field to what is plausible: no floor rolls easier than the smoothest; even ones to where they stand out."""
    candidate = task.candidates[name]
    if candidate.kind != "field" or candidate.term is None:
        return None
    term, root = candidate.term, task.root(candidate.term)
    low, high = _span(term)

    def within(beta: Floats) -> Floats:
        value = np.clip(root @ beta, low, high)
        if not term.odd:
            # The prior spreads over all of the floor what belongs to a part of it.
            value = np.where(stands_out(value), value, 0.0)
        return np.asarray(np.linalg.lstsq(root, value, rcond=None)[0], dtype=np.float64)

    return name, within


def _span(term: Term) -> tuple[float, float]:
    """How far a field may deviate from neutral."""
    first = term.parameters[0]
    # A cap can only slow down; where it does not bind, nothing is known of it.
    caps = term.acts == "speed" and first.neutral == 1.0
    return first.low - first.neutral, 0.0 if caps else first.high - first.neutral


def _pulled(task: Task, state: State, p: Problem) -> Floats:
    """What the fields already in the model add to X'y, so that a fit gives them whole and their prior pulls to zero."""
    out = np.zeros(len(p.moment))
    for name, deviation in state.found.fields.items():
        if name in task.candidates and name in p.at and name not in task.base.fields:
            term = task.candidates[name].term
            assert term is not None
            out += p.gram[:, p.at[name]] @ np.linalg.lstsq(task.root(term), deviation, rcond=None)[0]
    return out

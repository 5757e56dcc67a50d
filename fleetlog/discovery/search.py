"""The search for what an energy channel is missing: scan, compare on held-out trips, add, settle, start again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fleetlog.discovery import evidence as ev
from fleetlog.discovery import polish, select
from fleetlog.discovery.bench import Columns
from fleetlog.discovery.candidates import Candidate, Knob
from fleetlog.discovery.dropping import backward
from fleetlog.discovery.evidence import Evidence
from fleetlog.discovery.linear import Problem, Selection
from fleetlog.discovery.model import Found
from fleetlog.discovery.select import Choice
from fleetlog.discovery.settle import plausible, settle
from fleetlog.discovery.task import State, Task, posed, replaced, selection

Floats = NDArray[np.float64]

MOST_TERMS = 5
LOOSE = 100.0
"""A number already chosen is free: its prior spread is ten times what was first found."""
LEAK = 0.01
"""Share of what was explained that may reappear as something else."""
COMPANION = 6.0
"""Evidence with which a free curve over a chosen term's own variable is let in beside it."""


def search(task: Task, state: State) -> State:
    """Add explanations while one more predicts held-out trips better, then drop those that do not pay."""
    rng = np.random.default_rng(task.seed)
    got = 0.0
    while len(state.chosen) < MOST_TERMS:
        p = posed(task, state)[1]
        now = selection(state, p)
        base = {"trip": select.cross_validate(p, now, "trip")}
        choice, model = _step(task, state, p, now, base, got, rng)
        if choice is None:
            break
        got = 1.0 - (1.0 - got) * (1.0 - min(choice.gain.trip, 0.999))
        state = _accept(task, state, choice, model, rng)
    return backward(task, state)


def _step(
    task: Task,
    state: State,
    p: Problem,
    s: Selection,
    base: dict[str, Floats],
    got: float,
    rng: np.random.Generator,
) -> tuple[Choice | None, Found]:
    candidates = task.candidates
    variants = frozenset(c.name for c in task.named if c.variant)
    slow = frozenset(c.name for c in candidates.values() if c.slow)
    found = ev.scan(
        p, s, [n for n in candidates if n not in s.columns], variants=variants, slow=slow, rng=rng
    )
    ranked = sorted(found, key=lambda n: -found[n].raw)
    loud = [
        n
        for n in ranked
        if found[n].p_value <= select.ALPHA and found[n].log_evidence > select.LEAST_EVIDENCE
    ]
    # Every term that speaks is heard, however many free curves speak louder.
    short = loud[: select.SHORT] + [n for n in loud[select.SHORT :] if candidates[n].named]
    if not short:
        return None, state.found
    p, found, models = _polished(task, state, p, s, short, found)
    # A number that no step improves explains nothing.
    short = [n for n in short if candidates[n].kind != "scalar" or n in models]
    if not short:
        return None, state.found
    energy, root = task.recording.recorded[task.use], np.sqrt(p.weight[task.use])
    gains = {}
    for name in short:
        without = Selection(s.columns, s.tau, s.drop | replaced(p, name))
        hold = plausible(task, name)
        gains[name] = select.gain_of(p, s, without, candidates[name], found[name], base, root, energy, hold)
    # What is added later must clear what leaks from what was added before.
    need = max(select.LEAST_GAIN, LEAK * got / (1.0 - got))
    choice = select.choose(candidates, found, gains, need, task.material)
    state.log.append(_line(short, gains, found, candidates, choice))
    if choice is None:
        return None, state.found
    name = choice.candidate.name
    model, used = models.get(name, (state.found, ()))
    return replace(choice, knobs=used), model


def _line(
    short: list[str],
    gains: dict[str, select.Gain],
    found: dict[str, Evidence],
    candidates: dict[str, Candidate],
    choice: Choice | None,
) -> str:
    parts = [
        f"{n}: gain {gains[n].trip:.3f} kept {gains[n].worst(candidates[n].named):.2f}"
        f" share {gains[n].share:.3f} p {found[n].p_value:.3f}"
        for n in sorted(short, key=lambda n: -gains[n].trip)
    ]
    return "; ".join(parts) + (f" -> {choice.candidate.name}" if choice else " -> stop")


def _polished(
    task: Task, state: State, p: Problem, s: Selection, short: list[str], found: dict[str, Evidence]
) -> tuple[Problem, dict[str, Evidence], dict[str, tuple[Found, tuple[Knob, ...]]]]:
    """Numbers among the short list brought to their best value, their whole effect a column of its own."""
    columns: dict[str, Columns] = {}
    models: dict[str, tuple[Found, tuple[Knob, ...]]] = {}
    for name in short:
        candidate = task.candidates[name]
        if candidate.kind != "scalar":
            continue
        at = list(p.at[name])
        knobs = tuple(candidate.knobs[at.index(j)] for j in found[name].columns)
        without = Selection(s.columns, s.tau, s.drop | replaced(p, name))
        model, added, knobs = polish.shaped(
            task.recording, p, without, task.use, state.found, candidate, knobs
        )
        if not np.any(added):
            continue
        models[name] = (model, knobs)
        columns[f"polished {name}"] = added[:, None].astype(np.float32)
    if not columns:
        return p, found, models
    p = p.extended(columns)
    out = dict(found)
    for name in models:
        out[name] = replace(found[name], columns=p.at[f"polished {name}"], tau=1.0)
    return p, out, models


def _accept(task: Task, state: State, choice: Choice, model: Found, rng: np.random.Generator) -> State:
    """The model with the choice in it, everything brought to its best value together, and its free companions."""
    name = choice.candidate.name
    if not choice.candidate.named:
        curves = {**state.curves, name: choice.gain.tau}
        return replace(state, chosen=[*state.chosen, choice], curves=curves, weight=None)
    if choice.candidate.kind == "scalar":
        moved = [model.value(choice.candidate.term, k.parameter) - state.found.value(choice.candidate.term, k.parameter)
                 for k in choice.knobs] if choice.candidate.term else [1.0]  # fmt: skip
        choice = replace(
            choice, gain=replace(choice.gain, tau=LOOSE * max(float(np.square(moved).max()), 1e-12))
        )
    else:
        assert choice.candidate.term is not None
        model = state.found.with_field(name, np.zeros(len(task.root(choice.candidate.term))))
    state = settle(task, replace(state, found=model, chosen=[*state.chosen, choice]))
    # Noise is judged anew now that the effect is gone from the residual.
    return _with_companions(task, replace(state, weight=None), choice, rng)


def _with_companions(task: Task, state: State, choice: Choice, rng: np.random.Generator) -> State:
    """Free curves over the chosen term's own variables: a wrong shape must not call in a second, false mechanism."""
    own = set(choice.candidate.depends_on)
    names = [
        c.name for c in task.candidates.values()
        if not c.named and c.depends_on and set(c.depends_on) <= own and not c.place and c.name not in state.curves
    ]  # fmt: skip
    if not names:
        return state
    _, p = posed(task, state)
    s = selection(state, p)
    slow = frozenset(n for n in names if task.candidates[n].slow)
    found = ev.scan(p, s, names, variants=frozenset(), slow=slow, rng=rng)
    curves = {**state.curves, **{n: e.tau for n, e in found.items() if e.log_evidence > COMPANION}}
    return replace(state, curves=curves)

"""The search for what an energy channel is missing: scan, compare on held-out trips, add, settle, start again."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fleetlog.discovery import evidence as ev
from fleetlog.discovery import polish, select
from fleetlog.discovery.candidates import Candidate, Knob
from fleetlog.discovery.evidence import Evidence
from fleetlog.discovery.fields import stands_out
from fleetlog.discovery.linear import Hold, Problem, Selection, fit, pose
from fleetlog.discovery.model import Found
from fleetlog.discovery.residual import MATERIAL, Bench, Columns, Table
from fleetlog.discovery.select import Choice
from fleetlog.discovery.stretches import Cells
from fleetlog.physics.term import Term

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

MOST_TERMS = 5
SETTLE = 2
"""Gauss-Newton rounds over everything chosen together."""
LOOSE = 100.0
"""A number already chosen is free: its prior spread is ten times what was first found."""
LEAK = 0.01
"""Share of what was explained that may reappear as something else."""
COMPANION = 6.0
"""Evidence with which a free curve over a chosen term's own variable is let in beside it."""


@dataclass(frozen=True)
class Task:
    """What is searched, over what."""

    recording: Bench
    candidates: dict[str, Candidate]
    free: dict[str, Columns]
    fold: dict[str, NDArray[np.int64]]
    block: NDArray[np.int64]
    roots: dict[bool, Floats]
    floor: Cells | None
    base: Found
    train: Mask
    seed: int
    material: tuple[float, float] = (MATERIAL, 2.0 * MATERIAL)
    rough: float = 0.0
    """What the replay misses of any number found, as a share of it (one standard deviation)."""
    own_floors: dict[str, Cells] = field(default_factory=dict)
    own_roots: dict[str, Floats] = field(default_factory=dict)

    def cells(self, term: Term) -> Cells:
        """Pieces of the floor that a field term has values on."""
        floor = self.own_floors.get(term.name, self.floor)
        assert floor is not None
        return floor

    def root(self, term: Term) -> Floats:
        """L with L L' the prior covariance of a field term's values."""
        own = self.own_roots.get(term.name)
        return self.roots[term.odd] if own is None else own

    @property
    def named(self) -> list[Candidate]:
        """Candidates that are terms."""
        return [c for c in self.candidates.values() if c.named]

    @property
    def use(self) -> Mask:
        """(W,) windows that the search may see."""
        return self.train & self.recording.whole


@dataclass
class State:
    """Where the search stands: the model, the choices that led to it, and the free curves beside it."""

    found: Found
    chosen: list[Choice] = field(default_factory=list)
    curves: dict[str, float] = field(default_factory=dict)
    weight: Floats | None = None
    log: list[str] = field(default_factory=list)

    def names(self) -> list[str]:
        """What was chosen, in order."""
        return [c.candidate.name for c in self.chosen]


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


def posed(
    task: Task, state: State, use: Mask | None = None, *, chosen_only: bool = False
) -> tuple[Table, Problem]:
    """Residual and columns about the model so far; weights stay until something is added.

    ``chosen_only`` leaves the columns of everything else out, where weights are known already.
    """
    chosen = {c.candidate.name: c for c in state.chosen}
    everything = state.weight is None or not chosen_only
    named = [
        replace(c, knobs=chosen[c.name].knobs) if c.name in chosen and c.kind == "scalar" else c
        for c in task.named
        if everything or c.name in chosen
    ]
    table = task.recording.tabulate(state.found, named, task.free)
    groups = {c.name: rotated(task, c.name, table.groups[c.name]) for c in named}
    groups.update({k: v for k, v in task.free.items() if everything or k in state.curves})
    p = pose(
        table.windows, table.model, table.y, groups, table.nuisance, table.spread,
        task.use if use is None else use, task.fold, task.block, table.jitter, table.crude, state.weight, table.load,
    )  # fmt: skip
    if state.weight is None:
        state.weight = p.weight
    return table, p


def rotated(task: Task, name: str, x: Columns) -> Columns:
    """Columns of a field in the basis in which its prior is round."""
    candidate = task.candidates[name]
    if candidate.kind != "field" or candidate.term is None:
        return x
    return x @ task.root(candidate.term).astype(np.float32)


def selection(state: State, p: Problem) -> Selection:
    """The groups of everything chosen so far: corrections about the present model."""
    s = Selection()
    for choice in state.chosen:
        name = choice.candidate.name
        if choice.candidate.named:
            s = s.add(name, p.at[name], choice.gain.tau, replaced(p, name))
    for name, tau in state.curves.items():
        s = s.add(name, p.at[name], tau)
    return s


def replaced(p: Problem, name: str) -> frozenset[int]:
    """Nuisance columns that a term makes needless, being the same."""
    return frozenset(int(j) for j in p.at.get(f"nuisance {name}", ()))


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
        return State(state.found, [*state.chosen, choice], curves, None, state.log)
    if choice.candidate.kind == "scalar":
        moved = [model.value(choice.candidate.term, k.parameter) - state.found.value(choice.candidate.term, k.parameter)
                 for k in choice.knobs] if choice.candidate.term else [1.0]  # fmt: skip
        choice = replace(
            choice, gain=replace(choice.gain, tau=LOOSE * max(float(np.square(moved).max()), 1e-12))
        )
    else:
        assert choice.candidate.term is not None
        model = state.found.with_field(name, np.zeros(len(task.root(choice.candidate.term))))
    state = State(model, [*state.chosen, choice], state.curves, state.weight, state.log)
    state = settle(task, state)
    # Noise is judged anew now that the effect is gone from the residual.
    state.weight = None
    return _with_companions(task, state, choice, rng)


def _pulled(task: Task, state: State, p: Problem) -> Floats:
    """What the fields already in the model add to X'y, so that a fit gives them whole and their prior pulls to zero."""
    out = np.zeros(len(p.moment))
    for name, deviation in state.found.fields.items():
        if name in task.candidates and name in p.at and name not in task.base.fields:
            term = task.candidates[name].term
            assert term is not None
            out += p.gram[:, p.at[name]] @ np.linalg.lstsq(task.root(term), deviation, rcond=None)[0]
    return out


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
        state = State(found, state.chosen, state.curves, state.weight, state.log)
    return state


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
    return State(state.found, state.chosen, curves, state.weight, state.log)


def backward(task: Task, state: State) -> State:
    """Without each explanation that hardly helps on held-out trips once the others are there."""
    if len(state.chosen) < 2:
        return state
    _, p = posed(task, state, chosen_only=True)
    s = selection(state, p)
    full = select.cross_validate(p, s, "trip").mean()
    nothing = nominal_loss(task, state)
    for choice in list(state.chosen):
        name = choice.candidate.name
        if choice.candidate.named:
            worse = _loss_without(task, state, p, s, choice)
        else:
            worse = select.cross_validate(p, s.remove(name), "trip").mean()
        if (worse - full) / nothing < 0.5 * select.LEAST_GAIN:
            state.log.append(f"dropped {name}: costs {(worse - full) / nothing:.4f}")
            return backward(task, settle(task, without(task, state, choice)))
    return state


def without(task: Task, state: State, choice: Choice) -> State:
    """The state with one explanation less, and without the free curves that were let in beside it alone."""
    gone = {choice.candidate.name, *_companions_of(task, state, choice)}
    return replace(
        state,
        found=state.found.without(choice.candidate.name),
        chosen=[c for c in state.chosen if c is not choice],
        curves={k: v for k, v in state.curves.items() if k not in gone},
    )


def _companions_of(task: Task, state: State, choice: Choice) -> set[str]:
    """Free curves that are there for one chosen term only; left behind they would do its work."""

    def over(name: str, c: Candidate) -> bool:
        return set(task.candidates[name].depends_on) <= set(c.depends_on)

    others = [c.candidate for c in state.chosen if c is not choice and c.candidate.named]
    free = set(state.curves) - set(state.names())
    return {n for n in free if over(n, choice.candidate) and not any(over(n, o) for o in others)}


def _loss_without(task: Task, state: State, p: Problem, s: Selection, choice: Choice) -> float:
    name = choice.candidate.name
    added = task.recording.effect(state.found.without(name), state.found)
    y = p.y + p.scaled(added)
    other = replace(p, y=y, inner=None, _by_fold={})
    for n in (name, *_companions_of(task, state, choice)):
        s = s.remove(n)
    return float(select.cross_validate(other, s, "trip").mean())


def nominal_loss(task: Task, state: State) -> float:
    """Cross-validated loss of the nominal model with its honest errors."""
    bare = State(task.base, weight=state.weight)
    _, p = posed(task, bare, chosen_only=True)
    return float(select.cross_validate(p, Selection(), "trip").mean())

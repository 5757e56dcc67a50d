"""What is searched and how far the search has come, and the regression problem that follows from both."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fleetlog.discovery.bench import MATERIAL, Bench, Columns, Table
from fleetlog.discovery.candidates import Candidate
from fleetlog.discovery.linear import Problem, Selection, pose
from fleetlog.discovery.model import Found
from fleetlog.discovery.select import Choice
from fleetlog.discovery.stretches import Cells
from fleetlog.physics.term import Term

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


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

"""Explanations that do not pay once the others are there, taken out again with what came with them."""

from __future__ import annotations

from dataclasses import replace

from fleetlog.discovery import select
from fleetlog.discovery.candidates import Candidate
from fleetlog.discovery.linear import Problem, Selection
from fleetlog.discovery.select import Choice
from fleetlog.discovery.settle import settle
from fleetlog.discovery.task import State, Task, posed, selection


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

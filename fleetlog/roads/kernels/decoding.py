"""The hidden Markov model: steps between candidates, the likeliest sequence and every candidate's posterior.

States of a group are its candidates and, last, "off the roads".  Costs are negative logarithms of
probabilities.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fleetlog.compiling import fast_inner, fast_outer
from fleetlog.core.arrays import Floats
from fleetlog.roads.kernels.costs import BY_JUMP, CHAIN_END, JUMP, LEAVE, LEFT, RARE, reach_of, step_costs
from fleetlog.roads.kernels.distances import ensure
from fleetlog.roads.kernels.records import Candidates, Choice, Costs, Groups, Roads, Store, Wide

BLOCK, AHEAD = 1000, 60  # groups that are decided together, and how far beyond them the model looks


@fast_outer
def ensure_all(store: Store, roads: Roads, near: Candidates, groups: Groups, beta: float, begin: int) -> Any:
    """Store what the steps from group ``begin`` on need; the first group for which there is no room."""
    chain, moved = groups.chain, groups.moved
    for g in range(begin, len(chain) - 1):
        if chain[g + 1] != chain[g]:
            continue
        need = max(reach_of(moved[g], beta), 20.0)
        for c in range(near.ptr[g], near.ptr[g + 1]):
            e = near.edge[c]
            if store.known[e] < need and not ensure(store, roads, e, 1.5 * need):
                return g
    return len(chain)


class Scratch(NamedTuple):
    """For blocks of at most B groups with at most W states."""

    steps: NDArray[np.float32]  # (B W W,) probabilities of steps
    delta: Floats  # (B W,), as the next four
    alpha: Floats
    gamma: Floats
    own: Floats
    came: Wide
    cost: Floats  # (W, W) of one step
    beta: Floats  # (W,), as the next
    later: Floats
    slot: Wide  # (E,) state of an edge, -1


def scratch(near: Candidates, edges: int) -> Scratch:
    """Room for decoding."""
    widest = int(np.diff(near.ptr).max()) + 1
    groups = min(len(near.ptr), BLOCK + AHEAD + 1)
    delta, alpha, gamma, own = np.empty((4, groups * widest))
    came, cost = np.empty(groups * widest, np.int64), np.empty((widest, widest))
    steps, (beta, later) = np.empty(groups * widest * widest, np.float32), np.empty((2, widest))
    slot = np.full(edges, -1, np.int64)
    return Scratch(steps, delta, alpha, gamma, own, came, cost, beta, later, slot)


@fast_outer
def decode(
    store: Store, roads: Roads, near: Candidates, emission: Floats, groups: Groups, costs: Costs, out: Choice,
    room: Scratch,
) -> None:  # fmt: skip
    """Likeliest state of every group, and every state's posterior, into ``out``.

    Works through blocks of groups and looks ahead beyond each, so memory does not grow with the track.
    """
    ptr = near.ptr
    chain, moved, still = groups.chain, groups.moved, groups.still
    chosen, posterior, off_posterior, linked = out
    _, delta, alpha, gamma, own, came, cost, _, _, slot = room
    wide = len(cost)
    off = costs.off
    count = len(ptr) - 1
    start = 0
    fixed = -1  # state of the group before the block, when the chain goes on; its alpha is kept
    while start < count:
        begin = start - 1 if fixed >= 0 else start
        end = begin + 1
        while end < count and chain[end] == chain[begin] and end - start < BLOCK + AHEAD:
            end += 1
        whole = end == count or chain[end] != chain[begin]
        commit = end if whole else start + BLOCK
        k = ptr[begin + 1] - ptr[begin]
        for i in range(k + 1):
            own[i], came[i] = 1.0, CHAIN_END
            if fixed >= 0:
                delta[i] = 0.0 if i == fixed else 1e18
            else:
                delta[i] = emission[ptr[begin] + i] if i < k else off
                alpha[i] = np.exp(-delta[i])
        _normalise(alpha, 0, k + 1)
        for g in range(begin, end - 1):
            step_costs(store, roads, near, costs, g, moved[g], (still[g], still[g + 1]), slot, cost)
            _advance(g - begin, g, near, emission, off, roads.rank, room)
        _backward(end - begin, begin, ptr, room)
        best = _best_last((end - begin - 1) * wide, delta, roads.rank, near, end - 1)
        for h in range(end - begin - 1, -1, -1):
            g = begin + h
            k = ptr[g + 1] - ptr[g]
            link = came[h * wide + best]
            if start <= g < commit:
                chosen[g] = ptr[g] + best if best < k else -1
                for i in range(k):
                    posterior[ptr[g] + i] = gamma[h * wide + i]
                off_posterior[g] = gamma[h * wide + k]
                before_off = h > 0 and link % BY_JUMP == ptr[g] - ptr[g - 1]
                linked[g] = h > 0 and best < k and link < BY_JUMP and not before_off
            if g == commit - 1:
                fixed = best
                for i in range(k + 1):
                    alpha[i] = alpha[h * wide + i]
            best = link % BY_JUMP
        if whole:
            fixed = -1
        start = commit


@fast_inner
def _normalise(values: Floats, a: int, b: int) -> None:
    total = 0.0
    for i in range(a, b):
        total += values[i]
    for i in range(a, b):
        values[i] = values[i] / total if total > 0.0 else 1.0 / (b - a)


@fast_inner
def _advance(
    h: int, g: int, near: Candidates, emission: Floats, off: float, rank: Wide, room: Scratch
) -> None:
    """One step forward of Viterbi (``delta``, ``came``) and of the forward recursion (``alpha``)."""
    ptr, edge, _ = near
    steps, delta, alpha, _, own, came, cost, _, _, _ = room
    k, m = ptr[g + 1] - ptr[g] + 1, ptr[g + 2] - ptr[g + 1] + 1
    wide = len(cost)
    at, a, b = h * wide * wide, h * wide, (h + 1) * wide
    for j in range(m):
        best, where, total = 1e300, 0, 0.0
        for i in range(k):
            c = cost[i, j]
            p = RARE if c == JUMP else LEFT if c == LEAVE else math.exp(-c)
            steps[at + i * m + j] = p
            total += alpha[a + i] * p
            through = delta[a + i] + c
            if through < best + 1e-9 and (
                through < best - 1e-9 or (i < k - 1 and rank[edge[ptr[g] + i]] < rank[edge[ptr[g] + where]])
            ):
                best, where = through, i
        here = emission[ptr[g + 1] + j] if j < m - 1 else off
        delta[b + j] = best + here
        jumped = where < k - 1 and j < m - 1 and cost[where, j] >= JUMP
        came[b + j] = where + BY_JUMP if jumped else where
        own[b + j] = math.exp(-here)
        alpha[b + j] = total * own[b + j]
    _normalise(alpha, b, b + m)


@fast_inner
def _backward(count: int, begin: int, ptr: Wide, room: Scratch) -> None:
    """Posteriors of all states of a block into ``gamma``."""
    steps, _, alpha, gamma, own, _, cost, beta, later, _ = room
    wide, m = len(cost), 0
    for i in range(len(beta)):
        beta[i] = 1.0
    for h in range(count - 1, -1, -1):
        a, k = h * wide, ptr[begin + h + 1] - ptr[begin + h] + 1
        if h < count - 1:
            top = 0.0
            for j in range(m):
                later[j] = beta[j] * own[(h + 1) * wide + j]
                top = max(top, later[j])
            scale = 1.0 / top if top > 0.0 else 1.0
            for i in range(k):
                total = 0.0
                for j in range(m):
                    total += steps[h * wide * wide + i * m + j] * later[j]
                beta[i] = total * scale
        for i in range(k):
            gamma[a + i] = alpha[a + i] * beta[i]
        _normalise(gamma, a, a + k)
        m = k


@fast_inner
def _best_last(a: int, delta: Floats, rank: Wide, near: Candidates, g: int) -> Any:
    ptr, edge, _ = near
    k = ptr[g + 1] - ptr[g]
    best, order = 0, 1 << 31
    for i in range(k + 1):
        turn = rank[edge[ptr[g] + i]] if i < k else 1 << 30
        old = delta[a + best]
        if delta[a + i] < old - 1e-9 or (delta[a + i] < old + 1e-9 and turn < order):
            best, order = i, turn
    return best

"""The hidden Markov model: steps between candidates, the likeliest sequence and every candidate's posterior.

States of a group are its candidates and, last, "off the roads".  Costs are negative logarithms of
probabilities.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fleetlog.roads.matchkernels.kernels.costs import (
    BY_JUMP,
    CHAIN_END,
    CHANGE,
    IDLE_CHANGE,
    JUMP,
    RARE,
    reach_of,
    step_costs,
)
from fleetlog.roads.matchkernels.kernels.distances import ensure

Floats = NDArray[np.float64]
Wide = NDArray[np.int64]
Index = NDArray[np.int32]
Flags = NDArray[np.bool_]


@njit(cache=True, error_model="numpy", fastmath=True)
def _first_missing(known: Floats, ptr: Wide, edge: Index, moved: Floats, a: int, b: int, beta: float) -> Any:
    """The first candidate of groups a to b whose reach is not stored, and the bound it needs;
    -1 where all are.
    """
    for g in range(a, b):
        need = max(reach_of(moved[g], beta), 20.0)
        for c in range(ptr[g], ptr[g + 1]):
            if known[edge[c]] < need:
                return g, c, need
    return b, -1, 0.0


@njit(cache=True, error_model="numpy", fastmath=True)
def ensure_all(
    store: Any,
    ptr: Wide,
    edge: Index,
    moved: Floats,
    a: int,
    b: int,
    beta: float,
    next_first: Index,
    next_edges: Index,
    length: Floats,
) -> Any:
    """The store, with what the steps of groups a to b need."""
    g, c, need = _first_missing(store[0], ptr, edge, moved, a, b, beta)
    while c >= 0:
        store = ensure(store, edge[c], 1.5 * need, next_first, next_edges, length)
        g, c, need = _first_missing(store[0], ptr, edge, moved, g, b, beta)
    return store


@njit(cache=True, error_model="numpy", fastmath=True)
def decode(
    store: Any,
    ptr: Wide,
    edge: Index,
    value: Floats,
    emission: Floats,
    rank: Wide,
    chain: Wide,
    moved: Floats,
    still: Flags,
    beta: float,
    back: float,
    turn: float,
    off: float,
    block: int,
    ahead: int,
    reverse: Index,
    next_first: Index,
    next_edges: Index,
    length: Floats,
) -> Any:
    """Likeliest state of every group, and every state's posterior.

    Works through blocks of groups and looks ``ahead`` beyond each, so memory does not grow with the track.
    Returns the store; (G,) the chosen candidate (row of ``edge``) or -1 off the roads; (C,) posteriors of the
    candidates; (G,) posteriors of being off; (G,) whether the step into a group is connected to the group
    before."""  # fmt: s"""
    groups = len(ptr) - 1
    chosen = np.full(groups, -1, np.int64)
    posterior = np.zeros(len(edge))
    off_posterior = np.zeros(groups)
    linked = np.zeros(groups, np.bool_)
    widest = 1
    for g in range(groups):
        widest = max(widest, ptr[g + 1] - ptr[g] + 1)
    slot = np.full(len(length), -1, np.int64)
    cost = np.empty((widest, widest))
    start = 0
    alpha0 = np.empty(widest)
    fixed = -1  # state of the group before the block, when the chain goes on
    while start < groups:
        begin = start - 1 if fixed >= 0 else start
        end = begin + 1
        while end < groups and chain[end] == chain[begin] and end - start < block + ahead:
            end += 1
        whole = end == groups or chain[end] != chain[begin]
        commit = end if whole else start + block
        store = ensure_all(store, ptr, edge, moved, begin, end - 1, beta, next_first, next_edges, length)
        reach_begin, reach_count, target, away = store[1], store[2], store[3], store[5]
        size = 0
        for g in range(begin, end - 1):
            size += (ptr[g + 1] - ptr[g] + 1) * (ptr[g + 2] - ptr[g + 1] + 1)
        steps = np.empty(size, np.float32)
        at = np.empty(end - begin + 1, np.int64)
        at[0] = 0
        states = np.empty(end - begin + 1, np.int64)
        states[0] = 0
        for g in range(begin, end):
            states[g - begin + 1] = states[g - begin] + ptr[g + 1] - ptr[g] + 1
        total = states[end - begin]
        delta, alpha, gamma, own = np.empty(total), np.empty(total), np.empty(total), np.ones(total)
        came = np.full(total, CHAIN_END, np.int64)
        k = ptr[begin + 1] - ptr[begin]
        for i in range(k + 1):
            if fixed >= 0:
                delta[i] = 0.0 if i == fixed else 1e18
                alpha[i] = alpha0[i]
            else:
                delta[i] = emission[ptr[begin] + i] if i < k else off
                alpha[i] = np.exp(-delta[i])
        _normalise(alpha, 0, k + 1)
        for g in range(begin, end - 1):
            turn_here = 0.5 * turn if still[g] or still[g + 1] else turn
            change = IDLE_CHANGE if still[g + 1] else CHANGE
            step_costs(
                reach_begin, reach_count, target, away, slot, ptr, edge, value, g, moved[g], beta, back,
                turn_here, change, reverse, length, cost,
            )  # fmt: skip
            _advance(
                g - begin, ptr, g, cost, emission, off, rank, edge, states, at, steps, delta, alpha, came, own
            )
        _backward(end - begin, states, at, steps, alpha, own, gamma, widest)
        best = _best_last(states, end - begin, delta, rank, edge, ptr, end - 1)
        for h in range(end - begin - 1, -1, -1):
            g = begin + h
            k = ptr[g + 1] - ptr[g]
            link = came[states[h] + best]
            if start <= g < commit:
                chosen[g] = ptr[g] + best if best < k else -1
                for i in range(k):
                    posterior[ptr[g] + i] = gamma[states[h] + i]
                off_posterior[g] = gamma[states[h] + k]
                before_off = h > 0 and link % BY_JUMP == ptr[g] - ptr[g - 1]
                linked[g] = h > 0 and best < k and link < BY_JUMP and not before_off
            if g == commit - 1:
                fixed = best
                for i in range(k + 1):
                    alpha0[i] = alpha[states[h] + i]
            best = link % BY_JUMP
        if whole:
            fixed = -1
        start = commit
    return store, chosen, posterior, off_posterior, linked


@njit(cache=True, error_model="numpy", fastmath=True)
def _normalise(values: Floats, a: int, b: int) -> None:
    total = 0.0
    for i in range(a, b):
        total += values[i]
    for i in range(a, b):
        values[i] = values[i] / total if total > 0.0 else 1.0 / (b - a)


@njit(cache=True, error_model="numpy", fastmath=True)
def _advance(
    h: int,
    ptr: Wide,
    g: int,
    cost: Floats,
    emission: Floats,
    off: float,
    rank: Wide,
    edge: Index,
    states: Wide,
    at: Wide,
    steps: Floats,
    delta: Floats,
    alpha: Floats,
    came: Wide,
    own: Floats,
) -> None:
    """One step forward of Viterbi (``delta``, ``came``) and of the forward recursion (``alpha``)."""
    k, m = ptr[g + 1] - ptr[g] + 1, ptr[g + 2] - ptr[g + 1] + 1
    a, b = states[h], states[h + 1]
    at[h + 1] = at[h] + k * m
    for j in range(m):
        best, where, total = 1e300, 0, 0.0
        for i in range(k):
            c = cost[i, j]
            p = RARE if c == JUMP else math.exp(-c)
            steps[at[h] + i * m + j] = p
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


@njit(cache=True, error_model="numpy", fastmath=True)
def _backward(
    count: int, states: Wide, at: Wide, steps: Floats, alpha: Floats, own: Floats, gamma: Floats, widest: int
) -> None:
    """Posteriors of all states of a block into ``gamma``."""
    beta, later = np.ones(widest), np.ones(widest)
    for h in range(count - 1, -1, -1):
        a, k = states[h], states[h + 1] - states[h]
        if h < count - 1:
            m = states[h + 2] - states[h + 1]
            top = 0.0
            for j in range(m):
                later[j] = beta[j] * own[states[h + 1] + j]
                top = max(top, later[j])
            scale = 1.0 / top if top > 0.0 else 1.0
            for i in range(k):
                total = 0.0
                for j in range(m):
                    total += steps[at[h] + i * m + j] * later[j]
                beta[i] = total * scale
        for i in range(k):
            gamma[a + i] = alpha[a + i] * beta[i]
        _normalise(gamma, a, a + k)


@njit(cache=True, error_model="numpy", fastmath=True)
def _best_last(states: Wide, count: int, delta: Floats, rank: Wide, edge: Index, ptr: Wide, g: int) -> Any:
    a, k = states[count - 1], ptr[g + 1] - ptr[g]
    best, order = 0, 1 << 31
    for i in range(k + 1):
        turn = rank[edge[ptr[g] + i]] if i < k else 1 << 30
        old = delta[a + best]
        if delta[a + i] < old - 1e-9 or (delta[a + i] < old + 1e-9 and turn < order):
            best, order = i, turn
    return best

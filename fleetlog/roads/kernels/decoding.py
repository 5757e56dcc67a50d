"""The hidden Markov model: steps between candidates, the likeliest sequence and every candidate's posterior.

States of a group are its candidates and, last, "off the roads".  Costs are negative logarithms of
probabilities.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from fleetlog.roads.kernels.costs import BY_JUMP, CHAIN_END, JUMP, RARE, reach_of, step_costs
from fleetlog.roads.kernels.distances import ensure
from fleetlog.roads.kernels.records import Candidates, Choice, Costs, Floats, Roads, Steps, Store, Wide


@njit(cache=True, error_model="numpy", fastmath=True)
def _first_missing(known: Floats, near: Candidates, moved: Floats, a: int, b: int, beta: float) -> Any:
    """The first group of a to b with an edge whose reach is not stored, that edge (-1: none), its bound."""
    for g in range(a, b):
        need = max(reach_of(moved[g], beta), 20.0)
        for c in range(near.ptr[g], near.ptr[g + 1]):
            if known[near.edge[c]] < need:
                return g, near.edge[c], need
    return b, -1, 0.0


@njit(cache=True, error_model="numpy", fastmath=True)
def ensure_all(
    store: Store, roads: Roads, near: Candidates, moved: Floats, a: int, b: int, beta: float
) -> Store:
    """The store, with what the steps of groups a to b need."""
    g, edge, need = _first_missing(store.known, near, moved, a, b, beta)
    while edge >= 0:
        store = ensure(store, roads, edge, 1.5 * need)
        g, edge, need = _first_missing(store.known, near, moved, g, b, beta)
    return store


@njit(cache=True, error_model="numpy", fastmath=True)
def decode(
    store: Store, roads: Roads, near: Candidates, emission: Floats, groups: Steps, costs: Costs
) -> tuple[Store, Choice]:
    """Likeliest state of every group, and every state's posterior; the store, which grows.

    Works through blocks of groups and looks ahead beyond each, so memory does not grow with the track.
    """
    ptr, edge, _ = near
    chain, moved, still = groups
    off = costs.off
    count = len(ptr) - 1
    chosen = np.full(count, -1, np.int64)
    posterior = np.zeros(len(edge))
    off_posterior = np.zeros(count)
    linked = np.zeros(count, np.bool_)
    widest = np.diff(ptr).max() + 1
    slot = np.full(len(roads.length), -1, np.int64)
    cost = np.empty((widest, widest))
    start = 0
    alpha0 = np.empty(widest)
    fixed = -1  # state of the group before the block, when the chain goes on
    while start < count:
        begin = start - 1 if fixed >= 0 else start
        end = begin + 1
        while end < count and chain[end] == chain[begin] and end - start < costs.block + costs.ahead:
            end += 1
        whole = end == count or chain[end] != chain[begin]
        commit = end if whole else start + costs.block
        store = ensure_all(store, roads, near, moved, begin, end - 1, costs.beta)
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
            step_costs(store, roads, near, costs, g, moved[g], (still[g], still[g + 1]), slot, cost)
            _advance(
                g - begin,
                g,
                near,
                cost,
                emission,
                off,
                roads.rank,
                states,
                at,
                steps,
                delta,
                alpha,
                came,
                own,
            )
        _backward(end - begin, states, at, steps, alpha, own, gamma, widest)
        best = _best_last(states, end - begin, delta, roads.rank, near, end - 1)
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
    return store, Choice(chosen, posterior, off_posterior, linked)


@njit(cache=True, error_model="numpy", fastmath=True)
def _normalise(values: Floats, a: int, b: int) -> None:
    total = 0.0
    for i in range(a, b):
        total += values[i]
    for i in range(a, b):
        values[i] = values[i] / total if total > 0.0 else 1.0 / (b - a)


@njit(cache=True, error_model="numpy", fastmath=True, inline="always")
def _advance(
    h: int, g: int, near: Candidates, cost: Floats, emission: Floats, off: float, rank: Wide, states: Wide,
    at: Wide, steps: Floats, delta: Floats, alpha: Floats, came: Wide, own: Floats,
) -> None:  # fmt: skip
    """One step forward of Viterbi (``delta``, ``came``) and of the forward recursion (``alpha``)."""
    ptr, edge, _ = near
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
def _best_last(states: Wide, count: int, delta: Floats, rank: Wide, near: Candidates, g: int) -> Any:
    ptr, edge, _ = near
    a, k = states[count - 1], ptr[g + 1] - ptr[g]
    best, order = 0, 1 << 31
    for i in range(k + 1):
        turn = rank[edge[ptr[g] + i]] if i < k else 1 << 30
        old = delta[a + best]
        if delta[a + i] < old - 1e-9 or (delta[a + i] < old + 1e-9 and turn < order):
            best, order = i, turn
    return best

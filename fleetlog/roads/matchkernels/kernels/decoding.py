"""The hidden Markov model: steps between candidates, the likeliest sequence and every candidate's posterior.

States of a group are its candidates and, last, "off the roads".  Costs are negative logarithms of probabilities.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from fleetlog.roads.matchkernels.kernels.distances import ensure

JUMP = 12.0
"""Cost of two groups on roads that no path connects: the chain starts anew."""
LEAVE = 4.0
"""Cost of leaving the roads, and of coming back."""
CHAIN_END = -2
BY_JUMP = 1 << 20


@njit(cache=True)
def emission_costs(ptr, edge, value, direction, sharpness, axis, sigma, weight):
    """Cost of every candidate: lateral distance (Gaussian, beyond 3 sigma linear), direction of motion and the heading's axis."""
    out = np.empty(len(edge))
    for g in range(len(ptr) - 1):
        for c in range(ptr[g], ptr[g + 1]):
            z = abs(value[1, c]) / sigma
            cost = 0.5 * z * z if z < 3.0 else 3.0 * z - 4.5
            ux, uy = value[2, c], value[3, c]
            cost += sharpness[g] * (1.0 - (ux * direction[0, g] + uy * direction[1, g]))
            strength = np.hypot(axis[0, g], axis[1, g])
            if strength > 0.0:
                cost += strength - (axis[0, g] * (ux * ux - uy * uy) + axis[1, g] * 2.0 * ux * uy)
            out[c] = weight * cost
    return out


@njit(cache=True)
def step_costs(
    store, slot, ptr, edge, value, g, moved, beta, back, turn, reverse, next_first, next_edges, length, cost
):
    """Cost of every step from the candidates of group g to those of g + 1 into ``cost`` (K + 1, L + 1); the store, grown.

    A step costs |network distance - travelled distance| / beta, a turn in mid edge ``turn`` more; steps that the network
    does not allow cost ``JUMP``.  ``back`` is how far noise may move a truck against its edge.
    """
    a, b, c = ptr[g], ptr[g + 1], ptr[g + 2]
    k, m = b - a, c - b
    scale = np.hypot(beta, 0.1 * moved)
    reach = moved + JUMP * scale
    for j in range(m):
        slot[edge[b + j]] = j
    for i in range(k):
        for j in range(m):
            cost[i, j] = JUMP
        cost[i, m] = LEAVE
        e, s = edge[a + i], value[0, a + i]
        left = length[e] - s
        store = ensure(store, e, max(reach, 20.0), next_first, next_edges, length)
        for q in range(store[1][e], store[1][e] + store[2][e]):
            if store[5][q] + left > reach:
                break
            j = slot[store[3][q]]
            if j >= 0:
                d = store[5][q] + left + value[0, b + j]
                cost[i, j] = min(cost[i, j], abs(d - moved) / scale)
        j = slot[e]
        if j >= 0:
            d = value[0, b + j] - s
            if d >= -back:
                cost[i, j] = min(cost[i, j], abs(d - moved) / scale)
        if reverse[e] >= 0 and slot[reverse[e]] >= 0:
            j = slot[reverse[e]]
            d = abs(left - value[0, b + j])
            cost[i, j] = min(cost[i, j], turn + abs(d - moved) / scale)
    for j in range(m):
        cost[k, j] = LEAVE
        slot[edge[b + j]] = -1
    cost[k, m] = 0.0
    return store


@njit(cache=True)
def decode(
    store, ptr, edge, value, emission, rank, chain, moved, still, beta, back, turn, off, block, ahead,
    reverse, next_first, next_edges, length,
):  # fmt: skip
    """Likeliest state of every group, and every state's posterior.

    Works through blocks of groups and looks ``ahead`` beyond each, so memory does not grow with the track.
    Returns the store; (G,) the chosen candidate (row of ``edge``) or -1 off the roads; (C,) posteriors of the candidates;
    (G,) posteriors of being off; (G,) whether the step into a group is connected to the group before.
    """  # fmt: skip
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
        delta, alpha, gamma = np.empty(total), np.empty(total), np.ones(total)
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
            turn_here = 0.3 * turn if still[g] or still[g + 1] else turn
            store = step_costs(
                store, slot, ptr, edge, value, g, moved[g], beta, back, turn_here, reverse, next_first, next_edges, length, cost
            )  # fmt: skip
            _advance(
                g - begin, ptr, g, cost, emission, off, rank, edge, states, at, steps, delta, alpha, came
            )
        _backward(end - begin, states, at, steps, alpha, gamma)
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


@njit(cache=True)
def _normalise(values, a, b):
    total = 0.0
    for i in range(a, b):
        total += values[i]
    for i in range(a, b):
        values[i] = values[i] / total if total > 0.0 else 1.0 / (b - a)


@njit(cache=True)
def _advance(h, ptr, g, cost, emission, off, rank, edge, states, at, steps, delta, alpha, came):
    """One step forward of Viterbi (``delta``, ``came``) and of the forward recursion (``alpha``)."""
    k, m = ptr[g + 1] - ptr[g] + 1, ptr[g + 2] - ptr[g + 1] + 1
    a, b = states[h], states[h + 1]
    at[h + 1] = at[h] + k * m
    for j in range(m):
        best, where, order, total = 1e300, 0, -1, 0.0
        for i in range(k):
            c = cost[i, j]
            p = np.exp(-c)
            steps[at[h] + i * m + j] = p
            total += alpha[a + i] * p
            through = delta[a + i] + c
            turn = rank[edge[ptr[g] + i]] if i < k - 1 else 1 << 30
            if through < best - 1e-9 or (through < best + 1e-9 and turn < order):
                best, where, order = through, i, turn
        own = emission[ptr[g + 1] + j] if j < m - 1 else off
        delta[b + j] = best + own
        jumped = where < k - 1 and j < m - 1 and cost[where, j] >= JUMP
        came[b + j] = where + BY_JUMP if jumped else where
        alpha[b + j] = total * np.exp(-own)
    _normalise(alpha, b, b + m)


@njit(cache=True)
def _backward(count, states, at, steps, alpha, gamma):
    """Posteriors of all states of a block into ``gamma``."""
    beta = np.ones(states[count] - states[count - 1])
    for h in range(count - 1, -1, -1):
        a, k = states[h], states[h + 1] - states[h]
        if h < count - 1:
            m = states[h + 2] - states[h + 1]
            before = np.empty(k)
            for i in range(k):
                total = 0.0
                for j in range(m):
                    total += steps[at[h] + i * m + j] * beta[j]
                before[i] = total
            beta = before
        for i in range(k):
            gamma[a + i] = alpha[a + i] * beta[i]
        _normalise(gamma, a, a + k)
        # what the group before needs: the likelihood of this group and all after it, up to a factor
        if h > 0:
            top = 0.0
            for i in range(k):
                beta[i] *= _own(alpha, steps, states, at, h, i)
                top = max(top, beta[i])
            for i in range(k):
                beta[i] = beta[i] / top if top > 0.0 else 1.0


@njit(cache=True)
def _own(alpha, steps, states, at, h, j):
    """Relative emission likelihood of state j of step h: its forward probability over what flowed into it."""
    a, k = states[h - 1], states[h] - states[h - 1]
    m = states[h + 1] - states[h]
    total = 0.0
    for i in range(k):
        total += alpha[a + i] * steps[at[h - 1] + i * m + j]
    return alpha[states[h] + j] / total if total > 0.0 else 0.0


@njit(cache=True)
def _best_last(states, count, delta, rank, edge, ptr, g):
    a, k = states[count - 1], ptr[g + 1] - ptr[g]
    best, order = 0, 1 << 31
    for i in range(k + 1):
        turn = rank[edge[ptr[g] + i]] if i < k else 1 << 30
        old = delta[a + best]
        if delta[a + i] < old - 1e-9 or (delta[a + i] < old + 1e-9 and turn < order):
            best, order = i, turn
    return best

"""The hidden Markov model: what it charges, the likeliest sequence and every candidate's posterior.

States of a group are its candidates and, last, "off the roads".  Costs are negative logarithms of
probabilities."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fleetlog.compiling import fast_inner, fast_outer
from fleetlog.core.arrays import Floats, Index
from fleetlog.roads.kernels.distances import ensure
from fleetlog.roads.kernels.records import Candidates, Choice, Costs, Groups, Roads, Store, Wide

JUMP = 12.0  # cost of two groups on roads that no path connects: the chain starts anew
RARE = np.exp(-JUMP)
LEAVE = 4.0  # cost of leaving the roads, and of coming back
LEFT = np.exp(-LEAVE)
SLACK = 5.0  # a way this much longer than what was travelled is tried: two corners, taken short [m]
CHANGE = 0.5  # cost of entering another edge: of two routes that fit alike the plainer one
IDLE_CHANGE = 2.0  # cost of entering one only to stand there: a truck at a node has not left its edge
CHAIN_END = -2
BY_JUMP = 1 << 20


@fast_outer
def emission_costs(
    near: Candidates, direction: Floats, sharpness: Floats, axis: Floats, reverse: Index, sigma: float,
    weight: float, out: Floats,
) -> None:  # fmt: skip
    """Cost of every candidate into ``out``: lateral distance, direction, axis of the log's heading. That of
    the distance is Gaussian, linear beyond 3 sigma. A motion plainly against a one-way road counts threefold:
    it is no noise about the other direction."""
    ptr, edge, value = near
    for g in range(len(ptr) - 1):
        strength = math.sqrt(axis[0, g] ** 2 + axis[1, g] ** 2)
        for c in range(ptr[g], ptr[g + 1]):
            z = abs(value[1, c]) / sigma
            cost = 0.5 * z * z if z < 3.0 else 3.0 * z - 4.5
            ux, uy = value[2, c], value[3, c]
            along = ux * direction[0, g] + uy * direction[1, g]
            strict = 3.0 if along < -0.5 and reverse[edge[c]] < 0 else 1.0
            cost += strict * sharpness[g] * (1.0 - along)
            if strength > 0.0:
                cost += strength - (axis[0, g] * (ux * ux - uy * uy) + axis[1, g] * 2.0 * ux * uy)
            out[c] = weight * cost


@fast_inner
def mismatch(d: float, moved: float, scale: float) -> Any:
    """Cost of a step of network distance d: exponential, beyond four scales of slow growth (corners cut)."""
    z = abs(d - moved) / scale
    return z if z < 4.0 else 4.0 + 2.0 * math.log(0.25 * z)


@fast_inner
def step_costs(
    store: Store, roads: Roads, near: Candidates, costs: Costs, g: int, moved: float,
    standing: tuple[bool, bool], slot: Wide, cost: Floats,
) -> None:  # fmt: skip
    """Cost of every step from the candidates of group g to those of g + 1 into ``cost`` (K + 1, L + 1).

    A step costs about |network distance - travelled distance| / beta, more by a turn in mid edge and where
    it enters another edge; steps that the network does not allow cost ``JUMP``.  ``standing`` are the two
    groups."""
    ptr, edge, value = near
    length, reverse, beta = roads.length, roads.reverse, costs.beta
    begin, count, target, away = store.begin, store.reached, store.target, store.away
    turn = 0.5 * costs.turn if standing[0] or standing[1] else costs.turn
    change = IDLE_CHANGE if standing[1] else CHANGE
    a, b, c = ptr[g], ptr[g + 1], ptr[g + 2]
    k, m = b - a, c - b
    scale = math.sqrt(beta * beta + 0.01 * moved * moved)
    reach = reach_of(moved, beta)
    for j in range(m):
        slot[edge[b + j]] = j
    for i in range(k):
        for j in range(m):
            cost[i, j] = JUMP
        cost[i, m] = LEAVE
        e, s = edge[a + i], value[0, a + i]
        left = length[e] - s
        for q in range(begin[e], begin[e] + count[e]):
            if away[q] + left > reach:
                break
            j = slot[target[q]]
            if j >= 0:
                d = away[q] + left + value[0, b + j]
                cost[i, j] = min(cost[i, j], mismatch(d, moved, scale) + change)
        j = slot[e]
        if j >= 0:
            d = value[0, b + j] - s
            if d >= -costs.back:
                cost[i, j] = min(cost[i, j], mismatch(d, moved, scale))
        if reverse[e] >= 0 and slot[reverse[e]] >= 0:
            j = slot[reverse[e]]
            d = abs(left - value[0, b + j])
            cost[i, j] = min(cost[i, j], turn + mismatch(d, moved, scale) + change)
    for j in range(m):
        cost[k, j] = LEAVE
        slot[edge[b + j]] = -1
    cost[k, m] = 0.0


@fast_inner
def reach_of(moved: float, beta: float) -> Any:
    """How long a way is tried for a step of travelled distance ``moved`` [m]."""
    return moved + max(JUMP * math.sqrt(beta * beta + 0.01 * moved * moved), SLACK)


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
    """Likeliest state of every group, and every state's posterior, into ``out``. Works through blocks of
    groups and looks ahead beyond each, so memory does not grow with the track."""
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
            _ahead(g - begin, g, near, emission, off, roads.rank, room)
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
def _ahead(h: int, g: int, near: Candidates, emission: Floats, off: float, rank: Wide, room: Scratch) -> None:
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

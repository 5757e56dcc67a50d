"""The hidden Markov model: what it believes, the likeliest sequence and every state's posterior.

States of a group are its candidates and, last, "off the roads": those of group g begin at ptr[g] + g.
Chances are probabilities but for a common factor; where a text says cost, it is a chance's negative
logarithm."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fleetlog.compiling import fast_inner, fast_outer
from fleetlog.core.arrays import Floats, Index
from fleetlog.roads.kernels.distances import ensure
from fleetlog.roads.kernels.records import Candidates, Choice, Costs, Groups, Roads, Store, Wide

JUMP = 12.0  # cost of two groups on roads that no path connects: the chain starts anew
RARE = float(np.float32(np.exp(-JUMP)))
LEFT = float(np.exp(-4.0))  # chance of leaving the roads, and of coming back
SLACK = 5.0  # a way this much longer than what was travelled is tried: two corners, taken short [m]
ENTER = float(np.exp(-0.5))  # chance of entering another edge: of two routes that fit alike the plainer one
IDLE_ENTER = float(
    np.exp(-2.0)
)  # of entering one only to stand there: a truck at a node has not left its edge
OVER = 1.0 + 1e-9  # chances that are nearer to each other are equal
Step = tuple[
    float, float, float, float, float
]  # travelled distance, its scale, reach; chances: entering, turning
FAR = 16.0 * float(np.exp(-4.0))
CHAIN_END = -2


@fast_outer
def emission(
    near: Candidates, direction: Floats, sharpness: Floats, axis: Floats, reverse: Index, sigma: float,
    weight: float, off: float, out: Floats,
) -> None:  # fmt: skip
    """Chance of every state into ``out``: lateral distance, direction, axis of the log's heading; ``off`` is
    that of being off the roads. The distance is Gaussian, exponential beyond 3 sigma. A motion plainly
    against a one-way road counts threefold: it is no noise about the other direction."""
    ptr, edge, value = near
    for g in range(len(ptr) - 1):
        dx, dy, sharp, ax, ay = direction[0, g], direction[1, g], sharpness[g], axis[0, g], axis[1, g]
        strength = math.sqrt(ax * ax + ay * ay)
        for c in range(ptr[g], ptr[g + 1]):
            z, ux, uy = abs(value[1, c]) / sigma, value[2, c], value[3, c]
            along = ux * dx + uy * dy
            strict = 3.0 if along < -0.5 and reverse[edge[c]] < 0 else 1.0
            cost = (0.5 * z * z if z < 3.0 else 3.0 * z - 4.5) + strict * sharp * (1.0 - along)
            cost += strength - ax * (ux * ux - uy * uy) - ay * 2.0 * ux * uy
            out[c + g] = math.exp(-weight * cost)
        out[ptr[g + 1] + g] = off


@fast_inner
def _fit(d: float, moved: float, scale: float) -> Any:
    """Chance of a step of network distance d: exponential, beyond four scales of slow decay (corners cut)."""
    z = abs(d - moved) / scale
    return math.exp(-z) if z < 4.0 else FAR / (z * z)


@fast_inner
def _links(
    store: Store,
    roads: Roads,
    near: Candidates,
    back: float,
    step: Step,
    c: int,
    b: int,
    slot: Wide,
    row: Floats,
) -> None:
    """Chance of every step from candidate c to those from b on into ``row``, where it is more than is there:
    exp(-|network distance - travelled distance| / scale), less by a turn in mid edge and where it enters
    another edge."""
    e, s, value = near.edge[c], near.value[0, c], near.value
    moved, scale, reach, enter, turn = step
    left, first = roads.length[e] - s, store.begin[e]
    for q in range(first, first + store.reached[e]):
        away = store.away[q] + left
        if away > reach:
            break
        j = slot[store.target[q]]
        if j >= 0:
            row[j] = max(row[j], _fit(away + value[0, b + j], moved, scale) * enter)
    j = slot[e]
    if j >= 0 and value[0, b + j] - s >= -back:
        row[j] = max(row[j], _fit(value[0, b + j] - s, moved, scale))
    e = roads.reverse[e]
    if e >= 0 and slot[e] >= 0:
        j = slot[e]
        row[j] = max(row[j], _fit(abs(left - value[0, b + j]), moved, scale) * turn)


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

    steps: NDArray[np.float32]  # (B W W,) chances of steps
    alpha: Floats  # (B W,) chance of a state given all groups up to its own
    came: Wide  # (B W,) state before on the likeliest way to a state
    delta: Floats  # (W,) chance of that way, as the next four of the group in hand
    ahead: Floats
    total: Floats
    row: Floats
    later: Floats
    slot: Wide  # (E,) state of an edge, -1


def scratch(near: Candidates, edges: int) -> Scratch:
    """Room for decoding."""
    widest = int(np.diff(near.ptr).max()) + 1
    groups = min(len(near.ptr), BLOCK + AHEAD + 1)
    states = np.empty(groups * widest), np.empty(groups * widest, np.int64)
    steps, slot = np.empty(groups * widest * widest, np.float32), np.full(edges, -1, np.int64)
    return Scratch(steps, *states, *np.zeros((5, widest)), slot)


@fast_outer
def decode(
    store: Store, roads: Roads, near: Candidates, own: Floats, groups: Groups, costs: Costs, out: Choice,
    room: Scratch,
) -> None:  # fmt: skip
    """Likeliest state of every group, and every state's posterior, into ``out``; ``own`` are the states'
    chances by themselves. Works through blocks of groups and looks ahead beyond each, so memory does not
    grow with the track."""
    ptr, chain, rank, edge = near.ptr, groups.chain, roads.rank, near.edge
    chosen, linked, alpha, came, delta = out.chosen, out.linked, room.alpha, room.came, room.delta
    wide, count = len(delta), len(ptr) - 1
    start = 0
    fixed = -1  # state of the group before the block, when the chain goes on; its alpha is kept
    while start < count:
        begin = start - 1 if fixed >= 0 else start
        end = begin + 1
        while end < count and chain[end] == chain[begin] and end - start < BLOCK + AHEAD:
            end += 1
        whole = end == count or chain[end] != chain[begin]
        commit = end if whole else start + BLOCK
        first = ptr[begin] + begin
        for i in range(ptr[begin + 1] + begin - first + 1):
            came[i] = CHAIN_END
            delta[i] = 1.0 if i == fixed else 0.0
            if fixed < 0:
                delta[i] = alpha[i] = own[first + i]
        for g in range(begin, end - 1):
            _ahead(store, roads, near, own, groups, costs, g, g - begin, room)
        _backward(begin, start, end, ptr, own, out.posterior, room)
        k = ptr[end] - ptr[end - 1]
        best = k
        for i in range(k):
            if _better(delta[i], delta[best], i, best, k, ptr[end - 1], edge, rank):
                best = i
        for h in range(end - begin - 1, -1, -1):
            g = begin + h
            k = ptr[g + 1] - ptr[g]
            link = came[h * wide + best]
            if start <= g < commit:
                chosen[g] = ptr[g] + best if best < k else -1
                on = h > 0 and best < k and link < ptr[g] - ptr[g - 1]
                linked[g] = on and room.steps[((h - 1) * wide + link) * wide + best] > RARE
            if g == commit - 1:
                fixed = best
                for i in range(k + 1):
                    alpha[i] = alpha[h * wide + i]
            best = link
        if whole:
            fixed = -1
        start = commit


@fast_inner
def _better(new: float, old: float, i: int, best: int, k: int, a: int, edge: Index, rank: Wide) -> Any:
    """Whether state i of k and one is likelier than ``best``, or as likely and first by name."""
    if new > old * OVER:
        return True
    return new * OVER > old and i < k and (best == k or rank[edge[a + i]] < rank[edge[a + best]])


@fast_inner
def _ahead(
    store: Store, roads: Roads, near: Candidates, own: Floats, groups: Groups, costs: Costs, g: int, h: int,
    room: Scratch,
) -> None:  # fmt: skip
    """One step forward, from group g to the next, of Viterbi's algorithm and of the forward recursion."""
    ptr, edge, rank = near.ptr, near.edge, roads.rank
    steps, alpha, came, delta, ahead, total, row, _, slot = room
    a, b, c = ptr[g], ptr[g + 1], ptr[g + 2]
    k, m, wide = b - a, c - b, len(delta)
    moved, beta, still = groups.moved[g], costs.beta, groups.still
    enter = IDLE_ENTER if still[g + 1] else ENTER
    turn = enter * math.exp(-0.5 * costs.turn if still[g] or still[g + 1] else -costs.turn)
    step = moved, math.sqrt(beta * beta + 0.01 * moved * moved), reach_of(moved, beta), enter, turn
    for j in range(m + 1):
        ahead[j] = total[j] = 0.0
        if j < m:
            slot[edge[b + j]] = j
    for i in range(k + 1):
        for j in range(m):
            row[j] = RARE if i < k else LEFT
        row[m] = LEFT if i < k else 1.0
        if i < k:
            _links(store, roads, near, costs.back, step, a + i, b, slot, row)
        at, so_far, till_now = (h * wide + i) * wide, delta[i], alpha[h * wide + i]
        for j in range(m + 1):
            steps[at + j] = row[j]
            total[j] += till_now * row[j]
        for j in range(m + 1):
            through, before = so_far * row[j], (h + 1) * wide + j
            if through * OVER > ahead[j] and _better(through, ahead[j], i, came[before], k, a, edge, rank):
                ahead[j], came[before] = through, i
    likeliest = all_of = 0.0
    for j in range(m + 1):
        here = own[b + g + 1 + j]
        ahead[j] *= here
        total[j] *= here
        likeliest = max(likeliest, ahead[j])
        all_of += total[j]
    for j in range(m + 1):
        delta[j] = ahead[j] / likeliest
        alpha[(h + 1) * wide + j] = total[j] / all_of
    for j in range(m):
        slot[edge[b + j]] = -1


@fast_inner
def _backward(
    begin: int, start: int, end: int, ptr: Wide, own: Floats, posterior: Floats, room: Scratch
) -> None:
    """Posteriors of all states of a block."""
    steps, alpha, later, row = room.steps, room.alpha, room.later, room.row
    wide, m = len(later), 0
    for g in range(end - 1, begin - 1, -1):
        a, first, k = (g - begin) * wide, ptr[g] + g, ptr[g + 1] - ptr[g] + 1
        top = all_of = 0.0
        for i in range(k):
            beta = 0.0 if m else 1.0
            for j in range(m):
                beta += steps[(a + i) * wide + j] * later[j]
            row[i] = beta * own[first + i]
            top = max(top, row[i])
            all_of += alpha[a + i] * beta
            if g >= start:
                posterior[first + i] = alpha[a + i] * beta
        for i in range(k):
            later[i] = row[i] / top
            if g >= start:
                posterior[first + i] /= all_of
        m = k

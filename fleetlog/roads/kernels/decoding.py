"""The hidden Markov model: what it believes, the likeliest sequence and every state's posterior.

States of a group are its candidates and, last, "off the roads": those of group g begin at ptr[g] + g.
Chances are probabilities but for a common factor; a cost is the negative logarithm of a chance."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fleetlog.compiling import fast_inner, fast_outer
from fleetlog.core.arrays import Floats, Index, Mask
from fleetlog.roads.kernels.distances import ensure
from fleetlog.roads.kernels.records import Candidates, Choice, Groups, Roads, Store, Wide

JUMP = 12.0  # cost of two groups on roads that no path connects: the chain starts anew
RARE = float(np.float32(np.exp(-JUMP)))
LEFT = float(np.exp(-4.0))  # chance of leaving the roads, and of coming back
SLACK = 5.0  # a way this much longer than what was travelled is tried: two corners, taken short [m]
ENTER = float(np.exp(-0.5))  # chance of entering another edge: of two routes that fit alike the plainer one
# Of entering one only to stand there: a truck at a node has not left its edge.
IDLE_ENTER = float(np.exp(-2.0))
OVER = 1.0 + 1e-9  # chances that are nearer to each other are equal
Step = tuple[float, float, float, float, float]
"""Distance travelled, its spread, how far a way is tried [m]; chances of entering an edge and of turning."""
FAR = 16.0 * float(np.exp(-4.0))
BLOCK, AHEAD = 1000, 60  # groups that are decided together, and how far beyond them the model looks


@fast_outer
def emission(
    near: Candidates, direction: Floats, sharpness: Floats, axis: Floats, reverse: Index, sigma: float,
    weight: float, off: float, out: Floats,
) -> None:  # fmt: skip
    """Chance of every state into ``out``: lateral distance, direction, axis of the log's heading; ``off`` is
    that of being off the roads. The distance is Gaussian, exponential beyond 3 sigma. A motion plainly
    against a one-way road counts threefold: it is no noise about the other direction."""
    ptr = near.ptr
    for g in range(len(ptr) - 1):
        dx, dy, sharp, ax, ay = direction[0, g], direction[1, g], sharpness[g], axis[0, g], axis[1, g]
        strength = math.sqrt(ax * ax + ay * ay)
        for c in range(ptr[g], ptr[g + 1]):
            z, ux, uy = abs(near.lateral[c]) / sigma, near.ux[c], near.uy[c]
            along = ux * dx + uy * dy
            strict = 3.0 if along < -0.5 and reverse[near.edge[c]] < 0 else 1.0
            cost = (0.5 * z * z if z < 3.0 else 3.0 * z - 4.5) + strict * sharp * (1.0 - along)
            cost += strength - ax * (ux * ux - uy * uy) - ay * 2.0 * ux * uy
            out[c + g] = math.exp(-weight * cost)
        out[ptr[g + 1] + g] = off


@fast_inner
def _fit(d: float, moved: float, scale: float) -> Any:
    """Chance of a step of network distance d: exponential, beyond four scales of slow decay (corners cut)."""
    z = abs(d - moved) / scale
    return math.exp(-z) if z < 4.0 else FAR / (z * z)


class Model(NamedTuple):
    """What a step from group to group depends on: arrays of the records, but not the records themselves, for
    an array less is a hundredth less to compile."""

    length: Floats
    reverse: Index
    rank: Wide
    begin: Wide
    reached: Wide
    target: Index
    away: Floats
    ptr: Wide
    edge: Index
    offset: Floats
    own: Floats  # (S,) chance of every state by itself
    moved: Floats
    still: Mask
    beta: float  # spread of steps [m]
    back: float  # how far noise moves a truck against its edge [m]
    turn: float  # cost of a turn in mid edge


@fast_inner
def _links(x: Model, step: Step, c: int, b: int, slot: Wide, row: Floats) -> None:
    """Chance of every step from candidate c to those from b on into ``row``, where it is more than is there:
    exp(-|network distance - travelled distance| / scale), less by a turn in mid edge or into another edge."""
    e, s = x.edge[c], x.offset[c]
    moved, scale, reach, enter, turn = step
    left, first = x.length[e] - s, x.begin[e]
    for q in range(first, first + x.reached[e]):
        away = x.away[q] + left
        if away > reach:
            break
        j = slot[x.target[q]]
        if j >= 0:
            row[j] = max(row[j], _fit(away + x.offset[b + j], moved, scale) * enter)
    j = slot[e]
    if j >= 0 and x.offset[b + j] - s >= -x.back:
        row[j] = max(row[j], _fit(x.offset[b + j] - s, moved, scale))
    e = x.reverse[e]
    if e >= 0 and slot[e] >= 0:
        j = slot[e]
        row[j] = max(row[j], _fit(abs(left - x.offset[b + j]), moved, scale) * turn)


@fast_inner
def reach_of(moved: float, beta: float) -> Any:
    """How long a way is tried for a step of travelled distance ``moved`` [m]."""
    return moved + max(JUMP * math.sqrt(beta * beta + 0.01 * moved * moved), SLACK)


@fast_outer
def ensure_all(
    store: Store, roads: Roads, ptr: Wide, edge: Index, chain: Wide, moved: Floats, beta: float, begin: int
) -> Any:
    """Store what the steps from group ``begin`` on need; the first group for which there is no room."""
    for g in range(begin, len(chain) - 1):
        if chain[g + 1] != chain[g]:
            continue
        need = max(reach_of(moved[g], beta), 20.0)
        for c in range(ptr[g], ptr[g + 1]):
            e = edge[c]
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


def decode(
    roads: Roads, store: Store, near: Candidates, own: Floats, groups: Groups, *numbers: float
) -> Choice:
    """Likeliest state of every group, and every state's posterior; ``numbers`` are those of :class:`Model`.
    Works through blocks of groups and looks ahead beyond each, so memory does not grow with the track."""
    known = store.begin, store.reached, store.target, store.away
    of_roads, of_groups = (roads.length, roads.reverse, roads.rank), (groups.moved, groups.still)
    x = Model._make([*of_roads, *known, near.ptr, near.edge, near.offset, own, *of_groups, *numbers])
    count, widest, start = len(groups.t), int(np.diff(near.ptr).max()) + 1, 0
    out = Choice(np.full(count, -1), np.empty(len(own)), np.zeros(count, np.bool_))
    states = min(count + 1, BLOCK + AHEAD + 1) * widest
    rows = np.empty(states), np.empty(states, np.int64)
    steps, slot = np.empty(states * widest, np.float32), np.full(len(x.length), -1, np.int64)
    room = Scratch._make([steps, *rows, *np.zeros((5, widest)), slot])
    for end in (*(np.flatnonzero(np.diff(groups.chain)) + 1).tolist(), count):
        fixed = -1
        while start < end:
            seen = min(start + BLOCK + AHEAD, end)
            commit = end if seen == end else start + BLOCK
            fixed = _block(x, start, commit, seen, fixed, out, room)
            start = commit
    return out


@fast_outer
def _block(x: Model, start: int, commit: int, end: int, fixed: int, out: Choice, room: Scratch) -> Any:
    """Decide groups ``start`` to ``commit`` with a look at those up to ``end``; returns the last one's state.
    ``fixed`` is that of the group before, whose alpha is kept, or -1 where a chain begins."""
    ptr, alpha, came, delta = x.ptr, room.alpha, room.came, room.delta
    wide = len(delta)
    begin = start - 1 if fixed >= 0 else start
    first = ptr[begin] + begin
    for i in range(ptr[begin + 1] + begin - first + 1):
        delta[i] = 1.0 if i == fixed else 0.0
        if fixed < 0:
            delta[i] = alpha[i] = x.own[first + i]
    for g in range(begin, end - 1):
        _ahead(x, g, g - begin, room)
    _backward(x, begin, start, end, out.posterior, room)
    k = ptr[end] - ptr[end - 1]
    best = k
    for i in range(k):
        if _better(x, delta[i], delta[best], i, best, ptr[end - 1], k):
            best = i
    for g in range(end - 1, start - 1, -1):
        h, k = g - begin, ptr[g + 1] - ptr[g]
        if g == commit - 1:
            fixed = best
            for i in range(k + 1):
                alpha[i] = alpha[h * wide + i]
        before = came[h * wide + best]
        if g < commit:
            out.chosen[g] = ptr[g] + best if best < k else -1
            on = h > 0 and best < k and before < ptr[g] - ptr[g - 1]
            out.linked[g] = on and room.steps[((h - 1) * wide + before) * wide + best] > RARE
        best = before
    return fixed


@fast_inner
def _better(x: Model, new: float, old: float, i: int, best: int, a: int, k: int) -> Any:
    """Whether state i of k and one is likelier than ``best``, or as likely and first by the edge's name."""
    if new > old * OVER:
        return True
    return new * OVER > old and i < k and (best == k or x.rank[x.edge[a + i]] < x.rank[x.edge[a + best]])


@fast_inner
def _ahead(x: Model, g: int, h: int, room: Scratch) -> None:
    """One step forward, from group g to the next, of Viterbi's algorithm and of the forward recursion."""
    steps, alpha, came, delta, ahead, total, row, _, slot = room
    a, b, c = x.ptr[g], x.ptr[g + 1], x.ptr[g + 2]
    k, m, wide = b - a, c - b, len(delta)
    moved, beta = x.moved[g], x.beta
    enter = IDLE_ENTER if x.still[g + 1] else ENTER
    turn = enter * math.exp(-0.5 * x.turn if x.still[g] or x.still[g + 1] else -x.turn)
    step = moved, math.sqrt(beta * beta + 0.01 * moved * moved), reach_of(moved, beta), enter, turn
    for j in range(m + 1):
        ahead[j] = total[j] = 0.0
        if j < m:
            slot[x.edge[b + j]] = j
    for i in range(k + 1):
        for j in range(m):
            row[j] = RARE if i < k else LEFT
        row[m] = LEFT if i < k else 1.0
        if i < k:
            _links(x, step, a + i, b, slot, row)
        at, so_far, till_now = (h * wide + i) * wide, delta[i], alpha[h * wide + i]
        for j in range(m + 1):
            steps[at + j] = row[j]
            total[j] += till_now * row[j]
        for j in range(m + 1):
            through, before = so_far * row[j], (h + 1) * wide + j
            if through * OVER > ahead[j] and _better(x, through, ahead[j], i, came[before], a, k):
                ahead[j], came[before] = through, i
    likeliest = all_of = 0.0
    for j in range(m + 1):
        here = x.own[b + g + 1 + j]
        ahead[j] *= here
        total[j] *= here
        likeliest = max(likeliest, ahead[j])
        all_of += total[j]
    for j in range(m + 1):
        delta[j] = ahead[j] / likeliest
        alpha[(h + 1) * wide + j] = total[j] / all_of
    for j in range(m):
        slot[x.edge[b + j]] = -1


@fast_inner
def _backward(x: Model, begin: int, start: int, end: int, posterior: Floats, room: Scratch) -> None:
    """Posteriors of all states of a block."""
    steps, alpha, later, row = room.steps, room.alpha, room.later, room.row
    wide, m = len(later), 0
    for g in range(end - 1, begin - 1, -1):
        a, first, k = (g - begin) * wide, x.ptr[g] + g, x.ptr[g + 1] - x.ptr[g] + 1
        top = all_of = 0.0
        for i in range(k):
            beta = 0.0 if m else 1.0
            for j in range(m):
                beta += steps[(a + i) * wide + j] * later[j]
            row[i] = beta * x.own[first + i]
            top = max(top, row[i])
            all_of += alpha[a + i] * beta
            if g >= start:
                posterior[first + i] = alpha[a + i] * beta
        for i in range(k):
            later[i] = row[i] / top
            if g >= start:
                posterior[first + i] /= all_of
        m = k

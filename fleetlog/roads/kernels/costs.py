"""What the hidden Markov model charges: emissions and steps, as negative logarithms of probabilities."""

import math
from typing import Any

import numpy as np

from fleetlog.compiling import fast_inner, fast_outer
from fleetlog.core.arrays import Floats, Index
from fleetlog.roads.kernels.records import Candidates, Costs, Roads, Store, Wide

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
    """Cost of every candidate into ``out``: lateral distance, direction, axis of the log's heading.

    That of the distance is Gaussian, linear beyond 3 sigma.
    A motion plainly against a one-way road counts threefold: it is no noise about the other direction.
    """
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
    groups.
    """
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

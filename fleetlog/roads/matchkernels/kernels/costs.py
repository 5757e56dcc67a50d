"""What the hidden Markov model charges: emissions and steps.
Costs are negative logarithms of probabilities.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Wide = NDArray[np.int64]
Index = NDArray[np.int32]

JUMP = 12.0
"""Cost of two groups on roads that no path connects: the chain starts anew."""
RARE = np.exp(-JUMP)
LEAVE = 4.0
"""Cost of leaving the roads, and of coming back."""
SLACK = 5.0
"""A way this much longer than the travelled distance is always tried [m]:
two corners of an aisle, taken short.
"""
CHANGE = 0.5
"""Cost of entering another edge: of two routes that fit alike the plainer one."""
IDLE_CHANGE = 2.0
"""Cost of entering another edge only to stand there:
a truck that stops at a node has not left its edge yet.
"""
CHAIN_END = -2
BY_JUMP = 1 << 20


@njit(cache=True, error_model="numpy", fastmath=True)
def emission_costs(
    ptr: Wide,
    edge: Index,
    value: Floats,
    direction: Floats,
    sharpness: Floats,
    axis: Floats,
    reverse: Index,
    sigma: float,
    weight: float,
) -> Any:
    """Cost of every candidate: lateral distance (Gaussian, beyond 3 sigma linear), direction of motion and
    the heading's axis.

    A motion that is plainly against a one-way road counts threefold: there is no other direction that it
    could be noise of.
    """
    out = np.empty(len(edge))
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
    return out


@njit(cache=True, error_model="numpy", fastmath=True)
def mismatch(d: float, moved: float, scale: float) -> Any:
    """Cost of a step of network distance d:
    exponential, beyond four scales of slow growth (corners cut, wheels that slip).
    """
    z = abs(d - moved) / scale
    return z if z < 4.0 else 4.0 + 2.0 * math.log(0.25 * z)


@njit(cache=True, error_model="numpy", fastmath=True)
def step_costs(
    begin: Wide,
    count: Wide,
    target: Index,
    away: Floats,
    slot: Wide,
    ptr: Wide,
    edge: Index,
    value: Floats,
    g: int,
    moved: float,
    beta: float,
    back: float,
    turn: float,
    change: float,
    reverse: Index,
    length: Floats,
    cost: Floats,
) -> None:
    """Cost of every step from the candidates of group g to those of g + 1 into ``cost`` (K + 1, L + 1).

    A step costs about |network distance - travelled distance| / beta, a turn in mid edge ``turn`` and one to
    another edge ``change`` more; steps that the network does not allow cost ``JUMP``.  ``back`` is how far
    noise may move a truck against its edge.
    """
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
            if d >= -back:
                cost[i, j] = min(cost[i, j], mismatch(d, moved, scale))
        if reverse[e] >= 0 and slot[reverse[e]] >= 0:
            j = slot[reverse[e]]
            d = abs(left - value[0, b + j])
            cost[i, j] = min(cost[i, j], turn + mismatch(d, moved, scale) + change)
    for j in range(m):
        cost[k, j] = LEAVE
        slot[edge[b + j]] = -1
    cost[k, m] = 0.0


@njit(cache=True, error_model="numpy", fastmath=True)
def reach_of(moved: float, beta: float) -> Any:
    """How long a way is tried for a step of travelled distance ``moved`` [m]."""
    return moved + max(JUMP * math.sqrt(beta * beta + 0.01 * moved * moved), SLACK)

"""Who may go where: queues on pieces, reservations of junctions, aisles and spurs; who waits longest asks first."""

from __future__ import annotations

import numpy as np
from numba import njit

from fleetlog.simulate.state import (
    AT_BAY,
    DRIVING,
    ENTERING,
    LEAVING,
    WANTS_OUT,
    Fleet,
    Limits,
    Roads,
)

# Nothing here allocates, so counting references of sixty arrays at every access, which would take most of the time, is
# switched off: ``_nrt=False``.

SHORT = 0.3
"""Who stops for another stops this much earlier than it must [m]: a hair too far, and both would wait for ever."""


@njit(cache=True, _nrt=False)
def safe(v: float, room: float, u: float, brake: float, dt: float) -> float:
    """Highest speed after the next step that still stops ``brake``-ing behind one that does so from ``u``, ``room`` m ahead.

    Krauss 1998, written for a speed that is linear over the step.
    """
    q = 0.25 * brake * brake * dt * dt + 2.0 * brake * (room - 0.5 * v * dt) + u * u
    return -0.5 * brake * dt + np.sqrt(q) if q > 0.0 else 0.0


@njit(cache=True, _nrt=False)
def cap_at(r: Roads, piece: int, s: float, laden: int) -> float:
    """Speed cap on a piece; its square is linear between samples."""
    x = min(max(s, 0.0), r.length[piece]) / r.spacing[piece]
    low = r.first[piece]
    i = min(int(x), r.first[piece + 1] - low - 2)
    a, b = r.cap[laden, low + i], r.cap[laden, low + i + 1]
    return np.sqrt(a * a + (x - i) * (b * b - a * a))


@njit(cache=True, _nrt=False)
def is_safe_lane(r: Roads, piece: int) -> bool:
    """Whether a truck may wait on this piece."""
    return piece < len(r.clear) and r.capacity[piece] > 0


@njit(cache=True, _nrt=False)
def resource(r: Roads, f: Fleet, v: int, k: int, low: int, high: int) -> int:
    """Resource that position ``k`` of a truck's route stands for in the passage ``low`` to ``high``."""
    p = f.route[v, k]
    if is_safe_lane(r, p):
        # The last lane first: when the rest is given back it is the only one.
        if k == high:
            return len(r.length) + len(r.clear) + p
        if k == low:
            return len(r.length) + p
    return p


@njit(cache=True, _nrt=False)
def holds(r: Roads, f: Fleet, v: int, what: int) -> bool:
    """Whether truck ``v`` itself holds a resource."""
    for k in range(f.held_from[v], f.held_to[v] + 1):
        if resource(r, f, v, k, f.held_from[v], f.held_to[v]) == what:
            return True
    return False


@njit(cache=True, _nrt=False)
def is_free(r: Roads, f: Fleet, v: int, what: int, claims: bool) -> bool:
    """Whether nobody else holds, or with ``claims`` has claimed, what excludes resource ``what``."""
    for i in range(r.conflict_first[what], r.conflict_first[what + 1]):
        q = r.conflicts[i]
        others = f.held[q]
        if others > 0 and holds(r, f, v, q):
            others -= 1
        if others > 0 or (claims and f.claimed[q] == f.round[0]):
            return False
    return True


@njit(cache=True, _nrt=False)
def passage_end(r: Roads, f: Fleet, v: int, low: int) -> int:
    """Route position of the next lane with a safe part after ``low``, or of the last piece."""
    k = low + 1
    while k < f.last[v] and not is_safe_lane(r, f.route[v, k]):
        k += 1
    return min(k, f.last[v])


@njit(cache=True, _nrt=False)
def has_room(r: Roads, f: Fleet, v: int, lane: int, x: Limits) -> bool:
    """Whether one more truck can stand on a lane, a place being kept for one that has asked to come out of a bay."""
    room = r.capacity[lane]
    asker = f.asks[lane]
    if asker >= 0 and asker != v:
        if r.door_lane[f.door[asker]] == lane:
            room -= 1
        # Who could not stop there any more would go first, and after it the next one.
        if f.ask_at[lane] < max(r.clear[lane] + 0.5, run_in(r, lane, x)) and not f.force[v]:
            return False
    if f.force[v]:
        room += 1
    return f.on[lane] + f.inbound[lane] < room


@njit(cache=True, _nrt=False)
def ends_here(r: Roads, f: Fleet, piece: int) -> bool:
    """Whether somebody on a piece goes into a bay there: who followed with a reservation beyond it could be in his way."""
    u = f.tail[piece]
    while u >= 0:
        if f.at[u] == f.last[u]:
            return True
        u = f.ahead[u]
    return False


@njit(cache=True, _nrt=False)
def acquire(r: Roads, f: Fleet, v: int, low: int, x: Limits, claim: bool) -> int:
    """Reserve the way to the next safe lane whole or not at all: 0 done, 1 others are in the way, 2 no room there."""
    high = passage_end(r, f, v, low)
    ends_safe = is_safe_lane(r, f.route[v, high])
    if ends_safe and high > low and not has_room(r, f, v, f.route[v, high], x):
        return 2
    for k in range(low + 1, high):
        if ends_here(r, f, f.route[v, k]):
            return 1
    if f.mode[v] == WANTS_OUT and f.held[f.route[v, low]] > 0:
        # Who comes along a single-lane aisle may have a reservation beyond it already: it goes first.
        if claim:
            f.claimed[f.route[v, low]] = f.round[0]
        return 1
    for k in range(low, high + 1):
        if not is_free(r, f, v, resource(r, f, v, k, low, high), True):
            if claim:
                for j in range(low, high + 1):
                    f.claimed[resource(r, f, v, j, low, high)] = f.round[0]
            return 1
    f.held_from[v], f.held_to[v] = low, high
    for k in range(low, high + 1):
        f.held[resource(r, f, v, k, low, high)] += 1
    if ends_safe and high > low:
        f.inbound[f.route[v, high]] += 1
    f.force[v] = False
    return 0


@njit(cache=True, _nrt=False)
def release(r: Roads, f: Fleet, v: int, upto: int) -> None:
    """Give back the passage up to (not with) route position ``upto``."""
    low, high = f.held_from[v], f.held_to[v]
    for k in range(low, min(upto, high + 1)):
        f.held[resource(r, f, v, k, low, high)] -= 1
    if upto > high:
        f.held_from[v], f.held_to[v] = 0, -1
    elif upto > low:
        f.held_from[v] = upto


@njit(cache=True, _nrt=False)
def push(f: Fleet, v: int, piece: int) -> None:
    """Join the end of a piece's queue."""
    f.ahead[v] = f.tail[piece]
    f.behind[v] = -1
    if f.tail[piece] >= 0:
        f.behind[f.tail[piece]] = v
    f.tail[piece] = v


@njit(cache=True, _nrt=False)
def drop(f: Fleet, v: int, piece: int) -> None:
    """Leave a piece's queue."""
    a, b = f.ahead[v], f.behind[v]
    if a >= 0:
        f.behind[a] = b
    if b >= 0:
        f.ahead[b] = a
    if f.tail[piece] == v:
        f.tail[piece] = a
    f.ahead[v] = -1
    f.behind[v] = -1


@njit(cache=True, _nrt=False)
def insert(f: Fleet, v: int, piece: int) -> None:
    """Join a piece's queue at one's own offset."""
    b, a = -1, f.tail[piece]
    while a >= 0 and f.s[a] < f.s[v]:
        b, a = a, f.ahead[a]
    f.ahead[v], f.behind[v] = a, b
    if a >= 0:
        f.behind[a] = v
    if b >= 0:
        f.ahead[b] = v
    else:
        f.tail[piece] = v


@njit(cache=True, _nrt=False)
def front(r: Roads, f: Fleet, v: int, x: Limits) -> float:
    """How far along its lane a truck reaches [m]."""
    reach = 0.5 * x.length
    if f.mode[v] == LEAVING or f.mode[v] == ENTERING:
        reach = max(reach, r.door_ahead[f.door[v]])
    return f.s[v] + reach


@njit(cache=True, _nrt=False)
def may_ask(r: Roads, f: Fleet, v: int, j: int, x: Limits) -> bool:
    """Whether truck ``v`` may stop for the one that asks to come out onto, or to cross, route position ``j``.

    Not where that one could not come even so (see ``may_leave``): the two would wait for each other for ever.
    """
    lane = f.route[v, j]
    if not is_safe_lane(r, lane):
        # Who is in a single-lane aisle, or comes to it, has all of it reserved.
        return False
    comes_out = r.door_lane[f.door[f.asks[lane]]] == lane
    if comes_out and f.on[lane] + f.inbound[lane] >= r.capacity[lane]:
        return False
    if j == f.at[v]:
        # Its junction or the ground of its bay is reserved already: it goes first.
        return f.held_to[v] <= f.at[v] and not f.entry[v]
    return f.inbound[lane] == 0 or f.ask_at[lane] >= run_in(r, lane, x)


@njit(cache=True, _nrt=False)
def ask(r: Roads, f: Fleet, v: int, x: Limits) -> None:
    """Ask those on the lane that ``v`` comes out onto, and on the one that it crosses, to stop."""
    d = f.door[v]
    if f.mode[v] == WANTS_OUT and f.asks[r.door_lane[d]] < 0:
        f.asks[r.door_lane[d]] = v
        f.ask_at[r.door_lane[d]] = r.door_at[d] - x.length - x.gap - SHORT
    c = r.door_crosses[d]
    if c >= 0 and f.asks[c] < 0:
        f.asks[c] = v
        f.ask_at[c] = r.door_low[d] - SHORT


@njit(cache=True, _nrt=False)
def unask(r: Roads, f: Fleet, v: int) -> None:
    """Ask no longer."""
    d = f.door[v]
    if f.asks[r.door_lane[d]] == v:
        f.asks[r.door_lane[d]] = -1
    c = r.door_crosses[d]
    if c >= 0 and f.asks[c] == v:
        f.asks[c] = -1


@njit(cache=True, _nrt=False)
def comes_in(r: Roads, f: Fleet, lane: int, at: float, stop: float, x: Limits) -> bool:
    """Whether somebody comes onto a lane who could not stop at ``stop``; behind another one before ``at`` he stops anyway."""
    if f.inbound[lane] == 0 or stop >= run_in(r, lane, x):
        return False
    return f.tail[lane] < 0 or f.s[f.tail[lane]] >= at


@njit(cache=True, _nrt=False)
def may_cross(r: Roads, f: Fleet, v: int, x: Limits) -> bool:
    """Whether the lane that the truck's door crosses is clear there, and nobody comes who could not stop before it."""
    d = f.door[v]
    lane, low, high = r.door_crosses[d], r.door_low[d], r.door_high[d]
    if lane < 0:
        return True
    if f.crossed[lane] >= 0 or comes_in(r, f, lane, low, low, x):
        return False
    u = f.tail[lane]
    while u >= 0:
        if f.s[u] <= high:
            need = f.v[u] * f.v[u] / (2.0 * x.plan) + 0.6 * f.v[u]
            if f.s[u] + need > low or f.held_to[u] > f.at[u]:
                return False
        u = f.ahead[u]
    return True


@njit(cache=True, _nrt=False)
def run_in(r: Roads, lane: int, x: Limits) -> float:
    """Metres in which a truck that comes onto a lane can stop."""
    enter = min(cap_at(r, lane, 0.0, 0), cap_at(r, lane, 0.0, 1))
    return enter * enter / (2.0 * x.plan) + 0.6 * enter


@njit(cache=True, _nrt=False)
def may_leave(r: Roads, f: Fleet, v: int, x: Limits) -> bool:
    """Whether the stretch of lane that a truck backs out onto is clear, ahead and of trucks that could not stop behind."""
    d = f.door[v]
    lane, at = r.door_lane[d], r.door_at[d]
    rear = at - 0.5 * x.length - x.gap
    safe_lane = is_safe_lane(r, lane)
    if safe_lane and f.on[lane] + f.inbound[lane] >= r.capacity[lane]:
        return False
    if comes_in(r, f, lane, at, rear - 0.5 * x.length, x):
        return False
    u = f.tail[lane]
    while u >= 0:
        if f.s[u] >= at:
            if f.s[u] - 0.5 * x.length < at + r.door_ahead[d] + 0.3:
                return False
        else:
            need = f.v[u] * f.v[u] / (2.0 * x.plan) + 0.6 * f.v[u]
            if front(r, f, u, x) + need > rear or f.held_to[u] > f.at[u]:
                return False
        u = f.ahead[u]
    out = f.last_out[lane]
    if out >= 0 and f.left[out] == lane and f.left_by[out] < x.length + f.left_hold[out] and f.s[v] > 0.0:
        if r.length[lane] - 0.5 * x.length + f.left_by[out] < at + r.door_ahead[d] + 0.3:
            return False
    return True


@njit(cache=True, _nrt=False)
def try_leave(r: Roads, f: Fleet, v: int, x: Limits, now: float) -> int:
    """Back out of a bay if the road is clear: 0 done, 1 not yet."""
    d = f.door[v]
    lane = r.door_lane[d]
    spur = len(r.length) + 2 * len(r.clear) + d
    late = now - f.waits[v] > x.patience
    if late:
        ask(r, f, v, x)
    if not may_leave(r, f, v, x) or not may_cross(r, f, v, x) or not is_free(r, f, v, spur, True):
        return 1
    if not is_safe_lane(r, lane) and acquire(r, f, v, 0, x, late) != 0:
        return 1
    unask(r, f, v)
    f.s[v] = r.door_at[d]
    f.piece[v] = lane
    insert(f, v, lane)
    f.on[lane] += 1
    f.held[spur] += 1
    if r.door_crosses[d] >= 0:
        f.crossed[r.door_crosses[d]] = v
    f.mode[v] = LEAVING
    f.trip[v] += 1
    return 0


@njit(cache=True, _nrt=False)
def past_door(r: Roads, f: Fleet, v: int, x: Limits) -> bool:
    """Whether nobody stands or drives just past the door that the truck comes to."""
    d, a = f.door[v], f.ahead[v]
    return a < 0 or f.s[a] - 0.5 * x.length >= r.door_at[d] + r.door_ahead[d] + 0.3


@njit(cache=True, _nrt=False)
def try_enter(r: Roads, f: Fleet, v: int, x: Limits, now: float) -> int:
    """Turn into the bay if its ground, the road just ahead and the lane to cross are clear: 0 done, 1 not yet.

    A truck that still rolls towards its door has the ground reserved from then on, and need not stop.
    """
    d = f.door[v]
    spur = len(r.length) + 2 * len(r.clear) + d
    if not past_door(r, f, v, x):
        return 1
    if not f.entry[v]:
        # It is on the road already: whoever has claimed the junction waits for it to be gone.
        if not is_free(r, f, v, spur, False):
            return 1
        if now - f.waits[v] > x.patience:
            ask(r, f, v, x)
        if not may_cross(r, f, v, x):
            return 1
        unask(r, f, v)
        if r.door_crosses[d] >= 0:
            f.crossed[r.door_crosses[d]] = v
        f.held[spur] += 1
        f.entry[v] = True
    if f.mode[v] == AT_BAY:
        f.mode[v] = ENTERING
        f.spur[v] = 0.0
    return 0


@njit(cache=True, _nrt=False)
def wants_entry(r: Roads, f: Fleet, v: int, x: Limits) -> bool:
    """Whether a truck comes near its door without a reservation of the ground there."""
    if f.at[v] < f.last[v] or f.entry[v]:
        return False
    return r.door_at[f.door[v]] - f.s[v] < f.v[v] * f.v[v] / (2.0 * x.plan) + 1.2 * f.v[v] + 1.0


@njit(cache=True, _nrt=False)
def wants_passage(r: Roads, f: Fleet, v: int, x: Limits) -> bool:
    """Whether a truck comes near the end of its lane without a reservation, and is the first to."""
    if f.held_to[v] >= f.at[v] or f.at[v] >= f.last[v]:
        return False
    p = f.piece[v]
    if not is_safe_lane(r, p):
        return False
    if f.ahead[v] >= 0 and f.held_to[f.ahead[v]] <= f.at[f.ahead[v]]:
        return False
    return r.stop[p] - f.s[v] < f.v[v] * f.v[v] / (2.0 * x.plan) + 1.2 * f.v[v] + 3.0


@njit(cache=True, _nrt=False)
def reservations(r: Roads, f: Fleet, x: Limits, now: float) -> None:
    """One round: those who wait longest ask first."""
    f.round[0] += 1
    n = 0
    for v in range(len(f.mode)):
        m = f.mode[v]
        rolls = m == DRIVING and wants_entry(r, f, v, x)
        if m == WANTS_OUT or m == AT_BAY or rolls or (m == DRIVING and wants_passage(r, f, v, x)):
            if f.waits[v] == np.inf:
                f.waits[v] = now
            # Into the line behind all who have waited as long.
            k = n
            while k > 0 and f.waits[f.line[k - 1]] > f.waits[v]:
                f.line[k] = f.line[k - 1]
                k -= 1
            f.line[k] = v
            n += 1
    for i in range(n):
        v = f.line[i]
        if f.mode[v] == WANTS_OUT:
            answer = try_leave(r, f, v, x, now)
        elif f.mode[v] == AT_BAY or f.at[v] == f.last[v]:
            answer = try_enter(r, f, v, x, now)
        else:
            answer = acquire(r, f, v, f.at[v], x, now - f.waits[v] > x.patience)
        f.why[v] = answer
        if answer == 0:
            f.waits[v] = np.inf

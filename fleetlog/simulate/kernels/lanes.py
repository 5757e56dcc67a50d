"""Lanes and junctions: how fast, who is in line there; passages are reserved whole or not at all."""

import numpy as np

from fleetlog.compiling import inner
from fleetlog.core.arrays import Index
from fleetlog.simulate.state import Fleet, Limits, Mode, Roads

NEAR = 0.02  # At rest this close to its mark a truck is there [m]
REST = 0.01  # Slower than this it is at rest [m/s]


@inner
def safe(v: float, room: float, u: float, brake: float, dt: float) -> float:
    """Speed that still stops behind one ``room`` m ahead who brakes from ``u`` (Krauss 1998)."""
    q = 0.25 * brake * brake * dt * dt + 2.0 * brake * (room - 0.5 * v * dt) + u * u
    return -0.5 * brake * dt + np.sqrt(q) if q > 0.0 else 0.0


@inner
def is_safe_lane(r: Roads, piece: int) -> bool:
    """Whether a truck may wait on this piece."""
    return piece < len(r.clear) and r.capacity[piece] > 0


@inner
def wait_ahead(r: Roads, f: Fleet, x: Limits, v: int, lane: int) -> int:
    """Number of the next stop of truck ``v`` on a lane where it has to wait, -1: none."""
    row, past = x.cap[v] // 2 * len(r.clear) + lane, f.stood[v] if lane == f.piece[v] else -1.0
    for k in range(r.wait_first[row], r.wait_first[row + 1]):
        if r.wait_at[k] > past:
            return k
    return -1


@inner
def drop(first: Index, after: Index, v: int, piece: int) -> None:
    """Leave a piece's queue: who is ``first`` (P,) in each, and who is ``after`` (V,) each truck."""
    if first[piece] == v:
        first[piece] = after[v]
    else:
        u = first[piece]
        while after[u] != v:
            u = after[u]
        after[u] = after[v]
    after[v] = -1


@inner
def insert(f: Fleet, v: int, piece: int) -> None:
    """Join a piece's queue at one's own offset."""
    behind, ahead = -1, f.tail[piece]
    while ahead >= 0 and f.s[ahead] < f.s[v]:
        behind, ahead = ahead, f.ahead[ahead]
    f.ahead[v] = ahead
    if behind >= 0:
        f.ahead[behind] = v
    else:
        f.tail[piece] = v


@inner
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


@inner
def holds(r: Roads, f: Fleet, v: int, what: int) -> bool:
    """Whether truck ``v`` itself holds a resource."""
    for k in range(f.held_from[v], f.held_to[v] + 1):
        if resource(r, f, v, k, f.held_from[v], f.held_to[v]) == what:
            return True
    return False


@inner
def is_free(r: Roads, f: Fleet, v: int, what: int, ahead: bool) -> bool:
    """Whether nobody else holds or has claimed what excludes resource ``what``; for who is ``ahead``, on the
    road already, claims do not count, nor trucks that come onto its piece behind it."""
    for i in range(r.conflict_first[what], r.conflict_first[what + 1]):
        q = r.conflicts[i]
        others = f.held[q]
        if others > 0 and holds(r, f, v, q):
            others -= 1
        if ahead:
            for u in range(len(f.mode) if others > 0 else 0):
                behind = f.mode[u] == Mode.DRIVING and (f.piece[u] != f.piece[v] or f.s[u] < f.s[v])
                if behind and f.route[u, f.held_to[u]] == f.piece[v] and holds(r, f, u, q):
                    others -= 1
        elif f.claimed[q] == f.round[0]:
            return False
        if others > 0:
            return False
    return True


@inner
def next_safe(r: Roads, f: Fleet, v: int, at: int) -> int:
    """Position behind ``at`` of the next lane where truck ``v`` may wait, or of its last piece."""
    high = min(at + 1, f.last[v])
    while high < f.last[v] and not is_safe_lane(r, f.route[v, high]):
        high += 1
    return high


@inner
def fills_ring(r: Roads, f: Fleet, v: int, high: int) -> bool:
    """Whether a ring of lanes is full once truck ``v`` is at position ``high`` of its route: the first
    on each waits for room on the next, and nobody could ever move again."""
    lane, c, new, at = f.route[v, high], f.route[v, high], 1, high
    for _ in range(len(r.clear)):
        # The last place may be too short by a hair, where there is more than one.
        if f.on[c] + f.inbound[c] + new < max(r.capacity[c] - 1, 1) or (c == f.piece[v] and new == 0):
            return False
        u = f.tail[c]
        while u >= 0 and f.ahead[u] >= 0:
            u = f.ahead[u]
        u, at = (v, high) if u < 0 and new else (u, f.at[u])
        if u < 0 or at == f.last[u] or f.held_to[u] > at:
            return False
        c, new = f.route[u, next_safe(r, f, u, at)], 0
        if c == lane or not is_safe_lane(r, c):
            return c == lane
    return False


@inner
def heeded(r: Roads, f: Fleet, v: int, lane: int) -> int:
    """The truck for which truck ``v`` stops on a lane, -1: none. Who stands in the way of one that has waited
    for longer goes on: two that ask would wait for each other for ever."""
    asker, p = f.asks[lane], f.piece[v]
    if asker < 0 or asker == v:
        return -1
    before = 0 <= p < len(r.clear) and f.asks[p] >= 0 and f.s[v] > f.ask_at[p] + NEAR
    return -1 if before and f.waits[f.asks[p]] <= f.waits[asker] else asker


@inner
def has_room(r: Roads, f: Fleet, v: int, lane: int, x: Limits) -> bool:
    """Whether one more can stand on a lane, behind all that come, and clears the junction though those on it
    brake now; room is kept for one who asked to come out of a bay."""
    room, last, u, crosses = r.capacity[lane], r.stop[lane], f.tail[lane], f.crossed[lane]
    asker, inbound = heeded(r, f, v, lane), f.inbound[lane]
    if asker >= 0:
        if r.door_lane[f.door[asker]] == lane:
            room -= 1
        # Who could not stop there any more would go first, and after it the next one.
        if f.ask_at[lane] < max(r.clear[lane] + 0.5, r.run_in[lane]):
            return False
        last = min(last, f.ask_at[lane])
    if u >= 0:
        pace = f.v[u] if f.mode[u] == Mode.DRIVING else 0.0
        last = min(last, f.s[u] + pace * pace / (2.0 * x.down[u]) - x.length - x.gap)
    while crosses >= 0:
        last, crosses = min(last, r.door_low[f.door[crosses]]), f.beside[crosses]
    return f.on[lane] + inbound < room and inbound * (x.length + x.gap) <= last - r.clear[lane]


@inner
def acquire(r: Roads, f: Fleet, v: int, low: int, x: Limits, claim: bool) -> int:
    """Reserve the way to the next safe lane, whole: 0 done, 1 others are in the way, 2 no room there."""
    high = next_safe(r, f, v, low)
    ends_safe = is_safe_lane(r, f.route[v, high])
    if ends_safe and high > low and (not has_room(r, f, v, f.route[v, high], x) or fills_ring(r, f, v, high)):
        return 2
    for k in range(low + 1, high):
        # Who goes into a bay there, or is about to, could find a reservation beyond it in its way.
        u, p = f.tail[f.route[v, k]], f.route[v, k]
        if p < len(r.clear) and f.bound[p] > 0:
            return 1
        while u >= 0:
            if f.at[u] == f.last[u]:
                return 1
            u = f.ahead[u]
    if f.mode[v] == Mode.WANTS_OUT and f.held[f.route[v, low]] > 0:
        # Who comes along a single-lane aisle may have a reservation beyond it already: it goes first.
        if claim:
            f.claimed[f.route[v, low]] = f.round[0]
        return 1
    for k in range(low, high + 1):
        if not is_free(r, f, v, resource(r, f, v, k, low, high), False):
            if claim:
                for j in range(low, high + 1):
                    f.claimed[resource(r, f, v, j, low, high)] = f.round[0]
            return 1
    f.held_from[v], f.held_to[v] = low, high
    for k in range(low, high + 1):
        f.held[resource(r, f, v, k, low, high)] += 1
    if high > low:
        (f.inbound if ends_safe else f.bound)[f.route[v, high]] += 1
    return 0


@inner
def release(r: Roads, f: Fleet, v: int, upto: int) -> None:
    """Give back the passage up to (not with) route position ``upto``."""
    low, high = f.held_from[v], f.held_to[v]
    for k in range(low, min(upto, high + 1)):
        f.held[resource(r, f, v, k, low, high)] -= 1
    if upto > high:
        f.held_from[v], f.held_to[v] = 0, -1
    elif upto > low:
        f.held_from[v] = upto


@inner
def cross(r: Roads, f: Fleet, v: int) -> None:
    """Go over to the next pieces of the route where the end of one is passed."""
    while f.s[v] > r.length[f.piece[v]] and f.at[v] < f.last[v]:
        p = f.piece[v]
        if is_safe_lane(r, p) and f.held_to[v] <= f.at[v]:
            # A hair beyond the stop line by rounding, without a reservation: not over it.
            f.s[v] = r.length[p]
            return
        f.s[v] -= r.length[p]
        drop(f.tail, f.ahead, v, p)
        f.at[v] += 1
        q = f.route[v, f.at[v]]
        if p < len(r.clear):
            f.on[p] -= 1
            f.last_out[p] = v
            f.left[v] = p
            f.left_by[v] = f.s[v]
            f.left_hold[v] = r.length[q] + 1.0 if r.swings[q] else 0.0
        if q < len(r.clear):
            f.on[q] += 1
            if f.held_to[v] == f.at[v]:
                (f.inbound if is_safe_lane(r, q) else f.bound)[q] -= 1
        f.ahead[v], f.tail[q], f.piece[v], f.stood[v] = f.tail[q], v, q, -1.0


@inner
def let_go(r: Roads, f: Fleet, v: int, x: Limits) -> None:
    """Give back what is behind a truck that has something reserved."""
    p = f.piece[v]
    if f.at[v] == f.held_to[v] and is_safe_lane(r, p) and f.s[v] > r.clear[p] - NEAR:
        release(r, f, v, f.held_to[v] + 1)
    elif f.s[v] > 0.5 * x.length + 0.3:
        release(r, f, v, min(f.at[v], f.held_to[v]))


@inner
def stand(r: Roads, f: Fleet, v: int, x: Limits, now: float) -> None:
    """A truck on the road may have come to where it has to stand, or to its door: there it turns onto the
    spur where that is passed and its ground reserved, or waits at rest before it."""
    waits = wait_ahead(r, f, x, v, f.piece[v]) if f.piece[v] < len(r.clear) else -1
    if waits >= 0 and f.v[v] == 0.0 and f.s[v] > r.wait_at[waits] - NEAR:
        f.stood[v], f.until[v] = r.wait_at[waits], now + r.wait_for[waits]
    elif f.at[v] == f.last[v]:
        door = r.door_at[f.door[v]]
        past = f.s[v] - door
        if f.entry[v] and past >= 0.0:
            f.mode[v], f.spur[v], f.s[v], f.waits[v] = Mode.ENTERING, past, door, np.inf
        elif f.v[v] < REST and abs(past) < NEAR:
            f.mode[v], f.v[v], f.s[v], f.waits[v] = Mode.AT_BAY, 0.0, door, np.inf


@inner
def end_spur(r: Roads, f: Fleet, v: int) -> None:
    """Give back the lanes beside a bay that the footprint has left; at the end of the spur stand in the bay,
    or on the lane."""
    d, at, enters = f.door[v], f.spur[v], f.mode[v] == Mode.ENTERING
    lane, c, end = r.door_lane[d], r.door_crosses[d], r.door_length[d] if enters else 0.0
    there = abs(end - at) < NEAR and f.v[v] < REST
    if f.crosses[v] and (there or (at >= r.door_over[d] if enters else at <= r.door_onto[d])):
        f.crosses[v] = False
        drop(f.crossed, f.beside, v, c)
    # A single-lane aisle is kept to the end: given back earlier, who is to come out there waits for longer.
    if enters and f.piece[v] >= 0 and (there or (is_safe_lane(r, lane) and at >= r.door_off[d])):
        drop(f.tail, f.ahead, v, lane)
        f.on[lane] -= 1
        f.piece[v] = -1
        release(r, f, v, f.held_to[v] + 1)
    if not there:
        return
    f.held[len(r.length) + 2 * len(r.clear) + d] -= 1
    f.spur[v], f.v[v], f.attention[v] = end, 0.0, True
    if enters:
        f.mode[v], f.entry[v], f.left[v] = Mode.PARKED, False, -1
    else:
        f.mode[v], f.at[v], f.door[v] = Mode.DRIVING, 0, f.goal[v]

"""The fixed step of all trucks: queues on pieces, reservations at junctions, speeds, moves."""

from __future__ import annotations

import numpy as np
from numba import njit

from fleetlog.simulate.state import (
    AT_BAY,
    CHARGING,
    DRIVING,
    EMPTY,
    ENTERING,
    HANDLING,
    LEAVING,
    PARKED,
    WANTS_OUT,
    Fleet,
    Limits,
    Log,
    Roads,
)

# Nothing here allocates, so counting references of sixty arrays at every access, which
# would take most of the time, is switched off: ``_nrt=False``.
GRAVITY = 9.81
ROUND = 5
"""Steps between two rounds of reservations."""
NEAR = 0.02
"""At rest this close to its mark a truck is there [m]."""
REST = 0.01
"""Slower than this it is at rest [m/s]."""


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
        room -= 1
        if r.bay_at[f.bay[asker]] - x.length - x.gap < r.clear[lane] + 0.5 and not f.force[v]:
            return False
    if f.force[v]:
        room += 1
    return f.on[lane] + f.inbound[lane] < room


@njit(cache=True, _nrt=False)
def acquire(r: Roads, f: Fleet, v: int, low: int, x: Limits, claim: bool) -> int:
    """Reserve the way to the next safe lane whole or not at all: 0 done, 1 others are in the way, 2 no room there."""
    high = passage_end(r, f, v, low)
    ends_safe = is_safe_lane(r, f.route[v, high])
    if ends_safe and high > low and not has_room(r, f, v, f.route[v, high], x):
        return 2
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
        reach = max(reach, r.bay_ahead[f.bay[v]])
    return f.s[v] + reach


@njit(cache=True, _nrt=False)
def may_leave(r: Roads, f: Fleet, v: int, x: Limits) -> bool:
    """Whether the stretch of lane that a truck backs out onto is clear, ahead and of trucks that could not stop behind."""
    b = f.bay[v]
    lane, at = r.bay_lane[b], r.bay_at[b]
    rear = at - 0.5 * x.length - x.gap
    safe_lane = is_safe_lane(r, lane)
    if safe_lane and f.on[lane] + f.inbound[lane] >= r.capacity[lane]:
        return False
    enter = min(cap_at(r, lane, 0.0, 0), cap_at(r, lane, 0.0, 1))
    if f.inbound[lane] > 0 and rear - 0.5 * x.length < enter * enter / (2.0 * x.plan) + 0.6 * enter:
        return False
    u = f.tail[lane]
    while u >= 0:
        if f.s[u] >= at:
            if f.s[u] - 0.5 * x.length < at + r.bay_ahead[b] + 0.3:
                return False
        else:
            need = f.v[u] * f.v[u] / (2.0 * x.plan) + 0.6 * f.v[u]
            if front(r, f, u, x) + need > rear or f.held_to[u] > f.at[u]:
                return False
        u = f.ahead[u]
    out = f.last_out[lane]
    if out >= 0 and f.left[out] == lane and f.left_by[out] < x.length + f.left_hold[out] and f.s[v] > 0.0:
        if r.length[lane] - 0.5 * x.length + f.left_by[out] < at + r.bay_ahead[b] + 0.3:
            return False
    return True


@njit(cache=True, _nrt=False)
def try_leave(r: Roads, f: Fleet, v: int, x: Limits, now: float) -> int:
    """Back out of a bay if the road is clear: 0 done, 1 not yet."""
    b = f.bay[v]
    lane = r.bay_lane[b]
    spur = len(r.length) + 2 * len(r.clear) + b
    late = now - f.waits[v] > x.patience
    if late and f.asks[lane] < 0:
        f.asks[lane] = v
    if not may_leave(r, f, v, x) or not is_free(r, f, v, spur, True):
        return 1
    if not is_safe_lane(r, lane) and acquire(r, f, v, 0, x, late) != 0:
        return 1
    if f.asks[lane] == v:
        f.asks[lane] = -1
    f.s[v] = r.bay_at[b]
    f.piece[v] = lane
    insert(f, v, lane)
    f.on[lane] += 1
    f.held[spur] += 1
    f.mode[v] = LEAVING
    f.trip[v] += 1
    return 0


@njit(cache=True, _nrt=False)
def try_enter(r: Roads, f: Fleet, v: int, x: Limits) -> int:
    """Turn into the bay if its ground and the road just ahead are clear: 0 done, 1 not yet."""
    b = f.bay[v]
    spur = len(r.length) + 2 * len(r.clear) + b
    a = f.ahead[v]
    if a >= 0 and f.s[a] - 0.5 * x.length < r.bay_at[b] + r.bay_ahead[b] + 0.3:
        return 1
    # It is on the road already: whoever has claimed the junction waits for it to be gone.
    if not is_free(r, f, v, spur, False):
        return 1
    f.held[spur] += 1
    f.mode[v] = ENTERING
    f.spur[v] = 0.0
    return 0


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
        if m == WANTS_OUT or m == AT_BAY or (m == DRIVING and wants_passage(r, f, v, x)):
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
        elif f.mode[v] == AT_BAY:
            answer = try_enter(r, f, v, x)
        else:
            answer = acquire(r, f, v, f.at[v], x, now - f.waits[v] > x.patience)
        f.why[v] = answer
        if answer == 0:
            f.waits[v] = np.inf


@njit(cache=True, _nrt=False)
def wanted_speed(r: Roads, f: Fleet, v: int, x: Limits, dt: float) -> float:
    """The highest speed at the end of the step that keeps all limits, distances and stops ahead."""
    laden = 1 if f.load[v] > 25.0 else 0
    speed = f.v[v]
    limit = cap_at(r, f.piece[v], f.s[v] + speed * dt, laden)
    look = speed * speed / (2.0 * x.plan) + speed + 3.0 + x.length + x.gap
    off = -f.s[v]
    for j in range(f.at[v], f.last[v] + 1):
        p = f.route[v, j]
        if j > f.at[v]:
            limit = min(limit, safe(speed, off, r.cap[laden, r.first[p]], x.plan, dt))
        u = f.ahead[v] if j == f.at[v] else f.tail[p]
        if u >= 0:
            pace = f.v[u] if f.mode[u] == DRIVING or f.mode[u] == EMPTY else 0.0
            limit = min(limit, safe(speed, off + f.s[u] - x.length - x.gap, pace, x.plan, dt))
        if p < len(r.clear):
            if u < 0:
                o = f.last_out[p]
                if o >= 0 and o != v and f.left[o] == p:
                    past = max(0.0, f.left_by[o] - f.left_hold[o])
                    if past < x.length + x.gap:
                        limit = min(
                            limit, safe(speed, off + r.length[p] + past - x.length - x.gap, 0.0, x.plan, dt)
                        )
            asker = f.asks[p]
            if asker >= 0 and asker != v:
                room = off + r.bay_at[f.bay[asker]] - x.length - x.gap
                if room > speed * speed / (2.0 * x.down) + 0.1:
                    limit = min(limit, safe(speed, room, 0.0, x.plan, dt))
            if j == f.last[v]:
                limit = min(limit, safe(speed, off + r.bay_at[f.bay[v]], 0.0, x.plan, dt))
            elif is_safe_lane(r, p) and j >= f.held_to[v]:
                limit = min(limit, safe(speed, off + r.stop[p], 0.0, x.plan, dt))
                break
        if u >= 0:
            break
        off += r.length[p]
        if off > look:
            break
    return limit


@njit(cache=True, _nrt=False)
def pull(r: Roads, f: Fleet, v: int, x: Limits) -> float:
    """Greatest acceleration [m/s2]: the driver's, or what max_power leaves after rolling and slope."""
    p = f.piece[v]
    i = r.first[p] + int(min(max(f.s[v], 0.0), r.length[p]) / r.spacing[p])
    lean = r.slope[min(i, r.first[p + 1] - 1)]
    mass = x.mass + f.load[v]
    resist = mass * GRAVITY * (x.rolling * np.cos(lean) + np.sin(lean))
    if f.v[v] <= 0.0:
        return x.up
    return min(x.up, (x.power / f.v[v] - resist) / mass)


@njit(cache=True, _nrt=False)
def next_speed(r: Roads, f: Fleet, v: int, x: Limits, dt: float) -> float:
    """Speed at the end of the step."""
    m, speed = f.mode[v], f.v[v]
    if m == DRIVING:
        new = min(speed + pull(r, f, v, x) * dt, wanted_speed(r, f, v, x, dt))
    elif m == ENTERING or m == LEAVING:
        rest = r.bay_length[f.bay[v]] - f.spur[v] if m == ENTERING else f.spur[v]
        new = min(min(speed + x.up * dt, x.creep), safe(speed, rest, 0.0, x.plan, dt))
    else:
        new = 0.0
    new = max(new, speed - x.down * dt)
    return new if new > 1e-3 else 0.0


@njit(cache=True, _nrt=False)
def cross(r: Roads, f: Fleet, v: int) -> None:
    """Go over to the next pieces of the route where the end of one is passed."""
    while f.s[v] > r.length[f.piece[v]] and f.at[v] < f.last[v]:
        p = f.piece[v]
        if is_safe_lane(r, p) and f.held_to[v] <= f.at[v]:
            # A hair beyond the stop line by rounding, without a reservation: not over it.
            f.s[v] = r.length[p]
            return
        f.s[v] -= r.length[p]
        drop(f, v, p)
        f.at[v] += 1
        q = f.route[v, f.at[v]]
        if p < len(r.clear):
            f.on[p] -= 1
            f.last_out[p] = v
            f.left[v] = p
            f.left_by[v] = f.s[v]
            f.left_hold[v] = r.length[q] + 1.0 if r.bent[q] else 0.0
        if q < len(r.clear):
            f.on[q] += 1
            if is_safe_lane(r, q) and f.held_to[v] == f.at[v]:
                f.inbound[q] -= 1
        push(f, v, q)
        f.piece[v] = q


@njit(cache=True, _nrt=False)
def let_go(r: Roads, f: Fleet, v: int, x: Limits) -> None:
    """Give back what is behind the truck."""
    if f.held_to[v] < f.held_from[v]:
        return
    p = f.piece[v]
    if f.at[v] == f.held_to[v] and is_safe_lane(r, p) and f.s[v] >= r.clear[p]:
        release(r, f, v, f.held_to[v] + 1)
    elif f.s[v] > 0.5 * x.length + 0.3:
        release(r, f, v, min(f.at[v], f.held_to[v]))


@njit(cache=True, _nrt=False)
def arrive(r: Roads, f: Fleet, v: int) -> None:
    """Wait before the bay when its mark is reached."""
    if f.at[v] == f.last[v] and f.v[v] < REST and abs(f.s[v] - r.bay_at[f.bay[v]]) < NEAR:
        f.s[v] = r.bay_at[f.bay[v]]
        f.v[v] = 0.0
        f.mode[v] = AT_BAY
        f.waits[v] = np.inf


@njit(cache=True, _nrt=False)
def end_spur(r: Roads, f: Fleet, v: int) -> None:
    """Stand in the bay, or on the lane, at the end of a spur."""
    b = f.bay[v]
    lane = r.bay_lane[b]
    spur = len(r.length) + 2 * len(r.clear) + b
    if f.mode[v] == ENTERING and r.bay_length[b] - f.spur[v] < NEAR and f.v[v] < REST:
        f.spur[v] = r.bay_length[b]
        f.v[v] = 0.0
        f.held[spur] -= 1
        drop(f, v, lane)
        f.on[lane] -= 1
        if f.held_to[v] >= f.held_from[v]:
            release(r, f, v, f.held_to[v] + 1)
        f.mode[v] = PARKED
        f.piece[v] = -1
        f.left[v] = -1
        f.attention[v] = True
    elif f.mode[v] == LEAVING and f.spur[v] < NEAR and f.v[v] < REST:
        f.spur[v] = 0.0
        f.v[v] = 0.0
        f.held[spur] -= 1
        f.mode[v] = DRIVING
        f.at[v] = 0
        f.bay[v] = f.goal[v]
        f.attention[v] = True


@njit(cache=True, _nrt=False)
def handling(
    f: Fleet, log: Log, v: int, column: int, now: float, raise_speed: float, lower_speed: float
) -> None:
    """Forks and load of a truck that works at a place: up, take or leave the load, down."""
    since = now - f.hand_start[v]
    up, hold, down = f.hand_times[v, 0], f.hand_times[v, 1], f.hand_times[v, 2]
    height, lift = 0.0, 0.0
    if 0.0 <= since < up:
        height, lift = since * raise_speed, raise_speed
    elif up <= since < up + hold:
        height = f.hand_height[v]
    elif up + hold <= since < up + hold + down:
        height, lift = f.hand_height[v] - (since - up - hold) * lower_speed, -lower_speed
    f.load[v] = f.hand_before[v] if since < up + 0.5 * hold else f.hand_after[v]
    log.height[v, column], log.lift[v, column] = height, lift


@njit(cache=True, _nrt=False)
def write(r: Roads, f: Fleet, log: Log, v: int, column: int) -> None:
    """The state at the start of a step."""
    m = f.mode[v]
    if m == DRIVING or m == AT_BAY or (m == EMPTY and f.piece[v] >= 0):
        log.piece[v, column], log.s[v, column] = f.piece[v], f.s[v]
    else:
        log.piece[v, column], log.s[v, column] = len(r.length) + f.bay[v], f.spur[v]
    log.v[v, column], log.a[v, column], log.load[v, column] = f.v[v], f.a[v], f.load[v]
    log.trip[v, column], log.mode[v, column] = f.trip[v], m


@njit(cache=True, _nrt=False)
def advance(
    r: Roads, f: Fleet, x: Limits, log: Log, column: int, steps: int, step0: int, dt: float,
    raise_speed: float, lower_speed: float,
) -> None:  # fmt: skip
    """``steps`` steps of ``dt`` [s] from step number ``step0``, logged from ``column`` on."""
    trucks = len(f.mode)
    for k in range(steps):
        now = (step0 + k) * dt
        if (step0 + k) % ROUND == 0:
            reservations(r, f, x, now)
        for v in range(trucks):
            m = f.mode[v]
            if m == PARKED or m == CHARGING or m == WANTS_OUT or m == AT_BAY:
                f.a[v] = 0.0
                continue
            if m == HANDLING and now >= f.until[v] - 1e-9:
                f.mode[v] = PARKED
                f.attention[v] = True
            f.a[v] = (next_speed(r, f, v, x, dt) - f.v[v]) / dt
        for v in range(trucks):
            log.height[v, column + k], log.lift[v, column + k] = 0.0, 0.0
            m = f.mode[v]
            if m == HANDLING:
                handling(f, log, v, column + k, now, raise_speed, lower_speed)
            write(r, f, log, v, column + k)
            if f.v[v] == 0.0 and f.a[v] == 0.0:
                if m == DRIVING and f.at[v] == f.last[v]:
                    arrive(r, f, v)
                elif m == ENTERING or m == LEAVING:
                    end_spur(r, f, v)
                continue
            step = dt * (f.v[v] + 0.5 * f.a[v] * dt)
            f.v[v] = max(f.v[v] + f.a[v] * dt, 0.0)
            f.moved[v] += step
            if m == ENTERING:
                f.spur[v] = min(f.spur[v] + step, r.bay_length[f.bay[v]])
                end_spur(r, f, v)
            elif m == LEAVING:
                f.spur[v] = max(f.spur[v] - step, 0.0)
                end_spur(r, f, v)
            else:
                f.s[v] += step
                f.left_by[v] += step
                # Calls cost more than the questions whether they are needed.
                if f.s[v] > r.length[f.piece[v]] and f.at[v] < f.last[v]:
                    cross(r, f, v)
                if f.held_to[v] >= f.held_from[v]:
                    let_go(r, f, v, x)
                if m == DRIVING and f.at[v] == f.last[v] and f.v[v] < REST:
                    arrive(r, f, v)

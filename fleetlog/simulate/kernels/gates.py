"""In and out of bays: asking others to stop, crossing, backing out, turning in; and who asks when."""

import numpy as np

from fleetlog.compiling import inner
from fleetlog.simulate.kernels.lanes import acquire, fills_ring, insert, is_free, is_safe_lane, wait_ahead
from fleetlog.simulate.state import HAIR, STANDS, Fleet, Limits, Mode, Roads

SOON = 0.5  # So long before it has to brake a truck asks for its way: any earlier keeps others waiting [s]
SHORT = 0.3  # Who stops for another stops this much early: a hair too far, and both would wait for ever [m]


@inner
def may_ask(r: Roads, f: Fleet, v: int, j: int, x: Limits) -> bool:
    """Whether truck ``v`` may stop for the one that asks to come out onto, or to cross, route position ``j``.

    Not where that one could not come even so (see ``may_leave``): both would wait for ever."""
    lane = f.route[v, j]
    if not is_safe_lane(r, lane):
        # Who is in a single-lane aisle, or comes to it, has all of it reserved.
        return False
    comes_out = r.door_lane[f.door[f.asks[lane]]] == lane
    if comes_out and f.on[lane] + f.inbound[lane] >= r.capacity[lane]:
        return False
    if j == f.at[v]:
        room, u = f.ask_at[lane] - r.clear[lane] - f.inbound[lane] * (x.length + x.gap), f.tail[lane]
        while u != v:
            room, u = room - x.length - x.gap, f.ahead[u]
        # Those behind it would stand in the junction, or its own is reserved, or its bay: it goes first.
        return room >= 0.0 and f.held_to[v] <= f.at[v] and not f.entry[v]
    return f.inbound[lane] == 0 or f.ask_at[lane] >= r.run_in[lane]


@inner
def ask(r: Roads, f: Fleet, v: int, x: Limits, room: bool, now: float) -> None:
    """Ask those on the lane that ``v`` comes out onto to stop, with ``room`` there those it crosses too. Both
    or neither: who had one of two lanes could wait for the other for ever. For a while not from a bay where
    somebody stands in its way: he is let go first, others would only stop for nothing behind him."""
    d, patient = f.door[v], f.mode[v] == Mode.WANTS_OUT and now - f.waits[v] <= 2.0 * x.patience
    own, c = r.door_lane[d] if f.mode[v] == Mode.WANTS_OUT else -1, r.door_crosses[d] if room else -1
    first, last = r.door_at[d] - x.length - x.gap, r.door_at[d] + r.door_ahead[d] + 0.3 + 0.5 * x.length
    for lane, low, high in ((own, first, last), (c, r.door_low[d], r.door_high[d])):
        if lane >= 0 and f.asks[lane] >= 0 and f.asks[lane] != v:
            return
        u = f.tail[lane] if lane >= 0 and patient else -1
        while u >= 0:
            if low < f.s[u] <= high and f.v[u] < STANDS and f.mode[u] == Mode.DRIVING:
                return
            u = f.ahead[u]
    for lane, at in ((own, first), (c, r.door_low[d])):
        if lane >= 0:
            f.asks[lane], f.ask_at[lane] = v, at - SHORT


@inner
def asks_no_more(r: Roads, f: Fleet, v: int) -> None:
    """Nobody stops for truck ``v`` any longer."""
    for lane in (r.door_lane[f.door[v]], r.door_crosses[f.door[v]]):
        if lane >= 0 and f.asks[lane] == v:
            f.asks[lane] = -1


@inner
def take_spur(r: Roads, f: Fleet, v: int) -> None:
    """Reserve the way into a bay or out of it, and the lane that it crosses; ask no longer."""
    d = f.door[v]
    asks_no_more(r, f, v)
    c = r.door_crosses[d]
    if c >= 0:
        f.beside[v], f.crossed[c], f.crosses[v] = f.crossed[c], v, True
    f.held[len(r.length) + 2 * len(r.clear) + d] += 1


@inner
def is_clear(r: Roads, f: Fleet, lane: int, low: float, high: float, turning: bool, x: Limits) -> bool:
    """Whether no truck on a lane is between ``low`` and ``high`` [m] or cannot stop before ``low``, nor one
    that comes onto it behind nobody; with ``turning`` as far as who goes into a bay or out of it reaches."""
    u, n, at = f.tail[lane], f.inbound[lane], low + x.length + x.gap if turning else low
    if n > 0 and low < r.run_in[lane] + (n - 1) * (x.length + x.gap) and (u < 0 or f.s[u] >= at):
        return False
    while u >= 0:
        if f.s[u] <= high:
            need, more = f.v[u] * f.v[u] / (2.0 * x.plan[u]) + HAIR * f.v[u], 0.0
            if turning and (f.mode[u] == Mode.LEAVING or f.mode[u] == Mode.ENTERING):
                more = max(r.door_ahead[f.door[u]] - 0.5 * x.length, 0.0)
            if f.s[u] + more + need > low or f.held_to[u] > f.at[u]:
                return False
        u = f.ahead[u]
    return True


@inner
def may_cross(r: Roads, f: Fleet, v: int, x: Limits) -> bool:
    """Whether the lane that the door crosses is clear, and nobody comes who could not stop before it."""
    d = f.door[v]
    lane, low = r.door_crosses[d], r.door_low[d]
    return lane < 0 or is_clear(r, f, lane, low, r.door_high[d], False, x)


@inner
def may_leave(r: Roads, f: Fleet, v: int, x: Limits) -> bool:
    """Whether the lane that a truck backs out onto is clear, also of those behind who could not stop."""
    d = f.door[v]
    lane, at = r.door_lane[d], r.door_at[d]
    low, ahead = at - x.length - x.gap, at + r.door_ahead[d] + 0.3
    if is_safe_lane(r, lane) and f.on[lane] + f.inbound[lane] >= r.capacity[lane]:
        return False
    if not is_clear(r, f, lane, low, ahead + 0.5 * x.length, True, x):
        return False
    out = f.last_out[lane]
    if out >= 0 and f.left[out] == lane and f.left_by[out] < x.length + f.left_hold[out] and f.s[v] > 0.0:
        return r.length[lane] - 0.5 * x.length + f.left_by[out] >= ahead
    return True


@inner
def try_leave(r: Roads, f: Fleet, v: int, x: Limits, now: float) -> int:
    """Back out of a bay if the road is clear: 0 done, 1 not yet."""
    d, lane = f.door[v], r.door_lane[f.door[v]]
    spur = len(r.length) + 2 * len(r.clear) + d
    late, free = now - f.waits[v] > x.patience, is_safe_lane(r, lane)
    asks_no_more(r, f, v)
    if free and fills_ring(r, f, v, 0):
        # Nobody stops for one that could not come even so; behind it a ring would never come apart.
        return 1
    if late:
        ask(r, f, v, x, not free or f.on[lane] + f.inbound[lane] < r.capacity[lane], now)
    if not may_leave(r, f, v, x) or not may_cross(r, f, v, x) or not is_free(r, f, v, spur, False):
        return 1
    if not free and acquire(r, f, v, 0, x, late) != 0:
        return 1
    take_spur(r, f, v)
    f.s[v], f.stood[v], f.piece[v] = r.door_at[d], r.door_at[d], lane
    insert(f, v, lane)
    f.on[lane] += 1
    f.mode[v] = Mode.LEAVING
    f.trip[v] += 1
    return 0


@inner
def past_door(r: Roads, f: Fleet, v: int, x: Limits) -> bool:
    """Whether nobody stands or drives just past the door that the truck comes to."""
    d, a = f.door[v], f.ahead[v]
    return a < 0 or f.s[a] - 0.5 * x.length >= r.door_at[d] + r.door_ahead[d] + 0.3


@inner
def try_enter(r: Roads, f: Fleet, v: int, x: Limits, now: float) -> int:
    """Turn into the bay if ground, road and crossing are clear, rolling or at rest: 0 done, 1 not yet."""
    if not past_door(r, f, v, x):
        return 1
    if not f.entry[v]:
        # It is on the road already: whoever has claimed the junction waits for it to be gone.
        if not is_free(r, f, v, len(r.length) + 2 * len(r.clear) + f.door[v], True):
            return 1
        if f.mode[v] == Mode.AT_BAY:
            # It holds up those behind it.
            ask(r, f, v, x, True, now)
        if not may_cross(r, f, v, x):
            return 1
        take_spur(r, f, v)
        f.entry[v] = True
    if f.mode[v] == Mode.AT_BAY:
        f.mode[v] = Mode.ENTERING
        f.spur[v] = 0.0
    return 0


@inner
def comes_near(r: Roads, f: Fleet, v: int, x: Limits, now: float) -> bool:
    """Whether a truck comes near its door, or first near the end of its lane, without a reservation; not
    before it has stood where it has to."""
    if now < f.until[v]:
        return False
    look = f.v[v] * f.v[v] / (2.0 * x.plan[v]) + SOON * f.v[v]
    p, a = f.piece[v], f.ahead[v]
    if f.at[v] == f.last[v]:
        return not f.entry[v] and r.door_at[f.door[v]] - f.s[v] < look + 1.0
    if f.held_to[v] >= f.at[v] or not is_safe_lane(r, p) or (a >= 0 and f.held_to[a] <= f.at[a]):
        return False
    return wait_ahead(r, f, x, v, p) < 0 and r.stop[p] - f.s[v] < look + 3.0


@inner
def reservations(r: Roads, f: Fleet, x: Limits, now: float) -> None:
    """One round: those who wait longest ask first."""
    f.round[0] += 1
    n = 0
    for v in range(len(f.mode)):
        m = f.mode[v]
        if m == Mode.WANTS_OUT or m == Mode.AT_BAY or (m == Mode.DRIVING and comes_near(r, f, v, x, now)):
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
        if f.mode[v] == Mode.WANTS_OUT:
            answer = try_leave(r, f, v, x, now)
        elif f.mode[v] == Mode.AT_BAY or f.at[v] == f.last[v]:
            answer = try_enter(r, f, v, x, now)
        elif not comes_near(r, f, v, x, now):
            # Who came out before it in this round is ahead of it now, and needs the junction first.
            answer = 1
        else:
            answer = acquire(r, f, v, f.at[v], x, now - f.waits[v] > x.patience)
        f.why[v] = answer
        if answer == 0:
            f.waits[v] = np.inf
            f.until[v] = now + x.reaction[v] if f.v[v] == 0.0 else f.until[v]

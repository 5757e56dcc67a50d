"""The fixed step of all trucks: speeds, moves, arrivals, the log of it."""

import numpy as np

from fleetlog.compiling import free, inner
from fleetlog.physics.formulas import LADEN
from fleetlog.simulate.kernels.gates import may_ask, past_door, reservations
from fleetlog.simulate.kernels.lanes import cross, end_spur, is_safe_lane, let_go, safe, stand, wait_ahead
from fleetlog.simulate.state import Fleet, Limits, Log, Mode, Roads

GRAVITY = 9.81


@inner
def cap_at(r: Roads, piece: int, s: float, row: int) -> float:
    """Speed cap on a piece; its square is linear between samples."""
    x = min(max(s, 0.0), r.length[piece]) / r.spacing[piece]
    low = r.first[piece]
    i = min(int(x), r.first[piece + 1] - low - 2)
    a, b = r.cap[row, low + i], r.cap[row, low + i + 1]
    return np.sqrt(a * a + (x - i) * (b * b - a * a))


@inner
def stop_ahead(r: Roads, f: Fleet, v: int, x: Limits, j: int, u: int, off: float) -> float:
    """Metres to where others, or a term that waits, make a truck stop on the lane at route position ``j``,
    ``off`` m ahead, or inf; ``u`` is the truck before it on that lane, -1: nobody."""
    p, room = f.route[v, j], np.inf
    o, waits = f.last_out[p], wait_ahead(r, f, x, v, p)
    if waits >= 0:
        room = max(off + r.wait_at[waits], 0.0)
    if u < 0 and o >= 0 and o != v and f.left[o] == p:
        # Who has left the lane may reach into it still.
        past = max(0.0, f.left_by[o] - f.left_hold[o])
        if past < x.length + x.gap:
            room = min(room, off + r.length[p] + past - x.length - x.gap)
    # Who stands at a mark by a hair stays there; who cannot stop before it goes on.
    too_late = max(f.v[v] * f.v[v] / (2.0 * x.down[v]), 0.01) - 0.2
    asker, crosses = f.asks[p], f.crossed[p]
    if asker >= 0 and asker != v and off + f.ask_at[p] > too_late and may_ask(r, f, v, j, x):
        room = min(room, max(off + f.ask_at[p], 0.0))
    if f.walked[p] and off + r.walk_at[p] > too_late:
        room = min(room, max(off + r.walk_at[p], 0.0))
    while crosses >= 0:
        d = f.door[crosses]
        if j > f.at[v] or f.s[v] <= r.door_high[d]:
            room = min(room, max(off + r.door_low[d], 0.0))
        crosses = f.beside[crosses]
    return room


@inner
def wanted_speed(r: Roads, f: Fleet, v: int, x: Limits, dt: float) -> float:
    """The highest speed at the end of the step that keeps all limits, distances and stops ahead."""
    row, plan, speed = x.cap[v] + (1 if f.load[v] > LADEN else 0), x.plan[v], f.v[v]
    limit = cap_at(r, f.piece[v], f.s[v] + speed * dt, row)
    look = speed * speed / (2.0 * plan) + speed + 3.0 + x.length + x.gap
    off = -f.s[v]
    for j in range(f.at[v], f.last[v] + 1):
        p = f.route[v, j]
        if j > f.at[v]:
            limit = min(limit, safe(speed, off, r.cap[row, r.first[p]], plan, dt))
        u = f.ahead[v] if j == f.at[v] else f.tail[p]
        if u >= 0:
            pace = f.v[u] if f.mode[u] == Mode.DRIVING or f.mode[u] == Mode.EMPTY else 0.0
            # One who brakes harder stops sooner.
            pace *= min(1.0, np.sqrt(plan / x.plan[u]))
            # Behind who drives a driver keeps the way that he reacts on.
            gap = x.length + x.gap + pace * x.reaction[v]
            limit = min(limit, safe(speed, off + f.s[u] - gap, pace, plan, dt))
        if p < len(r.clear):
            room = stop_ahead(r, f, v, x, j, u, off)
            if room < np.inf:
                limit = min(limit, safe(speed, room, 0.0, plan, dt))
            if j == f.last[v]:
                d = f.door[v]
                creep = min(x.creep[v], np.sqrt(2.0 * plan * r.door_length[d]))
                pace = creep if f.entry[v] and past_door(r, f, v, x) else 0.0
                limit = min(limit, safe(speed, off + r.door_at[d], pace, plan, dt))
            elif is_safe_lane(r, p) and j >= f.held_to[v]:
                return min(limit, safe(speed, off + r.stop[p], 0.0, plan, dt))
        if u >= 0:
            break
        off += r.length[p]
        if off > look:
            break
    return limit


@inner
def pull(r: Roads, f: Fleet, v: int, x: Limits) -> float:
    """Greatest acceleration [m/s2]: the driver's, or what max_power leaves after rolling and slope."""
    p = f.piece[v]
    i = r.first[p] + int(min(max(f.s[v], 0.0), r.length[p]) / r.spacing[p])
    lean = r.slope[min(i, r.first[p + 1] - 1)]
    mass = x.mass[v] + f.load[v]
    resist = mass * GRAVITY * (x.rolling[v] * np.cos(lean) + np.sin(lean))
    return min(x.up[v], (x.power[v] / f.v[v] - resist) / mass) if f.v[v] > 0.0 else x.up[v]


@inner
def next_speed(r: Roads, f: Fleet, v: int, x: Limits, dt: float) -> float:
    """Speed at the end of the step."""
    m, speed = f.mode[v], f.v[v]
    if m == Mode.DRIVING:
        new = min(speed + pull(r, f, v, x) * dt, wanted_speed(r, f, v, x, dt))
    elif m == Mode.ENTERING or m == Mode.LEAVING:
        rest = r.door_length[f.door[v]] - f.spur[v] if m == Mode.ENTERING else f.spur[v]
        new = min(min(speed + x.up[v] * dt, x.creep[v]), safe(speed, rest, 0.0, x.plan[v], dt))
    else:
        new = 0.0
    new = max(new, speed - x.down[v] * dt)
    return new if new > 1e-3 else 0.0


@inner
def forks(f: Fleet, x: Limits, v: int, since: float) -> float:
    """Height of the forks so long after a truck began to work: up, take or leave the load, down [m]."""
    up, hold, down = f.hand_times[v, 0], f.hand_times[v, 1], f.hand_times[v, 2]
    if since < up:
        return max(since, 0.0) * x.raises[v]
    if since >= up + hold + down:
        return 0.0
    return max(f.hand_height[v] - max(since - up - hold, 0.0) * x.lowers[v], 0.0)


@inner
def write(r: Roads, f: Fleet, x: Limits, log: Log, v: int, column: int, now: float, dt: float) -> None:
    """The state at the start of a step; the rate of the forks is a mean over it, so energy is exact."""
    m, height, after = f.mode[v], 0.0, 0.0
    if m == Mode.HANDLING:
        since = now - f.hand_start[v]
        height, after = forks(f, x, v, since), forks(f, x, v, since + dt)
        taken = since >= f.hand_times[v, 0] + 0.5 * f.hand_times[v, 1]
        f.load[v] = f.hand_after[v] if taken else f.hand_before[v]
    log.height[v, column], log.lift[v, column] = height, (after - height) / dt
    if m == Mode.DRIVING or m == Mode.AT_BAY or (m == Mode.EMPTY and f.piece[v] >= 0):
        log.piece[v, column], log.s[v, column] = f.piece[v], f.s[v]
    else:
        log.piece[v, column], log.s[v, column] = len(r.length) + f.door[v], f.spur[v]
    log.v[v, column], log.a[v, column], log.load[v, column] = f.v[v], f.a[v], f.load[v]
    log.trip[v, column], log.mode[v, column] = f.trip[v], m


@free
def advance(r: Roads, f: Fleet, x: Limits, log: Log, column: int, steps: int, step0: int, dt: float) -> None:
    """``steps`` steps of ``dt`` [s] from step number ``step0``, logged from ``column`` on."""
    trucks = len(f.mode)
    for k in range(steps):
        now = (step0 + k) * dt
        reservations(r, f, x, now)
        for v in range(trucks):
            m = f.mode[v]
            stays = m == Mode.PARKED or m == Mode.CHARGING or m == Mode.WANTS_OUT or m == Mode.AT_BAY
            if stays or now < f.until[v] - 1e-9:
                f.a[v] = 0.0
                continue
            if m == Mode.HANDLING:
                f.mode[v] = Mode.PARKED
                f.attention[v] = True
            f.a[v] = (next_speed(r, f, v, x, dt) - f.v[v]) / dt
        for v in range(trucks):
            m = f.mode[v]
            write(r, f, x, log, v, column + k, now, dt)
            if f.v[v] == 0.0 and f.a[v] == 0.0:
                if m == Mode.DRIVING:
                    stand(r, f, v, x, now)
                elif m == Mode.ENTERING or m == Mode.LEAVING:
                    end_spur(r, f, v)
                continue
            step = dt * (f.v[v] + 0.5 * f.a[v] * dt)
            f.v[v] = max(f.v[v] + f.a[v] * dt, 0.0)
            f.moved[v] += step
            if m == Mode.ENTERING or m == Mode.LEAVING:
                spur = f.spur[v] + (step if m == Mode.ENTERING else -step)
                f.spur[v] = min(max(spur, 0.0), r.door_length[f.door[v]])
                end_spur(r, f, v)
            else:
                f.s[v] += step
                f.left_by[v] += step
                # Calls cost more than the questions whether they are needed.
                if f.s[v] > r.length[f.piece[v]] and f.at[v] < f.last[v]:
                    cross(r, f, v)
                if f.held_to[v] >= f.held_from[v]:
                    let_go(r, f, v, x)
                if m == Mode.DRIVING and f.at[v] == f.last[v]:
                    stand(r, f, v, x, now)

"""From piece to piece of a route, and into a bay and out of it."""

import numpy as np

from fleetlog.simulate.kernels.lanes import drop, inner, is_safe_lane, push, release
from fleetlog.simulate.state import Fleet, Limits, Mode, Roads

NEAR = 0.02  # At rest this close to its mark a truck is there [m]
REST = 0.01  # Slower than this it is at rest [m/s]


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
        drop(f, v, p)
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
            if is_safe_lane(r, q) and f.held_to[v] == f.at[v]:
                f.inbound[q] -= 1
        push(f, v, q)
        f.piece[v] = q


@inner
def let_go(r: Roads, f: Fleet, v: int, x: Limits) -> None:
    """Give back what is behind the truck."""
    if f.held_to[v] < f.held_from[v]:
        return
    p = f.piece[v]
    if f.at[v] == f.held_to[v] and is_safe_lane(r, p) and f.s[v] >= r.clear[p]:
        release(r, f, v, f.held_to[v] + 1)
    elif f.s[v] > 0.5 * x.length + 0.3:
        release(r, f, v, min(f.at[v], f.held_to[v]))


@inner
def arrive(r: Roads, f: Fleet, v: int) -> None:
    """Wait before the bay when its mark is reached."""
    if f.at[v] == f.last[v] and f.v[v] < REST and abs(f.s[v] - r.door_at[f.door[v]]) < NEAR:
        f.s[v] = r.door_at[f.door[v]]
        f.v[v] = 0.0
        f.mode[v] = Mode.AT_BAY
        f.waits[v] = np.inf


@inner
def roll_in(r: Roads, f: Fleet, v: int) -> None:
    """Turn onto the spur where its door is passed."""
    past = f.s[v] - r.door_at[f.door[v]]
    if f.entry[v] and past >= 0.0:
        f.spur[v], f.s[v] = past, r.door_at[f.door[v]]
        f.mode[v] = Mode.ENTERING
        f.waits[v] = np.inf


@inner
def clear_lane(r: Roads, f: Fleet, d: int) -> None:
    """The lane that door ``d`` crosses is free again."""
    if r.door_crosses[d] >= 0:
        f.crossed[r.door_crosses[d]] = -1


@inner
def end_spur(r: Roads, f: Fleet, v: int) -> None:
    """Stand in the bay, or on the lane, at the end of a spur."""
    d = f.door[v]
    lane = r.door_lane[d]
    spur = len(r.length) + 2 * len(r.clear) + d
    if f.mode[v] == Mode.ENTERING and r.door_length[d] - f.spur[v] < NEAR and f.v[v] < REST:
        f.spur[v] = r.door_length[d]
        f.v[v] = 0.0
        f.held[spur] -= 1
        clear_lane(r, f, d)
        drop(f, v, lane)
        f.on[lane] -= 1
        if f.held_to[v] >= f.held_from[v]:
            release(r, f, v, f.held_to[v] + 1)
        f.mode[v], f.entry[v] = Mode.PARKED, False
        f.piece[v] = -1
        f.left[v] = -1
        f.attention[v] = True
    elif f.mode[v] == Mode.LEAVING and f.spur[v] < NEAR and f.v[v] < REST:
        f.spur[v] = 0.0
        f.v[v] = 0.0
        f.held[spur] -= 1
        clear_lane(r, f, d)
        f.mode[v] = Mode.DRIVING
        f.at[v] = 0
        f.door[v] = f.goal[v]
        f.attention[v] = True

"""From piece to piece of a route, and into a bay and out of it."""

import numpy as np

from fleetlog.simulate.kernels.lanes import drop, inner, is_safe_lane, release
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
        f.ahead[v], f.tail[q], f.piece[v] = f.tail[q], v, q


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
def reach_door(r: Roads, f: Fleet, v: int) -> None:
    """Turn onto the spur where its door is passed and its ground reserved, or wait at rest before it."""
    past = f.s[v] - r.door_at[f.door[v]]
    if f.entry[v] and past >= 0.0:
        f.mode[v], f.spur[v] = Mode.ENTERING, past
    elif f.v[v] < REST and abs(past) < NEAR:
        f.mode[v], f.v[v] = Mode.AT_BAY, 0.0
    else:
        return
    f.s[v], f.waits[v] = r.door_at[f.door[v]], np.inf


@inner
def end_spur(r: Roads, f: Fleet, v: int) -> None:
    """Stand in the bay, or on the lane, at the end of a spur."""
    d, enters = f.door[v], f.mode[v] == Mode.ENTERING
    rest = r.door_length[d] - f.spur[v] if enters else f.spur[v]
    if rest >= NEAR or f.v[v] >= REST:
        return
    f.held[len(r.length) + 2 * len(r.clear) + d] -= 1
    if r.door_crosses[d] >= 0:
        f.crossed[r.door_crosses[d]] = -1
    f.v[v], f.attention[v] = 0.0, True
    if enters:
        lane = r.door_lane[d]
        drop(f, v, lane)
        f.on[lane] -= 1
        if f.held_to[v] >= f.held_from[v]:
            release(r, f, v, f.held_to[v] + 1)
        f.mode[v], f.entry[v], f.spur[v] = Mode.PARKED, False, r.door_length[d]
        f.piece[v], f.left[v] = -1, -1
    else:
        f.mode[v], f.at[v], f.door[v], f.spur[v] = Mode.DRIVING, 0, f.goal[v], 0.0

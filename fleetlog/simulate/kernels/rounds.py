"""Who may go where: all who want to go on ask in turn, who waits longest first."""

import numpy as np

from fleetlog.simulate.kernels.gates import try_enter, try_leave
from fleetlog.simulate.kernels.inner import inner
from fleetlog.simulate.kernels.lanes import is_safe_lane
from fleetlog.simulate.kernels.reserve import acquire
from fleetlog.simulate.state import Fleet, Limits, Mode, Roads


@inner
def wants_entry(r: Roads, f: Fleet, v: int, x: Limits) -> bool:
    """Whether a truck comes near its door without a reservation of the ground there."""
    if f.at[v] < f.last[v] or f.entry[v]:
        return False
    return r.door_at[f.door[v]] - f.s[v] < f.v[v] * f.v[v] / (2.0 * x.plan[v]) + 1.2 * f.v[v] + 1.0


@inner
def wants_passage(r: Roads, f: Fleet, v: int, x: Limits) -> bool:
    """Whether a truck comes near the end of its lane without a reservation, and is the first to."""
    if f.held_to[v] >= f.at[v] or f.at[v] >= f.last[v]:
        return False
    p = f.piece[v]
    if not is_safe_lane(r, p):
        return False
    if f.ahead[v] >= 0 and f.held_to[f.ahead[v]] <= f.at[f.ahead[v]]:
        return False
    return r.stop[p] - f.s[v] < f.v[v] * f.v[v] / (2.0 * x.plan[v]) + 1.2 * f.v[v] + 3.0


@inner
def reservations(r: Roads, f: Fleet, x: Limits, now: float) -> None:
    """One round: those who wait longest ask first."""
    f.round[0] += 1
    n = 0
    for v in range(len(f.mode)):
        m = f.mode[v]
        rolls = m == Mode.DRIVING and wants_entry(r, f, v, x)
        if (
            m == Mode.WANTS_OUT
            or m == Mode.AT_BAY
            or rolls
            or (m == Mode.DRIVING and wants_passage(r, f, v, x))
        ):
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
        else:
            answer = acquire(r, f, v, f.at[v], x, now - f.waits[v] > x.patience)
        f.why[v] = answer
        if answer == 0:
            f.waits[v] = np.inf

"""What every truck does at a moment, and what it has reserved: only changes are written down."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fleetlog.simulate.arrays import Flags, Floats, Index, Ints
from fleetlog.simulate.kernels.inner import inner
from fleetlog.simulate.state import CHARGER, STANDS, Mode

DRIVES, LADEN, WAITS, WAITS_FOR_PLACE, PICKS, DROPS, CHARGES, WAITS_FOR_CHARGER, PARKS, DEAD, NAMES = range(
    11
)
"""Activities in the order of :data:`fleetlog.store.events.ACTIVITIES`, and how many there are."""


class Trucks(NamedTuple):
    """(V,) of the fleet, and (V, n) routes; see :class:`fleetlog.simulate.state.Fleet`.
    ``task`` is -1 for none.
    """

    mode: NDArray[np.int8]
    v: Floats
    waits: Floats
    load: Floats
    hand_after: Floats
    door: Index
    goal: Index
    entry: Flags
    held_from: Index
    held_to: Index
    route: Index
    task: Ints
    lacks: NDArray[np.int8]


class Ground(NamedTuple):
    """(D,) place of every door, (P,) lanes on which trucks can stand, (R,) ways that exclude others."""

    place: Ints
    safe: Flags
    matters: Flags
    places: int
    lanes: int


class Seen(NamedTuple):
    """(V,) what was seen last: key of the activity and since when [ms], ends of the passage,
    door of the spur.
    """

    key: Ints
    since: Ints
    low: Index
    high: Index
    spur: Index


class Pages(NamedTuple):
    """Changes in order of time, and (3,) how many there are of each kind."""

    stretches: Ints
    """(n, 4) truck, key, since, until."""
    looks: Ints
    """(n, 2) truck whose reservations have changed, when."""
    held: Ints
    """(n, 3) truck, way that it has, when."""
    filled: Ints


@inner
def activity(t: Trucks, v: int) -> int:
    """What truck ``v`` does."""
    m = t.mode[v]
    if m == Mode.PARKED:
        if t.lacks[v] == CHARGER:
            return WAITS_FOR_CHARGER
        return WAITS_FOR_PLACE if t.lacks[v] > 0 or t.task[v] >= 0 else PARKS
    if m == Mode.HANDLING:
        return PICKS if t.hand_after[v] > 0.0 else DROPS
    if m == Mode.CHARGING:
        return CHARGES
    if m == Mode.EMPTY:
        return DEAD
    # Who has just been sent off has not been kept waiting yet.
    if (
        m == Mode.AT_BAY
        or (m == Mode.WANTS_OUT and t.waits[v] != np.inf)
        or (m == Mode.DRIVING and t.v[v] < STANDS)
    ):
        return WAITS
    return LADEN if t.load[v] > 0.0 else DRIVES


@inner
def way_of(t: Trucks, g: Ground, v: int, k: int) -> int:
    """The way that position ``k`` of a truck's passage stands for; see ``kernels.reserve.resource``."""
    piece = t.route[v, k]
    if g.safe[piece]:
        if k == t.held_to[v]:
            return len(g.safe) + g.lanes + piece
        if k == t.held_from[v]:
            return len(g.safe) + piece
    return piece


@inner
def hold(g: Ground, p: Pages, v: int, way: int, now: int) -> None:
    """Write down one way, unless it excludes nobody."""
    if g.matters[way]:
        n = p.filled[2]
        p.held[n, 0], p.held[n, 1], p.held[n, 2] = v, way, now
        p.filled[2] += 1


# Nothing is allocated here: see kernels.inner.
@njit(cache=True, _nrt=False)
def look(t: Trucks, g: Ground, s: Seen, p: Pages, first: int, now: int) -> int:
    """Look at the trucks from ``first`` on at ``now`` [ms];
    the first one that there was no room for, or how many there are.
    """
    for v in range(first, len(t.mode)):
        low, high = t.held_from[v], t.held_to[v]
        room = p.filled[2] + max(high - low, -1) + 2 <= len(p.held)
        if not room or p.filled[0] == len(p.stretches) or p.filled[1] == len(p.looks):
            return v
        doing = activity(t, v)
        door = t.goal[v] if doing <= LADEN and t.goal[v] >= 0 else t.door[v]
        key = ((t.task[v] + 1) * g.places + g.place[door]) * NAMES + doing
        if key != s.key[v]:
            if s.key[v] >= 0:
                n = p.filled[0]
                p.stretches[n, 0], p.stretches[n, 1], p.stretches[n, 2], p.stretches[n, 3] = (
                    v, s.key[v], s.since[v], now,
                )  # fmt: skip
                p.filled[0] += 1
            s.key[v], s.since[v] = key, now
        on_spur = t.mode[v] == Mode.LEAVING or t.mode[v] == Mode.ENTERING or t.entry[v]
        spur = t.door[v] if on_spur else -1
        if low == s.low[v] and high == s.high[v] and spur == s.spur[v]:
            continue
        s.low[v], s.high[v], s.spur[v] = low, high, spur
        p.looks[p.filled[1], 0], p.looks[p.filled[1], 1] = v, now
        p.filled[1] += 1
        for k in range(low, high + 1):
            hold(g, p, v, way_of(t, g, v, k), now)
        if spur >= 0:
            hold(g, p, v, len(g.safe) + 2 * g.lanes + spur, now)
    return len(t.mode)

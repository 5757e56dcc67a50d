"""What every truck does at a moment, and what it has reserved: only changes are written down."""

from typing import NamedTuple

from numba import njit
from numpy import inf

from fleetlog.simulate.arrays import Flags, Floats, Index, Ints, Modes
from fleetlog.simulate.kernels.inner import inner
from fleetlog.simulate.kernels.reserve import resource
from fleetlog.simulate.state import CHARGER, STANDS, Mode

(DRIVES, LADEN, WAITS, WAITS_FOR_PLACE, PICKS, DROPS, CHARGES, WAITS_FOR_CHARGER, PARKS, DEAD, NAMES) = range(
    11
)
"""Activities in the order of :data:`fleetlog.store.events.ACTIVITIES`, and how many there are."""


class Trucks(NamedTuple):
    """(V,) of the fleet, and (V, n) routes; see :class:`fleetlog.simulate.state.Fleet`; ``task`` -1: none."""

    mode: Modes
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
    lacks: Modes


class Ground(NamedTuple):
    """(D,) place of every door, (R,) ways that exclude others, number of places; the rest as in ``Roads``."""

    place: Ints
    matters: Flags
    places: int
    length: Floats
    clear: Floats
    capacity: Index


class Seen(NamedTuple):
    """(V,) key of the activity and since when [ms], ends of the passage, door of the spur, as seen last.

    ``way``, ``start`` (V, n) are what a truck has reserved and since when [ms], ``reserved`` (V,) how many;
    ``fresh``, ``begun`` (n,) the same of the truck that is looked at.
    """

    key: Ints
    since: Ints
    low: Index
    high: Index
    spur: Index
    reserved: Index
    way: Index
    start: Ints
    fresh: Index
    begun: Ints


class Pages(NamedTuple):
    """(n, 4) truck, key or way, since, until of what has ended, in this order; (2,) how many of each."""

    stretches: Ints
    held: Ints
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
    out = m == Mode.WANTS_OUT and t.waits[v] != inf
    if m == Mode.AT_BAY or out or (m == Mode.DRIVING and t.v[v] < STANDS):
        return WAITS
    return LADEN if t.load[v] > 0.0 else DRIVES


@inner
def write(page: Ints, filled: Ints, which: int, v: int, what: int, since: int, until: int) -> None:
    """Add a line to a page."""
    n = filled[which]
    page[n, 0], page[n, 1], page[n, 2], page[n, 3] = v, what, since, until
    filled[which] += 1


@inner
def has(g: Ground, s: Seen, n: int, way: int, now: int) -> int:
    """Make a way number ``n`` of those that the truck has, if it excludes others; how many it has."""
    if not g.matters[way]:
        return n
    s.fresh[n], s.begun[n] = way, now
    return n + 1


@inner
def note_ways(t: Trucks, g: Ground, s: Seen, p: Pages, v: int, now: int) -> None:
    """Write down what truck ``v`` has given back, and remember since when it has the rest."""
    low, high, n = t.held_from[v], t.held_to[v], 0
    for k in range(low, high + 1):
        n = has(g, s, n, resource(g, t, v, k, low, high), now)
    if s.spur[v] >= 0:
        n = has(g, s, n, len(g.length) + 2 * len(g.clear) + s.spur[v], now)
    for k in range(s.reserved[v]):
        i = 0
        while i < n and s.fresh[i] != s.way[v, k]:
            i += 1
        if i < n:
            s.begun[i] = s.start[v, k]
        else:
            write(p.held, p.filled, 1, v, s.way[v, k], s.start[v, k], now)
    s.reserved[v] = n
    for k in range(n):
        s.way[v, k], s.start[v, k] = s.fresh[k], s.begun[k]


# Nothing is allocated here: see kernels.inner.
@njit(cache=True, _nrt=False)
def look(t: Trucks, g: Ground, s: Seen, p: Pages, first: int, now: int) -> int:
    """Look at the trucks from ``first`` on at ``now`` [ms]; the first without room on the pages, or all."""
    for v in range(first, len(t.mode)):
        if p.filled[0] == len(p.stretches) or p.filled[1] + s.reserved[v] > len(p.held):
            return v
        doing = activity(t, v)
        door = t.goal[v] if doing <= LADEN and t.goal[v] >= 0 else t.door[v]
        key = ((t.task[v] + 1) * g.places + g.place[door]) * NAMES + doing
        if key != s.key[v]:
            if s.key[v] >= 0:
                write(p.stretches, p.filled, 0, v, s.key[v], s.since[v], now)
            s.key[v], s.since[v] = key, now
        on_spur = t.mode[v] == Mode.LEAVING or t.mode[v] == Mode.ENTERING or t.entry[v]
        spur = t.door[v] if on_spur else -1
        if t.held_from[v] != s.low[v] or t.held_to[v] != s.high[v] or spur != s.spur[v]:
            s.low[v], s.high[v], s.spur[v] = t.held_from[v], t.held_to[v], spur
            note_ways(t, g, s, p, v, now)
    return len(t.mode)

"""Trucks on paths of their own that wait before places until others have passed them."""

from typing import NamedTuple

import numpy as np

from fleetlog.compiling import inner, kernel
from fleetlog.core.arrays import Floats, Ints, Mask
from fleetlog.simulate.kernels.lanes import safe

STEP = 0.1  # [s]
BEFORE = 0.3  # A truck waits this far before the first node that it may not reach [m]
FAR = 2.0  # What lies so far beyond its braking distance does not concern a truck yet [m]
NEAR = 0.05  # A node this close ahead is reached [m]; slower than this a truck stands [m/s]
PATIENCE = 60.0  # A truck that has stood so long for one that stands for another is let past [s]
STANDS, ALONE, HINDERED = range(3)


class Drives(NamedTuple):
    """(N,) nodes of all trips, those of a truck in order: ``SpeedProfile`` of one alone, when it leaves them.

    (K + 1,) first nodes of trips, (K,) when a truck may leave, and how long it works after arrival [s]."""

    distance: Floats
    speed: Floats
    time: Floats
    leaves: Floats
    first: Ints
    leave: Floats
    work: Floats


class Gates(NamedTuple):
    """Truck v has gates first[v]:first[v + 1], in order of ``at``. Node ``at`` is closed until ``truck`` has
    reached ``node``, unless this ``side`` of a meeting goes first."""

    first: Ints
    at: Ints
    truck: Ints
    node: Ints
    meeting: Ints
    side: Ints


class State(NamedTuple):
    """(V,) where trucks are on their trips, (K,) what became of trips, (M,) who goes first at meetings.

    ``gate`` is the first that may be closed, ``clock`` the time since setting off where nobody hinders it,
    ``ready`` when it has done its last trip, ``waits`` how long it has stood for another [s]; ``goes_first``
    -1: not decided; ``past`` (1,) how often one of two that stood for each other was let past."""

    trip: Ints
    gate: Ints
    node: Ints
    phase: Ints
    x: Floats
    v: Floats
    clock: Floats
    ready: Floats
    waits: Floats
    begin: Floats
    took: Floats
    hindered: Mask
    goes_first: Ints
    past: Ints


def new_state(first_trip: Ints, d: Drives, g: Gates) -> State:
    """All before their first trip; where a truck stands then, it is the first."""
    v, k, trip = len(first_trip) - 1, len(d.leave), first_trip[:-1].copy()
    goes_first = np.full(g.meeting.max(initial=-1) + 1, -1)
    here = np.isin(g.at, d.first[trip])
    goes_first[g.meeting[here]] = g.side[here]
    trips = (np.zeros(k), np.zeros(k), np.zeros(k, np.bool_))
    first = (trip, g.first[:-1].copy(), d.first[trip] - 1, np.zeros(v, np.int64))
    return State._make([*first, *np.zeros((5, v)), *trips, goes_first, np.zeros(1, np.int64)])


@inner
def at_time(d: Drives, low: int, high: int, t: float) -> tuple[float, float]:
    """Distance and speed ``t`` [s] after setting off alone on the trip of nodes ``low`` to ``high`` - 1."""
    i = max(low + int(np.searchsorted(d.leaves[low : high - 1], t, side="right")) - 1, low)
    span = d.time[i + 1] - d.leaves[i]
    since = min(max(t - d.leaves[i], 0.0), span)
    a = (d.speed[i + 1] - d.speed[i]) / span if span > 0.0 else 0.0
    return d.distance[i] + d.speed[i] * since + 0.5 * a * since * since, d.speed[i] + a * since


@inner
def at_distance(d: Drives, node: int, high: int, x: float) -> tuple[float, float]:
    """Speed alone at ``x`` [m], at or after ``node``, and seconds after setting off."""
    i = node
    while i + 2 < high and d.distance[i + 1] <= x:
        i += 1
    ds = max(d.distance[i + 1] - d.distance[i], 1e-9)
    share = min(max((x - d.distance[i]) / ds, 0.0), 1.0)
    v0, v1 = d.speed[i], d.speed[i + 1]
    v = np.sqrt(v0 * v0 + share * (v1 * v1 - v0 * v0))
    took = 2.0 * share * ds / (v0 + v) if v0 + v > 1e-6 else 0.0
    return v, d.leaves[i] + took


@inner
def opens_before(d: Drives, g: Gates, s: State, q: int, ahead: float, pace: float, down: Floats) -> bool:
    """Whether gate ``q`` opens before a truck with ``ahead`` [m] to go comes there, at most at ``pace``: the
    other truck, on the trip in question, can no longer stop before it has passed."""
    other, i = g.truck[q], g.node[q]
    k = s.trip[other]
    if s.node[other] < d.first[k] or i >= d.first[k + 1]:
        return False
    v, rest = s.v[other], d.distance[i] - s.x[other]
    square = v * v - 2.0 * down[other] * rest
    return square > 0.0 and ((v - np.sqrt(square)) / down[other] + STEP) * pace < ahead


@inner
def room_ahead(d: Drives, g: Gates, s: State, u: int, up: Floats, down: Floats) -> float:
    """Metres to the first closed gate of a truck, inf where none concerns it; who comes first goes first."""
    low, high = d.first[s.trip[u]], d.first[s.trip[u] + 1]
    far, pace = s.v[u] * s.v[u] / (2.0 * down[u]) + FAR, s.v[u] + up[u] * STEP
    for q in range(s.gate[u], g.first[u + 1]):
        ahead, m = d.distance[g.at[q]] - BEFORE - s.x[u], g.meeting[q]
        if g.at[q] >= high or ahead > far:
            return np.inf
        if s.goes_first[m] < 0:
            s.goes_first[m] = g.side[q]
        if s.goes_first[m] == g.side[q] or s.node[g.truck[q]] >= g.node[q]:
            continue
        if s.waits[u] > PATIENCE and s.waits[g.truck[q]] > 0.0:
            s.goes_first[m], s.waits[u] = g.side[q], 0.0
            s.past[0] += 1
        elif not opens_before(d, g, s, q, ahead, pace, down):
            return max(ahead, d.distance[max(g.at[q] - 1, low)] - s.x[u])
    return np.inf


@inner
def go_on(d: Drives, s: State, u: int, room: float, step: float, up: float, down: float) -> None:
    """Move a truck as if it were alone or, where that would not stop within ``room`` [m], more slowly."""
    k = s.trip[u]
    low, high = d.first[k], d.first[k + 1]
    if s.phase[u] == ALONE:
        ahead, v = at_time(d, low, high, s.clock[u] + step)
        if ahead == s.x[u] or ahead - s.x[u] + v * v / (2.0 * down) <= room:
            s.x[u], s.v[u], s.clock[u] = ahead, v, s.clock[u] + step
        else:
            s.phase[u], s.hindered[k] = HINDERED, True
    if s.phase[u] == HINDERED:
        cap, _ = at_distance(d, s.node[u], high, s.x[u] + max(s.v[u] * step, NEAR))
        v = min(min(s.v[u] + up * step, cap), safe(s.v[u], max(room, 0.0), 0.0, down, step))
        v = max(max(v, s.v[u] - down * step), 0.0)
        s.x[u] += 0.5 * (s.v[u] + v) * step
        s.v[u] = v
        alone, clock = at_distance(d, s.node[u], high, s.x[u])
        if v >= alone - 0.01:
            s.phase[u], s.clock[u] = ALONE, clock
    stands = s.phase[u] == HINDERED and s.v[u] < NEAR and room < np.inf
    s.waits[u] = s.waits[u] + step if stands else 0.0
    while s.node[u] + 1 < high and d.distance[s.node[u] + 1] <= s.x[u] + NEAR:
        s.node[u] += 1


@inner
def arrives(d: Drives, s: State, u: int, now: float) -> bool:
    """Whether a truck is at the end of its trip at ``now`` [s]; it turns to its next one then."""
    k = s.trip[u]
    last = d.first[k + 1] - 1
    late = s.clock[u] - d.time[last]
    alone = s.phase[u] == ALONE and late >= 0.0
    if not alone and (d.distance[last] - s.x[u] >= NEAR or s.v[u] >= NEAR):
        return False
    s.took[k] = now - s.begin[k] - (late if alone else 0.0)
    s.ready[u] = s.begin[k] + s.took[k] + d.work[k]
    s.node[u], s.phase[u], s.trip[u], s.x[u], s.v[u] = last, STANDS, k + 1, 0.0, 0.0
    return True


@kernel()
def meet(first_trip: Ints, d: Drives, g: Gates, s: State, up: Floats, down: Floats) -> Floats:
    """Drive all trips, those of truck v being ``first_trip[v]:first_trip[v + 1]``; (M, 4) trip, seconds since
    it began, distance, speed at every step."""
    log, n, left, now = np.empty((65536, 4)), 0, len(d.leave), 0.0
    while left > 0:
        soonest = np.inf
        for u in range(len(first_trip) - 1):
            k, step = s.trip[u], STEP
            if k == first_trip[u + 1]:
                continue
            if s.phase[u] == STANDS:
                start = max(d.leave[k], s.ready[u])
                soonest = min(soonest, start)
                if start >= now + STEP:
                    continue
                s.begin[k], step = start, min(now + STEP - start, STEP)
                s.node[u], s.phase[u], s.clock[u] = d.first[k], ALONE, 0.0
            soonest = now
            # Gates that cannot close any more are forgotten.
            while s.gate[u] < g.first[u + 1]:
                p = s.gate[u]
                goes = s.goes_first[g.meeting[p]]
                if goes < 0 or (goes != g.side[p] and s.node[g.truck[p]] < g.node[p]):
                    break
                s.gate[u] += 1
            go_on(d, s, u, room_ahead(d, g, s, u, up, down), step, up[u], down[u])
            if n == len(log):
                log = np.concatenate((log, np.empty_like(log)))
            log[n, 0], log[n, 1], log[n, 2], log[n, 3] = k, now + STEP - s.begin[k], s.x[u], s.v[u]
            n += 1
            left -= arrives(d, s, u, now + STEP)
        # While nobody drives nothing happens.
        now = max(now + STEP, np.floor(soonest / STEP) * STEP)
    return log[:n]

"""Trucks on paths of their own that wait before places until others have passed them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from fleetlog.simulate.arrays import Floats, Ints
from fleetlog.simulate.kernels.inner import inner
from fleetlog.simulate.kernels.lanes import safe

STEP = 0.1
"""[s]"""
BEFORE = 0.3
"""A truck waits this far before the first node that it may not reach [m]."""
FAR = 2.0
"""What lies so far beyond its braking distance does not concern a truck yet [m]."""
NEAR = 0.05
"""A node this close ahead is reached [m]; slower than this a truck stands [m/s]."""
PATIENCE = 60.0
"""A truck that has stood so long for one that stands for another is let past [s]."""
STANDS, ALONE, HINDERED = range(3)


class Drives(NamedTuple):
    """N nodes of all trips, those of a truck in order: ``SpeedProfile`` of a truck alone; K trips: their first nodes
    (K + 1,), when a truck may leave [s], and how long it works after the arrival [s].
    """

    distance: Floats
    speed: Floats
    time: Floats
    wait: Floats
    first: Ints
    leave: Floats
    work: Floats


class Gates(NamedTuple):
    """Truck v, gates first[v]:first[v + 1] in order: node ``at`` is closed until ``truck`` has reached ``node``.

    That is where the other side of the ``meeting`` goes first.
    """

    first: Ints
    at: Ints
    truck: Ints
    node: Ints
    meeting: Ints
    side: Ints


@inner
def at_time(d: Drives, low: int, high: int, t: float) -> tuple[float, float]:
    """Distance and speed ``t`` [s] after setting off alone on the trip of nodes ``low`` to ``high`` - 1."""
    i, end = low, high - 1
    while end - i > 1:
        middle = (i + end) // 2
        if d.time[middle] + d.wait[middle] <= t:
            i = middle
        else:
            end = middle
    leave = d.time[i] + d.wait[i]
    span = d.time[i + 1] - leave
    since = min(max(t - leave, 0.0), span)
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
    return v, d.time[i] + d.wait[i] + took


@inner
def opens_in(rest: float, v: float, down: float) -> float:
    """Seconds in which a truck goes ``rest`` [m] even if it brakes from now on; inf where it could stop before."""
    square = v * v - 2.0 * down * rest
    return (v - np.sqrt(square)) / down if square > 0.0 else np.inf


@njit(cache=True)
def meet(first_trip: Ints, d: Drives, g: Gates, up: Floats, down: Floats) -> Any:
    """Drive all trips, those of truck v being ``first_trip[v]:first_trip[v + 1]``.

    (K,) when each began and how long it took [s], whether others hindered it; how often one was let past; and
    (M, 4) trip, seconds since it began, distance, speed at every step.
    """
    trucks, trips = len(first_trip) - 1, len(d.leave)
    trip, gate = first_trip[:-1].copy(), g.first[:-1].copy()
    node, phase = np.zeros(trucks, np.int64), np.zeros(trucks, np.int64)
    x, v, tau, ready = np.zeros(trucks), np.zeros(trucks), np.zeros(trucks), np.full(trucks, -np.inf)
    begin, took, hindered = np.zeros(trips), np.zeros(trips), np.zeros(trips, np.bool_)
    waits, blocked = np.zeros(trucks), np.zeros(trucks, np.bool_)
    log, n, left, now, forced = np.empty((65536, 4)), 0, trips, 0.0, 0
    goes_first = np.full(g.meeting.max() + 1 if len(g.meeting) else 0, -1)
    for u in range(trucks):
        node[u] = d.first[trip[u]] - 1
        for q in range(g.first[u], g.first[u + 1]):
            # Where a truck stands at first it is first.
            if g.at[q] == d.first[trip[u]] and goes_first[g.meeting[q]] < 0:
                goes_first[g.meeting[q]] = g.side[q]
    while left > 0:
        reached, was_at, was_on, pace, stuck = node.copy(), x.copy(), trip.copy(), v.copy(), blocked.copy()
        for u in range(trucks):
            k, step = trip[u], STEP
            if k == first_trip[u + 1] or (phase[u] == STANDS and now + STEP <= max(d.leave[k], ready[u])):
                continue
            low, high = d.first[k], d.first[k + 1]
            while gate[u] < g.first[u + 1]:
                p = gate[u]
                goes = goes_first[g.meeting[p]]
                if goes < 0 or (goes != g.side[p] and reached[g.truck[p]] < g.node[p]):
                    break
                gate[u] += 1
            room, stop, at = np.inf, high, x[u] if phase[u] != STANDS else 0.0
            for q in range(gate[u], g.first[u + 1]):
                ahead = d.distance[g.at[q]] - BEFORE - at
                if g.at[q] >= high or ahead > v[u] * v[u] / (2.0 * down[u]) + FAR:
                    break
                i, other = g.node[q], g.truck[q]
                if goes_first[g.meeting[q]] < 0:
                    # Who comes first goes first.
                    goes_first[g.meeting[q]] = g.side[q]
                if goes_first[g.meeting[q]] == g.side[q] or reached[other] >= i:
                    continue
                if reached[other] >= d.first[was_on[other]] and i < d.first[was_on[other] + 1]:
                    rest = d.distance[i] - was_at[other]
                    if opens_in(rest, pace[other], down[other]) * (v[u] + up[u] * step) < ahead:
                        continue
                if waits[u] > PATIENCE and q == gate[u] and stuck[other]:
                    goes_first[g.meeting[q]], waits[u], forced = g.side[q], 0.0, forced + 1
                    continue
                stop = g.at[q]
                room = max(ahead, d.distance[max(stop - 1, low)] - at)
                break
            if phase[u] == STANDS:
                start = max(d.leave[k], ready[u])
                begin[k], step, phase[u] = start, min(now + STEP - start, STEP), ALONE
                node[u], x[u], v[u], tau[u] = low, 0.0, 0.0, 0.0
            if phase[u] == ALONE:
                s1, v1 = at_time(d, low, high, tau[u] + step)
                if s1 > x[u] and s1 - x[u] + v1 * v1 / (2.0 * down[u]) > room:
                    phase[u], hindered[k] = HINDERED, True
                else:
                    x[u], v[u], tau[u] = s1, v1, tau[u] + step
            if phase[u] == HINDERED:
                cap, _ = at_distance(d, node[u], high, x[u] + max(v[u] * step, NEAR))
                new = min(min(v[u] + up[u] * step, cap), safe(v[u], max(room, 0.0), 0.0, down[u], step))
                new = max(max(new, v[u] - down[u] * step), 0.0)
                x[u] += 0.5 * (v[u] + new) * step
                v[u] = new
                alone, clock = at_distance(d, node[u], high, x[u])
                if v[u] >= alone - 0.01:
                    phase[u], tau[u] = ALONE, clock
            blocked[u] = phase[u] == HINDERED and v[u] < NEAR and stop < high
            waits[u] = waits[u] + step if blocked[u] else 0.0
            while node[u] + 1 < high and d.distance[node[u] + 1] <= x[u] + NEAR:
                node[u] += 1
            if n == len(log):
                log = np.concatenate((log, np.empty_like(log)))
            log[n, 0], log[n, 1], log[n, 2], log[n, 3] = k, now + STEP - begin[k], x[u], v[u]
            n += 1
            late = tau[u] - d.time[high - 1]
            there = phase[u] == ALONE and late >= 0.0
            if there or (d.distance[high - 1] - x[u] < NEAR and v[u] < NEAR):
                took[k] = now + STEP - begin[k] - (late if there else 0.0)
                ready[u] = begin[k] + took[k] + d.work[k]
                node[u], phase[u], trip[u], v[u], left = high - 1, STANDS, k + 1, 0.0, left - 1
        now += STEP
    return begin, took, hindered, forced, log[:n]

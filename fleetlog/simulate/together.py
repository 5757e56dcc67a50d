"""Recorded missions in one another's way.

Every truck drives its own path. At a place that two want, the one that passed it first in the recording passes it
first again, and the other waits before it until there is room: the order of an action dependency graph (Hönig,
Kiesel, Tinka, Durham and Ayanian 2019, Persistent and robust execution of MAPF schedules in warehouses). Since
every wait is for something that the recording has earlier, no ring of trucks can wait for one another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pandas as pd

from fleetlog.core.truck import Truck
from fleetlog.physics.motion.legs import Leg
from fleetlog.physics.motion.profile import SpeedProfile
from fleetlog.simulate.arrays import Floats, Ints
from fleetlog.simulate.junctions import half_box
from fleetlog.simulate.retrace import Trip, VehicleReplay

WINDOW = 180.0
"""Who passes a place so much later than another cannot meet it there [s]."""
AFTER = 6.0
"""A truck that set off at most so long after the way ahead became free had stood for that [s]."""
REACH = 12.0
"""How far ahead of a standing truck that is looked for [m]."""


class Nodes(NamedTuple):
    """(N,) nodes of all trips, truck after truck: where, when in the recording [s], whose, how far on its trip [m]."""

    x: Floats
    y: Floats
    heading: Floats
    time: Floats
    truck: Ints
    distance: Floats


def meet_again(replays: Sequence[VehicleReplay], truck: Truck) -> float:
    """Let the trips of all trucks wait for one another; the share of the travel time that is lost by that."""
    trips = [(u, trip) for u, r in enumerate(replays) for trip in r.trips if trip.leg is not None]
    start = min(r.recorded.time[0] for r in replays)
    clock = [float(r.recorded.time[0] - start) * 1e-6 for r in replays]
    nodes = _nodes(trips, clock)
    first = np.cumsum([0, *(len(_leg(t).distance) for _, t in trips)])
    gates = _gates(nodes, half_box(truck), len(replays))
    for k, (u, trip) in enumerate(trips):
        stops = _own_stops(_leg(trip), nodes, gates, int(first[k]))
        if len(stops) < len(_leg(trip).stops):
            replays[u].drive_on(trip, replace(_leg(trip), stops=stops))
    return _driven(replays, trips, clock, first, _needed(gates, nodes))


def _leg(trip: Trip) -> Leg:
    assert trip.leg is not None
    return trip.leg


def _nodes(trips: Sequence[tuple[int, Trip]], clock: Sequence[float]) -> Nodes:
    legs = [(u, _leg(trip)) for u, trip in trips]
    x, y, heading = (np.concatenate([getattr(g.path, c) for _, g in legs]) for c in ("x", "y", "heading"))
    time = np.concatenate([g.path.time + clock[u] for u, g in legs])
    owner = np.concatenate([np.full(len(g.distance), u) for u, g in legs])
    return Nodes(x, y, heading, time, owner, np.concatenate([g.distance for _, g in legs]))


def _gates(n: Nodes, half: tuple[float, float], trucks: int) -> pd.DataFrame:
    """Node ``at`` could be entered when ``truck`` had reached its ``node``: a row a node and other truck."""
    parts = [_met(n, half, begin) for begin in np.arange(n.time.min(), n.time.max() + 1e-3, WINDOW)]
    met = pd.DataFrame(np.concatenate(parts), columns=["at", "node"])
    met["truck"] = n.truck[met.node]
    found = met.groupby(["at", "truck"])["node"].max().reset_index()
    # Past what was met, or as far as the recording shows that it was by then.
    ends = np.searchsorted(n.truck, np.arange(trucks + 1))
    for u in range(trucks):
        rows = found.truck == u
        own = n.time[ends[u] : ends[u + 1]]
        last = ends[u] + np.searchsorted(own, n.time[found["at"][rows]]) - 1
        found.loc[rows, "node"] = np.minimum(found.node[rows] + 1, last)
    return found


def _met(n: Nodes, half: tuple[float, float], begin: float) -> Ints:
    """(P, 2) later and earlier node of footprints of two trucks that meet, from a time on for two windows."""
    from fleetlog.simulate.kernels.geometry import meetings

    rows = np.flatnonzero((n.time >= begin) & (n.time < begin + 2.0 * WINDOW))
    if not len(rows):
        return np.zeros((0, 2), np.int64)
    x, y, heading, flat = n.x[rows], n.y[rows], n.heading[rows], np.zeros(len(rows))
    every, skip = np.ones(len(rows), bool), np.full(len(rows), -1, np.int32)
    pairs = rows[meetings(x, y, flat, heading, n.truck[rows].astype(np.int32), every, *half, skip)]
    gap = n.time[pairs[:, 0]] - n.time[pairs[:, 1]]
    near = (np.abs(gap) <= WINDOW) & (gap != 0.0)
    return np.asarray(np.where(gap[near, None] > 0.0, pairs[near], pairs[near][:, ::-1]))


def _needed(gates: pd.DataFrame, n: Nodes) -> pd.DataFrame:
    """The gates that say more of a truck than those before them, in order."""
    gates = gates.assign(owner=n.truck[gates["at"]]).sort_values(["at", "truck"])
    known = gates.groupby(["owner", "truck"]).node.cummax()
    before = known.groupby([gates.owner, gates.truck]).shift(fill_value=-1)
    return gates[gates.node > before]


def _own_stops(leg: Leg, n: Nodes, gates: pd.DataFrame, first: int) -> dict[int, float]:
    """The stops on the way at which no other truck was in the way."""
    kept = {}
    for k, seconds in leg.stops.items():
        until = n.time[first + k] + seconds
        end = first + int(np.searchsorted(leg.distance, leg.distance[k] + REACH))
        low, high = np.searchsorted(gates["at"], [first + k, end])
        opened = n.time[gates.node[low:high]]
        if not ((opened > until - min(seconds, AFTER)) & (opened <= until + 1.0)).any():
            kept[k] = seconds
    return kept


def _driven(
    replays: Sequence[VehicleReplay], trips: Sequence[tuple[int, Trip]], clock: Sequence[float], first: Ints,
    gates: pd.DataFrame,
) -> float:  # fmt: skip
    """Give each hindered trip its beginning and its drive."""
    from fleetlog.simulate.kernels.meet import Drives, Gates, meet

    alone = [trip.drive for _, trip in trips if trip.drive is not None]
    columns = (np.concatenate([getattr(p, c) for p in alone]) for c in ("distance", "speed", "time", "wait"))
    leave = np.array([clock[u] + replays[u].earliest(trip) for u, trip in trips])
    work = np.array([replays[u].work(trip) for u, trip in trips])
    trucks = np.arange(len(replays) + 1)
    owner = np.array([u for u, _ in trips])
    table = (gates[c].to_numpy(np.int64) for c in ("at", "truck", "node"))
    begin, took, hindered, log = meet(
        np.searchsorted(owner, trucks), Drives._make([*columns, first, leave, work]),
        Gates._make([np.searchsorted(gates.owner, trucks), *table]),
        np.array([r.physics.actual_truck().drive.max_acceleration for r in replays]),
        np.array([r.physics.actual_truck().drive.max_deceleration for r in replays]),
    )  # fmt: skip
    log = log[np.argsort(log[:, 0], kind="stable")]
    rows = np.searchsorted(log[:, 0], np.arange(len(trips) + 1))
    free = sum(p.duration for p in alone)
    for k in np.flatnonzero(hindered).tolist():
        u, trip = trips[k]
        _, t, x, v = log[rows[k] : rows[k + 1]][log[rows[k] : rows[k + 1], 1] < took[k] - 1e-6].T
        t, v = np.concatenate([[0.0], t, [took[k]]]), np.concatenate([[0.0], v, [0.0]])
        x = np.concatenate([[0.0], x, [_leg(trip).distance[-1]]])
        trip.begin, trip.drive = float(begin[k] - clock[u]), SpeedProfile(x, v, t, np.zeros(len(t)))
    lost = took.sum() - free
    return float(lost / took.sum())

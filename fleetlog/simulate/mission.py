"""The same mission as a recording, as the model drives it: each truck by itself, so that what differs is the
physics and not the traffic, or in one another's way."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from fleetlog.core.arrays import Ints
from fleetlog.core.truck import Truck
from fleetlog.errors import DataError
from fleetlog.listening import progress
from fleetlog.physics.motion.legs import SpeedProfile
from fleetlog.physics.power import Physics
from fleetlog.simulate.junctions import half_box
from fleetlog.simulate.places import joined
from fleetlog.simulate.retrace import Trip, VehicleReplay
from fleetlog.simulate.track import lane_shift
from fleetlog.store.dataset import Dataset
from fleetlog.store.writer import DatasetWriter

WINDOW = 60.0  # Who would be at a place so much later than another does not meet it there [s]
CLOSE = 6  # Touching nodes of two trucks so many nodes apart are one meeting
AFTER = 6.0  # A truck that set off at most so long after the way ahead became free had stood for that [s]
REACH = 12.0  # How far ahead of a standing truck that is looked for [m]


@dataclass
class MissionSummary:
    """How replay and recording compare over all trips of some length."""

    vehicles: int
    trips: int
    rows: int
    distance_ratio: float
    duration_ratio: float
    energy_ratio: float
    own_path: int  # Trips off the roads, which follow their recorded positions
    lost_share: float | None = None  # Of the travel time, to other trucks; None where each drives by itself
    let_past: int | None = None  # How often a truck was let past another, as each waited for the other


def replay(
    dataset: Dataset, truck: Truck, writer: DatasetWriter, physics: Physics | None = None,
    together: bool = False, temperature: float = np.nan,
) -> MissionSummary:  # fmt: skip
    """Drive every recorded trip of ``dataset`` through the model, under the same vehicle and trip ids.

    Rows come at the recorded interval.  Loads, fork heights, charging and temperature are the recorded ones,
    shifted to the simulated arrival; where a trip takes longer than it took, the next one sets off later.
    ``together`` the trucks keep to their lanes and wait for one another.  ``temperature`` of the air [degC]
    holds where the recording has none."""
    network, physics, lost, past = dataset.site.network, physics or Physics(truck), None, None
    lanes = np.zeros(1 if network is None else len(network))
    if together and network is not None:
        lanes = lane_shift(network, truck, dataset.site.traffic)
    recorded = (t for vehicle in dataset.vehicles if len(t := dataset.read(vehicle)) > 1)
    replays: Iterable[VehicleReplay] = (
        VehicleReplay(t, dataset, truck, physics, writer, lanes, temperature) for t in recorded
    )
    if together:
        replays = found = list(replays)
        lost, past = meet_again(found, truck)
    total, rows, trips, own = np.zeros(6), 0, 0, 0
    for i, one in enumerate(replays):
        one.run()
        driven = [t.leg for t in one.trips if t.leg is not None]
        total, rows, trips = total + one.totals, rows + one.written, trips + len(driven)
        own += sum(bool((leg.path.edge < 0).all()) for leg in driven)
        progress("simulating", (i + 1) / len(dataset.vehicles))
    if not trips:
        do = "import it with speed or denser positions"
        raise DataError("the recording has no trip", where=dataset.path, do=do)
    distance, duration, energy = (float(b / a) if a > 0.0 else float("nan") for a, b in total.reshape(2, 3).T)
    return MissionSummary(len(dataset.vehicles), trips, rows, distance, duration, energy, own, lost, past)


def meet_again(replays: Sequence[VehicleReplay], truck: Truck) -> tuple[float, int]:
    """Let trucks wait for one another: the share of travel time that they lose; how many were let past."""
    every = ((u, trip, trip.leg) for u, r in enumerate(replays) for trip in r.trips)
    if not (driven := [(u, trip, leg) for u, trip, leg in every if leg is not None]):
        return 0.0, 0
    start = min(r.recorded.time[0] for r in replays)
    clock = [float(r.recorded.time[0] - start) * 1e-6 for r in replays]
    first = np.cumsum([0, *(len(leg.distance) for *_, leg in driven)])
    trips = [(u, trip) for u, trip, _ in driven]
    half = half_box(truck)
    nodes = _nodes(replays, trips, clock)
    was = _gates(nodes.assign(alone=nodes.recorded), half)
    recorded = nodes.recorded.to_numpy()
    for (u, trip, leg), begin in zip(driven, first.tolist()[:-1], strict=True):
        stops = dict[int, float]()  # On the way, with no other truck in the way
        for k, seconds in leg.stops.items():
            until = recorded[begin + k] + seconds
            end = begin + int(np.searchsorted(leg.distance, leg.distance[k] + REACH))
            low, high = np.searchsorted(was["at"], [begin + k, end])
            opened = recorded[was.node[low:high]]
            if not ((opened > until - min(seconds, AFTER)) & (opened <= until + 1.0)).any():
                stops[k] = seconds
        if len(stops) < len(leg.stops):
            trip.leg = replace(leg, stops=stops)
            trip.drive = replays[u].free_flow(trip.leg)
    return _driven(replays, trips, clock, first, _gates(_nodes(replays, trips, clock), half))


def _nodes(
    replays: Sequence[VehicleReplay], trips: Sequence[tuple[int, Trip]], clock: Sequence[float]
) -> pd.DataFrame:
    """All nodes, truck after truck: where, when in the recording and when alone [s], whose, on which trip."""
    parts, ready = [], dict.fromkeys(range(len(replays)), -np.inf)
    for k, (u, trip) in enumerate(trips):
        assert trip.leg is not None and trip.drive is not None
        begin, path = max(trip.earliest, ready[u]), trip.leg.path
        ready[u] = begin + trip.drive.duration + trip.work
        recorded, alone = path.time + clock[u], begin + trip.drive.time + clock[u]
        where = {"x": path.x, "y": path.y, "heading": path.heading}
        parts.append(pd.DataFrame(where | {"recorded": recorded, "alone": alone, "truck": u, "trip": k}))
    return pd.concat(parts, ignore_index=True)


def _gates(n: pd.DataFrame, half: tuple[float, float]) -> pd.DataFrame:
    """A row a node and meeting: after ``truck``, node ``at`` is free when that has reached its ``node``;
    ``side`` says which of the two trucks of ``meeting`` it is whose node ``at`` is."""
    pairs, truck, trip = _met(n, half), n.truck.to_numpy(), n.trip.to_numpy()
    # Nodes of different trips are never neighbours.
    cells, cell = np.unique((pairs + 3 * CLOSE * trip[pairs]) // CLOSE, axis=0, return_inverse=True)
    meeting = joined(cells, 1.5)[cell.ravel()]
    parts = []
    for side in (0, 1):
        rows = pd.DataFrame({"at": pairs[:, side], "meeting": meeting, "node": pairs[:, 1 - side]})
        rows = rows.groupby(["at", "meeting"])["node"].max().reset_index()
        parts.append(rows.assign(side=side, truck=truck[rows.node]))
    found = pd.concat(parts, ignore_index=True)
    # Past the last node that is touched; who has arrived stands in nobody's way.
    ahead = np.minimum(found.node + 1, len(n) - 1)
    found["node"] = np.where(trip[ahead] == trip[found.node], ahead, found.node)
    found["owner"] = truck[found["at"]]
    found = found.sort_values(["at", "meeting"])
    # What says no more than a gate before it is none.
    of = [found.meeting, found.side]
    before = found.groupby(of).node.cummax().groupby(of).shift(fill_value=-1)
    return pd.DataFrame(found[found.node > before])


def _met(n: pd.DataFrame, half: tuple[float, float]) -> Ints:
    """(P, 2) nodes whose footprints touch, of two trucks that are there within ``WINDOW``."""
    from fleetlog.simulate.kernels.geometry import meetings

    found = [np.zeros((0, 2), np.int64)]
    for begin in np.arange(n.alone.min(), n.alone.max() + 1e-3, WINDOW):
        if len(own := n[(n.alone >= begin) & (n.alone < begin + 2.0 * WINDOW)]):
            boxes, trucks = own[["x", "y", "heading"]].to_numpy().T.copy(), own.truck.to_numpy(np.int32)
            flat, every = np.zeros(len(own)), np.ones(len(own), bool)
            touch = meetings(boxes[0], boxes[1], flat, boxes[2], trucks, every, *half)
            found.append(own.index.to_numpy()[touch])
    return np.unique(np.sort(np.concatenate(found), axis=1), axis=0)


def _driven(
    replays: Sequence[VehicleReplay], trips: Sequence[tuple[int, Trip]], clock: Sequence[float], first: Ints,
    gates: pd.DataFrame,
) -> tuple[float, int]:  # fmt: skip
    """Give each hindered trip its beginning and its drive."""
    from fleetlog.simulate.kernels.meet import Drives, Gates, meet, new_state

    alone = [trip.drive for _, trip in trips if trip.drive is not None]
    columns = [np.concatenate([getattr(p, c) for p in alone]) for c in ("distance", "speed", "time")]
    leaves = np.concatenate([p.time + p.wait for p in alone])
    leave = np.array([clock[u] + trip.earliest for u, trip in trips])
    drives = Drives._make([*columns, leaves, first, leave, np.array([trip.work for _, trip in trips])])
    trucks = np.arange(len(replays) + 1)
    table = (gates[c].to_numpy(np.int64) for c in ("at", "truck", "node", "meeting", "side"))
    closed = Gates._make([np.searchsorted(gates.owner, trucks), *table])
    first_trip = np.searchsorted([u for u, _ in trips], trucks)
    limits = [r.physics.actual_truck.drive for r in replays]
    up, down = (np.array([getattr(d, f"max_{c}") for d in limits]) for c in ("acceleration", "deceleration"))
    state = new_state(first_trip, drives, closed)
    log = meet(first_trip, drives, closed, state, up, down)
    log = log[np.argsort(log[:, 0], kind="stable")]
    rows, lost = np.searchsorted(log[:, 0], np.arange(len(trips) + 1)), 0.0
    for k in np.flatnonzero(state.hindered).tolist():
        (u, trip), took = trips[k], float(state.took[k])
        _, t, x, v = log[rows[k] : rows[k + 1]].T
        on = slice(int(np.searchsorted(t, took - 1e-6)))
        t, v = np.concatenate([[0.0], t[on], [took]]), np.concatenate([[0.0], v[on], [0.0]])
        x = np.concatenate([[0.0], x[on], [alone[k].distance[-1]]])
        trip.begin, trip.drive = float(state.begin[k] - clock[u]), SpeedProfile(x, v, t, np.zeros(len(t)))
        lost += took - alone[k].duration
    return lost / (sum(p.duration for p in alone) + lost), int(state.past[0])

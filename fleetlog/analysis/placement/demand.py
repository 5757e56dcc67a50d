"""Where trucks need a charger: visits, standstills and urgency per road vertex."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.network import Network
from fleetlog.core.trajectory import Floats, Ints, Trajectory
from fleetlog.store import Dataset
from fleetlog.store.days import each_day
from fleetlog.store.trips import MAX_GAP, STANDING_SPEED, runs

ENOUGH_SOC, LEAST_SOC = 0.5, 0.2
"""Urgency rises from 0 at the first to 1 at the second state of charge."""
LOAD_CHANGE = 25.0
COLUMNS = ("edge_id", "edge_offset", "speed", "soc", "payload", "x", "y")


@dataclass(frozen=True)
class Unit:
    """What one vehicle did on one day, per road vertex (n,); left out in turn to test stability."""

    vehicle: str
    day: int
    visits: list[Ints]
    standing: Floats
    """Seconds of standstills of at least the shortest useful time."""
    urgent: Floats
    """The same, weighted by the urgency of the state of charge."""
    loading: Floats
    """Payload changes."""
    open_spells: list[tuple[int, int]]
    """Start and end (int64 us) of those standstills with urgency, for the number of plugs."""
    spell_vertices: list[int]
    """The vertex of each of them, -1 off the map."""


def urgency(soc: Floats, enough: float = ENOUGH_SOC, least: float = LEAST_SOC) -> Floats:
    """clip((enough - soc) / (enough - least), 0, 1); 0 where unknown."""
    return np.nan_to_num(np.clip((enough - soc) / (enough - least), 0.0, 1.0))


def read_units(dataset: Dataset, shortest: float) -> list[Unit]:
    """Every vehicle-day; ``shortest`` [s] is the least standstill in which charging is worth plugging in."""
    return list(each_day(dataset, _unit, shortest, kinds=(Unit,)))


def _unit(dataset: Dataset, vehicle: str, date: str, shortest: float) -> Unit:
    t, network = dataset.read(vehicle, date, COLUMNS), dataset.site.roads()
    n = len(network.node_ids)
    edge = t.labels("edge_id").recode(network.index)
    vertex = _nearest_vertex(t, edge, network)
    time = t.seconds()
    dt = np.clip(np.diff(time, append=time[-1:]), 0.0, MAX_GAP)
    stands = np.nan_to_num(t.floats("speed"), nan=1.0) <= STANDING_SPEED
    u = urgency(t.floats("soc"))
    standing, urgent = np.zeros(n), np.zeros(n)
    spells: list[tuple[int, int]] = []
    places: list[int] = []
    for a, b in runs(stands):
        if dt[a:b].sum() < shortest:
            continue
        on = vertex[a:b] >= 0
        np.add.at(standing, vertex[a:b][on], dt[a:b][on])
        np.add.at(urgent, vertex[a:b][on], (dt * u)[a:b][on])
        if (u[a:b] > 0).any():
            spells.append((int(t.time[a]), int(t.time[b - 1])))
            places.append(int(vertex[a]))
    payload = t.floats("payload")
    changed = np.flatnonzero(np.abs(np.diff(payload)) > LOAD_CHANGE)
    loading = np.bincount(vertex[changed][vertex[changed] >= 0], minlength=n).astype(float)
    day, visits = int(t.time[0] // 86_400_000_000), _visits(edge, time, network)
    return Unit(t.vehicle_id, day, visits, standing, urgent, loading, spells, places)


def _nearest_vertex(t: Trajectory, edge: NDArray[np.int32], network: Network) -> Ints:
    """The nearer end of the edge that a row is on; -1 off the map."""
    offset = np.nan_to_num(t.floats("edge_offset"))
    ends = np.where(offset < 0.5 * network.length[edge], network.start[edge], network.end[edge])
    return np.where(edge >= 0, ends, -1).astype(np.int64)


def _visits(edge: NDArray[np.int32], time: Floats, network: Network) -> list[Ints]:
    """Sequences of vertices in the order driven, broken at gaps, off the map, and where edges do not join."""
    out: list[list[int]] = [[]]
    for i in np.flatnonzero(np.diff(edge, prepend=-2)).tolist():
        e = int(edge[i])
        gap = i > 0 and time[i] - time[i - 1] > MAX_GAP
        if e < 0 or gap or (out[-1] and out[-1][-1] != network.start[e]):
            out.append([])
        if e >= 0:
            out[-1] += [] if out[-1] else [int(network.start[e])]
            out[-1].append(int(network.end[e]))
    return [np.array(s, dtype=np.int64) for s in out if s]


def peak(spells: list[tuple[int, int]]) -> int:
    """The most spells that are open at once."""
    events = sorted([(a, 1) for a, _ in spells] + [(b, -1) for _, b in spells])
    return int(np.max(np.cumsum([d for _, d in events], dtype=int), initial=0))

"""Test cycles as a dataset: one truck on a strip of floor of its own."""

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.core.network import Edge, build_network, reversed_edge
from fleetlog.core.site import Site
from fleetlog.core.trajectory import Labels, Trajectory
from fleetlog.core.truck import Truck
from fleetlog.errors import InputError, nearest
from fleetlog.physics.cycles import CYCLES, VDI_LEGS
from fleetlog.physics.power import Physics, battery_power, soc_change
from fleetlog.simulate.record import rounded
from fleetlog.store.writer import DatasetWriter


def strip() -> Site:
    """Thirty metres of two-way floor."""
    points = np.array([[0.0, 0.0, 0.0], [30.0, 0.0, 0.0]])
    edge = Edge("strip", "a", "b", points, "strip", width=4.0)
    return Site("test strip", network=build_network([edge, reversed_edge(edge)]))


def run_cycle(
    name: str, truck: Truck, duration: float, writer: DatasetWriter, physics: Physics, start: int, soc: float
) -> float:
    """Write ``duration`` [s] of a cycle, to and fro on the strip, at 10 Hz; the energy of an hour [Wh]."""
    if name not in CYCLES:
        raise InputError(f"unknown cycle {name!r}", do=nearest(name, CYCLES))
    one, every = CYCLES[name](truck), 0.1
    period, ends = float(one.dt.sum()), np.concatenate([[0.0], np.cumsum(one.dt)])
    energy = np.concatenate([[0.0], np.cumsum(battery_power(one, physics.fleet) * one.dt)])
    at = np.arange(0.0, duration, every)
    k = np.clip(np.searchsorted(ends[1:], at % period, side="right"), 0, len(one) - 1)
    driven, turn = np.cumsum(one.speed * one.dt)[k], sum(VDI_LEGS[:2])
    back = driven - 1e-9 >= turn
    x = np.where(back, np.maximum(2.0 * turn - driven, 0.0), driven)

    def used(time: Floats) -> Floats:
        whole = np.floor(time / period + 1e-12)
        return np.asarray(whole * energy[-1] + np.interp(time - whole * period, ends, energy))

    mean = (used(at + every) - used(at)) / every
    change = soc_change(mean, np.full(len(at), every), physics.actual_truck)
    columns = rounded({
        "x": x, "heading": np.where(back, np.pi, 0.0), "speed": one.speed[k], "battery_power": mean,
        "edge_offset": np.where(back, 30.0 - x, x),
        "fork_height": np.cumsum(one.lift_speed * one.dt)[k] + 0.3,
        "soc": np.clip(soc + np.concatenate([[0.0], np.cumsum(change)[:-1]]), 0.0, 1.0),
    }) | {
        "y": np.zeros(len(at)), "lateral_offset": np.zeros(len(at)), "payload": one.payload[k],
        "edge_id": Labels(back.astype(np.int32), ("strip", "-strip")),
        "trip_id": np.floor(at / period + 1e-12).astype(np.int64),
    }  # fmt: skip
    writer.write(Trajectory("T1", start + np.rint(at * 1e6).astype(np.int64), columns))
    return float(energy[-1] / period)

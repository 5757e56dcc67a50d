"""Test cycles as a dataset: one truck on a strip of floor of its own."""

from __future__ import annotations

import numpy as np

from fleetlog.core.network import Edge, build_network, reversed_edge
from fleetlog.core.site import Site
from fleetlog.core.trajectory import Labels, Trajectory
from fleetlog.core.truck import Truck
from fleetlog.errors import InputError, nearest
from fleetlog.physics.cycles import CYCLES, VDI_LEGS
from fleetlog.physics.power import Physics, battery_power, soc_change
from fleetlog.simulate.arrays import Floats
from fleetlog.simulate.record import rounded
from fleetlog.store.writer import DatasetWriter

STRIP = max(VDI_LEGS)


def strip() -> Site:
    """Thirty metres of two-way floor."""
    points = np.array([[0.0, 0.0, 0.0], [30.0, 0.0, 0.0]])
    edge = Edge("strip", "a", "b", points, "strip", width=4.0)
    return Site("test strip", network=build_network([edge, reversed_edge(edge)]))


def run_cycle(
    name: str,
    truck: Truck,
    duration: float,
    writer: DatasetWriter,
    physics: Physics,
    start: int,
    soc: float = 0.95,
) -> float:
    """Write ``duration`` [s] of a cycle, to and fro on the strip, at 10 Hz; the energy of an hour [Wh]."""
    if name not in CYCLES:
        raise InputError(f"unknown cycle {name!r}", do=nearest(name, CYCLES))
    one = CYCLES[name](truck)
    power = battery_power(one, physics.fleet)
    period = float(one.dt.sum())
    every = 0.1
    at = np.arange(0.0, duration, every)
    k = np.clip(np.searchsorted(np.cumsum(one.dt), at % period, side="right"), 0, len(one) - 1)
    legs = np.cumsum(one.speed * one.dt)[k]
    bounds = np.concatenate([[0.0], np.cumsum(VDI_LEGS)])
    leg = np.clip(np.searchsorted(bounds, legs - 1e-9, side="right") - 1, 0, len(VDI_LEGS) - 1)
    back = leg >= len(VDI_LEGS) // 2
    half = bounds[len(VDI_LEGS) // 2]
    x = np.where(back, np.maximum(2.0 * half - legs, 0.0), legs)
    energy = np.concatenate([[0.0], np.cumsum(power * one.dt)])
    edge_time = np.concatenate([[0.0], np.cumsum(one.dt)])

    def used(time: Floats) -> Floats:
        whole = np.floor(time / period + 1e-12)
        return np.asarray(whole * energy[-1] + np.interp(time - whole * period, edge_time, energy))

    mean = (used(at + every) - used(at)) / every
    charge = soc + np.concatenate(
        [[0.0], np.cumsum(soc_change(mean, np.full(len(at), every), physics.actual_truck()))[:-1]]
    )
    height = np.cumsum(one.lift_speed * one.dt)[k] + 0.3
    writer.write(
        Trajectory(
            "T1", start + np.rint(at * 1e6).astype(np.int64),
            {
                **rounded({
                    "x": x, "heading": np.where(back, np.pi, 0.0), "speed": one.speed[k],
                    "edge_offset": np.where(back, 30.0 - x, x), "fork_height": height, "battery_power": mean,
                    "soc": np.clip(charge, 0.0, 1.0),
                }),
                "y": np.zeros(len(at)), "lateral_offset": np.zeros(len(at)), "payload": one.payload[k],
                "edge_id": Labels(back.astype(np.int32), ("strip", "-strip")),
                "trip_id": np.floor(at / period + 1e-12).astype(np.int64),
            },
        )
    )  # fmt: skip
    return float(energy[-1] / period)

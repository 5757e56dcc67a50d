"""A street, a shuttle on it, and its log."""

from __future__ import annotations

import numpy as np

from fleetlog.core.motion import Motion
from fleetlog.core.network import Edge, Network, build_network, reversed_edge
from fleetlog.core.trajectory import Labels, Trajectory
from fleetlog.core.truck import Truck
from fleetlog.physics.cycles import Piece, legs, lift, run

START = int(np.datetime64("2026-03-02T05:40:00", "us").astype(np.int64))
LENGTH = 120.0


def street() -> Network:
    """120 m east, uphill 3 % between 40 and 80 m, both ways."""
    points = np.array([[0.0, 0, 0], [40, 0, 0], [80, 0, 1.2], [LENGTH, 0, 1.2]])
    out = Edge("a", "w", "e", points, "a")
    return build_network([out, reversed_edge(out)])


def truth(truck: Truck, network: Network, trips: int, dt: float = 0.2) -> tuple[Motion, np.ndarray]:
    """Out laden, back empty, lifting at the ends; the exact motion and its trip ids."""
    length = float(network.length[0])
    shuttle = legs([Piece(10.0), *run(length, 2.5, 0.6, 0.8), *lift(2.0, truck), Piece(20.0)], dt=dt)
    n = len(shuttle)
    k, trip = np.arange(n * trips) % n, np.arange(n * trips) // n
    edge = (trip % 2).astype(np.int32)
    way = np.minimum(np.tile(np.cumsum(shuttle.speed * shuttle.dt), trips), length)
    place = network.position(edge, way)
    motion = shuttle[k].replaced(
        time=np.arange(n * trips) * dt, dt=np.full(n * trips, dt), payload=np.where(edge == 0, 1500.0, 0.0),
        slope=network.slope(edge, way), edge=edge, edge_offset=way, x=place[:, 0], y=place[:, 1],
        heading=np.where(edge == 0, 0.0, np.pi), trip=trip,
        fork_height=np.tile(np.cumsum(shuttle.lift_speed * shuttle.dt), trips),
    )  # fmt: skip
    return motion, trip


def recorded(
    motion: Motion, vehicle: str, power: np.ndarray, network: Network, **columns: np.ndarray
) -> Trajectory:
    """The motion as a log would have it."""
    return Trajectory(vehicle, START + np.round(motion.time * 1e6).astype(np.int64), {
        "x": motion.x, "y": motion.y, "speed": motion.speed, "heading": np.clip(motion.heading, -np.pi, np.pi),
        "edge_id": Labels(motion.edge, network.edge_ids), "edge_offset": motion.edge_offset, "trip_id": motion.trip,
        "payload": motion.payload, "fork_height": motion.fork_height, "battery_power": power, **columns,
    })  # fmt: skip

"""A truck's true motion along a road, from its own little integrator: legs of constant jerk-free acceleration, stops between."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.network import Edge, Network, build_network, reversed_edge
from fleetlog.core.trajectory import Labels, Trajectory

Floats = NDArray[np.float64]
FINE = 0.01


@dataclass(frozen=True)
class Truth:
    """Sampled truth (N,): time [s], way [m], speed [m/s], acceleration [m/s2]."""

    t: Floats
    way: Floats
    speed: Floats
    acceleration: Floats


def shuttle(duration: float, rate: float, seed: int) -> Truth:
    """Sets off, cruises, slows, stops for a while, again and again; accelerations ramp over half a second."""
    rng = np.random.default_rng(seed)
    wanted: list[float] = []
    while len(wanted) * FINE < duration:
        v, gain, loss = rng.uniform(1.5, 4.5), rng.uniform(0.4, 0.8), rng.uniform(0.5, 1.0)
        for a, span in (
            (gain, v / gain),
            (0.0, rng.uniform(5, 25)),
            (-loss, v / loss),
            (0.0, rng.uniform(8, 20)),
        ):
            wanted += [a] * round(span / FINE)
    raw = np.array(wanted[: round(duration / FINE)])
    speed = np.maximum(np.cumsum(raw) * FINE, 0.0)
    ramp = np.ones(50) / 50.0
    speed = np.convolve(np.pad(speed, (49, 0)), ramp, "valid")
    speed[speed < 0.01] = 0.0
    way = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))]) * FINE
    pick = np.arange(0, len(speed), round(1.0 / rate / FINE))
    return Truth(pick * FINE, way[pick], speed[pick], np.gradient(speed, FINE)[pick])


def long_road(length: float = 4000.0, edge: float = 50.0, climb: float = 0.0) -> Network:
    """A straight two-way road in edges of ``edge`` metres, rising ``climb`` metres a metre."""
    edges = []
    for i in range(int(length / edge)):
        ends = np.array([[i * edge, 0.0, i * edge * climb], [(i + 1) * edge, 0.0, (i + 1) * edge * climb]])
        e = Edge(f"r{i}", f"n{i}", f"n{i + 1}", ends, f"r{i}")
        edges += [e, reversed_edge(e)]
    return build_network(edges)


def on_road(
    truth: Truth, network: Network, noise: float, seed: int, speed_noise: float | None = None
) -> Trajectory:
    """The truth as a matched log with noisy positions on the east axis."""
    rng = np.random.default_rng(seed)
    size = float(network.length[0])
    at = np.minimum((truth.way / size).astype(int), len(network) // 2 - 1)
    xy = np.stack([truth.way, np.zeros(len(truth.way))]) + rng.normal(0.0, noise, (2, len(truth.way)))
    columns = {
        "x": xy[0], "y": xy[1],
        "edge_id": Labels(np.array([network.index[f"r{i}"] for i in at], np.int32), network.edge_ids),
        "edge_offset": truth.way - at * size,
    }  # fmt: skip
    if speed_noise is not None:
        columns["speed"] = np.maximum(
            truth.speed + (truth.speed > 0) * rng.normal(0, speed_noise, len(truth.t)), 0.0
        )
    return Trajectory("T", np.round(truth.t * 1e6).astype(np.int64), columns)

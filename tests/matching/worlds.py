"""An aisle grid and trips on it whose true edges are known; made without any code of the matcher."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.network import Edge, Network, build_network, reversed_edge
from fleetlog.core.trajectory import Trajectory


def aisle_grid(nodes: int = 12, step: float = 10.0) -> Network:
    """Two-way aisles in a square grid."""
    edges = []
    for i in range(nodes):
        for j in range(nodes):
            for di, dj in ((1, 0), (0, 1)):
                if i + di < nodes and j + dj < nodes:
                    ends = np.array([[i * step, j * step, 0.0], [(i + di) * step, (j + dj) * step, 0.0]])
                    name = f"r{i}.{j}.{'xy'[dj]}"
                    edge = Edge(name, f"{i}.{j}", f"{i + di}.{j + dj}", ends, name)
                    edges += [edge, reversed_edge(edge)]
    return build_network(edges)


def drive(
    network: Network, rows: int, rate: float, noise: float, seed: int
) -> tuple[Trajectory, NDArray[np.int32], NDArray[np.float64]]:
    """A truck at about 2.5 m/s that turns at random, changes its speed and stops now and then: track, true edges, true offsets."""
    rng = np.random.default_rng(seed)
    dt, edge, offset, v, target, hold = 1.0 / rate, int(rng.integers(len(network))), 0.0, 0.0, 2.5, 0.0
    edges, offsets = np.empty(rows, np.int32), np.empty(rows)
    for k in range(rows):
        if hold <= 0.0:
            stops = rng.random() < 0.08
            target, hold = (
                (0.0, rng.uniform(5, 15)) if stops else (2.5 * rng.uniform(0.6, 1.2), rng.uniform(5, 20))
            )
        hold -= dt
        v += float(np.clip(target - v, -0.8 * dt, 0.6 * dt))
        offset += v * dt
        while offset >= network.length[edge]:
            offset -= network.length[edge]
            edge = int(rng.choice(network.successors(edge)))
        edges[k], offsets[k] = edge, offset
    xy = network.position(edges, offsets)[:, :2] + rng.normal(0.0, noise, (rows, 2)) if noise else None
    if xy is None:
        xy = network.position(edges, offsets)[:, :2]
    time = np.round(np.arange(rows) * dt * 1e6).astype(np.int64)
    return Trajectory("truck", time, {"x": xy[:, 0].copy(), "y": xy[:, 1].copy()}), edges, offsets


def wandering(track: Trajectory, rate: float, spread: float, memory: float, seed: int) -> Trajectory:
    """The track with errors that last: a first-order process of standard deviation ``spread`` [m] and ``memory`` seconds."""
    rng = np.random.default_rng(seed)
    keep = float(np.exp(-1.0 / (rate * memory)))
    steps = rng.normal(0.0, spread * np.sqrt(1.0 - keep * keep), (len(track), 2))
    error = np.empty((len(track), 2))
    error[0] = rng.normal(0.0, spread, 2)
    for i in range(1, len(track)):
        error[i] = keep * error[i - 1] + steps[i]
    error += rng.normal(0.0, 0.05, error.shape)
    return track.with_columns(x=track.floats("x") + error[:, 0], y=track.floats("y") + error[:, 1])

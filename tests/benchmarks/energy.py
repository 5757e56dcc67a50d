"""How long the energy of one day of 20 trucks at 10 Hz takes (17.3 million rows), and how much memory.

    python tests/benchmarks/energy.py [--trucks 20] [--hours 24] [--rate 10] [--keep FOLDER]

The day is made here: trucks drive back and forth on a street of 400 m with a hill, lift at both ends, 5 cm of position noise.
CPU seconds count children too.  Memory is the proportional set size of all processes together (shared pages count once),
sampled five times a second.
"""

from __future__ import annotations

import argparse
import os
import resource
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from fleetlog.analysis.energy import energy
from fleetlog.core.network import Edge, Network, build_network, reversed_edge
from fleetlog.core.site import Site
from fleetlog.core.trajectory import Labels, Trajectory
from fleetlog.core.truck import load_truck
from fleetlog.physics.cycles import Piece, legs, lift, run
from fleetlog.physics.power import Physics, battery_power
from fleetlog.store.dataset import Dataset
from fleetlog.store.writer import DatasetWriter

LENGTH = 400.0


def street() -> Network:
    """One street with a hill in its middle, both ways."""
    x = np.linspace(0.0, LENGTH, 41)
    points = np.column_stack([x, np.zeros(41), 3.0 * np.sin(np.pi * x / LENGTH) ** 2])
    out = Edge("a", "w", "e", points, "a")
    return build_network([out, reversed_edge(out)])


def day(vehicle: str, network: Network, hours: float, rate: float, seed: int) -> Trajectory:
    """One vehicle's day."""
    rng = np.random.default_rng(seed)
    truck = load_truck("counterbalance-2.5t")
    length = float(network.length[0])
    shuttle = legs([*run(length, 3.0, 0.6, 0.8), *lift(3.0, truck), Piece(15.0)], dt=1.0 / rate)
    n = int(hours * 3600 * rate)
    k = np.arange(n) % len(shuttle)
    back = (np.arange(n) // len(shuttle)) % 2 == 1
    way = np.minimum(np.cumsum(shuttle.speed * shuttle.dt)[k], length)
    edge = back.astype(np.int32)
    place = network.position(edge, way)
    motion = shuttle[k].replaced(
        payload=np.where(back, 0.0, 1800.0), slope=network.slope(edge, way), edge=edge, edge_offset=way
    )
    noisy = place[:, :2] + rng.normal(0, 0.05, (n, 2))
    start = np.datetime64("2026-03-02T00:00:00", "us").astype(np.int64)
    return Trajectory(vehicle, start + (np.arange(n) * (1e6 / rate)).astype(np.int64), {
        "x": noisy[:, 0], "y": noisy[:, 1], "z": place[:, 2], "heading": np.where(back, np.pi - 1e-7, 0.0),
        "speed": np.maximum(motion.speed + (motion.speed > 0) * rng.normal(0, 0.03, n), 0.0),
        "edge_id": Labels(edge, network.edge_ids), "edge_offset": way,
        "trip_id": np.arange(n) // len(shuttle), "payload": motion.payload,
        "fork_height": np.clip(np.cumsum(motion.lift_speed) / rate, 0, None),
        "battery_power": battery_power(motion, Physics(truck)) + rng.normal(0, 150, n),
        "soc": np.linspace(1.0, 0.3, n),
    })  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trucks", type=int, default=20)
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--rate", type=float, default=10.0)
    parser.add_argument("--keep", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        path = (options.keep or Path(scratch)) / "day"
        if not path.exists():
            network = street()
            with DatasetWriter.create(path, "recorded", Site("street", network=network)) as writer:
                for i in range(options.trucks):
                    writer.write(day(f"T{i:02d}", network, options.hours, options.rate, i))
        dataset = Dataset(path)
        memory = Memory()
        memory.start()
        wall, cpu = time.perf_counter(), _cpu()
        result = energy(dataset, load_truck("counterbalance-2.5t"))
        wall, cpu = time.perf_counter() - wall, _cpu() - cpu
        memory.done.set()
        print(
            f"{dataset.rows:,} rows: {wall:.1f} s, {cpu:.1f} CPU s on two cores ({dataset.rows / cpu:,.0f} rows per CPU s)"
        )
        print(f"memory: {memory.peak:.0f} MB in all processes together")
        print("\n".join(result.lines))


class Memory(threading.Thread):
    """The highest proportional set size of this process and its children [MB]."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.peak, self.done = 0.0, threading.Event()

    def run(self) -> None:
        while not self.done.wait(0.2):
            children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
            self.peak = max(self.peak, sum(_megabytes(pid) for pid in ["self", *children]))


def _megabytes(pid: str) -> float:
    try:
        rollup = Path(f"/proc/{pid}/smaps_rollup").read_text()
    except OSError:  # it has just ended
        return 0.0
    return next(int(line.split()[1]) for line in rollup.splitlines() if line.startswith("Pss:")) / 1024


def _cpu() -> float:
    own, child = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return own.ru_utime + own.ru_stime + child.ru_utime + child.ru_stime


if __name__ == "__main__":
    main()

"""The motion smoother: error against truth at several rates and noises, and CPU time for a fleet day.

python tests/benchmarks/motion.py [--rows 864000]
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import time
from pathlib import Path

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "motion"))
from truth import Truth, long_road, on_road, shuttle

from fleetlog.core.network import Network
from fleetlog.core.trajectory import Labels, Trajectory
from fleetlog.physics.motion import Reconstruction, reconstruct
from fleetlog.roads.matching import match


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def matched(log: Trajectory, road: Network) -> Trajectory:
    """As import makes it: the edges are found, not told."""
    found = match(log, road)
    return log.with_columns(edge_id=Labels(found.edge, road.edge_ids), edge_offset=found.offset)


def against(found: Reconstruction, truth: Truth) -> tuple[np.ndarray, np.ndarray]:
    """Errors of speed and of the likeliest acceleration at the samples."""
    v, a = (np.interp(found.motion.time, truth.t, values) for values in (truth.speed, truth.acceleration))
    return found.motion.speed - v, np.where(found.standing, 0.0, found.states.mean[found.node, 2]) - a


def of(found: Reconstruction, truth: Truth) -> tuple[float, ...]:
    """Errors of speed and acceleration, each with what is stated of it."""
    v, a = against(found, truth)
    return rms(v), rms(found.speed_sd), rms(a), rms(found.acceleration_sd)


def errors() -> None:
    road = long_road()
    print(
        "| rate | position noise | speed: differences | speed: smoothed | stated | acceleration | stated | with the log's speed |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for rate in (10.0, 1.0):
        for noise in (0.05, 0.5, 2.0):
            truth = shuttle(1800.0, rate, 1)
            log = matched(on_road(truth, road, noise, 2), road)
            plain = rms(np.gradient(log.floats("x"), truth.t) - truth.speed)
            found = reconstruct(log, road)
            helped = reconstruct(matched(on_road(truth, road, noise, 2, speed_noise=0.05), road), road)
            numbers = (plain, *of(found, truth), rms(against(helped, truth)[0]))
            print(f"| {rate:g} Hz | {noise:g} m | " + " | ".join(f"{x:.3f}" for x in numbers) + " |")


def pace(rows: int) -> None:
    road = long_road(20_000.0)
    truth = shuttle(rows / 10.0, 10.0, 3)
    truth = type(truth)(truth.t, truth.way % 19_000.0, truth.speed, truth.acceleration)
    log = on_road(truth, road, 0.1, 4, speed_noise=0.05)
    n = len(log)
    log = log.with_columns(
        payload=np.full(n, 500.0), fork_height=np.zeros(n), battery_power=np.full(n, 900.0)
    )
    reconstruct(log[:5000], road)
    start = time.process_time()
    reconstruct(log, road)
    seconds = time.process_time() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"\n{n:,} rows: {seconds:.2f} CPU s, {n / seconds / 1e6:.2f} million rows/s; 17.3 million rows (20 trucks, one day at 10 Hz): "
          f"{17.28e6 / n * seconds:.1f} CPU s; peak {peak:.0f} MB, one truck-day at a time")  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=864_000)
    options = parser.parse_args()
    errors()
    pace(options.rows)

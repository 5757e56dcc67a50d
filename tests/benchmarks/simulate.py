"""Vehicle-steps per CPU second, ours beside SUMO's, on one grid; everything written.

    python tests/benchmarks/simulate.py [--vehicles 50 200 1000] [--seconds 200] [--sumo]

Both drive a 10 by 10 grid of two-way roads, 60 m apart, at 3 m/s, step 0.1 s, and write a row a vehicle a step: ours to the
dataset (Parquet: position, heading, speed, road, offset, load, fork height, power, charge, trip), SUMO to its FCD output as
Parquet with its battery device on.  What each models beside that: SUMO lane changing, driver imperfection, traffic lights
and right of way by rule; ours footprints that never touch, reservations, loads and lifts, bays, charging, a power ledger.
CPU time of the process and its children; SUMO's includes its start, ours a warm-up run is left out (compilation).
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
sys.path.insert(0, str(Path(__file__).parents[1] / "simulate"))

SIDE, PITCH = 10, 60.0


def ours(vehicles: int, seconds: float, interval: float, folder: Path) -> dict[str, float]:
    from sites import TRUCK, grid

    from fleetlog.simulate.engine import Settings, simulate
    from fleetlog.store import DatasetWriter

    site = grid(SIDE, SIDE, PITCH)
    begin, clock = time.process_time(), time.perf_counter()
    with DatasetWriter.create(folder / "ours", "simulated", site, overwrite=True) as writer:
        settings = Settings(vehicles=vehicles, duration=seconds, interval=interval, seed=1)
        summary = simulate(site, TRUCK, writer, settings)
    cpu, wall = time.process_time() - begin, time.perf_counter() - clock
    return {
        "cpu_s": cpu, "wall_s": wall, "vehicle_steps": summary.vehicle_steps, "per_cpu_s": summary.vehicle_steps / cpu,
        "rows": summary.rows, "tasks_done": summary.count.tasks_done, "deadlocks": summary.count.deadlocks,
        "waiting_share": summary.waiting_s / (vehicles * seconds),
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    }  # fmt: skip


def sumo(vehicles: int, seconds: float, folder: Path) -> dict[str, float]:
    """SUMO with as many vehicles on the way for the whole time (random trips long enough not to end)."""
    import sumo as wheel

    home = Path(wheel.SUMO_HOME)
    run = lambda *a: subprocess.run(
        [str(x) for x in a], check=True, capture_output=True, env={**os.environ, "SUMO_HOME": str(home)}
    )
    net, routes, fcd = folder / "grid.net.xml", folder / "routes.xml", folder / "fcd.parquet"
    run(home / "bin/netgenerate", "--grid", "--grid.number", SIDE, "--grid.length", PITCH, "--default.speed", 3.0,
        "--default.lanenumber", 1, "--no-turnarounds.except-deadend", "-o", net)  # fmt: skip
    trips = folder / "trips.xml"
    run(
        sys.executable,
        home / "tools/randomTrips.py",
        "-n",
        net,
        "-o",
        trips,
        "-e",
        20,
        "-p",
        20.0 / vehicles,
        "--intermediate",
        30,
        "--seed",
        1,
    )
    run(home / "bin/duarouter", "-n", net, "-r", trips, "-o", routes, "--ignore-errors", "true")
    before, clock = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    # The fleet is on the road after 20 s; what it does before is counted too.
    done = run(
        home / "bin/sumo", "-n", net, "-r", routes, "--step-length", 0.1, "--end", seconds, "--fcd-output", fcd,
        "--device.battery.probability", 1.0, "--duration-log.statistics", "true", "--no-step-log", "true", "--time-to-teleport", 60,
    )  # fmt: skip
    after, wall = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter() - clock
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    import pyarrow.parquet as pq

    steps = pq.ParquetFile(fcd).metadata.num_rows
    teleports = [line.strip() for line in done.stdout.decode().splitlines() if "Teleports" in line]
    return {
        "cpu_s": cpu,
        "wall_s": wall,
        "vehicle_steps": steps,
        "per_cpu_s": steps / cpu,
        "teleports": teleports[0] if teleports else 0,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vehicles", type=int, nargs="+", default=[50, 200, 1000])
    parser.add_argument("--seconds", type=float, default=200.0)
    parser.add_argument("--interval", type=float, default=0.1)
    parser.add_argument("--sumo", action="store_true")
    args = parser.parse_args()
    folder = Path(tempfile.mkdtemp())
    try:
        ours(10, 20.0, args.interval, folder)
        for n in args.vehicles:
            print("fleetlog", n, json.dumps(ours(n, args.seconds, args.interval, folder)), flush=True)
            if args.sumo:
                print("sumo    ", n, json.dumps(sumo(n, args.seconds, folder)), flush=True)
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()

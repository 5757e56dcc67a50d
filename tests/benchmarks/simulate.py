"""Vehicle-steps a second, ours beside SUMO's, on one grid; everything written.

    python tests/benchmarks/simulate.py [--vehicles 50 200 1000] [--seconds 400] [--side 10] [--repeat 3] [--sumo]

Both drive a grid of ``side`` by ``side`` crossings of two-way roads, 60 m apart, at 3 m/s, step 0.1 s, and write a row a
vehicle a step as Parquet: ours position, heading, speed, road, offset, load, fork height, power, charge and trip; SUMO, its
battery device on, position, angle, speed, lane and offset (``fcd``), or these and charge and energy (``fcd and battery``).
What each models beside that: SUMO lane changing, driver imperfection, right of way by rule; ours footprints that never
touch, reservations, loads and lifts, bays, charging, a power ledger, tasks.

Files go to memory where the system has a folder for that, so that no disk is measured.  Times include the start of either;
of ours a warm-up run is left out (compilation).  CPU time is that of the process, its threads and its children; the clock
shows what a user waits: ours writes in other threads.  Medians of ``repeat`` runs.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
sys.path.insert(0, str(Path(__file__).parents[1] / "simulate"))

SIDE, PITCH = 10, 60.0


def ours(vehicles: int, seconds: float, interval: float, folder: Path) -> dict[str, float]:
    from simulated_sites import TRUCK, grid

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
        "per_s": summary.vehicle_steps / wall,
        "rows": summary.rows, "tasks_done": summary.count.tasks_done, "deadlocks": summary.count.deadlocks,
        "waiting_share": summary.waiting_s / (vehicles * seconds),
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    }  # fmt: skip


def sumo(vehicles: int, seconds: float, folder: Path, battery: bool) -> dict[str, float]:
    """SUMO with as many vehicles on the way for the whole time (random trips long enough not to end)."""
    import pyarrow.parquet as pq
    import sumo as wheel

    home, fcd = Path(wheel.SUMO_HOME), folder / "fcd.parquet"
    net, routes = folder / f"grid{SIDE}.net.xml", folder / f"routes{SIDE}-{vehicles}.xml"
    if not routes.exists():
        draw(home, net, routes, vehicles)
    more = ["--battery-output", folder / "battery.parquet"] if battery else []
    before, clock = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    # The fleet is on the road after 20 s; what it does before is counted too.
    done = run(
        home, "bin/sumo", "-n", net, "-r", routes, "--step-length", 0.1, "--end", seconds, "--fcd-output", fcd, *more,
        "--device.battery.probability", 1.0, "--duration-log.statistics", "true", "--no-step-log", "true", "--time-to-teleport", 60,
    )  # fmt: skip
    after, wall = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter() - clock
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    steps = pq.ParquetFile(fcd).metadata.num_rows
    teleports = [line.split("(")[0].split()[-1] for line in done.splitlines() if "Teleports" in line]
    return {
        "cpu_s": cpu, "wall_s": wall, "vehicle_steps": steps, "per_cpu_s": steps / cpu, "per_s": steps / wall,
        "teleports": int(teleports[0]) if teleports else 0,
    }  # fmt: skip


def run(home: Path, program: str, *arguments: object, cwd: Path | None = None) -> str:
    """What a program of SUMO prints."""
    command = [*([sys.executable] if program.endswith(".py") else []), home / program, *arguments]
    environment = {**os.environ, "SUMO_HOME": str(home)}
    done = subprocess.run(
        [str(x) for x in command], check=True, capture_output=True, env=environment, cwd=cwd
    )
    return done.stdout.decode()


def draw(home: Path, net: Path, routes: Path, vehicles: int) -> None:
    """The grid and the routes."""
    trips = routes.with_suffix(".trips.xml")
    run(
        home, "bin/netgenerate", "--grid", "--grid.number", SIDE, "--grid.length", PITCH, "--default.speed", 3.0,
        "--default.lanenumber", 1, "--no-turnarounds.except-deadend", "-o", net,
    )  # fmt: skip
    run(
        home, "tools/randomTrips.py", "-n", net, "-o", trips, "-e", 20, "-p", 20.0 / vehicles, "--intermediate", 30,
        "--seed", 1, cwd=routes.parent,
    )  # fmt: skip
    run(home, "bin/duarouter", "-n", net, "-r", trips, "-o", routes, "--ignore-errors", "true")


def median(runs: list[dict[str, float]]) -> dict[str, float]:
    """Of each figure."""
    return {key: statistics.median(r[key] for r in runs) for key in runs[0]}


def main() -> None:
    global SIDE
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--vehicles", type=int, nargs="+", default=[50, 200, 1000])
    parser.add_argument("--seconds", type=float, default=400.0)
    parser.add_argument("--interval", type=float, default=0.1)
    parser.add_argument("--side", type=int, default=SIDE)
    parser.add_argument("--repeat", type=int, default=1)
    parser.add_argument("--sumo", action="store_true")
    args = parser.parse_args()
    SIDE = args.side
    memory = Path("/dev/shm")
    folder = Path(tempfile.mkdtemp(dir=memory if memory.is_dir() else None))
    try:
        ours(10, 20.0, args.interval, folder)
        for n in args.vehicles:
            kinds = {"fleetlog": lambda n=n: ours(n, args.seconds, args.interval, folder)}
            if args.sumo:
                kinds["SUMO, fcd"] = lambda n=n: sumo(n, args.seconds, folder, False)
                kinds["SUMO, fcd and battery"] = lambda n=n: sumo(n, args.seconds, folder, True)
            # One after the other in each round, so that what disturbs the machine disturbs all.
            rounds = [{name: kind() for name, kind in kinds.items()} for _ in range(args.repeat)]
            found = {name: median([r[name] for r in rounds]) for name in kinds}
            for name, figures in found.items():
                print(n, name, json.dumps(figures), flush=True)
                if name != "fleetlog":
                    cpu, wall = (found["fleetlog"][k] / figures[k] for k in ("per_cpu_s", "per_s"))
                    print(
                        f"    fleetlog does {cpu:.1f} times as many a CPU second, {wall:.1f} times by the clock"
                    )
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()

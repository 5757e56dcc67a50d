"""Rows a second and peak memory of an import, at growing lengths of the log.

    python tests/benchmarks/import_rows.py [--rows 1e6 3e6 1e7] [--map] [--workers 2]

Writes CSV logs of eight trucks at 10 Hz (speed, payload, power and SOC beside the position, the trucks mixed row by row), imports
each in a process of its own without the replay, and prints the processor time of all its processes, what of
the wall time went to reading, and the peak of the resident memory.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from fleetlog.core.site import Site

TRUCKS, RATE = 8, 10.0
CHUNK = 200_000


def write_log(path: Path, rows: int) -> None:
    """Trucks that go round a 200 m by 100 m block, each at its own pace, and stand for a minute in every four."""
    import pyarrow as pa
    import pyarrow.csv as pv

    rng = np.random.default_rng(1)
    names = np.array([f"T{i}" for i in range(TRUCKS)])
    options = pv.WriteOptions(include_header=True)
    with path.open("wb") as stream:
        for first in range(0, rows, CHUNK):
            i = np.arange(first, min(first + CHUNK, rows))
            truck, t = i % TRUCKS, (i // TRUCKS) / RATE
            phase = (t + 30.0 * truck) % 240.0
            driving = phase < 180.0
            gone = (t + 30.0 * truck) // 240.0 * 360.0 + np.minimum(phase, 180.0) * 2.0
            x, y = around(gone)
            table = pa.table({
                "vehicle_id": names[truck],
                "timestamp": pa.array(1_767_225_600_000_000 + (t * 1e6).astype(np.int64) + truck, pa.timestamp("us", "UTC")),
                "x": np.round(x + rng.normal(0, 0.05, len(i)), 3), "y": np.round(y + rng.normal(0, 0.05, len(i)), 3),
                "speed": np.where(driving, 2.0, 0.0), "payload": np.where(truck % 2, 800.0, 0.0),
                "battery_power": np.round(np.where(driving, 2500.0, 400.0) + rng.normal(0, 30, len(i)), 1),
                "soc": np.round(1.0 - (t % 28800) / 40000, 5),
            })  # fmt: skip
            pv.write_csv(table, stream, options)
            options = pv.WriteOptions(include_header=False)


def around(distance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Place after a distance [m] around the block."""
    s = distance % 600.0
    return np.interp(s, [0, 200, 300, 500, 600], [0, 200, 200, 0, 0]), np.interp(
        s, [0, 200, 300, 500, 600], [0, 0, 100, 100, 0]
    )


def block() -> Site:
    """The block as four two-way roads."""
    from fleetlog.core.network import Edge, build_network
    from fleetlog.core.site import Site

    corners = np.array([[0, 0, 0], [200, 0, 0], [200, 100, 0], [0, 100, 0], [0, 0, 0]], float)
    edges = []
    for i in range(4):
        points = corners[i : i + 2]
        edges.append(Edge(f"r{i}", f"n{i}", f"n{(i + 1) % 4}", points, f"r{i}"))
        edges.append(Edge(f"-r{i}", f"n{(i + 1) % 4}", f"n{i}", points[::-1].copy(), f"r{i}"))
    return Site("block", None, build_network(edges))


def measure(log: Path, out: Path, with_map: bool, workers: int) -> dict[str, float]:
    """Processor seconds, wall seconds (of reading too), peak memory [MB] of one import by this process and its workers."""
    from fleetlog import engines
    from fleetlog.core.site import Site
    from fleetlog.ingest.pipeline import import_logs
    from fleetlog.listening import listening, unheard
    from fleetlog.store import DatasetWriter

    place, said = block() if with_map else Site(), []
    before, wall = sum(os.times()[:4]), time.perf_counter()

    def progress(what: str, share: float) -> None:
        if what.startswith("reading"):
            said.append(time.perf_counter() - wall)

    made = DatasetWriter.create(out, "recorded", place)
    with listening(progress, unheard), engines.using(workers), made as writer:
        rows = import_logs([log], place, writer).rows
    peaks = [
        resource.getrusage(who).ru_maxrss / 1024 for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    ]
    return {
        "rows": rows, "cpu": sum(os.times()[:4]) - before, "wall": time.perf_counter() - wall,
        "read": said[-1], "memory": max(peaks),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else "")
    parser.add_argument("--rows", type=float, nargs="+", default=[1e6, 3e6, 1e7])
    parser.add_argument("--map", action="store_true", help="match to the roads of the block too")
    parser.add_argument("--workers", type=int, default=1, help="processes, and threads that read")
    parser.add_argument("--one", nargs=2, type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        print(json.dumps(measure(*arguments.one, arguments.map, arguments.workers)))
        return
    print(
        f"{'rows':>12} {'MB of CSV':>10} {'rows/CPU s':>12} {'rows/s':>10} {'read in s':>10} {'peak MB':>8}"
    )
    with tempfile.TemporaryDirectory(dir=os.environ.get("TMPDIR")) as folder:
        for rows in map(int, arguments.rows):
            log = Path(folder) / f"log{rows}.csv"
            write_log(log, rows)
            command = [sys.executable, __file__, "--one", str(log), str(Path(folder) / f"out{rows}")]
            command += ["--workers", str(arguments.workers), *(["--map"] if arguments.map else [])]
            found = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
            size = log.stat().st_size / 1e6
            print(
                f"{found['rows']:12,.0f} {size:10.0f} {rows / found['cpu']:12,.0f} {rows / found['wall']:10,.0f} "
                f"{found['read']:10.1f} {found['memory']:8.0f}"
            )
            log.unlink()


if __name__ == "__main__":
    main()

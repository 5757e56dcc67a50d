"""Cost of a vehicle-day by command, from one day to many; what one more day costs; what a second core gives.

    python tests/benchmarks/scale.py [--trucks 5] [--days 6] [--steps 1,3,9,10] [--figure docs/figures/scale.png]

A month of 50 trucks is ``--trucks 50 --days 30``.  With ``--brief`` energy, heat map and density alone, by one
worker.  CPU seconds are those of all processes together, memory is the
largest process.  On a busy machine compare CPU seconds, not wall time.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "sample_data"
COMMANDS = {
    "energy": ["--truck", str(SAMPLE / "truck.toml")], "heatmap": [], "density": [], "stops": [], "chargers": [],
}  # fmt: skip


@dataclass
class Cost:
    """Of one run: CPU seconds in all, wall seconds, peak memory of the largest process [MB]."""

    cpu: float
    wall: float
    memory: float


def run(*words: object) -> Cost:
    """Run fleetlog."""
    began = time.monotonic()
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    process = subprocess.Popen([sys.executable, "-m", "fleetlog", *map(str, words)], env=environment)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"fleetlog {' '.join(map(str, words))} ended with {process.returncode}")
    return Cost(usage.ru_utime + usage.ru_stime, time.monotonic() - began, usage.ru_maxrss / 1024)


def first_days(source: Path, days: int, target: Path) -> int:
    """Make ``target`` the first days of a dataset, as hard links; its partial results stay.  How many vehicle-days."""
    import pandas as pd

    from fleetlog.store import Dataset
    from fleetlog.store.output import share

    data = Dataset(source)
    dates = data.dates[:days]
    for date in dates:
        if not (target / "trajectories" / f"date={date}").exists():
            share(source / "trajectories" / f"date={date}", target / "trajectories" / f"date={date}")
    shutil.copy(source / "site.json", target)
    end = pd.Timestamp(dates[-1], tz="UTC") + pd.Timedelta(days=1)
    trips = data.trips[data.trips.start < end]
    trips.to_parquet(target / "trips.parquet")
    last = min(trips.end.max(), end - pd.Timedelta(seconds=1))
    meta = {**data.meta, "rows": int(trips.rows.sum()), "end": last.tz_localize(None).isoformat() + "Z"}
    (target / "dataset.json").write_text(json.dumps(meta))
    return sum(d in dates for _, d in data.vehicle_days)


def measured(dataset: Path, scratch: Path, workers: int, fresh: bool) -> dict[str, Cost]:
    """The cost of every analysis."""
    if fresh:
        shutil.rmtree(dataset / ".partials", ignore_errors=True)
    return {
        name: run("analyze", name, dataset, *more, "--workers", workers, "-q", "--overwrite", "-o", scratch / name)
        for name, more in COMMANDS.items()
    }  # fmt: skip


def main() -> None:
    """Measure and print tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--trucks", type=int, default=5)
    parser.add_argument("--days", type=int, default=6)
    parser.add_argument("--dataset", type=Path, help="made before with these trucks and days")
    parser.add_argument("--steps", help="numbers of days, the last two one apart: what one more day costs")
    parser.add_argument("--brief", action="store_true")
    parser.add_argument("--figure", type=Path)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        source = args.dataset or folder / "all"
        if args.dataset is None:
            cost = run(
                "simulate", "--site", SAMPLE / "site.toml", "--truck", SAMPLE / "truck.toml", "--vehicles", args.trucks,
                "--duration", f"{24 * args.days}h", "--seed", 1, "--no-recording", "--no-shadow", "-q", "-o", source,
            )  # fmt: skip
            print(
                f"simulate: {cost.cpu / args.trucks / args.days:.2f} CPU s per vehicle-day, {cost.memory:.0f} MB"
            )
        steps = sorted({1, 2, *range(4, args.days, 4), args.days - 1, args.days})
        if args.steps:
            steps = [int(n) for n in args.steps.split(",")]
        if args.brief:
            del COMMANDS["stops"], COMMANDS["chargers"]
        table = growth(source, steps, folder)
        if not args.brief:
            second(table, folder)
        if args.figure:
            draw(table, args.figure)


def growth(source: Path, steps: list[int], folder: Path) -> list[tuple[int, dict[str, Cost]]]:
    """Print the cost per vehicle-day of some numbers of days, and of one more day."""
    out = []
    for n in steps:
        count = first_days(source, n, folder / "part")
        more = measured(folder / "part", folder, 1, fresh=False) if n == steps[-1] else {}
        costs = measured(folder / "part", folder, 1, fresh=True)
        out.append((count, costs))
        for name, c in costs.items():
            print(
                f"{count:6d} vehicle-days  {name:9s} {c.cpu:7.2f} CPU s  {c.cpu / count:6.3f} each  {c.memory:6.0f} MB"
            )
        for name, c in more.items():
            print(f"one more day {name:9s} {c.cpu:7.2f} CPU s (a day at first {out[0][1][name].cpu:.2f})")
    return out


def second(table: list[tuple[int, dict[str, Cost]]], folder: Path) -> None:
    """Print the cost with what is kept, and with two workers."""
    again = measured(folder / "part", folder, 1, fresh=False)
    both = measured(folder / "part", folder, 2, fresh=True)
    for name, c in both.items():
        one = table[-1][1][name]
        print(
            f"{name:9s} kept {again[name].cpu:6.2f} CPU s; wall 1 worker {one.wall:.1f} s, 2 workers {c.wall:.1f} s"
        )


def draw(table: list[tuple[int, dict[str, Cost]]], target: Path) -> None:
    """CPU seconds and memory against vehicle-days."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6))
    count = [n for n, _ in table]
    for name in COMMANDS:
        left.plot(count, [c[name].cpu / n for n, c in table], "o-", label=name)
        right.plot(count, [c[name].memory for _, c in table], "o-", label=name)
    left.set(xlabel="vehicle-days", ylabel="CPU s per vehicle-day", ylim=(0, None))
    right.set(xlabel="vehicle-days", ylabel="peak memory [MB]", ylim=(0, None))
    left.legend()
    figure.tight_layout()
    figure.savefig(target, dpi=110)


if __name__ == "__main__":
    main()

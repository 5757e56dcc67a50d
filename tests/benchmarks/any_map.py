"""Run a fleet on every map given, over seeds and fleet sizes, and check the laws of a simulation; one line a map and size.

    python tests/benchmarks/any_map.py MAP... [--seeds 20] [--trucks 1 5 20] [--minutes 7] [--truck truck.toml]

Speeds may exceed a limit by 5 cm/s within a step of where it changes.  A map on which no truck can operate must say so in one line.  Exit status 1 where a law is broken.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import traceback
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "simulate"))

import laws
from conftest import Outcome

from fleetlog.core.truck import load_truck
from fleetlog.errors import FleetlogError
from fleetlog.roads import load_site
from fleetlog.simulate.engine import Settings, simulate
from fleetlog.store import DatasetWriter


def run(site, truck, trucks: int, seed: int, seconds: float) -> tuple[str, int, float]:
    """What became of one run: "runs" or the line of an error; tasks done; longest wait [s]."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run"
        try:
            with DatasetWriter.create(path, "simulated", site) as writer:
                summary = simulate(site, truck, writer, Settings(trucks, seconds, interval=0.1, seed=seed))
        except FleetlogError as error:
            return str(error), 0, 0.0
        outcome = Outcome(path, summary)
        laws.keeps_the_laws(outcome, outcome.dataset.site.network, truck, slack=0.05)
        return "runs", summary.count.tasks_done, summary.longest_wait_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("maps", nargs="+", type=Path)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--trucks", type=int, nargs="+", default=[1, 5, 20])
    parser.add_argument("--minutes", type=float, default=7.0)
    parser.add_argument("--truck", default="sample_data/truck.toml")
    args = parser.parse_args()
    truck, broken = load_truck(args.truck), 0
    laws.HALF = (truck.chassis.length / 2, truck.chassis.width / 2)
    for path in args.maps:
        site, _ = load_site(path)
        for trucks in args.trucks:
            kinds: Counter[str] = Counter()
            tasks, wait = 0, 0.0
            for seed in range(args.seeds):
                try:
                    kind, done, longest = run(site, truck, trucks, seed, 60.0 * args.minutes)
                except AssertionError:
                    traceback.print_exc(limit=-1)
                    kind, done, longest = "BROKEN", 0, 0.0
                    broken += 1
                kinds[kind] += 1
                tasks, wait = tasks + done, max(wait, longest)
            told = "; ".join(f"{n} of {args.seeds} {kind}" for kind, n in kinds.items())
            print(
                f"{path.name:32} {trucks:3} trucks: {told}; {tasks} tasks, longest wait {wait:.0f} s",
                flush=True,
            )
    sys.exit(1 if broken else 0)


if __name__ == "__main__":
    main()

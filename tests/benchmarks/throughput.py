"""Throughput of one crossing against the number of trucks: rises, saturates, does not collapse; draws a figure.

    python tests/benchmarks/throughput.py [-o docs/figures/throughput.png] [--minutes 30]

Endless random tasks between bays along the four arms of a crossing; a passage is a truck that gets through the middle.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "simulate"))


def passages(trucks: int, minutes: float, seed: int, folder: Path) -> tuple[float, int, float]:
    """Passages of the middle in an hour, deadlocks, share of time spent waiting."""
    from simulated_sites import TRUCK, crossing

    from fleetlog.simulate.engine import Settings, simulate
    from fleetlog.simulate.tasks import Demand
    from fleetlog.store import Dataset, DatasetWriter

    with DatasetWriter.create(folder / "run", "simulated", crossing(arm=120.0), overwrite=True) as writer:
        settings = Settings(vehicles=trucks, duration=60.0 * minutes, seed=seed)
        summary = simulate(crossing(arm=120.0), TRUCK, writer, settings, Demand(pause=1.0))
    data = Dataset(folder / "run")
    count = 0
    for vehicle in data.vehicles:
        t = data.read(vehicle, columns=["x", "y"])
        near = np.hypot(t.floats("x"), t.floats("y")) < 4.0
        count += int((np.diff(near.astype(int)) == 1).sum())
    waiting = summary.limits.waiting_s["traffic"] / (trucks * 60.0 * minutes)
    return count / minutes * 60.0, summary.count.deadlocks, waiting


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/figures/throughput.png"))
    parser.add_argument("--minutes", type=float, default=30.0)
    args = parser.parse_args()
    fleets, seeds = (2, 4, 8, 16, 24, 32, 40, 48, 56, 64), (1, 2)
    with tempfile.TemporaryDirectory() as name:
        found = [[passages(n, args.minutes, s, Path(name)) for s in seeds] for n in fleets]
    rate = np.array([[f[0] for f in row] for row in found])
    for n, row in zip(fleets, found, strict=True):
        print(n, "trucks:", ", ".join(f"{p:.0f}/h {d} deadlocks {100 * w:.0f} % waiting" for p, d, w in row))
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axis = plt.subplots(figsize=(7, 4))
    axis.plot(fleets, rate.mean(axis=1), "o-", color="#1f6feb")
    axis.fill_between(fleets, rate.min(axis=1), rate.max(axis=1), color="#1f6feb", alpha=0.2, lw=0)
    other = axis.twinx()
    other.plot(fleets, [100.0 * np.mean([f[2] for f in row]) for row in found], "s--", color="#d1242f", ms=4)
    other.set_ylabel("time spent waiting [%]", color="#d1242f")
    other.set_ylim(0, 100)
    axis.set(
        xlabel="trucks",
        ylabel="passages of the crossing per hour",
        ylim=(0, None),
        title="One crossing under load",
    )
    axis.grid(alpha=0.3)
    figure.tight_layout()
    args.output.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(args.output, dpi=130)


if __name__ == "__main__":
    main()

"""Whether p-values of clean recordings are uniform.

    python tests/benchmarks/p_values.py [COUNT]

Simulates COUNT (200) fleets of three trucks for 40 minutes with nothing concealed, diagnoses the battery power of each, and
compares the p-values of the strongest hypothesis, told or not, with a uniform distribution (Kolmogorov and Smirnov).
They count the model's own error as chance, so that they are conservative: few are small, and they are not uniform.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from scipy.stats import kstest

import fleetlog
from fleetlog import engines
from fleetlog.core.truck import load_truck
from fleetlog.discovery.diagnose import diagnose
from fleetlog.store import Dataset

SAMPLE = Path(__file__).parents[2] / "sample_data"


def clean(seed: int) -> tuple[float, int]:
    """The p-value of one clean recording, and how many findings were told."""
    with tempfile.TemporaryDirectory() as folder, engines.using(1):
        day = Path(folder) / "day"
        fleetlog.simulate(
            site=SAMPLE / "site.toml", truck=SAMPLE / "truck.toml", vehicles=3, duration="40min", seed=seed, rate=5.0,
            recording=False, output=day,
        )  # fmt: skip
        found = diagnose(Dataset(day), load_truck(SAMPLE / "truck.toml"), channels=("battery_power",)).verdict
        p = found.channels[0].p_value
        return 1.0 if p is None else p, len(found.findings)


def main() -> None:
    """One line a recording, and the test over all."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    values: list[float] = []
    for seed in range(count):
        p, told = clean(seed)
        values.append(p)
        print(f"seed {seed}: p = {p:.3f}, {told} told", flush=True)
    low = float(np.mean(np.array(values) < 0.05))
    print(
        f"{count} recordings: {low:.1%} below 0.05; uniform with p = {kstest(values, 'uniform').pvalue:.3f}"
    )


if __name__ == "__main__":
    main()

"""Is the confidence of a match the share of right edges?  Draws docs/figures/matching_reliability.png and prints its numbers.

python tests/benchmarks/matching_reliability.py [OUT.png]
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "matching"))
from worlds import aisle_grid, drive, wandering

from fleetlog.roads.matching import match

# rate [1/s], noise [m], memory of the noise [s]: 0 is independent from row to row
CASES = (
    (10.0, 0.5, 0.0),
    (10.0, 2.0, 0.0),
    (1.0, 0.5, 0.0),
    (1.0, 2.0, 0.0),
    (10.0, 1.0, 20.0),
    (1.0, 2.0, 20.0),
    (1.0, 1.0, 60.0),
)
BINS = np.array([0.0, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99, 1.0001])


def main(out: Path) -> None:
    network = aisle_grid()
    figure, axes = plt.subplots(figsize=(5.2, 5.0), layout="constrained")
    axes.plot([0, 1], [0, 1], color="0.7", lw=1, label="perfect")
    for rate, noise, memory in CASES:
        sure, hit = [], []
        for seed in range(12):
            track, edges, _ = drive(network, 10_000, rate, 0.0 if memory else noise, 100 + seed)
            if memory:
                track = wandering(track, rate, noise, memory, seed)
            found = match(track, network)
            sure.append(found.confidence)
            hit.append(found.edge == edges)
        confidence, right = np.concatenate(sure), np.concatenate(hit)
        which = np.digitize(confidence, BINS) - 1
        rows = np.bincount(which, minlength=len(BINS) - 1)
        kept = rows >= 100
        x = (np.bincount(which, confidence, len(BINS) - 1) / np.maximum(rows, 1))[kept]
        y = (np.bincount(which, right, len(BINS) - 1) / np.maximum(rows, 1))[kept]
        gap = float(np.sum(np.abs(x - y) * rows[kept]) / rows[kept].sum())
        name = f"{rate:g} Hz, {noise:g} m" + (f" lasting {memory:g} s" if memory else "")
        axes.plot(x, y, "o--" if memory else "o-", ms=4, lw=1.2, label=f"{name}: off by {gap:.3f}")
        print(f"{name}: right {right.mean():.3f}, stated {confidence.mean():.3f}, mean distance {gap:.3f}")
    axes.set(
        xlabel="stated confidence",
        ylabel="share of rows on the right directed edge",
        xlim=(0, 1.01),
        ylim=(0, 1.01),
    )
    axes.legend(loc="upper left", frameon=False, fontsize=8)
    out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(out, dpi=130)


if __name__ == "__main__":
    main(
        Path(sys.argv[1])
        if len(sys.argv) > 1
        else Path(__file__).parents[2] / "docs" / "figures" / "matching_reliability.png"
    )

"""How near a simulated fleet comes to the recording that it is like: Kolmogorov-Smirnov distances of its trips.

    python tests/benchmarks/as_recorded.py RECORDED TRUCK [--duration 30m] [--seeds 3]

Prints a line of Markdown a quantity: means, and the distance between the recorded distribution and that of
all seeds together; beside it the distance between two halves of the recorded trips, which no simulation can
be expected to beat by much.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
from scipy.stats import ks_2samp

import fleetlog
from fleetlog.store import Dataset

SHORTEST = 10.0
WAIT = 3.0
"""A trip is this long at least [m]; a shorter standstill is no wait [s]."""
NAMES = ("distance [m]", "travel time [s]", "waiting [s]", "time at the place [s]", "energy [Wh]")


def trips(path: Path) -> np.ndarray:
    """(N, 5) of every trip, in the order of NAMES; energy of the driving, NaN where it was not recorded."""
    out = []
    dataset = Dataset(path)
    for vehicle in dataset.vehicles:
        t = dataset.read(vehicle)
        ids, time = t.trip_ids(), t.time * 1e-6
        speed, power = np.nan_to_num(t.floats("speed")), t.floats("battery_power")
        power = power if len(power) == len(t) else np.full(len(t), np.nan)
        begin = np.flatnonzero(np.diff(ids, prepend=ids[0] - 1))
        for a, b in zip(begin, np.append(begin[1:], len(t)), strict=True):
            dt = np.append(np.diff(time[a:b]), 0.0).clip(0.0, 60.0)
            moves = np.flatnonzero(speed[a:b] > 0.2)
            if len(moves):
                way = slice(0, moves[-1] + 1)
                energy = float((power[a:b] * dt)[way].sum()) / 3600.0
                waits = standing(speed[a:b][way] <= 0.2, dt[way])
                out.append(((speed[a:b] * dt).sum(), dt[way].sum(), waits, dt[way.stop :].sum(), energy))
    table = np.array(out)
    return table[table[:, 0] >= SHORTEST]


def standing(still: np.ndarray, dt: np.ndarray) -> float:
    """Seconds of the standstills of WAIT at least."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]]))).reshape(-1, 2)
    return sum(s for a, b in edges if (s := float(dt[a:b].sum())) >= WAIT)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("recorded", type=Path)
    parser.add_argument("truck")
    parser.add_argument("--duration", default="30m")
    parser.add_argument("--seeds", type=int, default=3)
    args = parser.parse_args()
    recorded, found = trips(args.recorded), []
    with tempfile.TemporaryDirectory() as scratch:
        for seed in range(args.seeds):
            out = Path(scratch) / str(seed)
            same = {"like": args.recorded, "truck": args.truck, "duration": args.duration, "seed": seed}
            fleetlog.simulate(**same, shadow=False, recording=False, output=out)
            found.append(trips(out))
    both, halves = np.concatenate(found), np.random.default_rng(0).permutation(len(recorded))
    print(f"{len(recorded)} trips recorded, {len(both)} simulated")
    for k, name in enumerate(NAMES):
        a, b = (v[np.isfinite(v[:, k]), k] for v in (recorded, both))
        half = recorded[halves, k][np.isfinite(recorded[halves, k])]
        chance = ks_2samp(half[::2], half[1::2]).statistic
        print(f"| {name} | {a.mean():.1f} | {b.mean():.1f} | {ks_2samp(a, b).statistic:.3f} | {chance:.3f} |")


if __name__ == "__main__":
    main()

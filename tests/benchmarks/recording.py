"""Size, processor time and memory of a recording: ``python tests/benchmarks/recording.py [VEHICLES HOURS HZ RATE]``.

Prints one line; the fleet drives round a block and stands a quarter of the time;
positions carry 1 cm of noise, powers 50 W, so that nothing is equal to its neighbour.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "view"))

import numpy as np
from fixtures_view import drive, plant

from fleetlog.core.trajectory import Trajectory
from fleetlog.store import DatasetWriter
from fleetlog.view.recording import RATE, write_recording

NOISE = {"x": 0.01, "y": 0.01, "heading": 0.01, "battery_power": 50.0}


def main(vehicles: int = 20, hours: float = 8.0, hz: float = 10.0, rate: float = RATE) -> None:
    site, rng = plant(), np.random.default_rng(1)
    with tempfile.TemporaryDirectory() as folder:
        dataset, out = Path(folder) / "d", Path(folder) / "r.rrd"
        with DatasetWriter.create(dataset, "simulated", site) as writer:
            shape = drive(site, "v", 0.0, hz=hz, seconds=3600.0 * hours)
            for i in range(vehicles):
                noisy = {c: shape.floats(c) + rng.normal(0, s, len(shape)) for c, s in NOISE.items()}
                writer.write(Trajectory(f"T{i:03d}", shape.time + 250_000 * i, {**shape.columns, **noisy}))
        before, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
        write_recording(dataset, out, rate_hz=rate)
        spent, peak = time.process_time() - start, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        rows, size = vehicles * len(shape), out.stat().st_size
        print(
            f"{vehicles} vehicles, {hours:g} h, {hz:g} Hz in, {rate:g} Hz out: {rows:,} rows, {spent:.1f} s of processor, "
            f"{size / 1e6:.1f} MB, {size / (vehicles * hours * 3600 * rate):.1f} B a vehicle-sample, "
            f"peak {peak / 1024:.0f} MB (before {before / 1024:.0f} MB)"
        )


if __name__ == "__main__":
    numbers = [float(a) for a in sys.argv[1:]]
    main(*([int(numbers[0]), *numbers[1:]] if numbers else []))

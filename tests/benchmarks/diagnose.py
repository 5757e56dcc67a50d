"""Time and memory of ``fleetlog diagnose`` by the number of rows.

    python tests/benchmarks/diagnose.py [TERM] [MILLION]

Records a plant with tests/blind/recorder.py (two and a half hours a truck and day), imports it, and diagnoses it in a process
of its own: CPU and wall seconds, and the largest resident set, for about 43 000, 200 000 and 1 000 000 rows.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "blind"))

SIZES = {"43k": (4, 1), "200k": (6, 4), "1M": (14, 8)}
"""Vehicles and days."""


def measured(call: list[str]) -> tuple[str, float, float, float]:
    """Output, CPU s, wall s and peak resident MB of a process."""
    begin = time.time()
    process = subprocess.Popen(call, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    text = process.stdout.read()
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"{' '.join(call)} failed")
    return text, usage.ru_utime + usage.ru_stime, time.time() - begin, usage.ru_maxrss / 1024.0


def main() -> None:
    """One line a size."""
    from recorder import record

    term = sys.argv[1] if len(sys.argv) > 1 else "grade"
    sizes = sys.argv[2:] or list(SIZES)
    print(
        "| rows | vehicle-days | CPU s | wall s | peak MB | verdict |\n| --- | --- | --- | --- | --- | --- |"
    )
    for name in sizes:
        vehicles, days = SIZES[name]
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(scratch)
            record(f"{term},seed=11,vehicles={vehicles},days={days}", folder)
            rows = json.loads((folder / "key.json").read_text())["rows"]
            tool = [sys.executable, "-m", "fleetlog"]
            site, log, data = (str(folder / f) for f in ("site.toml", "recorded.csv.gz", "data"))
            subprocess.run([*tool, "import", log, "--site", site, "-o", data, "-q"], check=True)
            truck = str(folder / "truck.toml")
            text, cpu, wall, peak = measured(
                [*tool, "diagnose", data, "--truck", truck, "-o", str(folder / "out"), "--json", "-q"]
            )
            found = ", ".join(f["term"] for f in json.loads(text)["findings"]) or "none"
            print(
                f"| {rows:,} | {vehicles * days} | {cpu:.1f} | {wall:.1f} | {peak:.0f} | {found} |",
                flush=True,
            )


if __name__ == "__main__":
    main()

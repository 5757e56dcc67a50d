"""Run the blind benchmark and print its table.

python table.py RESULTS.jsonl FIRST LAST [TERM ...]     record, import, diagnose and judge; one line a recording is appended
python table.py RESULTS.jsonl                           the table of what is there
"""

from __future__ import annotations

import collections
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from effects import OUTSIDE, TERMS
from recorder import record
from score import judge, overlap, parameters


def one(name: str, seed: int, strength: float = 1.0) -> dict[str, object]:
    """Record, import, diagnose and judge one case."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        record(name, seed, folder, strength)
        log, site, data = str(folder / "recorded.csv.gz"), str(folder / "site.toml"), str(folder / "data")
        subprocess.run(
            ["fleetlog", "import", log, "--site", site, "-o", data, "-q"], check=True, capture_output=True
        )
        begin = time.time()
        call = [
            "fleetlog",
            "diagnose",
            data,
            "--truck",
            str(folder / "truck.toml"),
            "-o",
            str(folder / "out"),
            "--json",
            "-q",
        ]
        done = subprocess.run(call, capture_output=True, text=True)
        key = json.loads((folder / "key.json").read_text())
        if done.returncode:
            return {"name": name, "seed": seed, "word": "crashed", "error": done.stderr[-500:]}
        found = json.loads(done.stdout)
    terms = [
        f"{f['term']}({','.join(f['depends_on'])})" if f["term"] == "unknown" else f["term"]
        for f in found["findings"]
    ]
    return {
        "name": name, "seed": seed, "word": judge(key, found), "named": terms, "not_excluded": [f["not_excluded"] for f in found["findings"]],
        "parameters": parameters(key, found), "overlap": overlap(key, found), "channels": found["channels"], "seconds": time.time() - begin,
    }  # fmt: skip


def table(path: Path) -> None:
    """One row a term."""
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    by: dict[str, list[dict]] = collections.defaultdict(list)
    for r in rows:
        by[r["name"]].append(r)
    words = ("right", "undecided", "extra", "partly", "missed", "wrong", "false alarm", "crashed")
    print(
        "| concealed | n | " + " | ".join(words) + " | median error of the number | in its interval | roads |"
    )
    print("|" + " --- |" * (len(words) + 5))
    inside_all: list[bool] = []
    for name, group in by.items():
        count = collections.Counter(r["word"] for r in group)
        numbers = [p for r in group for p in r.get("parameters", [])]
        error = [abs(p["value"] - p["truth"]) / max(abs(p["truth"]), 1e-9) for p in numbers]
        inside = [p["low"] <= p["truth"] <= p["high"] for p in numbers]
        inside_all += inside
        places = [
            r["overlap"] for r in group if r.get("overlap") is not None and r["word"] in ("right", "extra")
        ]
        print(
            f"| {name} | {len(group)} | " + " | ".join(str(count[w] or "") for w in words)
            + f" | {f'{100 * np.median(error):.1f} %' if error else ''} | {f'{sum(inside)}/{len(inside)}' if inside else ''}"
            + f" | {f'{np.mean(places):.2f}' if places else ''} |"
        )  # fmt: skip
    print(f"\nintervals hold the truth: {sum(inside_all)} of {len(inside_all)}")


def main() -> None:
    """See the module's own words."""
    path = Path(sys.argv[1])
    if len(sys.argv) > 3:
        names = sys.argv[4:] or ["none", *TERMS, *OUTSIDE]
        for seed in range(int(sys.argv[2]), int(sys.argv[3])):
            for name in names:
                with path.open("a") as out:
                    out.write(json.dumps(one(name, seed)) + "\n")
    table(path)


if __name__ == "__main__":
    main()

"""Run the blind benchmark and print its table.

python table.py RESULTS.jsonl FIRST LAST [TERM ...]     record, import, diagnose and judge; one line a recording is appended
python table.py RESULTS.jsonl                           the table of what is there

Recordings are kept in a folder beside RESULTS.jsonl, so that the same ones can be diagnosed again.  A term may be several
joined by ``+``, and ``@0.4`` at its end makes the effects weaker.  The floor of a recording is the error of its clean twin: the same drives without the effect.
"""

from __future__ import annotations

import collections
import json
import sys
import time
import traceback
from pathlib import Path

import numpy as np
from effects import OUTSIDE, TERMS
from recorder import record
from score import judge, overlap, parameters

from fleetlog.cli.main import cli as fleetlog
from fleetlog.core.truck import load_truck
from fleetlog.discovery.diagnose import diagnose
from fleetlog.store import Dataset

NOTICED = 0.1
"""Share of the held-out error that the true term removes where an effect must be named."""


def one(name: str, seed: int, recordings: Path) -> dict[str, object]:
    """Record and import (unless that was done before), diagnose and judge one case."""
    folder = recordings / f"{name}_{seed}"
    if not (folder / "data" / "dataset.json").exists():
        terms, _, strength = name.partition("@")
        record(terms, seed, folder, float(strength or 1.0))
        log, site = str(folder / "recorded.csv.gz"), str(folder / "site.toml")
        call = [
            "import",
            log,
            "--site",
            site,
            "-o",
            str(folder / "data"),
            "-q",
            "--no-recording",
            "--overwrite",
        ]
        fleetlog(call, standalone_mode=False)
    key = json.loads((folder / "key.json").read_text())
    begin = time.process_time()
    try:
        found = diagnose(Dataset(folder / "data"), load_truck(str(folder / "truck.toml"))).verdict.document()
    except Exception:
        return {"name": name, "seed": seed, "word": "crashed", "error": traceback.format_exc()[-800:]}
    terms = [
        f"{f['term']}({','.join(f['depends_on'])})" if f["term"] == "unknown" else f["term"]
        for f in found["findings"]
    ]
    return {
        "name": name, "seed": seed, "word": judge(key, found), "named": terms, "not_excluded": [f["not_excluded"] for f in found["findings"]],
        "parameters": parameters(key, found), "overlap": overlap(key, found), "channels": found["channels"],
        "seconds": time.process_time() - begin,
    }  # fmt: skip


WORDS = ("right", "undecided", "extra", "partly", "missed", "wrong", "false alarm", "crashed")
CHANNEL = dict.fromkeys(
    ("speed_zone", "cornering_speed", "laden_speed", "acceleration_limit", "waiting"), "speed"
) | {"battery_resistance": "soc"}


def noticeable(row: dict, floors: dict[int, dict[str, float]]) -> bool:
    """Whether the true term would lower the held-out error of its channel by ``NOTICED``."""
    if row["name"].partition("@")[0] in ("none", "clock_offset", "speed_scale"):
        return True
    for channel in row.get("channels", []):
        floor = floors.get(row["seed"], {}).get(channel["name"])
        if floor is not None and floor < (1.0 - NOTICED) * channel["before"]:
            return True
    return False


def table(path: Path) -> None:
    """One row a term."""
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    rows = list({(r["name"], r["seed"]): r for r in rows}.values())
    floors = {
        r["seed"]: {c["name"]: c["before"] for c in r.get("channels", [])}
        for r in rows
        if r["name"] == "none"
    }
    by: dict[str, list[dict]] = collections.defaultdict(list)
    for r in rows:
        by[r["name"]].append(r)
    print(
        "| concealed | n | noticeable | " + " | ".join(WORDS)
        + " | error of the number, median | in its interval | roads | held-out error before, after, floor | CPU s |"
    )  # fmt: skip
    print("|" + " --- |" * (len(WORDS) + 8))
    inside_all: list[bool] = []
    for name, group in sorted(by.items(), key=lambda kv: _order(kv[0])):
        inside_all += _row(name, group, floors)
    _bars(rows, floors, inside_all)


def _row(name: str, group: list[dict], floors: dict[int, dict[str, float]]) -> list[bool]:
    count = collections.Counter(r["word"] for r in group)
    numbers = [p for r in group for p in r.get("parameters", [])]
    error = [abs(p["value"] - p["truth"]) / max(abs(p["truth"]), 1e-9) for p in numbers]
    inside = [p["low"] <= p["truth"] <= p["high"] for p in numbers]
    places = [r["overlap"] for r in group if r.get("overlap") is not None and r["word"] in ("right", "extra")]
    wanted = CHANNEL.get(name.partition("@")[0].split("+")[0], "battery_power")
    fits = [
        (c["before"], c["after"], floors[r["seed"]][wanted])
        for r in group
        for c in r.get("channels", [])
        if c["name"] == wanted and wanted in floors.get(r["seed"], {})
    ]
    shown = ", ".join(f"{v:.3f}" for v in np.median(np.array(fits), axis=0)) if fits else ""
    print(
        f"| {name} | {len(group)} | {sum(noticeable(r, floors) for r in group)} | " + " | ".join(str(count[w] or "") for w in WORDS)
        + f" | {f'{100 * np.median(error):.1f} %' if error else ''} | {f'{sum(inside)}/{len(inside)}' if inside else ''}"
        + f" | {f'{np.mean(places):.2f}' if places else ''} | {shown} | {np.median([r.get('seconds', 0.0) for r in group]):.1f} |"
    )  # fmt: skip
    return inside


def _order(name: str) -> int:
    names = ["none", *TERMS, *OUTSIDE]
    whole = name.partition("@")[0]
    return (names.index(whole) if whole in names else len(names)) + len(names) * ("@" in name)


def _bars(rows: list[dict], floors: dict[int, dict[str, float]], inside: list[bool]) -> None:
    """The figures that are asked for."""
    clean = [r for r in rows if r["name"] == "none"]
    faulty = [r for r in rows if r["name"] != "none" and noticeable(r, floors)]
    if clean:
        alarms = sum(r["word"] != "right" for r in clean)
        print(f"\nfalse alarms: {alarms} of {len(clean)} ({alarms / len(clean):.1%})")
    if faulty:
        named = sum(r["word"] in ("right", "extra") for r in faulty)
        certain = sum(_certain_and_wrong(r) for r in faulty)
        exact = sum(r["word"] == "right" for r in faulty)
        print(f"of {len(faulty)} noticeable effects: named {named / len(faulty):.1%}, exactly so {exact / len(faulty):.1%}, "
              f"certain and wrong {certain / len(faulty):.1%}")  # fmt: skip
    print(f"intervals hold the truth: {sum(inside)} of {len(inside)}")


def _certain_and_wrong(row: dict) -> bool:
    """Whether any term is named that is not true and nothing beside it is left possible."""
    truth = set(row["name"].partition("@")[0].split("+"))
    named = zip(row.get("named", []), row.get("not_excluded", []), strict=True)
    return any(
        not n.startswith("unknown") and n not in truth and not truth & set(others) for n, others in named
    )


def confusion(path: Path) -> None:
    """What was named for what was concealed."""
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    rows = list({(r["name"], r["seed"]): r for r in rows}.values())
    for name in sorted({r["name"] for r in rows}, key=_order):
        said: collections.Counter[str] = collections.Counter()
        for r in rows:
            if r["name"] == name:
                said[", ".join(sorted(r.get("named", [r["word"]]))) or "nothing"] += 1
        print(f"| {name} | " + "; ".join(f"{k}: {v}" for k, v in said.most_common()) + " |")


def main() -> None:
    """See the module's own words."""
    path = Path(sys.argv[1])
    if len(sys.argv) > 3:
        names = sys.argv[4:] or ["none", *TERMS, *OUTSIDE]
        for seed in range(int(sys.argv[2]), int(sys.argv[3])):
            for name in names:
                line = json.dumps(one(name, seed, path.parent / "recordings"))
                with path.open("a") as out:
                    out.write(line + "\n")
    table(path)
    confusion(path)


if __name__ == "__main__":
    main()

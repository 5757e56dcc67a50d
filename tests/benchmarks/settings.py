"""Which answers of the diagnosis change when one of its settings is moved by 30 %.

    python tests/benchmarks/settings.py OUT.jsonl CASE|FAMILY ... [--seeds 4000..4000] [--keep FOLDER]
    python tests/benchmarks/settings.py OUT.jsonl

Records the cases of tests/blind (or takes them from FOLDER), diagnoses each with the settings as they are, and with each
of them 30 % smaller and larger.  A line of OUT.jsonl is one case with one setting; what OUT.jsonl holds is not run again.
Then, or alone where no case is given, the table: settings that change no answer are not needed, and one that changes
many should be measured from the recording.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
sys.path.insert(0, str(Path(__file__).parents[1] / "blind"))

from run import chosen, read, recorded
from score import judge

from fleetlog import engines
from fleetlog.core.truck import load_truck
from fleetlog.discovery.diagnose import diagnose
from fleetlog.discovery.settings import SETTINGS, Settings
from fleetlog.store import Dataset

BY = 0.3


def moved(name: str, up: bool) -> Settings:
    """The settings with one of them moved; a whole number by one at least."""
    now = getattr(SETTINGS, name)
    new = now * (1.0 + BY if up else 1.0 - BY)
    if isinstance(now, int):
        new = max(round(new), now + 1) if up else min(round(new), now - 1)
    return replace(SETTINGS, **{name: new})


def answer(folder: Path, settings: Settings) -> dict[str, Any]:
    """What is told of a recording, and what the key thinks of it."""
    truck, key = load_truck(folder / "truck.toml"), json.loads((folder / "key.json").read_text())
    found = diagnose(Dataset(folder / "data"), truck, settings=settings).verdict.document()
    told = sorted(
        f["term"] + "".join(f" of {v}" for v in f["scope"]["vehicles"] or ()) for f in found["findings"]
    )
    return {"told": told, "verdict": found["verdict"], "word": judge(key, found)}


def run(out: Path, folders: dict[str, Path]) -> None:
    """Add the answers that ``out`` does not hold yet."""
    done = {(row["case"], row["setting"], row["up"]) for row in rows(out)}
    tried = [("", False), *((name, up) for name in asdict(SETTINGS) for up in (False, True))]
    for case, folder in folders.items():
        for name, up in tried:
            if (case, name, up) in done:
                continue
            said = answer(folder, moved(name, up) if name else SETTINGS)
            with out.open("a") as file:
                file.write(json.dumps({"case": case, "setting": name, "up": up, **said}) + "\n")


def rows(out: Path) -> list[dict[str, Any]]:
    """The lines of a file that may not exist."""
    return [json.loads(line) for line in out.read_text().splitlines()] if out.exists() else []


def table(out: Path) -> None:
    """By setting: how many answers change each way, which become right and which wrong."""
    found = {(r["case"], r["setting"], r["up"]): r for r in rows(out)}
    cases = sorted({case for case, *_ in found})
    print(f"{len(cases)} cases\n\n| setting | value | 30 % less | 30 % more | what changes |")
    print("| --- | --- | --- | --- | --- |")
    for name, value in asdict(SETTINGS).items():
        counts, words = [], []
        for up in (False, True):
            pairs = [(c, found[c, "", False], found[c, name, up]) for c in cases if (c, name, up) in found]
            other = [p for p in pairs if (p[1]["told"], p[1]["verdict"]) != (p[2]["told"], p[2]["verdict"])]
            counts.append(f"{len(other)} of {len(pairs)}")
            words += [f"{c} {'+' if up else '-'}: {a['word']}, then {b['word']}" for c, a, b in other]
        print(f"| {name} | {value:g} | {counts[0]} | {counts[1]} | {'; '.join(words)} |")


def main() -> None:
    """See the module's own words."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("out", type=Path)
    words.add_argument("what", nargs="*")
    words.add_argument("--seeds", default="4000..4000")
    words.add_argument("--keep", type=Path)
    given = words.parse_args()
    first, _, last = given.seeds.partition("..")
    with tempfile.TemporaryDirectory() as scratch, engines.using(1):
        folders = {}
        for case in chosen(given.what, range(int(first), int(last or first) + 1)):
            folder = folders[case.name] = (given.keep or Path(scratch)) / case.name
            recorded(case, folder)
            if not (folder / "data").exists():
                read(case, folder)
        run(given.out, folders)
    table(given.out)


if __name__ == "__main__":
    main()

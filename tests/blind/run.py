"""Record, import, diagnose: one line of JSON a case.

    python run.py OUT.jsonl FAMILY|CASE ... [--seeds 4000..4004] [--jobs 2] [--keep FOLDER]

FAMILY is one of clean, ladders, mixtures, loggers, sites, scopes, wrong_truck, traffic (by SUMO) and engine (by
MuJoCo), or ``all`` but these two; a CASE is written as in cases.py.  Cases that OUT.jsonl holds are not run again.
``table.py`` judges the lines, so that a change of the rules needs no new run.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import tempfile
import time
import traceback
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import itertools

import recorder
import traffic
from cases import FAMILIES, Case, family

from fleetlog.cli.main import cli as fleetlog
from fleetlog.errors import FleetlogError


def run(case: Case, folder: Path) -> dict[str, Any]:
    """Record (unless that was done before), import and diagnose one case."""
    out: dict[str, Any] = {"case": case.name, "family": case.family}
    clock = [time.process_time()]
    try:
        out["key"] = recorded(case, folder)
        clock.append(time.process_time())
        read(case, folder)
        clock.append(time.process_time())
        truck = ["--truck", str(folder / "truck.toml"), "-o", str(folder / "diagnosis")]
        _call("diagnose", str(folder / "data"), *truck, "-q", "--overwrite")
        clock.append(time.process_time())
        out["found"] = compact(json.loads((folder / "diagnosis" / "diagnosis.json").read_text()))
    except (Exception, SystemExit) as error:
        out["error"] = _words(error)
    out["seconds"] = [round(b - a, 2) for a, b in itertools.pairwise(clock)]
    return out


def recorded(case: Case, folder: Path) -> dict[str, Any]:
    """The key of a case, which is recorded unless that was done before."""
    done = folder / "key.json"
    record = traffic.record if case.site == "grid" else recorder.record
    return json.loads(done.read_text()) if done.exists() else record(case, folder)


def read(case: Case, folder: Path) -> None:
    """Import what was recorded."""
    site = [] if case.site == "none" else ["--site", str(folder / "site.toml")]
    given = [str(folder / "recorded.csv.gz"), *site, "-o", str(folder / "data")]
    _call("import", *given, "-q", "--no-recording", "--overwrite")


def compact(found: dict[str, Any]) -> dict[str, Any]:
    """A diagnosis without what no judgement needs."""
    for f in found["findings"]:
        f.get("evidence", {}).pop("alternatives", None)
        if f.get("where"):
            f["where"]["edges"] = [{k: e.get(k) for k in ("edge_id", "value")} for e in f["where"]["edges"]]
    return found


def _call(*arguments: str) -> None:
    fleetlog(list(arguments), standalone_mode=False)


def _words(error: BaseException) -> str:
    if isinstance(error, FleetlogError):
        return f"{type(error).__name__}: {error}"
    return traceback.format_exc()[-1500:]


def chosen(names: list[str], seeds: range) -> list[Case]:
    """Cases by family or by their own names."""
    out: list[Case] = []
    for name in [f for f in FAMILIES if f not in ("traffic", "engine")] if names == ["all"] else names:
        if name in FAMILIES:
            out += family(name, seeds)
        else:
            case = Case.parse(name)
            out += [case] if case.seed else [replace(case, seed=s) for s in seeds]
    return out


def _work(case: Case, keep: Path | None) -> str:
    folder = keep / case.name if keep else Path(tempfile.mkdtemp(prefix="blind-"))
    try:
        return json.dumps(run(case, folder))
    finally:
        if not keep:
            shutil.rmtree(folder, ignore_errors=True)


def main() -> None:
    """See the module's own words."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("out", type=Path)
    words.add_argument("what", nargs="+")
    words.add_argument("--seeds", default="4000..4000")
    words.add_argument("--jobs", type=int, default=1)
    words.add_argument("--keep", type=Path)
    given = words.parse_args()
    first, _, last = given.seeds.partition("..")
    cases = chosen(given.what, range(int(first), int(last or first) + 1))
    done = (
        {json.loads(line)["case"] for line in given.out.read_text().splitlines()}
        if given.out.exists()
        else set()
    )
    todo = [c for c in cases if c.name not in done]
    with ProcessPoolExecutor(given.jobs) as pool, given.out.open("a") as out:
        waiting = [pool.submit(_work, case, given.keep) for case in todo]
        for k, one in enumerate(waiting):
            out.write(one.result() + "\n")
            out.flush()
            print(f"{k + 1} of {len(todo)}: {todo[k].name}", flush=True)


if __name__ == "__main__":
    main()

"""Poorer versions of a recording that was not made here: what a fleet may lack.

    python degrade.py FOLDER [LACK ...]

FOLDER holds recorded.csv.gz, site.toml and truck.toml; what is diagnosed is printed.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import polars as pl

from fleetlog.cli.main import cli as fleetlog
from fleetlog.core.truck import load_truck
from fleetlog.discovery.diagnose import diagnose
from fleetlog.errors import FleetlogError
from fleetlog.store import Dataset

LACKS = ("nothing", "network", "load", "power", "rows", "vehicles")
"""No road network; no payload and fork height; no battery power; four of five rows; all vehicles but one."""
COLUMNS = {"load": ["payload", "fork_height"], "power": ["battery_power"]}


def degrade(recorded: Path, lack: str, out: Path) -> None:
    """Write ``recorded`` (csv.gz) without what it lacks to ``out`` (csv); the import drops the network."""
    log = pl.read_csv(recorded, infer_schema=False).drop(COLUMNS.get(lack, []))
    if lack == "rows":
        log = log.filter(pl.int_range(pl.len()).over("vehicle_id") % 5 == 0)
    if lack == "vehicles":
        log = log.filter(pl.col("vehicle_id") == pl.col("vehicle_id").first())
    log.write_csv(out)


def diagnosed(folder: Path, lack: str) -> dict[str, Any]:
    """The diagnosis of a recording without what it lacks."""
    return diagnosed_as(folder, lambda log: degrade(folder / "recorded.csv.gz", lack, log), lack != "network")


def diagnosed_as(folder: Path, write: Callable[[Path], None], mapped: bool = True) -> dict[str, Any]:
    """The diagnosis of a recording as it is written to a log, imported as the command does."""
    with tempfile.TemporaryDirectory() as scratch:
        log, data = Path(scratch) / "log.csv", Path(scratch) / "data"
        write(log)
        site = ["--site", str(folder / "site.toml")] if mapped else []
        fleetlog(["import", str(log), *site, "-o", str(data), "-q", "--no-recording"], standalone_mode=False)
        return diagnose(Dataset(data), load_truck(str(folder / "truck.toml"))).verdict.document()


def line(found: dict[str, Any]) -> str:
    """Terms with what is not excluded, numbers, and the held-out errors."""
    says = []
    for f in found["findings"]:
        name = f["term"] if f["term"] != "unknown" else f"unknown({','.join(f['depends_on'])})"
        number = "".join(f" {p['value']:.3g} [{p['low']:.3g}, {p['high']:.3g}]" for p in f["parameters"][:1])
        says.append(name + number + (f" or {'/'.join(f['not_excluded'])}" if f["not_excluded"] else ""))
    errors = ", ".join(f"{c['name']} {c['before']:.3f}>{c['after']:.3f}" for c in found["channels"])
    return f"{'; '.join(says) or 'none'} | {errors}"


def main(every: Iterable[str], diagnosed: Callable[[Path, str], dict[str, Any]]) -> None:
    """Print what is diagnosed of a folder in the cases that are asked for."""
    folder = Path(sys.argv[1])
    for case in sys.argv[2:] or every:
        try:
            print(f"| {folder.name} | {case} | {line(diagnosed(folder, case))} |", flush=True)
        except FleetlogError as error:
            print(f"| {folder.name} | {case} | {error} |", flush=True)


if __name__ == "__main__":
    main(LACKS, diagnosed)

"""A recorder for blind tests: trucks and drivers on a site at 20 Hz, seen through a logger, and a key.

It shares no code with the model that it tests: another integrator, another rounding of corners, drivers
who differ and are slowed by others at random, loads that are mis-weighed, trucks that differ, power that is
filtered and noisy.

    python recorder.py CASE FOLDER        for CASE see cases.py
"""

from __future__ import annotations

import gzip
import io
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from cases import Case
from effects import Effect
from key import START, key_of
from observe import Seen, observe
from shifts import Legs, shift
from world import World, world


def record(case: Case | str, folder: Path, given: list[Effect] | None = None) -> dict[str, Any]:
    """Write ``recorded.csv.gz``, ``truck.toml``, ``key.json`` and the site; return the key.

    ``given`` effects are concealed in place of drawn ones.
    """
    w = world(Case.parse(case) if isinstance(case, str) else case, given)
    log, seen, legs = play(w)
    key = key_of(w, seen, legs, log.height)
    folder.mkdir(parents=True, exist_ok=True)
    w.site.write(folder)
    w.file.write(folder / "truck.toml")
    write_log(log, folder / "recorded.csv.gz")
    (folder / "key.json").write_text(json.dumps(key, indent=1))
    return key


def play(w: World) -> tuple[pl.DataFrame, list[Seen], list[Legs]]:
    """The log of all trucks and days, and what an oracle would know of it.

    Drives and noise have streams of their own, so that the clean recording of a seed has the same drives.
    """
    tables, seen, legs = [], [], []
    for vehicle in range(w.case.vehicles):
        own = w.truck.own(np.random.default_rng([w.case.seed, 7, vehicle]))
        for day in range(w.case.days):
            motion, driven = shift(w, vehicle, day, np.random.default_rng([w.case.seed, 8, vehicle, day]))
            noise = np.random.default_rng([w.case.seed, 9, vehicle, day])
            table, rows = observe(w, motion, own, vehicle, noise)
            tables.append(table)
            seen.append(rows)
            legs.append(driven)
    return pl.concat(tables).sort("timestamp", "vehicle_id", maintain_order=True), seen, legs


def write_log(log: pl.DataFrame, file: Path) -> None:
    """Write a compressed CSV, the same bytes for the same log."""
    text = io.BytesIO()
    stamp = pl.from_epoch(pl.col("timestamp") + START.astype(int), time_unit="ms")
    log.with_columns(stamp.dt.strftime("%Y-%m-%dT%H:%M:%S%.3fZ").alias("timestamp")).write_csv(text)
    with gzip.GzipFile(file, "wb", compresslevel=1, mtime=0) as out:
        out.write(text.getvalue())


if __name__ == "__main__":
    record(sys.argv[1], Path(sys.argv[2]))

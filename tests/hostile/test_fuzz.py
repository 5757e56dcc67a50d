"""Mutants of every reader's files: rows or one line, never a fault (``fuzz.py`` makes as many as one likes)."""

from __future__ import annotations

import random
import tempfile
from pathlib import Path

import fuzz
import judge
import pytest
import seeds

import fleetlog
from fleetlog.errors import FleetlogError

MUTANTS, IMPORTS = 1000, 30
"""For each reader, and for a whole import of each format."""


@pytest.mark.slow
@pytest.mark.parametrize("name", fuzz.targets())
def test_mutants(name: str) -> None:
    with tempfile.TemporaryDirectory(dir=fuzz.quick_folder()) as folder:
        found = fuzz.fuzz(name, IMPORTS if fuzz.weight(name) < 1.0 else MUTANTS, 0, Path(folder))
    assert not found, "\n".join(found[:3])


def test_mutants_of_a_dataset() -> None:
    """A damaged file of a dataset is one line that names it, whatever is asked."""
    with tempfile.TemporaryDirectory(dir=fuzz.quick_folder()) as folder:
        log, out = Path(folder) / "a.csv", Path(folder) / "out"
        log.write_bytes(seeds.csv())
        judge.imported(log, Path(folder))
        files = [p for p in sorted(out.rglob("*")) if p.suffix in (".json", ".parquet")]
        assert len(files) == 5
        refused = 0
        for k in range(300):
            rng = random.Random(k)
            file = rng.choice(files)
            whole = file.read_bytes()
            file.write_bytes(fuzz.mutant(rng, whole))
            try:
                fleetlog.info(out)
                data = fleetlog.open(out)
                assert data.trips is not None and data.site is not None
                assert all(len(day) for day in data.days())
            except FleetlogError as error:
                refused += str(out) in error.line()
            file.write_bytes(whole)
        assert refused > 100

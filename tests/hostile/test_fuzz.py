"""Mutants of every reader's files: rows or one line, never a fault (``fuzz.py`` makes as many as one likes)."""

from __future__ import annotations

import tempfile
from pathlib import Path

import fuzz
import pytest

MUTANTS, IMPORTS = 1000, 50
"""For each reader, and for a whole import of each format."""


@pytest.mark.slow
@pytest.mark.parametrize("name", fuzz.targets())
def test_mutants(name: str) -> None:
    with tempfile.TemporaryDirectory(dir=fuzz.quick_folder()) as folder:
        found = fuzz.fuzz(name, IMPORTS if fuzz.weight(name) < 1.0 else MUTANTS, 0, Path(folder))
    assert not found, "\n".join(found[:3])

"""Mutants of every reader's files: rows or one line, never a fault (``fuzz.py`` makes as many as one likes)."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import fuzz
import pytest

MUTANTS, SECONDS = 1000, 40.0
"""For each reader, in so many seconds of processor time at most."""


@pytest.mark.slow
@pytest.mark.parametrize("name", fuzz.targets())
def test_mutants(name: str) -> None:
    begin = time.process_time()
    with tempfile.TemporaryDirectory(dir=fuzz.quick_folder()) as folder:
        for part in range(10):
            found = fuzz.fuzz(name, fuzz.share(name, MUTANTS // 10), part, Path(folder))
            assert not found, "\n".join(found[:3])
            if time.process_time() - begin > SECONDS:
                break

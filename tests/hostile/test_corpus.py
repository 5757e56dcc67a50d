"""Every broken and hostile file of the corpus meets the fate that it deserves."""

from __future__ import annotations

import re
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import corpus
import fuzz
import judge
import pytest
import seeds

LONGEST = 10.0
"""Seconds of processor time for one file; the bombs take one or two."""


@pytest.fixture(scope="module")
def folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(dir=fuzz.quick_folder()) as name:
        (Path(name) / "map.geojson").write_bytes(seeds.MAPS["map.geojson"])
        yield Path(name)


def verdict(case: corpus.Case, folder: Path) -> str | None:
    """What is wrong with the outcome of a case; None where nothing is."""
    path = folder / case.file
    path.write_bytes(case.data)
    begin = time.process_time()
    try:
        out = judge.read(path) if case.how == "read" else judge.settings(path)
    except Exception as error:
        return f"{case.name}: {type(error).__name__}: {error}"
    finally:
        path.unlink()
        if case.file == "map.geojson":
            path.write_bytes(seeds.MAPS["map.geojson"])
    wrong = []
    if out.status != case.status:
        wrong.append(f"status {out.status}, not {case.status}")
    if case.rows is not None and out.rows != case.rows:
        wrong.append(f"{out.rows} rows, not {case.rows}")
    if not re.search(case.says, out.text):
        wrong.append(f"does not say {case.says!r}")
    if "a fault in" in out.text:
        wrong.append("a fault of the reader")
    if time.process_time() - begin > LONGEST:
        wrong.append("too slow")
    return f"{case.name}: {'; '.join(wrong)} ({out.text[:300]})" if wrong else None


def test_every_file_meets_its_fate(folder: Path) -> None:
    cases = list(corpus.cases())
    assert len(cases) > 1000
    assert len({c.name for c in cases}) == len(cases)
    wrong = [w for case in cases if (w := verdict(case, folder))]
    assert not wrong, f"{len(wrong)} of {len(cases)}:\n" + "\n".join(wrong[:40])

"""A handful of the benchmark's cases, run as its script runs them."""

from __future__ import annotations

from pathlib import Path

import pytest
from cases import Case
from judged import judged
from run import run


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["none", "drivetrain_efficiency", "waiting", "auxiliary_load+grade", "lift_efficiency+wind", "warm_up"],
)
def test_concealed_effects_are_named(name: str, tmp_path: Path) -> None:
    row = judged(run(Case.parse(f"{name},seed=1002"), tmp_path))
    assert row["word"] == "right", row.get("error", row.get("found"))
    assert not row["faults"]

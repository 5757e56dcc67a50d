"""Effects that no term describes: what they follow, and a fitted expression that is marked as a proposal."""

from __future__ import annotations

from pathlib import Path

import pytest
from degrade import diagnosed
from effects import FOLLOWS
from recorder import record

SEEDS = {"warm_up": 61, "hour": 62, "low_charge": 63, "laden_fast": 64}


@pytest.mark.slow
@pytest.mark.parametrize("name", SEEDS)
def test_an_expression_is_proposed(name: str, tmp_path: Path) -> None:
    record(f"{name},seed={SEEDS[name]}", tmp_path)
    found = diagnosed(tmp_path, "nothing")
    assert found["verdict"] == "unknown"
    first = found["findings"][0]
    assert set(first["depends_on"]) & FOLLOWS[name]
    assert "proposed, and no more" in first["statement"]
    fitted = first["evidence"]["proposal_fit"]
    assert fitted["coefficient"]["low"] < fitted["coefficient"]["value"] < fitted["coefficient"]["high"]
    assert fitted["coefficient"]["unit"]
    assert fitted["kept"] > 0.6

"""The sample logs: five ways of logging one plant, a ramp that the map does not have, one truck without its power."""

from __future__ import annotations

from pathlib import Path

import pytest

import fleetlog

LONG, JUNCTION, RISE = 26.0, 3.0, 1.0  # Of the ramp in sample_data/make_plant.py [m]


def height(s: float) -> float:
    """Height [m] of the ramp at an offset along it: a smooth step between the junctions at its ends."""
    u = min(max((s - JUNCTION) / (LONG - 2.0 * JUNCTION), 0.0), 1.0)
    return RISE * u * u * (3.0 - 2.0 * u)


@pytest.mark.slow
def test_the_ramp_and_nothing_else(project_root: Path, tmp_path: Path) -> None:
    sample = project_root / "sample_data"
    fleetlog.read_logs(sample / "logs", site=sample / "site.toml", output=tmp_path / "recorded")
    answer = fleetlog.diagnose(
        tmp_path / "recorded",
        truck=sample / "truck.toml",
        channels=("battery_power", "soc"),
        output=tmp_path / "d",
    )
    found = answer.summary
    assert (found["verdict"], [f["term"] for f in found["findings"]]) == ("found", ["grade"])
    for e in found["findings"][0]["where"]["edges"]:
        assert e["edge_id"] == "ramp"
        assert e["low"] <= (height(e["to"]) - height(e["from"])) / (e["to"] - e["from"]) <= e["high"]
    assert any("T7" in note and "no battery power" in note for note in found["notes"])

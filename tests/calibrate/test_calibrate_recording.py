"""A recording whose truck is known: the plants of the shared data."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from fleetlog.calibrate.fit import calibrate
from fleetlog.cli.main import cli
from fleetlog.core.truck import load_truck


@pytest.mark.parametrize("case", ["none", "aux"])
def test_a_recorded_truck_lies_within_the_stated_intervals(
    shared_data: Path, tmp_path: Path, case: str
) -> None:
    folder = shared_data / "blind" / case
    key = json.loads((folder / "key.json").read_text())
    arguments = [
        str(folder / "recorded.csv.gz"),
        "--site",
        str(folder / "site.toml"),
        "-o",
        str(tmp_path / "day"),
    ]
    read = CliRunner().invoke(cli, ["import", *arguments, "--no-recording", "-q"])
    assert read.exit_code in (0, 3), read.output
    truck = load_truck(folder / "truck.toml")
    truth = truck.with_value("auxiliary.power", truck.auxiliary.power + key["effect"].get("aux", 0.0))
    found = {e.unknown.key: e for e in calibrate([tmp_path / "day"], truck).estimates}
    for name in ("auxiliary.power", "drive.efficiency", "resistance.rolling", "lift.efficiency"):
        assert found[name].status == "fitted", name
    for name, e in found.items():
        if e.status == "fitted":
            assert e.low <= truth.value(name) <= e.high, name
    # The truck has no drag and the runs are slow: no number may be printed for it.
    assert found["resistance.drag_area"].status != "fitted"
